"""What each simplification of the task costs: the time it saves against the error it makes."""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from envs.collapse import SEPARATED
from tests.benchmarks.studies.scene_keeping import Keeper, outer_faces, settling_time
from tests.benchmarks.studies.scene_replay import (
    FAMILIES,
    SHIPPED,
    SINGLE,
    Move,
    Played,
    Variant,
    orders_of,
    percent_of_labels,
    percentiles,
    play_all,
    sample,
    share,
    task_of,
)
from tests.benchmarks.study import Plan, Study, Table

REFERENCE = 12.5
"""Settling time of the reference, over the shipped one."""
SETTLES = (0.25, 0.5, 1.0, 2.0, 4.0, REFERENCE)
TOLERANCES = (0.1, 0.01, 1e-3, 1e-4)
"""Motions left at which a settling may end early, in units of the scene's length h."""
LOOSE_SHARES = (0.25, 0.5)
"""Parts of a body that are cut off; of a box no more, since its lower half is all anchor."""
SETTLE_VARIANTS = [SHIPPED if factor == 1.0 else Variant(f"settle x {factor:g}", settle=factor) for factor in SETTLES]
REST_VARIANTS = [Variant(f"rest {tolerance:g} h", physics={"rest_tolerance": tolerance}) for tolerance in TOLERANCES]
VARIANTS = [*SETTLE_VARIANTS, *REST_VARIANTS, SINGLE]


def run(plan: Plan) -> Study:
    """Play certificates and random orders under simplified physics, and compare."""
    n_scenes, n_random = (4, 1) if plan.is_quick else (128, 3)
    played = []
    for family in FAMILIES:
        for scene in sample(family, "train", n_scenes):
            plan.say(f"{family}, seed {scene.seed}")
            played += play_all(scene, "train", VARIANTS, n_random)
    settle = [cost_row(played, variant, SETTLE_VARIANTS[-1]) for variant in SETTLE_VARIANTS]
    other = [cost_row(played, variant, SHIPPED) for variant in (*REST_VARIANTS, SINGLE)]
    plan.say("dropping what is loose")
    kept = [kept_row(family, max(1, n_scenes // 8), n_random) for family in FAMILIES]
    halved = [halved_row(family, loose) for family in (*FAMILIES, "liver") for loose in LOOSE_SHARES]
    text = "\n\n".join((opening(played, n_scenes), settle_text(settle, played), other_text(other), loose_text(kept, halved)))
    tables = (
        Table("Settling time after a cut, against the longest.", settle),
        Table("Ending a settling early, and single precision, against the shipped physics.", other),
        Table("Pieces that have come loose, dropped as the task does against kept: the same cuts.", kept),
        Table("The same for bodies of which a part was cut off: one settling.", halved),
    )
    by_family = [
        {"family": family} | cost_row([each for each in played if each.family == family], variant, SETTLE_VARIANTS[-1])
        for family in FAMILIES
        for variant in SETTLE_VARIANTS
    ]
    return Study("What simplifications cost", text, tables, {"settle": settle_figure(by_family)}, {"settle-by-family": by_family})


def cost_row(played: Sequence[Played], variant: Variant, reference: Variant) -> dict[str, Any]:
    """Return what a variant costs in time, and what it gets wrong."""
    moves: dict[bool, list[Move]] = defaultdict(list)
    for each in played:
        moves[each.is_certificate].append(each.move(variant.name, reference.name))
    median, high, largest = percentiles(move.strain for move in (*moves[True], *moves[False]))
    microseconds = time_per_cut(played, variant)
    return {
        "physics": variant.name,
        "us per action": microseconds,
        "times shipped": microseconds / time_per_cut(played, SHIPPED),
        "labels that differ, certificates [%]": percent_of_labels(moves[True]),
        "labels that differ, random orders [%]": percent_of_labels(moves[False]),
        "certificates that end otherwise [%]": share(move.ends_otherwise for move in moves[True]),
        "random orders that end otherwise [%]": share(move.ends_otherwise for move in moves[False]),
        "peak strain off by, p50": median,
        "p95": high,
        "largest": largest,
    }


def time_per_cut(played: Sequence[Played], variant: Variant) -> float:
    """Return the processor time of one cut and the settling after it [us]."""
    traces = [each.traces[variant.name] for each in played]
    return 1e6 * sum(trace.seconds for trace in traces) / sum(len(trace.reasons) - 1 for trace in traces)


# Loose pieces -----------------------------------------------------------------------------------------------------


def kept_row(family: str, n_scenes: int, n_random: int) -> dict[str, Any]:
    """Play scenes with a body beside that keeps what comes loose; return labels and differences."""
    labels, is_loose, strains, distances = [], [], [], []
    for scene in sample(family, "train", n_scenes):
        task = task_of(scene, SHIPPED)
        for order in orders_of(scene, n_random):
            task.reset()
            keeper = Keeper(task)
            for (action,) in order:
                keeper.apply(action)
                keeper.settle()
                is_loose.append(keeper.simulation.body.is_alive.sum() > task.is_attached.sum())
                labels.append(keeper.reason != (None if task.outcome == SEPARATED else task.outcome))
                strains.append(abs(keeper.tissue.healthy_strain - task.tissue.healthy_strain))
                distances.append(keeper.farthest() / scene.spacing)
    return {
        "family": family,
        "cuts": len(labels),
        "with a loose piece": int(sum(is_loose)),
        "labels that differ": sum(labels),
        "strain off by at most": max(strains),
        "attached points off by at most [h]": max(distances),
    }


def halved_row(family: str, loose: float) -> dict[str, Any]:
    """Cut a share off a body and settle it once with and once without; return times and the difference."""
    scene = sample(family, "train", 1)[0]
    task = task_of(scene, SHIPPED)
    keeper = Keeper(task)
    for face in outer_faces(task, loose):
        # A face may lie between two pieces that are loose both.
        if task.action_mask()[face]:
            keeper.apply(face)
    seconds = scene.physics.settle_seconds
    dropped, kept = (settling_time(simulation, seconds) for simulation in (task.simulation, keeper.simulation))
    n_all, n_attached = scene.mesh.n_tetrahedra, int(task.is_attached.sum())
    keeper.settle()
    return {
        "body": family,
        "loose tetrahedra [%]": 100.0 * (1.0 - n_attached / n_all),
        "us, dropped": 1e6 * dropped,
        "us, kept": 1e6 * kept,
        "saved [%]": 100.0 * (1.0 - dropped / kept),
        "strain off by at most": abs(keeper.tissue.healthy_strain - task.tissue.healthy_strain),
        "attached points off by at most [h]": keeper.farthest() / scene.spacing,
    }


# What comes out ---------------------------------------------------------------------------------------------------


def opening(played: Sequence[Played], n_scenes: int) -> str:
    """Say what was done."""
    falls = share(bool(each.traces[SHIPPED.name].has_collapsed.any()) for each in played if not each.is_certificate)
    return (
        f"Up to {n_scenes} training scenes of each of {', '.join(FAMILIES)}: the certificate's order of cuts, and random orders "
        f"of the same cuts, {len(played)} in all; {falls:.0f} % of the random ones collapse. The same list of cuts is carried "
        "out from the start under each physics, and labels (collapsed or not) are compared cut by cut up to the first collapse "
        "in either. Where tissue turns inside out the label counts, but no strain is compared: that is another state, and no "
        "error. Times are of the processor, for cut, settling and judgement together."
    )


def settle_text(rows: Sequence[dict[str, Any]], played: Sequence[Played]) -> str:
    """Say what the settling time costs."""
    label, ends = "labels that differ, random orders [%]", "random orders that end otherwise [%]"
    shipped, half, double = (row_of(rows, name) for name in (SHIPPED.name, "settle x 0.5", "settle x 2"))
    certificates = [each for each in played if each.is_certificate]
    standing = sum(not each.traces[SETTLE_VARIANTS[-1].name].has_collapsed.any() for each in certificates)
    return (
        f"**Settling time.** Against {REFERENCE:g} times the shipped time, the shipped one gets {shipped[label]:.2g} % of the "
        f"labels along random orders wrong, and the end of {shipped[ends]:.2g} % of these orders, with a peak strain that is off "
        f"by {shipped['p95']:.2g} at the 95th percentile. Half of it takes {half['times shipped']:.2f} times as long per action, "
        f"with {half[label]:.2g} % of labels wrong and {half['p95']:.2g} off; twice as much {double['times shipped']:.2f} times "
        f"as long, with {double[label]:.2g} % wrong and {double['p95']:.2g} off. {standing} of {len(certificates)} certificates "
        "stand in the reference too."
    )


def other_text(rows: Sequence[dict[str, Any]]) -> str:
    """Say what an early end and single precision cost."""
    labels = [key for key in rows[0] if key.endswith("[%]")]
    safe = [row for row in rows if row["physics"] != SINGLE.name and not any(row[key] for key in labels)]
    single = row_of(rows, SINGLE.name)
    early = "every tolerance tried changes labels"
    if safe:
        best = min(safe, key=lambda row: row["us per action"])
        early = (
            f"with {best['physics'].removeprefix('rest ')} no label changes, the peak strain by at most {best['largest']:.1g}, "
            f"and an action takes {best['times shipped']:.2f} times as long"
        )
    return (
        f"**Ending early.** A settling may end once no node can move further than a tolerance: {early}. **Single precision** "
        f"changes {single['labels that differ, random orders [%]']:.2g} % of the labels along random orders and the peak strain "
        f"by at most {single['largest']:.1g}, and takes {single['times shipped']:.2f} times as long on bodies this small."
    )


def loose_text(kept: Sequence[dict[str, Any]], halved: Sequence[dict[str, Any]]) -> str:
    """Say what the dropping of loose pieces costs."""
    n_labels, n_loose, n_other = (sum(row[key] for row in kept) for key in ("cuts", "with a loose piece", "labels that differ"))
    distance = max(row["attached points off by at most [h]"] for row in (*kept, *halved))
    same = "bit-identical" if distance == 0.0 else (
        f"equal to {distance:.1g} h, since a removal puts nodes and springs in another order, and sums then round otherwise"
    )
    saved = [row["saved [%]"] for row in halved if math.isclose(row["loose tetrahedra [%]"], 50.0, abs_tol=10.0)]
    return (
        "**Loose pieces.** The task removes what hangs on no anchor. A body that takes the same cuts and loads, but goes on "
        f"moving such pieces, gives {n_other} other labels of {n_labels}, {n_loose} of them with a loose piece; what is attached "
        f"is {same}. Where about half of a body is cut off, dropping it saves {min(saved, default=math.nan):.0f} to "
        f"{max(saved, default=math.nan):.0f} % of the time of a settling."
    )


def row_of(rows: Sequence[dict[str, Any]], name: str) -> dict[str, Any]:
    """Return the row of some physics."""
    return next(row for row in rows if row["physics"] == name)


def settle_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Draw settling time against labels that differ, strain and processor time."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    drawn = (
        ("labels that differ, random orders [%]", "labels that differ [%]", "linear"),
        ("p95", "peak strain off by, 95th percentile", "log"),
        ("us per action", "processor time of an action [us]", "log"),
    )
    for ax, (key, label, scale) in zip(axes, drawn, strict=True):
        # The reference takes time, but has no error to draw.
        n_drawn = len(SETTLES) - (key != "us per action")
        for family in FAMILIES:
            values = [row[key] for row in rows if row["family"] == family]
            ax.plot(SETTLES[:n_drawn], values[:n_drawn], "o-", label=family)
        ax.axvline(1.0, color="grey", linestyle=":")
        ax.set(xscale="log", yscale=scale, xlabel="settling time over the shipped one", ylabel=label)
        ax.set_xticks(SETTLES[:n_drawn], [f"{factor:g}" for factor in SETTLES[:n_drawn]])
        ax.minorticks_off()
        ax.grid(alpha=0.3)
    axes[0].legend()
    return figure
