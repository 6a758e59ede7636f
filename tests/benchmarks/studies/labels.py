"""What ends an episode is a strain and a volume: how far both move with scheme, precision, settling time and mesh."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from envs.library import load_scene_config, load_scenes, shipped_scenes
from tests.benchmarks.studies.scene_margin import ROOM_KEPT, Margin, room_left, stated_margin
from tests.benchmarks.studies.scene_refine import refined_row
from tests.benchmarks.studies.scene_replay import (
    FAMILIES,
    INVERTED,
    SHIPPED,
    SINGLE,
    Played,
    Variant,
    percent_of_labels,
    percentiles,
    play_all,
    sample,
    share,
)
from tests.benchmarks.studies.scene_schemes import Schemes, schemes_for
from tests.benchmarks.study import Plan, Study, Table

SETTLES = [Variant(f"settle x {factor:g}", settle=factor) for factor in (2.0, 4.0, 12.5)]
REFINEMENTS = {"box-48": (2, 4), "box-108": (2, 4), "box-192": (2,)}
"""How many times finer the meshes are."""


def run(plan: Plan) -> Study:
    """Play certificates and random orders in every way, derive the margin, and look who keeps it."""
    n_scenes, n_random, n_refined, n_shipped = (2, 1, 1, 4) if plan.is_quick else (20, 3, 16, 10_000)
    schemes = schemes_for(load_scenes(FAMILIES[-1], "train")[0])
    variants = [SHIPPED, SINGLE, *SETTLES, *schemes.variants]
    sampled = play_families(plan, variants, n_scenes, n_random)
    cheap = [SHIPPED, SINGLE, *SETTLES[:2], *schemes.cheap]
    shipped = play_shipped(plan, cheap, n_shipped)
    plan.say("finer meshes")
    refined = [refined_row(family, factor, n_refined, n_random) for family in FAMILIES for factor in REFINEMENTS[family]]
    moves = [move_row(sampled, variant.name, is_certificate) for variant in variants[1:] for is_certificate in (True, False)]
    worst = worst_moves(each for each in shipped if each.split == "train")
    kept = [split_row(shipped, name, split) for name in shipped_scenes() for split in load_scene_config(name).splits]
    flips = [flip_row(each, name) for each in shipped for name in each.traces if each.move(name, SHIPPED.name).is_flipped]
    texts = opening(sampled, shipped, schemes), moves_text(moves), margin_text(worst, kept), flips_text(shipped, flips)
    tables = (
        Table("How far labels and peak strain move from the shipped physics, on training scenes.", moves),
        Table("Certificates' room to the limits, and how many end otherwise under other physics.", kept),
        Table("The same scenes on finer meshes, cut along the same surfaces: another model, no error of a scheme.", refined),
    )
    figures = {"margins": margin_figure(shipped, worst)}
    return Study("How sure labels are", "\n\n".join((*texts, refined_text(refined))), tables, figures, {"other-ends": flips})


# What is played ---------------------------------------------------------------------------------------------------


def play_families(plan: Plan, variants: Sequence[Variant], n_scenes: int, n_random: int) -> list[Played]:
    """Play training scenes of every family."""
    played = []
    for family in FAMILIES:
        for scene in sample(family, "train", n_scenes):
            plan.say(f"{family}, seed {scene.seed}")
            played += play_all(scene, "train", variants, n_random)
    return played


def play_shipped(plan: Plan, variants: Sequence[Variant], count: int) -> list[Played]:
    """Play the certificates of all shipped scenes, of each split so many."""
    played = []
    for name in shipped_scenes():
        for split in load_scene_config(name).splits:
            plan.say(f"{name} {split}: all certificates")
            for scene in sample(name, split, count):
                played += play_all(scene, split, variants, 0)
    return played


# What comes out ---------------------------------------------------------------------------------------------------


class Worst(NamedTuple):
    """The farthest that any physics moved training certificates towards a limit, a number for each of them."""

    strain: list[float]
    volume_ratio: list[float]
    healthy_share: list[float]
    stated: list[Margin]
    """What each of them keeps."""


def worst_moves(played: Iterable[Played]) -> Worst:
    """Return the largest move towards each limit over all physics, 0 where all moves lead away."""
    worst = Worst([], [], [], [])
    for each in played:
        moves = [each.move(variant, SHIPPED.name) for variant in each.traces]
        worst.strain.append(max(0.0, *(move.strain for move in moves)))
        worst.volume_ratio.append(max(0.0, *(-move.volume_ratio for move in moves)))
        worst.healthy_share.append(max(0.0, *(-move.healthy_share for move in moves)))
        worst.stated.append(stated_margin(load_scene_config(each.family)))
    return worst


def move_row(played: Sequence[Played], variant: str, is_certificate: bool) -> dict[str, Any]:
    """Return how far one variant moves labels, strains and volumes."""
    moves = [each.move(variant, SHIPPED.name) for each in played if each.is_certificate == is_certificate]
    strain, volume = (percentiles(getattr(move, name) for move in moves) for name in ("strain", "volume_ratio"))
    return {
        "physics": variant,
        "orders": f"{len(moves)} {'certificates' if is_certificate else 'random'}",
        "peak strain moves by, p50": strain[0],
        "p95": strain[1],
        "most": strain[2],
        "volume ratio moves by, p95": volume[1],
        "most ": volume[2],
        "labels that differ [%]": percent_of_labels(moves),
        "orders that end otherwise [%]": share(move.ends_otherwise for move in moves),
    }


def split_row(shipped: Sequence[Played], name: str, split: str) -> dict[str, Any]:
    """Return how near the certificates of a split come to their limits, and how many keep the margin and the label."""
    mine = [each for each in shipped if (each.family, each.split) == (name, split)]
    rooms = rooms_of(mine)
    return {
        "scene": name,
        "split": split,
        "certificates": len(mine),
        "least strain room": min(room.strain for room in rooms),
        "least volume ratio room": min(room.volume_ratio for room in rooms),
        "least healthy share room": min(room.healthy_share for room in rooms),
        "keep the margin": sum(keeps_margin(each) for each in mine),
        "end otherwise": sum(ends_otherwise(each) for each in mine),
    }


def ends_otherwise(played: Played) -> bool:
    """Tell whether any physics tried ends an order otherwise than the shipped one."""
    return any(played.move(variant, SHIPPED.name).ends_otherwise for variant in played.traces)


def flip_row(played: Played, variant: str) -> dict[str, Any]:
    """Return where and why a certificate's label differs under other physics."""
    shipped, move = played.traces[SHIPPED.name], played.move(variant, SHIPPED.name)
    return {
        "scene": played.family,
        "split": played.split,
        "seed": played.seed,
        "physics": variant,
        "reason": move.reason,
        "cut": move.n_labels,
        "cuts": len(shipped.reasons) - 1,
        "shipped peak strain": float(shipped.strain.max()),
        "shipped volume ratio": float(shipped.volume_ratio.min()),
    }


def opening(sampled: Sequence[Played], shipped: Sequence[Played], schemes: Schemes) -> str:
    """Say what was done."""
    n_random = sum(not each.is_certificate for each in sampled)
    skipped = "; ".join(f"{name} is left out, since {reason}" for name, reason in schemes.skipped.items())
    return (
        f"{len(sampled) - n_random} training scenes were played by their certificates and by {n_random} random orders of the "
        "same cuts, in the shipped physics and in others: longer settling, single precision, every registered scheme at the "
        f"steps that it allows{f' ({skipped})' if skipped else ''}; and {len(shipped)} shipped certificates, of all splits, in "
        "the quicker ones. Labels are compared cut by cut up to the first collapse in either; moves of strain and volume "
        "likewise, but without a cut after which tissue is inside out: that is another state, and no error."
    )


def moves_text(rows: Sequence[dict[str, Any]]) -> str:
    """Say what moves labels most and least."""
    certificates, random = rows[::2], rows[1::2]
    most = max(certificates, key=lambda row: row["p95"])
    single = next(row for row in certificates if row["physics"] == SINGLE.name)
    worst = max(random, key=lambda row: row["orders that end otherwise [%]"])
    return (
        f"**Moves.** Certificates' peak strain moves most with {most['physics']}: by {most['p95']:.2g} at the 95th percentile "
        f"and {most['most']:.2g} at most; with single precision by {single['most']:.1g} at most. Random orders, which run into "
        f"the limits, end otherwise most often with {worst['physics']}: {worst['orders that end otherwise [%]']:.2g} %."
    )


def margin_text(worst: Worst, kept: Sequence[dict[str, Any]]) -> str:
    """State the margin, what it covers and who keeps it."""
    names = "the strain", "the volume ratio", "the healthy share"
    covered = ", ".join(
        f"{100.0 * np.mean(np.less_equal(moves, margins)):.1f} % for {name} "
        f"(95th percentile {np.percentile(moves, 95.0):.2g}, farthest {max(moves):.2g})"
        for name, moves, margins in zip(names, worst[:3], zip(*worst.stated, strict=True), strict=True)
    )
    n_all, n_kept = (sum(row[key] for row in kept) for key in ("certificates", "keep the margin"))
    return (
        f"**Margin.** {margin_statement()} This covers how far the other physics move {len(worst.strain)} training certificates "
        f"towards the limit: {covered}. {n_kept} of {n_all} shipped certificates keep it."
    )


def margin_statement() -> str:
    """Say what every certificate keeps."""
    configs = {config.kappa: config for config in map(load_scene_config, shipped_scenes())}
    stated = {kappa: stated_margin(configs[kappa]) for kappa in sorted(configs)}
    rooms = ", ".join(f"{margin.strain:.2g} at κ = {kappa:g}" for kappa, margin in stated.items())
    _, volume_ratio, healthy_share = next(iter(stated.values()))
    return (
        f"A certificate stays away from the limit of the strain by {ROOM_KEPT:g} (1 - κ) of it ({rooms}), from that of the "
        f"volume ratio by {volume_ratio:g} and from that of the healthy share by {healthy_share:g}."
    )


def flips_text(shipped: Sequence[Played], flips: Sequence[dict[str, Any]]) -> str:
    """Say how many certificates end otherwise, and whether the margin tells them."""
    flipped = [each for each in shipped if ends_otherwise(each)]
    if not flipped:
        return f"None of {len(shipped)} shipped certificates ends otherwise under any physics tried."
    reasons = Counter(row["reason"] for row in flips)
    n_kept = sum(map(keeps_margin, flipped))
    ratio = np.median([each.traces[SHIPPED.name].volume_ratio.min() for each in flipped])
    snap = (
        " A tetrahedron of springs has a second rest shape, inside out, and snaps into it where the body settles for longer or "
        f"on another path; also from far above the limit: the smallest volume ratio in the shipped physics is {ratio:.2f} at "
        "the median of these scenes."
    )
    return (
        f"**Labels that depend on the physics.** {len(flipped)} of {len(shipped)} shipped certificates collapse under at least "
        f"one of the others ({', '.join(f'{count} x {reason}' for reason, count in reasons.most_common())}). {n_kept} of these "
        f"{len(flipped)} keep the margin{', so that it does not tell them' if n_kept else ''}: what finds them is to carry the "
        f"order out under other physics too.{snap if reasons.most_common()[0][0] == INVERTED else ''} They are listed in "
        "other-ends.csv."
    )


def refined_text(rows: Sequence[dict[str, Any]]) -> str:
    """Say what a finer mesh changes."""
    halved = [row for row in rows if row["mesh"] == "h/2"]
    peaks, gauges, ends = (
        [row[key] for row in halved]
        for key in (
            "certificate's peak over own", "the same along the own mesh's edges", "certificates that end otherwise [%]"
        )
    )  # fmt: skip
    return (
        f"**Mesh.** On a mesh of half the spacing the same certificates strain healthy tissue {min(peaks):.2f} to "
        f"{max(peaks):.2f} times as much (medians of families), along the edges of the scene's own mesh {min(gauges):.2f} to "
        f"{max(gauges):.2f} times, and {min(ends):.0f} to {max(ends):.0f} % of them collapse. Strain has no limit at the end of "
        "a cut, and a finer mesh resolves more of it: a limit of strain is one of a mesh, and a certificate holds for the mesh "
        "that it was made on."
    )


def margin_figure(shipped: Sequence[Played], worst: Worst) -> Figure:
    """Draw the room that certificates have, and how far other physics move them."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    for ax, name in zip(axes, ("strain", "volume_ratio"), strict=True):
        for family in FAMILIES:
            rooms = rooms_of([each for each in shipped if each.family == family])
            ax.ecdf([getattr(room, name) for room in rooms], label=f"{family}: room to the limit")
        ax.ecdf(getattr(worst, name), color="black", linestyle="--", label="farthest move towards it, training scenes")
        stated = sorted({getattr(margin, name) for margin in worst.stated})
        ax.vlines(stated, 0.0, 1.0, color="grey", linestyle=":", label="stated margin, for each κ")
        ax.set(xscale="log", xlim=(1e-4, 1.0), xlabel=name.replace("_", " "), ylabel="share of certificates")
        ax.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize="small")
    return figure


def rooms_of(played: Sequence[Played]) -> list[Margin]:
    """Return how far the shipped physics stays from the limits."""
    return [room_left(each.traces[SHIPPED.name], load_scene_config(each.family).limits) for each in played]


def keeps_margin(played: Played) -> bool:
    """Tell whether the shipped physics stays as far from every limit as is stated."""
    return stated_margin(load_scene_config(played.family)).holds(*rooms_of([played]))
