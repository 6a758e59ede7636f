"""Error against cost of one scheme in one precision at one step, on one scene; and the file that such rows are kept in."""

import csv
import gc
import math
import pathlib
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np

from gmapspring.errors import DivergenceError
from gmapspring.integrators import INTEGRATORS, Limits
from tests.benchmarks.studies.precision_reference import Errors, Motion, motion_of
from tests.benchmarks.studies.precision_scenes import Scene

NAN = math.nan
DTYPES = (np.float64, np.float32)
FACTOR = 2.0
"""Between one step and the next shorter one."""
IMPLICIT_GROWTH = 1.5
"""Half of a step costs about so much more where equations are solved: those of short steps are easier."""
N_TRIAL = 20
"""Substeps by which the cost of a first run is told."""
STAGNATION = 0.8
"""An error that halving the step does not bring below this share of itself is as small as the precision allows."""
SMALL = 1e-3
"""Errors above this may stand still for a while and shrink later."""
LUCK = 2.0
"""Shorter steps may have errors so many times as large: round-off grows with their number."""
CHEAP = 0.1
"""Runs shorter than this are repeated [CPU s]."""
N_REPEATS = 3


class Budget(NamedTuple):
    """When to stop halving the step."""

    first_seconds: float
    """Of CPU, that the run with the longest step may take [s]."""
    seconds: float
    """Of CPU, that each run after it may take [s]."""
    error: float
    """An error small enough."""


class Row(NamedTuple):
    """One run."""

    scene: str
    scheme: str
    precision: str
    """"float64" or "float32"."""
    step: float
    """Longest step allowed [s]: the time is cut into equal ones."""
    share: float
    """This over the stable step of the scheme; over its default step where every step is stable."""
    n_substeps: int
    position_error: float
    """See Errors; NaN where there is no result."""
    strain_error: float
    cpu: float
    """CPU time per simulated second; NaN where not run."""
    note: str = ""
    """Why there is no result."""

    @property
    def error(self) -> float:
        """Return the larger error, by which a tolerance is judged; NaN if there is none."""
        return float(np.maximum(self.position_error, self.strain_error))

    @property
    def label(self) -> str:
        """Name scheme and precision."""
        return f"{self.scheme} {self.precision}"


class Contestant:
    """A scheme in a precision on a scene, ready to run with any step."""

    def __init__(self, scene: Scene, scheme: str, dtype: type):
        self.scene, self.scheme, self.dtype = scene, scheme, dtype
        self.simulation = scene.build(scheme, dtype)
        self.start = self.simulation.save_state()
        self.unit = self.simulation.stable_step if is_explicit(scheme) else self.simulation.default_step
        """What shares of steps refer to [s]."""

    def first_step(self) -> float:
        """Return the longest step to try [s]."""
        if is_explicit(self.scheme):
            return self.simulation.stable_step
        # Where every step is stable, begin with at least two of them; counted in powers of two of the default step.
        return self.unit * 2.0 ** math.floor(math.log2(self.scene.seconds / 2 / self.unit))

    def run(self, step: float) -> float:
        """Follow the motion from its start to its end and return the CPU time [s]."""
        return self.take(self.scene.seconds, step)

    def predict(self) -> float:
        """Return the CPU time that the run with the longest step will take [s], from a few substeps of it."""
        step = self.first_step()
        n_trial = min(N_TRIAL, math.ceil(self.scene.seconds / step))
        self.take(step, step)  # compiled, and in the caches
        return self.take(n_trial * step, step) / n_trial * self.scene.seconds / step

    def take(self, seconds: float, step: float) -> float:
        """Go on from the start for some time and return the CPU time [s]."""
        self.simulation.load_state(self.start)
        begin = time.process_time()
        self.simulation.advance(seconds, step)
        return time.process_time() - begin

    def row(self, step: float, reference: Motion) -> Row:
        """Run once and return errors and cost."""
        errors, note, cpu = Errors(NAN, NAN), "", NAN
        try:
            cpu = self.run(step) / self.scene.seconds
            errors = motion_of(self.simulation.body).errors(reference)
        except DivergenceError as error:
            note = str(error).split(";")[0]
        n_substeps = self.simulation.n_substeps - self.start.n_substeps
        return self.blank(note)._replace(
            step=step, share=step / self.unit, n_substeps=n_substeps, position_error=errors.position,
            strain_error=errors.strain, cpu=cpu,
        )  # fmt: skip

    def blank(self, note: str) -> Row:
        """Return a row without a result."""
        name = np.dtype(self.dtype).name
        return Row(self.scene.name, self.scheme, name, NAN, NAN, 0, NAN, NAN, NAN, note)


def is_explicit(scheme: str) -> bool:
    """Tell whether a scheme has a longest stable step."""
    return math.isfinite(INTEGRATORS[scheme].stable_step(Limits(frequency=1.0)))


def unique(names: Iterable[str]) -> list[str]:
    """Return each name once, in order."""
    return list(dict.fromkeys(names))


def fastest(rows: Iterable[Row], tolerance: float) -> Row | None:
    """Return the run on a scene that costs least among those within a tolerance, and not by luck; None where there is none."""
    runs = list(rows)
    # Where a shorter step gave a much larger error, this one was good by chance.
    beyond = [row for row in runs if row.error > LUCK * tolerance]
    within = [
        row for row in runs
        if row.error <= tolerance and not any(other.label == row.label and other.step < row.step for other in beyond)
    ]  # fmt: skip
    return min(within, key=lambda row: row.cpu, default=None)


def measure(scene: Scene, reference: Motion, budget: Budget, say: Callable[[str], None]) -> list[Row]:
    """Run every scheme in both precisions with shorter and shorter steps."""
    runs: list[tuple[Contestant, Row]] = []
    for scheme in INTEGRATORS:
        for dtype in DTYPES:
            contestant = Contestant(scene, scheme, dtype)
            for row in ladder(contestant, reference, budget):
                say(f"{scene.name}: {row.label}, {row.share:.3g} of its step")
                runs.append((contestant, row))
    return repeat(runs)


def ladder(contestant: Contestant, reference: Motion, budget: Budget) -> Iterator[Row]:
    """Yield rows from the longest step down, until errors are small, or stand still, or a run would cost too much."""
    if contestant.unit == 0.0:
        yield contestant.blank("no stable step: some of the body has stiffness and no drag")
        return
    cost = contestant.predict()
    if cost > budget.first_seconds:
        yield contestant.blank(f"one run at its stable step would take about {cost:.3g} s of CPU")
        return
    step, row, n_still = contestant.first_step(), contestant.blank(""), 0
    while True:
        before, row = row, contestant.row(step, reference)
        yield row
        is_still = row.error < SMALL and row.error > STAGNATION * before.error
        n_still = n_still + 1 if is_still else 0
        spent = cost if math.isnan(row.cpu) else row.cpu * contestant.scene.seconds
        cost = spent * (FACTOR if is_explicit(contestant.scheme) else IMPLICIT_GROWTH)
        if cost > budget.seconds or row.error <= budget.error or n_still == 2:
            return
        step /= FACTOR


def repeat(runs: list[tuple[Contestant, Row]]) -> list[Row]:
    """Run what is cheap again, all contestants in turn, and keep the least time of each."""
    cheap = [i for i, (contestant, row) in enumerate(runs) if row.cpu * contestant.scene.seconds < CHEAP]
    least, rng = [row.cpu for _, row in runs], np.random.default_rng(0)
    gc.disable()
    try:
        for _ in range(N_REPEATS):
            for i in rng.permutation(cheap):
                contestant, row = runs[i]
                least[i] = min(least[i], contestant.run(row.step) / contestant.scene.seconds)
    finally:
        gc.enable()
    return [row._replace(cpu=cpu) for (_, row), cpu in zip(runs, least, strict=True)]


# Files --------------------------------------------------------------------------------------------------------------------

Record = TypeVar("Record", bound=tuple[Any, ...])


def as_dicts(rows: Iterable[Any]) -> list[dict[str, Any]]:
    """Return named tuples as rows of a table."""
    return [row._asdict() for row in rows]


def read_rows(path: pathlib.Path, kind: type[Record]) -> list[Record]:
    """Read named tuples back from the CSV file that a study has written."""
    types = kind.__annotations__
    with path.open(newline="", encoding="utf-8") as stream:
        return [kind(*(types[name](value) for name, value in row.items())) for row in csv.DictReader(stream)]
