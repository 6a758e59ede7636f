"""What observations of a scene are made with: all that never changes while it is played, in their units."""

from typing import Any, NamedTuple

import numpy as np

from envs.action_table import ActionTable
from envs.scene import Scene

Array = np.ndarray[Any, Any]

LARGEST = 1e6
"""Values are held within plus or minus this: a body that blows up is still inside its space."""
LENGTH, VELOCITY, MASS, STRAIN = range(4)
"""Places in Sight.units."""


class Sight(NamedTuple):
    """Constants of the observations of one scene."""

    rest_position: Array
    """Of each mesh point / h, (n_points, 3)."""
    shares: Array
    """What a tetrahedron adds to each of its nodes: target mass [kg], and mass times log(E / E0) [kg], (n_tetrahedra, 2)."""
    tetrahedra: Array
    """Rows of the table of tetrahedra while they are whole and whatever they hang on, float32 (n_tetrahedra, 11)."""
    faces: Array
    """Rows of the table of faces while they are sewn, float32 (n_faces, 5)."""
    face_tetrahedra: Array
    """Two sides of each face, float32 (n_faces, 2)."""
    face_corners: Array
    """Corners 4 * tetrahedron + corner of each face, in the one tetrahedron, then the same in the other, int32 (n_faces, 6)."""
    load: Array
    """Direction of the load, 0 without one, and its size / (E0 h^2), (4,)."""
    units: Array
    """What turns metres into h, m/s into h per time between two cuts, kg into mean node masses, strain into parts of the
    limit, (4,)."""


def sight_of(scene: Scene, table: ActionTable) -> Sight:
    """Return the constants of a scene."""
    stiffness = np.log(scene.young_modulus / scene.reference_modulus)
    mass = scene.physics.density * table.volume
    tetrahedra = np.zeros((table.n_tetrahedra, 11), np.float32)
    tetrahedra[:, :2] = 1.0
    size = 6.0 * table.volume / scene.spacing**3
    for column, values in ((2, scene.target), (3, scene.anchor), (6, stiffness), (7, size), (10, scene.vessel)):
        tetrahedra[:, column] = values
    faces = np.column_stack([np.ones(table.n_faces), table.face_area / scene.spacing**2, table.face_centroid / scene.spacing])
    corners = 4 * table.face_tetrahedra[:, :, None] + table.face_corners
    units = (
        1.0 / scene.spacing, scene.physics.settle_seconds / scene.spacing, scene.mesh.n_points / float(mass.sum()),
        1.0 / scene.limits.strain,
    )  # fmt: skip
    return Sight(
        rest_position=scene.mesh.points / scene.spacing,
        shares=np.ascontiguousarray(0.25 * np.stack([mass * scene.target, mass * stiffness], axis=1)),
        tetrahedra=tetrahedra,
        faces=faces.astype(np.float32),
        face_tetrahedra=table.face_tetrahedra.astype(np.float32),
        face_corners=np.ascontiguousarray(corners.reshape(-1, 6), dtype=np.int32),
        load=seen_load(scene, scene.load),
        units=np.array(units),
    )


def seen_load(scene: Scene, load: Array) -> Array:
    """Return how a total force on the target [N] is shown, (4,)."""
    force = float(np.sqrt((load**2).sum()))
    # A load of zero has no direction.
    return np.append(load / (force or 1.0), force / (scene.reference_modulus * scene.spacing**2))


def no_sight() -> Sight:
    """Return the constants of no scene: what the types of their arrays are."""
    nothing, single = np.zeros(0), np.float32
    return Sight(
        np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 11), single), np.zeros((0, 5), single), np.zeros((0, 2), single),
        np.zeros((0, 6), np.int32), nothing, nothing,
    )  # fmt: skip
