"""The same cuts under other physics: play them, and see by how much what the task judges then moves."""

import contextlib
import dataclasses
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from envs.collapse import SEPARATED
from envs.library import load_scenes
from envs.scene import Scene
from envs.task import Resection
from gmapspring.errors import TopologyError
from gmapspring.integrators import INTEGRATORS
from gmapspring.stability import stable_step

Array = np.ndarray[Any, Any]
Order = Sequence[Sequence[int]]
"""Cuts one after the other, each of one action or of several that are carried out before the body settles."""

FAMILIES = ("box-48", "box-108", "box-192")
"""Shipped scenes of which there are many."""
INVERTED = "inverted"
"""The collapse of tissue that turns inside out."""


class Variant(NamedTuple):
    """Physics that differ from those that a scene asks for."""

    name: str
    settle: float = 1.0
    """Settling time after a cut, over the scene's own."""
    physics: Mapping[str, Any] = {}
    """Fields of `scene_config.Physics`."""
    step: float = 1.0
    """Substep over the stable one; where a scheme is stable at any, over that of the scene's own scheme."""


SHIPPED = Variant("shipped")
SINGLE = Variant("float32", physics={"dtype": "float32"})


class Trace(NamedTuple):
    """What was judged of a body: settled and uncut, then after each cut; a collapse ends nothing."""

    strain: Array
    """Largest healthy strain, (n_cuts + 1,)."""
    volume_ratio: Array
    """Smallest healthy volume ratio, (n_cuts + 1,)."""
    healthy_share: Array
    """Attached healthy volume over that at the start, (n_cuts + 1,)."""
    reasons: list[str | None]
    """Why the body has collapsed, None where it stands."""
    seconds: float = math.nan
    """Processor time of all cuts and settlings."""

    @property
    def has_collapsed(self) -> Array:
        """Return the labels, bool (n_cuts + 1,)."""
        return np.array([reason is not None for reason in self.reasons])


class Move(NamedTuple):
    """How one play differs from another of the same cuts, up to the first collapse in either."""

    n_labels: int
    """Cuts whose labels are compared."""
    is_flipped: bool
    """Whether the last of them differs: one body collapses where the other stands."""
    ends_otherwise: bool
    """Whether one play collapses sooner or later and the other never does."""
    reason: str | None
    """Why the one collapses where the other stands, else None."""
    strain: float
    """By how much the peak strain is higher."""
    volume_ratio: float
    """By how much the smallest volume ratio is higher."""
    healthy_share: float
    """By how much the smallest share of healthy tissue is higher."""


class Played(NamedTuple):
    """One order of cuts, carried out under all variants."""

    family: str
    split: str
    seed: int
    is_certificate: bool
    """Whether it is the certificate's order, else a random one."""
    traces: dict[str, Trace]
    """By variant."""

    def move(self, variant: str, reference: str) -> Move:
        """Return how one variant differs from another."""
        return compare(self.traces[variant], self.traces[reference])


def sample(name: str, split: str, count: int) -> list[Scene]:
    """Return so many certified scenes of a split, evenly spread over its seeds, or all that there are."""
    scenes = load_scenes(name, split)
    return [scenes[int(i)] for i in np.unique(np.linspace(0, len(scenes) - 1, count).round())]


def orders_of(scene: Scene, n_random: int) -> list[Order]:
    """Return the certificate's order, then random orders of the same cuts, the same ones at every call."""
    assert scene.certificate is not None
    rng = np.random.default_rng(scene.seed)
    order = scene.certificate.order
    return [one_by_one(order), *(one_by_one(rng.permutation(order).tolist()) for _ in range(n_random))]


def one_by_one(actions: Iterable[int]) -> Order:
    """Return actions as cuts of one action each."""
    return [(action,) for action in actions]


def task_of(scene: Scene, variant: Variant) -> Resection:
    """Return the task of a scene under other physics."""
    settle = variant.settle * scene.physics.settle_seconds
    physics = scene.physics.model_copy(update={"settle_seconds": settle, **variant.physics})
    task = Resection(dataclasses.replace(scene, physics=physics))
    simulation, own = task.simulation, INTEGRATORS[scene.physics.integrator]
    stable = simulation.stable_step if math.isfinite(simulation.stable_step) else stable_step(simulation.body, own)
    if variant.step * stable != simulation.stable_step:
        # The task settles in stable steps; and its start was settled in the old ones.
        simulation.stable_step = variant.step * stable
        task.set_load(scene.load)
    return task


def play(task: Resection, order: Order) -> Trace:
    """Carry out cuts from the start and return what was judged on the way."""
    judged, seconds = zip(*((_judgement(task), seconds) for seconds in carried_out(task, order)), strict=True)
    strain, volume_ratio, healthy_share, reasons = zip(*judged, strict=True)
    return Trace(np.array(strain), np.array(volume_ratio), np.array(healthy_share), list(reasons), sum(seconds))


def carried_out(task: Resection, order: Order) -> Iterator[float]:
    """Yield when the body has settled uncut, then after each cut; each time the processor time that it took [s]."""
    task.reset()
    yield 0.0
    for cut in order:
        begin = time.thread_time()
        for action in cut:
            # What has come loose on the way need not be cut any more.
            with contextlib.suppress(TopologyError):
                task.apply(action)
        task.settle()
        yield time.thread_time() - begin


def play_all(scene: Scene, split: str, variants: Sequence[Variant], n_random: int) -> list[Played]:
    """Carry out the certificate, and random orders of its cuts, under all variants, which take turns."""
    tasks = {variant.name: task_of(scene, variant) for variant in variants}
    return [
        Played(scene.name, split, scene.seed, number == 0, {name: play(task, order) for name, task in tasks.items()})
        for number, order in enumerate(orders_of(scene, n_random))
    ]


def _judgement(task: Resection) -> tuple[float, float, float, str | None]:
    """Return strain, volume ratio, healthy share, and the reason of a collapse.

    Tissue that is inside out strains what is round it: where a body tears too, it is the inversion that did it.
    """
    tissue = task.tissue
    reason = None if task.outcome == SEPARATED else task.outcome
    if reason and tissue.lowest_volume_ratio < task.scene.limits.volume_ratio:
        reason = INVERTED
    return tissue.healthy_strain, tissue.lowest_volume_ratio, task.healthy_share, reason


def compare(trace: Trace, reference: Trace) -> Move:
    """Return how a play differs from the reference, up to the first collapse in either.

    A cut after which tissue has turned inside out counts among the labels, but not among the moves: that is another state of
    the body, with strains and volumes of its own, and no error of the first.
    """
    mine, others = trace.has_collapsed, reference.has_collapsed
    ends = np.flatnonzero(mine | others)
    last = int(ends[0]) if len(ends) else len(mine) - 1
    inverts = INVERTED in (trace.reasons[last], reference.reasons[last])
    # An uncut body that inverts has no other state to compare.
    moved = slice(max(1, last + 1 - inverts))
    return Move(
        n_labels=max(1, last),
        is_flipped=bool(mine[last] != others[last]),
        ends_otherwise=bool(mine.any() != others.any()),
        reason=(trace.reasons[last] or reference.reasons[last]) if mine[last] != others[last] else None,
        strain=float(trace.strain[moved].max() - reference.strain[moved].max()),
        volume_ratio=float(trace.volume_ratio[moved].min() - reference.volume_ratio[moved].min()),
        healthy_share=float(trace.healthy_share[moved].min() - reference.healthy_share[moved].min()),
    )


def percentiles(values: Iterable[float]) -> tuple[float, float, float]:
    """Return median, 95th percentile and largest of the magnitudes; NaN where there are none."""
    magnitudes = np.abs(np.fromiter(values, dtype=np.float64))
    if not len(magnitudes):
        return math.nan, math.nan, math.nan
    median, high, largest = np.percentile(magnitudes, (50.0, 95.0, 100.0)).tolist()
    return median, high, largest


def share(flags: Iterable[bool]) -> float:
    """Return how many flags are set, in percent."""
    return 100.0 * float(np.mean(list(flags)))


def percent_of_labels(moves: Sequence[Move]) -> float:
    """Return the labels that differ, in percent of those that are compared."""
    return 100.0 * sum(move.is_flipped for move in moves) / sum(move.n_labels for move in moves)
