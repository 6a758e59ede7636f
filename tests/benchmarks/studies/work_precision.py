"""Error against CPU time of every scheme, in both precisions, on bodies of several kinds; and where an implicit scheme wins."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from gmapspring.integrators import INTEGRATORS
from tests.benchmarks.studies.precision_drift import drift_rows
from tests.benchmarks.studies.precision_figure import draw
from tests.benchmarks.studies.precision_reference import CONVERGED, Reference, refer
from tests.benchmarks.studies.precision_rows import Budget, Row, as_dicts, fastest, is_explicit, measure, unique
from tests.benchmarks.studies.precision_scenes import (
    Facts,
    Scene,
    damped_scenes,
    facts_of,
    free_scene,
    layered_scenes,
)
from tests.benchmarks.study import Plan, Study, Table

BUDGET = {False: Budget(2.0, 0.4, 1e-7), True: Budget(0.25, 0.02, 1e-6)}
"""By whether the study is quick."""
LAYERED_BUDGET = {False: Budget(2.0, 0.4, 3e-5), True: Budget(0.25, 0.02, 1e-4)}
"""Where only moderate errors are looked at."""
TOLERANCES = (1e-1, 1e-2, 1e-3)
"""At which explicit schemes are compared with the implicit one."""


class Measured(NamedTuple):
    """All that was measured of some scenes."""

    facts: list[Facts]
    references: list[Reference]
    rows: list[Row]

    def joined(self, other: "Measured") -> "Measured":
        """Return this and another together."""
        return Measured(self.facts + other.facts, self.references + other.references, self.rows + other.rows)


def run(plan: Plan) -> Study:
    """Measure all scenes."""
    scenes, layers = measure_scenes(plan)
    everything = scenes.joined(layers)
    plan.say("invariants of an undamped body")
    drifts = drift_rows(free_scene(plan.is_quick))
    crossovers = crossover_rows(layers)
    return Study(
        "Error against CPU time",
        "\n\n".join((method_text(everything), outcome_text(scenes.rows), crossover_text(crossovers, layers.rows))),
        tables=(
            Table("The scenes: how many tetrahedra, the longest side, the time that is followed, the highest and the median "
                  "frequency of elements, their median damping ratio, how far nodes come (root of the mean square, over the size "
                  "of the body), and the largest strain at the end.", scene_rows(everything)),
            Table("The references: step of RK4, what twice of it changes, over how long and by how much SciPy's DOP853 differs.",
                  reference_rows(everything)),
            Table("Each scheme at the longest step it may take, float64, and the least error it came to within the budget; CPU "
                  "time in seconds for each simulated second.", first_rows(scenes.rows)),
            Table("One layer stiffer and stiffer: CPU time of the fastest explicit run over that of the fastest of backward "
                  "Euler, both within a tolerance. Above 1 backward Euler wins; NaN: one of them does not get there within the "
                  "budget.", crossovers),
            Table("An undamped body that nothing holds: the largest change of energy on the way, over the energy at the start; "
                  "momentum over the sum of m |v|, and angular momentum over itself, at the end.", drifts),
        ),
        figures=figures(scenes),
        hidden={"rows": as_dicts(everything.rows), "scenes": as_dicts(everything.facts)},
    )  # fmt: skip


def measure_scenes(plan: Plan) -> tuple[Measured, Measured]:
    """Measure the scenes of all kinds, and those with a stiffer and stiffer layer."""
    scenes = follow(damped_scenes(plan.is_quick), BUDGET[plan.is_quick], plan)
    return scenes, follow(layered_scenes(plan.is_quick), LAYERED_BUDGET[plan.is_quick], plan)


def follow(scenes: Sequence[Scene], budget: Budget, plan: Plan) -> Measured:
    """Find the references of some scenes and run all schemes."""
    result = Measured([], [], [])
    for scene in scenes:
        plan.say(f"reference of {scene.name}")
        reference = refer(scene)
        result.facts.append(facts_of(scene))
        result.references.append(reference)
        result.rows.extend(measure(scene, reference.end, budget, plan.say))
    return result


def figures(measured: Measured) -> dict[str, Figure]:
    """Return a work-precision diagram for each kind of error."""
    names = [facts.scene for facts in measured.facts]
    return {
        "position": draw(measured.rows, names, "position_error", "position error over size of the body"),
        "strain": draw(measured.rows, names, "strain_error", "largest strain error"),
    }


# Tables -------------------------------------------------------------------------------------------------------------------


def scene_rows(measured: Measured) -> list[dict[str, Any]]:
    """Return what is known of each scene."""
    return [
        {
            "scene": facts.scene, "what": facts.description, "tetrahedra": facts.tetrahedra, "size [m]": facts.size,
            "seconds": facts.seconds, "highest [rad/s]": facts.frequency, "median [rad/s]": facts.median_frequency,
            "damping ratio": facts.damping_ratio, "travel": reference.travel,
            "largest strain": reference.largest_strain,
        }
        for facts, reference in zip(measured.facts, measured.references, strict=True)
    ]  # fmt: skip


def reference_rows(measured: Measured) -> list[dict[str, Any]]:
    """Return why references can be trusted."""
    return [
        {
            "scene": facts.scene, "step [s]": reference.step, "change by twice the step": reference.change,
            "seconds checked": reference.checked_seconds, "difference from SciPy": reference.checked,
        }
        for facts, reference in zip(measured.facts, measured.references, strict=True)
    ]  # fmt: skip


def first_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return errors and costs at the longest step, and the least error, for each scene and scheme."""
    result = []
    for scene in unique(row.scene for row in rows):
        for scheme in INTEGRATORS:
            double, single = (
                [row for row in rows if (row.scene, row.scheme, row.precision) == (scene, scheme, precision)]
                for precision in ("float64", "float32")
            )
            result.append({
                "scene": scene, "scheme": scheme, "step [s]": double[0].step, "position error": double[0].position_error,
                "strain error": double[0].strain_error, "CPU float64": double[0].cpu, "CPU float32": single[0].cpu,
                "least error float64": least_error(double), "least error float32": least_error(single),
                "note": double[0].note,
            })  # fmt: skip
    return result


def least_error(rows: Iterable[Row]) -> float:
    """Return the smallest error of any row; NaN if none has a result."""
    return min((row.error for row in rows if not math.isnan(row.error)), default=math.nan)


def crossover_rows(layers: Measured) -> list[dict[str, Any]]:
    """Return, for each stiffness ratio and tolerance, what the fastest explicit run costs beside the fastest implicit one."""
    result = []
    for facts in layers.facts:
        rows = [row for row in layers.rows if row.scene == facts.scene]
        cells: dict[str, Any] = {"stiffness ratio": float(facts.scene.split()[-1])}
        for tolerance in TOLERANCES:
            explicit = fastest((row for row in rows if is_explicit(row.scheme)), tolerance)
            implicit = fastest((row for row in rows if not is_explicit(row.scheme)), tolerance)
            cells[f"{tolerance:g}"] = explicit.cpu / implicit.cpu if explicit and implicit else math.nan
            cells[f"runs at {tolerance:g}"] = " / ".join(row.label if row else "none" for row in (explicit, implicit))
        result.append(cells)
    return result


# Text ---------------------------------------------------------------------------------------------------------------------


def method_text(measured: Measured) -> str:
    """Say how it was measured, and how far references are right."""
    changes = [reference.change for reference in measured.references]
    checked = [reference.checked for reference in measured.references]
    return (
        "Every scheme follows the same motions in both precisions, with its longest stable step and with halves of it until "
        "errors no longer shrink or a run costs too much; backward Euler, stable at every step, begins with a long one. Errors "
        "are those at the end of the motion: the root of the mean square distance of nodes from where they should be, over the "
        "longest side of the body, and the largest error of a spring's strain. CPU time is that of one process on one thread, "
        "the least of several runs where runs are short. The reference is RK4 in float64 with a step so fine that twice of it "
        f"changes no error by more than {max(changes):.1g} ({CONVERGED:g} was asked for), and SciPy's DOP853 with forces in "
        f"NumPy agrees to {max(checked):.1g}; it follows the stiff bodies for a shorter time, which the table tells. All rows "
        "are in rows.csv."
    )


def outcome_text(rows: Sequence[Row]) -> str:
    """Say who is fastest at which tolerance, and how far float32 comes."""
    scenes = unique(row.scene for row in rows)
    lines = []
    for tolerance in TOLERANCES:
        best = [fastest((row for row in rows if row.scene == scene), tolerance) for scene in scenes]
        labels = [row.label if row else "none" for row in best]
        counts = ", ".join(f"{label} in {labels.count(label)}" for label in unique(labels))
        lines.append(f"- Within {tolerance:g} the fastest of {len(scenes)} scenes: {counts}.")
    floors = [least_error(row for row in rows if row.scene == scene and row.label == "rk4 float32") for scene in scenes]
    lines.append(f"- RK4 in float32 comes to errors from {min(floors):.1g} to {max(floors):.1g}, depending on the scene.")
    failed = [row for row in rows if row.note]
    lines.append(f"- Of {len(rows)} runs {len(failed)} have no result; their rows are NaN and say why.")
    return "\n".join(lines)


def crossover_text(crossovers: Sequence[dict[str, Any]], rows: Sequence[Row]) -> str:
    """Say from which stiffness ratio on the implicit scheme wins, and how exact it is there."""
    parts = []
    for tolerance in TOLERANCES:
        wins = [row["stiffness ratio"] for row in crossovers if row[f"{tolerance:g}"] > 1.0]
        # A win counts from where on no larger ratio is lost.
        losses = [row["stiffness ratio"] for row in crossovers if not row[f"{tolerance:g}"] > 1.0]
        lasting = [ratio for ratio in wins if ratio > max(losses, default=0.0)]
        where = f"from a ratio of {min(lasting):g} on" if lasting else "at no ratio that was tried"
        parts.append(f"within {tolerance:g} {where}")
    errors = {
        precision: [least_error(row for row in rows if (row.scene, row.label) == (scene, f"backward_euler {precision}"))
                    for scene in (rows[0].scene, rows[-1].scene)]
        for precision in ("float64", "float32")
    }  # fmt: skip
    least = "; ".join(f"in {precision} {even:.1g} and {uneven:.1g}" for precision, (even, uneven) in errors.items())
    return (
        f"Backward Euler is faster than every explicit scheme {', '.join(parts)}. Its least error at the lowest ratio and at the "
        f"highest, within the budget: {least}."
    )
