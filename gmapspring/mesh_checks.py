"""What a mesh must fulfil: every check names the first culprit and the way out. All are vectorised."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.topology.darts import EDGE_CORNERS, OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]

FLAT_RATIO = 1e-12
"""A volume below this times the cube of the longest edge is round-off; a regular tetrahedron has 0.118."""

MOST_TETRAHEDRA = np.iinfo(np.int32).max // 24
"""Each has 24 darts, numbered in int32."""


def checked_shape(points: Any) -> Array:
    """Return points as a new float64 array (n, 3), finite or not, or raise."""
    array = _as_array(points, "points")
    if array.dtype.kind not in "fiu":
        raise MeshError(f"points have dtype {array.dtype}; give floats")
    if array.ndim != 2 or array.shape[1] != 3:
        raise MeshError(f"points have shape {array.shape}; give (n_points, 3)")
    return np.array(array, dtype=np.float64, order="C")


def _as_array(values: Any, name: str) -> Array:
    """Return anything as an array, or raise."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as error:
        raise MeshError(f"{name} are not an array ({error}); give rows of equal length") from error


def checked_points(points: Any) -> Array:
    """Return points as a new finite float64 array (n, 3), or raise."""
    array = checked_shape(points)
    is_finite = np.isfinite(array).all(axis=1)
    if not is_finite.all():
        culprit = int(np.argmin(is_finite))
        raise MeshError(f"point {culprit} is not finite: {array[culprit].tolist()}; correct its coordinates")
    return array


def checked_tetrahedra(tetrahedra: Any, n_points: int) -> Array:
    """Return tetrahedra as a new int32 array (n, 4) of ids in range, each point used, no corner twice, or raise."""
    array = _as_array(tetrahedra, "tetrahedra")
    if array.size == 0:
        raise MeshError("the mesh has no tetrahedra; give at least one")
    if array.ndim != 2 or array.shape[1] != 4:
        raise MeshError(f"tetrahedra have shape {array.shape}; give (n_tetrahedra, 4)")
    if array.dtype.kind not in "iu":
        raise MeshError(f"tetrahedra have dtype {array.dtype}; give integers")
    if len(array) > MOST_TETRAHEDRA:
        raise MeshError(f"the mesh has {len(array)} tetrahedra; give at most {MOST_TETRAHEDRA}, so that darts fit int32")
    check_range(array, n_points)
    _check_corners(array)
    is_used = np.zeros(n_points, dtype=bool)
    is_used[array.ravel()] = True
    if not is_used.all():
        raise MeshError(
            f"point {int(np.argmin(is_used))} is a corner of no tetrahedron ({np.count_nonzero(~is_used)} such points); "
            "remove it and renumber, as read_mesh does"
        )
    return np.array(array, dtype=np.int32, order="C")


def check_range(tetrahedra: Array, n_points: int) -> None:
    """Raise when an id is below 0 or above the last point."""
    is_outside = ((tetrahedra < 0) | (tetrahedra >= n_points)).any(axis=1)
    if is_outside.any():
        culprit = int(np.argmax(is_outside))
        raise MeshError(
            f"tetrahedron {culprit} has corners {tetrahedra[culprit].tolist()}, but points are numbered 0 to "
            f"{n_points - 1}; correct its ids"
        )


def _check_corners(tetrahedra: Array) -> None:
    """Raise when a tetrahedron has the same corner twice."""
    ordered = np.sort(tetrahedra, axis=1)
    is_repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if is_repeated.any():
        culprit = int(np.argmax(is_repeated))
        raise MeshError(
            f"tetrahedron {culprit} has a repeated corner: {tetrahedra[culprit].tolist()}; remove it or correct its ids"
        )


def signed_volumes(points: Array, tetrahedra: Array) -> Array:
    """Return the volume of each tetrahedron [m^3], negative where it is wound the other way, shape (n,)."""
    # Coordinates first, so that every operation below runs over long contiguous rows.
    corners = np.ascontiguousarray(points.T)[:, tetrahedra.T]
    (ax, bx, cx), (ay, by, cy), (az, bz, cz) = corners[:, 1:] - corners[:, :1]
    return (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6.0


def flat_limits(points: Array, tetrahedra: Array) -> Array:
    """Return the volume at or below which each tetrahedron counts as flat [m^3], shape (n,)."""
    corners = np.ascontiguousarray(points.T)[:, tetrahedra.T]
    longest = np.zeros(len(tetrahedra))
    for first, second in EDGE_CORNERS.tolist():
        x, y, z = corners[:, first] - corners[:, second]
        np.maximum(longest, x * x + y * y + z * z, out=longest)
    return FLAT_RATIO * longest * np.sqrt(longest)


def check_volumes(points: Array, tetrahedra: Array) -> None:
    """Raise when a volume is not positive, or overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        volumes = signed_volumes(points, tetrahedra)
        limits = flat_limits(points, tetrahedra)
    is_good = (volumes > limits) & np.isfinite(volumes)
    if is_good.all():
        return
    culprit = int(np.argmin(is_good))
    volume = volumes[culprit]
    which = f"tetrahedron {culprit} (corners {tetrahedra[culprit].tolist()})"
    if not np.isfinite(limits[culprit]):
        raise MeshError(f"{which} is too large for float64; give coordinates in metres")
    if volume < -limits[culprit]:
        n_inverted = np.count_nonzero(volumes < -limits)
        raise MeshError(
            f"{which} has negative volume {volume:.3g} m^3 ({n_inverted} such tetrahedra); "
            "swap two of its corners, as read_mesh does"
        )
    raise MeshError(f"{which} is flat: volume {volume:.3g} m^3; remove it or move a corner")


def row_keys(rows: Array, n_values: int) -> Array:
    """Return one int64 per row of ids below n_values, equal exactly where the rows are, shape (n,)."""
    keys, limit = rows[:, 0].astype(np.int64), n_values
    for column in rows.T[1:]:
        if limit > np.iinfo(np.int64).max // n_values:
            keys, limit = np.unique(keys, return_inverse=True)[1].astype(np.int64), len(rows)
        keys, limit = keys * n_values + column, limit * n_values
    return keys


def check_faces(tetrahedra: Array, n_points: int) -> None:
    """Raise for two tetrahedra on the same corners, three on one face, or two on the same side of one."""
    ordered = np.sort(tetrahedra, axis=1)
    order, is_same = _sorted_keys(row_keys(ordered, n_points))
    if is_same.any():
        first, second = np.sort(order[np.argmax(is_same) :][:2]).tolist()
        raise MeshError(f"tetrahedra {first} and {second} are on the same corners {ordered[first].tolist()}; remove one of them")
    faces = tetrahedra[:, OUTWARD_FACE_CORNERS].reshape(-1, 3)
    order, is_same = _sorted_keys(row_keys(np.sort(faces, axis=1), n_points))
    is_triple = is_same[1:] & is_same[:-1]
    if is_triple.any():
        slots = np.sort(order[np.argmax(is_triple) :][:3])
        raise MeshError(
            f"face {np.sort(faces[slots[0]]).tolist()} has three tetrahedra: {(slots // 4).tolist()}; "
            "a face can join two: remove one of them"
        )
    pairs = np.flatnonzero(is_same)
    _check_sides(faces, order[pairs], order[pairs + 1])


def _sorted_keys(keys: Array) -> tuple[Array, Array]:
    """Return the order that sorts the keys, and which of them then equal their successor."""
    order = np.argsort(keys)
    ordered = keys[order]
    return order, ordered[1:] == ordered[:-1]


def _check_sides(faces: Array, first: Array, second: Array) -> None:
    """Raise when both tetrahedra of a face lie on the same side: positive volumes alone allow that."""
    a, b, c = faces.T
    is_odd = (a > b) ^ (b > c) ^ (a > c)
    is_overlap = is_odd[first] == is_odd[second]
    if is_overlap.any():
        culprit = int(np.argmax(is_overlap))
        slots = np.sort([first[culprit], second[culprit]])
        raise MeshError(
            f"tetrahedra {slots[0] // 4} and {slots[1] // 4} lie on the same side of their face "
            f"{np.sort(faces[slots[0]]).tolist()}, so they overlap; remove one or correct its corners"
        )


def paired_faces(tetrahedra: Array, n_points: int) -> tuple[Array, Array]:
    """Return the two sides of every interior face of a checked mesh as slots 4 * tetrahedron + face, lower first."""
    order, is_same = _sorted_keys(row_keys(np.sort(tetrahedra[:, OUTWARD_FACE_CORNERS].reshape(-1, 3), axis=1), n_points))
    pairs = np.flatnonzero(is_same)
    return np.minimum(order[pairs], order[pairs + 1]), np.maximum(order[pairs], order[pairs + 1])


def checked_regions(regions: Mapping[str, Any], length: int, items: str, where: str) -> dict[str, Array]:
    """Return copies of the masks of named regions, each bool of the given length, or raise."""
    if not isinstance(regions, Mapping):
        raise MeshError(f"{where} is a {type(regions).__name__}; give a dict from names to masks")
    checked = {}
    for name, mask in regions.items():
        if not isinstance(name, str) or not name:
            raise MeshError(f"{where} has the name {name!r}; give a non-empty string")
        array = np.array(mask)
        if array.dtype != np.bool_ or array.shape != (length,):
            raise MeshError(
                f"{where}[{name!r}] has dtype {array.dtype} and shape {array.shape}; "
                f"give a bool mask of shape ({length},), one entry for each of the {items}"
            )
        checked[name] = array
    return checked
