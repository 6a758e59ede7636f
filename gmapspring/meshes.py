"""Meshes made by rule, and the organ that ships with the package. Every one is deterministic."""

from collections.abc import Sequence
from itertools import combinations, permutations
from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import signed_volumes
from gmapspring.mesh_files import read_mesh
from gmapspring.paths import configs_folder

Array = np.ndarray[Any, Any]

_ORDERS = list(permutations(range(3)))


def single(size: float = 1.0) -> Mesh:
    """Return one regular tetrahedron of the given edge length [m]."""
    _check_positive("size", size)
    corners = np.array([(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)], dtype=np.float64)
    return _oriented(corners * (size / np.sqrt(8.0)), np.array([(0, 1, 2, 3)]))


def two_tetrahedra(size: float = 1.0) -> Mesh:
    """Return two regular tetrahedra of the given edge length [m] that share the face of points 0, 1 and 2."""
    _check_positive("size", size)
    triangle = [(1.0, 0.0, 0.0), (-0.5, np.sqrt(0.75), 0.0), (-0.5, -np.sqrt(0.75), 0.0)]
    points = np.array([*triangle, (0.0, 0.0, np.sqrt(2.0)), (0.0, 0.0, -np.sqrt(2.0))])
    return _oriented(points * (size / np.sqrt(3.0)), np.array([(0, 1, 2, 3), (0, 1, 2, 4)]))


def box(shape: Sequence[int], spacing: float = 1.0, is_mirrored: bool = False) -> Mesh:
    """Return a box of cubes, each cut into six tetrahedra round its diagonal (Kuhn, 1960).

    Args:
        shape: number of cubes along x, y and z, each at least 1.
        spacing: edge length of a cube [m].
        is_mirrored: cut each cube as the mirror image of its neighbours, so that diagonals run all ways alike (Todd, 1976, J1);
            else they run one way, along which springs make the box stiffer: see docs/accuracy.md.

    Faces of neighbours match either way; cube (i, j, k) owns six consecutive tetrahedra, k fastest.
    """
    counts = _checked_counts(shape)
    _check_positive("spacing", spacing)
    points = spacing * np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in counts), indexing="ij"), axis=-1)
    strides = np.array([(counts[1] + 1) * (counts[2] + 1), counts[2] + 1, 1])
    cubes = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    is_turned = cubes % 2 if is_mirrored else np.zeros_like(cubes)
    # A path along the three axes, in each of the six orders, from the cube's first corner to its last; from mirrored ones back.
    steps = ((1 - 2 * is_turned) * strides)[:, np.array(_ORDERS)]
    firsts = ((cubes + is_turned) @ strides)[:, None, None]
    tetrahedra = np.concatenate([np.broadcast_to(firsts, (*steps.shape[:2], 1)), firsts + np.cumsum(steps, axis=2)], axis=2)
    return _oriented(points.reshape(-1, 3), tetrahedra.reshape(-1, 4))


def ball(n_shells: int = 3, radius: float = 1.0) -> Mesh:
    """Return a ball round the origin with the given radius [m]: 20 n_shells^3 well-shaped tetrahedra.

    An icosahedron, cut into 20 tetrahedra round its centre, each cut into n_shells^3 by the rule of Kuhn and then
    pushed outward until every shell lies on a sphere.
    """
    if not isinstance(n_shells, int | np.integer) or n_shells < 1:
        raise MeshError(f"n_shells is {n_shells!r}; give a whole number of shells, at least 1")
    _check_positive("radius", radius)
    corners, parts = _icosahedron()
    weights, tetrahedra = _subdivided(parts, int(n_shells))
    points = weights @ corners
    shell = n_shells - weights[:, 0]
    length = np.linalg.norm(points, axis=1)
    # The centre has no direction: it stays where it is.
    points *= (radius / n_shells * shell / np.where(length > 0, length, 1.0))[:, None]
    return _oriented(points, tetrahedra)


def _icosahedron() -> tuple[Array, Array]:
    """Return centre and corners (13, 3), and the 20 tetrahedra between the centre (id 0) and each face."""
    golden = (1 + np.sqrt(5.0)) / 2
    upright = [(0.0, y, z * golden) for y in (-1, 1) for z in (-1, 1)]
    corners = np.array([(0.0, 0.0, 0.0), *(np.roll(corner, turn) for turn in range(3) for corner in upright)])
    distance = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    is_edge = np.isclose(distance, 2.0)  # the other distances are 0, 1.9 (to the centre), 3.2 and 3.8
    faces = [f for f in combinations(range(1, 13), 3) if all(is_edge[a, b] for a, b in combinations(f, 2))]
    return corners, np.array([(0, *face) for face in faces])


def _subdivided(parts: Array, n: int) -> tuple[Array, Array]:
    """Cut tetrahedra into n^3 each (Freudenthal, 1942); return corner weights (n_points, n_corners) and tetrahedra.

    Whole-number weights sum to n. Shared faces match, since each part lists its corners in ascending order.
    """
    grid = np.stack(np.meshgrid(*(np.arange(n),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    steps = np.array([np.cumsum([(0, 0, 0), *np.eye(3, dtype=int)[list(order)]], axis=0) for order in _ORDERS])
    paths = (grid[:, None, None] + steps).reshape(-1, 4, 3)
    x, y, z = np.moveaxis(paths, 2, 0)
    paths = paths[((x >= y) & (y >= z)).all(axis=1)]
    x, y, z = np.moveaxis(paths, 2, 0)
    local = np.stack([n - x, x - y, y - z, z], axis=-1)
    weights = np.zeros((len(parts), *local.shape[:2], parts.max() + 1), dtype=np.int64)
    for part, corners in enumerate(parts):
        weights[part][..., corners] = local
    points, tetrahedra = np.unique(weights.reshape(-1, weights.shape[-1]), axis=0, return_inverse=True)
    return points, tetrahedra.reshape(-1, 4)


def liver() -> Mesh:
    """Return the shipped organ: 563 points and 1854 tetrahedra, 0.2 m wide, made by configs/meshes/make_liver.py.

    Its regions: point region "anchor" (where it hangs) and cell region "tumour" (a lump under the surface).
    """
    return read_mesh(configs_folder() / "meshes" / "liver.vtu")


def _oriented(points: Array, tetrahedra: Array) -> Mesh:
    """Return the mesh with its negative tetrahedra turned."""
    turned = tetrahedra.copy()
    is_negative = signed_volumes(points, tetrahedra) < 0
    turned[is_negative, 2:] = tetrahedra[is_negative][:, [3, 2]]
    return Mesh(points, turned)


def _check_positive(name: str, value: float) -> None:
    """Raise unless a length is a positive finite number."""
    if not (isinstance(value, int | float | np.number) and np.isfinite(value) and value > 0):
        raise MeshError(f"{name} is {value!r}; give a positive length in metres")


def _checked_counts(shape: Sequence[int]) -> tuple[int, int, int]:
    """Return three counts of cubes, or raise."""
    counts = np.asarray(shape)
    if counts.shape != (3,) or counts.dtype.kind not in "iu" or (counts < 1).any():
        raise MeshError(f"shape is {shape!r}; give three whole numbers of cubes, each at least 1")
    return int(counts[0]), int(counts[1]), int(counts[2])
