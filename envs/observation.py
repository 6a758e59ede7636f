"""What an agent sees: the whole body as arrays of fixed size, gathered by index, in one table.

Lengths are in units of the scene's h, stiffness in units of its reference modulus E0, strain and time in units of what
tears and of the time between two cuts. What is gone is a row of zeros, and an id that leads nowhere is -1.
The optimum, the certificate and anything computed from them never enter.
"""

from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from envs.observation_kernel import Observation
from envs.sight import LARGEST

Array = np.ndarray[Any, Any]


class Column(NamedTuple):
    """One column of a table."""

    name: str
    meaning: str
    low: float = 0.0
    high: float = LARGEST


def _vector(name: str, meaning: str, reach: float = LARGEST) -> list[Column]:
    """Return three columns for a vector."""
    return [Column(f"{name}_{axis}", meaning, -reach, reach) for axis in "xyz"]


COLUMNS: dict[str, list[Column]] = {
    "nodes": [
        Column("alive", "1, or a row of zeros", 0.0, 1.0),
        *_vector("position", "position / h"),
        *_vector("displacement", "displacement from rest / h"),
        *_vector("velocity", "velocity, h per time between two cuts"),
        Column("pinned", "1 if it never moves", 0.0, 1.0),
        Column("mass", "mass / mean node mass of the uncut body"),
        Column("target", "share of its mass that is target", 0.0, 1.0),
        Column("strain", "largest edge strain of its tetrahedra / limit", -LARGEST),
        Column("stiffness", "log(E / E0), mean by mass", -LARGEST),
    ],
    "faces": [
        Column("sewn", "1 if it can be cut, or a row of zeros", 0.0, 1.0),
        Column("area", "rest area / h^2"),
        *_vector("centroid", "rest centroid / h"),
    ],
    "tetrahedra": [
        Column("alive", "1, or a row of zeros", 0.0, 1.0),
        Column("attached", "1 if it hangs on an anchor; loose pieces are taken away at once", 0.0, 1.0),
        Column("target", "1 if it is to be freed", 0.0, 1.0),
        Column("anchor", "1 if it has a pinned corner", 0.0, 1.0),
        Column("strain", "largest edge strain / limit", -LARGEST),
        Column("volume_ratio", "volume / rest volume", -LARGEST),
        Column("stiffness", "log(E / E0)", -LARGEST),
        Column("volume", "6 rest volume / h^3"),
        Column("free_faces", "faces on the surface / 4", 0.0, 1.0),
        Column("cut_faces", "faces that a cut has laid open / 4", 0.0, 1.0),
        Column("vessel", "1 if it must not be laid open", 0.0, 1.0),
    ],
    "globals": [
        *_vector("load_direction", "unit vector of the load, 0 without one", 1.0),
        Column("load", "total load / (E0 h^2)"),
        Column("healthy_strain", "largest edge strain of healthy tissue / limit"),
        Column("target_strain", "largest edge strain of the target / limit"),
        Column("healthy_share", "attached healthy volume / that of the settled, uncut body", 0.0, 1.0),
        Column("target_share", "attached target volume / that of the settled, uncut body", 0.0, 1.0),
        Column("cost", "cost so far / 10"),
        Column("steps", "actions so far / 100"),
        Column("lowest_volume_ratio", "smallest volume / rest volume of healthy tissue", -LARGEST),
        Column("components", "pieces / 10"),
    ],
}
"""Columns of the tables of numbers: a row per node, per interior face, per tetrahedron, and one row for the whole."""

IDS: dict[str, tuple[str, int, str, str]] = {
    "face_tetrahedra": ("faces", 2, "tetrahedra", "its two tetrahedra in the uncut body"),
    "face_nodes": (
        "faces",
        6,
        "nodes",
        "its three corners in the one tetrahedron, then the same in the other",
    ),
    "tetrahedron_nodes": ("tetrahedra", 4, "nodes", "its corners"),
    "tetrahedron_neighbours": (
        "tetrahedra",
        4,
        "tetrahedra",
        "the tetrahedron across the face opposite each corner",
    ),
    "components": (
        "tetrahedra",
        0,
        "tetrahedra",
        "its piece, numbered in the order of the lowest tetrahedron",
    ),
}
"""Tables of ids: a row for each of what, how many columns (0: a flat array), ids of what, meaning; -1 leads nowhere.

Node rows belong to corners: row 4 t + c is the node whose lowest corner is c of tetrahedron t. There is a row for every
node that cutting can make, and which rows are alive depends on the body alone, not on the order of its cuts."""


def observation_space(n_faces: int, n_tetrahedra: int) -> spaces.Dict:
    """Return the space of a mesh with so many interior faces and tetrahedra, in the order of `Observation`."""
    rows = {"nodes": 4 * n_tetrahedra, "faces": n_faces, "tetrahedra": n_tetrahedra}
    found: dict[str, spaces.Space[Any]] = {}
    for name, columns in COLUMNS.items():
        low = np.array([column.low for column in columns], dtype=np.float32)
        high = np.array([column.high for column in columns], dtype=np.float32)
        shape = (rows[name], len(columns)) if name in rows else (len(columns),)
        found[name] = spaces.Box(np.broadcast_to(low, shape), np.broadcast_to(high, shape), dtype=np.float32)
    for name, (owner, n_columns, of, _) in IDS.items():
        shape = (rows[owner], n_columns) if n_columns else (rows[owner],)
        found[name] = spaces.Box(-1.0, float(rows[of] - 1), shape, np.float32)
    found["action_mask"] = spaces.Box(0, 1, (n_faces + n_tetrahedra,), np.int8)
    return spaces.Dict([(name, found[name]) for name in Observation._fields])


class Observer:
    """Make arrays for observations of one mesh; those handed out are the receiver's own."""

    def __init__(self, space: spaces.Dict) -> None:
        """Keep the shapes of the arrays in a space."""
        self._kinds = [(box.shape or (), np.dtype(box.dtype or np.float32)) for box in space.values()]

    def room_for(self, n: int) -> Observation:
        """Return arrays for n observations, side by side, not set to anything."""
        return Observation._make([np.empty((n, *shape), dtype) for shape, dtype in self._kinds])


def one_of(observations: Observation, place: int) -> dict[str, Array]:
    """Return one of many observations, as views."""
    return {name: array[place] for name, array in zip(Observation._fields, observations, strict=True)}
