"""What the study of the continuum says, put together from its numbers."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tests.benchmarks.studies import anisotropy
from tests.benchmarks.studies.comparison import ALONG, SLENDERNESS, WHOLE, Comparison, least_wrong
from tests.benchmarks.studies.continuum_tables import CAUCHY_RATIO, SOFT_TISSUE, Rows, linear_errors, spring_errors
from tests.benchmarks.studies.statics import body_of, mean_elasticity

METHOD = f"""Static deflection under small loads, by linear theory: a cantilever {SLENDERNESS} times as long as high that sags by
its weight, a cube clamped at its bottom and pressed evenly on its top, and the liver hanging by its anchor. The springs are
compared with isotropic linear elasticity of the same Young's modulus, solved by scikit-fem with quadratic tetrahedra, the
reference. The finer mesh of the liver has its tetrahedra cut into eight. An error is the RMS distance of two displacement
fields over the body, relative to the RMS displacement of the continuum; also of the part along the load alone. All is
proportional to the load.

Six springs of stiffness E V / l² on a tetrahedron are, for small strains, a linear finite element of the elasticity tensor
E Σ n n n n, summed over its edges. So the error has two causes: what linear elements of any material get wrong on the mesh
(locking, which refinement cures: the rows of linear elements show it), and that this is not the isotropic tensor (which
refinement does not cure). Locking of linear elements at high ν is their own error, not the springs'."""


def error_text(bodies: Mapping[str, Sequence[Comparison]]) -> str:
    """Say how large the errors are, and where springs do better than linear elements."""
    lines, better = [], []
    for name, comparisons in bodies.items():
        whole = comparisons[-1]
        along = whole.along_load()
        ranges = [spread(spring_errors(each)) for each in (whole, along)]
        lines.append(f"{name} {ranges[0]} of the whole displacement and {ranges[1]} of that along the load (linear elements: "
                     f"{spread(linear_errors(whole))} of the whole)")  # fmt: skip
        better += [f"{each.label['body']} of {each.label['tetrahedra']} tetrahedra" for each in comparisons
                   if np.mean(spring_errors(each)) < np.mean(linear_errors(each))]  # fmt: skip
    return (
        f"**Error of the springs** over all ν, on the finest meshes: {'; '.join(lines)}. Springs are closer than linear "
        f"elements, on average over ν, on these meshes: {', '.join(better) or 'none'}."
    )


def spread(values: Sequence[float]) -> str:
    """Return the least and the largest share."""
    return f"{percent(min(values))} to {percent(max(values))}"


def ratio_text(finest: Sequence[Comparison]) -> str:
    """Say which Poisson ratio is least wrong."""
    each = ", ".join(f"{whole.problem.name} {least_wrong([whole], False)[0]:.2f}" for whole in finest)
    sentences = [f"**Least wrong Poisson ratio**, by the whole displacement on the finest meshes: {each}."]
    for part in (WHOLE, ALONG):
        chosen = [whole if part == WHOLE else whole.along_load() for whole in finest]
        for is_scaled in (False, True):
            ratio, error = least_wrong(chosen, is_scaled)
            scale = "each with its best scale" if is_scaled else "unscaled"
            sentences.append(f"All together, {part}, {scale}: {ratio:.2f} (RMS error {percent(error)}).")
    organ = anisotropy.closest_isotropic(mean_elasticity(body_of(finest[-1].problem.mesh)))
    boxes = anisotropy.closest_isotropic(mean_elasticity(body_of(finest[0].problem.mesh)))
    return " ".join(sentences) + (
        f" If all tetrahedra were strained alike, the closest isotropic material would have ν = {boxes[1]:.3f} and "
        f"{boxes[0]:.3f} times the Young's modulus for the boxes, {organ[1]:.3f} and {organ[0]:.3f} for the liver: "
        "so E V / l² asks for no constant on average, and leaves no Poisson ratio to choose."
    )


def scale_text(bodies: Mapping[str, Sequence[Comparison]], held_out: Rows) -> str:
    """Say what a constant is worth: on the body it was found on, on other meshes of it, and on other bodies."""
    own, meshes_of, parts, shifts = [], [], [], []
    for name, comparisons in bodies.items():
        along = [whole.along_load() for whole in comparisons]
        references = [each.reference_at(CAUCHY_RATIO) for each in along]
        scales = [each.best_scale(reference) for each, reference in zip(along, references, strict=True)]
        before, after = along[-1].scaled_error(references[-1], 1.0), along[-1].scaled_error(references[-1])
        own.append(f"{name} {percent(before)} to {percent(after)}")
        meshes_of.append(f"{name} {' → '.join(f'{scale:.3f}' for scale in scales)}")
        shifts.append((comparisons[-1].best_scale(comparisons[-1].reference_at(CAUCHY_RATIO)), scales[-1], name))
    for part in (WHOLE, ALONG):
        pairs, scales = held_out_pairs(held_out, part)
        n_better = sum(after < before for before, after in pairs)
        change = np.exp(np.mean(np.log([after / before for before, after in pairs])))
        verdict = "helps" if change < 1.0 and 2 * n_better > len(pairs) else "does not help"
        parts.append(
            f"fitted to the displacement {'as a whole' if part == WHOLE else part}, c lies between {min(scales):.3f} and "
            f"{max(scales):.3f}; on another body it lowers the error in {n_better} of {len(pairs)} cases and multiplies it by "
            f"{change:.2f} in the geometric mean: it {verdict}"
        )
    of_whole, of_along, furthest = max(shifts, key=lambda shift: abs(math.log(shift[0] / shift[1])))
    return (
        f"**One constant c for the stiffness.** On the body that it is fitted to, along the load at ν = {CAUCHY_RATIO}, it "
        f"brings the error from {', '.join(own)}. From coarse to fine meshes of one body it goes {', '.join(meshes_of)}. Found "
        f"on one body and used on the others, at ν = {CAUCHY_RATIO} and {SOFT_TISSUE}: {'; '.join(parts)}. "
        f"Where the two fits differ (most for the {furthest}: {of_whole:.2f} against {of_along:.2f}), the one of the whole "
        "shrinks sideways motion rather than mending stiffness."
    )


def held_out_pairs(held_out: Rows, part: str) -> tuple[list[tuple[float, float]], list[float]]:
    """Return errors without and with a constant on each body that it was not found on, and the constants."""
    pairs, scales = [], []
    plain: dict[str, Any] = {}
    for row in (row for row in held_out if row["displacement"] == part):
        if row["found on"] == "none":
            plain = row
            continue
        scales.append(row["c"])
        pairs += [(plain[name], row[name]) for name in row if name.startswith("error, ") and name != f"error, {row['found on']}"]
    return pairs, scales


def direction_text(directions: Rows) -> str:
    """Say how far stiffness depends on direction."""
    softest, stiffest = (choose(directions, key=lambda row: row["theory"]) for choose in (min, max))
    *_, last, mirrored = softest
    mirrored_moduli = [row[mirrored] for row in directions]
    return (
        f"**Direction.** Kuhn boxes are stiffest along the {stiffest['direction']}, {stiffest[last]:.2f} times the Young's "
        f"modulus asked for, and softest along the {softest['direction']}, {softest[last]:.2f} times: a factor of "
        f"{stiffest[last] / softest[last]:.1f} (theory: {stiffest['theory'] / softest['theory']:.1f}). A load along an edge "
        "therefore moves a box sideways too, which an isotropic one would not: that is the gap between the errors of the whole "
        "displacement and of its part along the load. Where cubes are mirror images of their neighbours "
        "(`meshes.box(..., is_mirrored=True)`), no way is preferred to its mirror image, and the factor is "
        f"{max(mirrored_moduli) / min(mirrored_moduli):.1f}."
    )


def rest_text(checks: Rows, settled: Rows) -> str:
    """Say what the checks and the simulation give."""
    changes = ", ".join(f"{row['body']} {percent(row['moved by'])}" for row in checks if np.isfinite(row["moved by"]))
    softest = min(row["least eigenvalue ratio"] for row in checks)
    small, large = settled
    return (
        f"**Checks.** Quadratic elements twice as large are off the reference by at most: {changes}; it is itself wrong by less, "
        "and errors of that size are not resolved. The stiffness matrix is regular on all bodies: its least eigenvalue is at "
        f"least {softest:.2f} times that of linear elements at ν = {CAUCHY_RATIO}, so no hinge swings freely. A simulation let "
        f"come to rest differs from linear theory by {percent(small['relative difference, RMS'])} where the tip sinks by "
        f"{percent(small['deflection over length'])} of the length, and by {percent(large['relative difference, RMS'])} at "
        f"{percent(large['deflection over length'])}: what large rotation changes."
    )


def percent(value: float) -> str:
    """Return a share as a percentage with two digits that matter."""
    if value < 1e-5:
        return "less than 0.001 %"
    return f"{100.0 * value:.2g} %" if value < 0.995 else f"{100.0 * value:.0f} %"
