"""A zoo of meshes: plain, holed, hollow, pinched, and the shipped organ. Every test on the map runs over all of it."""

from functools import lru_cache
from itertools import permutations

import numpy as np

from gmapspring import meshes
from gmapspring.mesh import Mesh


def cubes(is_solid, spacing=1.0):
    """Return the solid cubes of a grid (bool, 3-D), each cut into six tetrahedra round its diagonal; points shared."""
    is_solid = np.asarray(is_solid, dtype=bool)
    paths = [np.concatenate([np.zeros((1, 3), int), np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)])
             for order in permutations(range(3))]  # fmt: skip
    corners = np.array([cube + path for cube in np.argwhere(is_solid) for path in paths])
    grid_points, tetrahedra = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return oriented(spacing * grid_points, tetrahedra.reshape(-1, 4))


def oriented(points, tetrahedra):
    """Return a mesh in which tetrahedra that were wound the other way are turned."""
    points, tetrahedra = np.asarray(points, dtype=float), np.array(tetrahedra)
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    is_negative = np.linalg.det(edges) < 0
    tetrahedra[is_negative, 2:] = tetrahedra[is_negative][:, [3, 2]]
    return Mesh(points, tetrahedra)


def torus():
    """Return a ring of eight cubes: a solid torus."""
    is_solid = np.ones((3, 3, 1))
    is_solid[1, 1] = 0
    return cubes(is_solid)


def hollow_box():
    """Return a box of 26 cubes round an inner cavity."""
    is_solid = np.ones((3, 3, 3))
    is_solid[1, 1, 1] = 0
    return cubes(is_solid)


def ring(n_tetrahedra=6):
    """Return tetrahedra all round one interior edge."""
    angles = 2 * np.pi * np.arange(n_tetrahedra) / n_tetrahedra
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(n_tetrahedra)], axis=1)
    following = np.roll(np.arange(n_tetrahedra), -1)
    return oriented([*rim, (0, 0, -1), (0, 0, 1)],
                    [(a, b, n_tetrahedra, n_tetrahedra + 1) for a, b in enumerate(following)])  # fmt: skip


def fan():
    """Return tetrahedra round an edge that lies on the boundary: a ring with one missing."""
    whole = ring(6)
    return Mesh(whole.points, whole.tetrahedra[1:])


def star():
    """Return the 24 tetrahedra that join the faces of a subdivided cube surface to one inner point."""
    whole = cubes(np.ones((2, 2, 2)))
    centre = int(np.flatnonzero((whole.points == 1.0).all(axis=1))[0])
    return compacted(whole.points, whole.tetrahedra[(whole.tetrahedra == centre).any(axis=1)])


def compacted(points, tetrahedra):
    """Return a mesh without the points that no tetrahedron uses."""
    used, renumbered = np.unique(tetrahedra, return_inverse=True)
    return Mesh(points[used], renumbered.reshape(-1, 4))


def two_cubes(offset):
    """Return two cubes that touch in a vertex (offset 1, 1, 1), an edge (1, 1, 0) or a face (1, 0, 0)."""
    is_solid = np.zeros((2, 2, 2))
    is_solid[0, 0, 0] = is_solid[tuple(offset)] = 1
    return cubes(is_solid)


def pinched_block():
    """Return a block of six cubes whose middle node is singular: its link is a band, not a disc."""
    is_solid = np.ones((2, 2, 2))
    is_solid[0, 0, 0] = is_solid[1, 1, 1] = 0
    return cubes(is_solid)


def shaken(mesh, seed=0, share=0.06):
    """Move every point by a random share of the mean edge length, so that no two lengths are alike."""
    corners = mesh.points[mesh.tetrahedra]
    length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).min()
    noise = np.random.default_rng(seed).uniform(-1.0, 1.0, mesh.points.shape)
    return Mesh(mesh.points + share * length * noise, mesh.tetrahedra)


BUILDERS = {
    "single": meshes.single,
    "two": meshes.two_tetrahedra,
    "ring": ring,
    "fan": fan,
    "star": star,
    "box": lambda: meshes.box((2, 2, 2)),
    "slab": lambda: meshes.box((3, 2, 1)),
    "ball": lambda: meshes.ball(3),
    "torus": torus,
    "hollow_box": hollow_box,
    "cubes_sharing_a_vertex": lambda: two_cubes((1, 1, 1)),
    "cubes_sharing_an_edge": lambda: two_cubes((1, 1, 0)),
    "pinched_block": pinched_block,
    "liver": meshes.liver,
}

ALL = tuple(BUILDERS)
SMALL = tuple(name for name in ALL if name not in ("liver", "ball", "hollow_box"))
MANIFOLD = tuple(name for name in ALL if name != "pinched_block")


@lru_cache
def build(name):
    """Return the mesh of that name, points shaken so that lengths and masses all differ."""
    return shaken(BUILDERS[name]()) if name != "liver" else BUILDERS[name]()
