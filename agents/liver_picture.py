"""The picture of the first screen: a liver that hangs from its anchor, cut open beside the tumour."""

from typing import Any

import numpy as np

import gmapspring as gs
from gmapspring.render import render_body
from gmapspring.rendering.camera import Camera

Array = np.ndarray[Any, Any]

SIZE = (900, 600)
GRAVITY = (0.0, 0.0, -9.81)
RETRACTION = np.array([-7.7, -4.1, -0.9])
"""Force with which the tumour is held aside [N]."""

PLANE_X, BACK_Y = -0.046, 0.03
"""The cut: along a plane across the organ, from its front edge to here [m]."""

OPENING = 0.53
"""Width of the wedge that is removed, over its distance from the wedge's tip in the middle of the organ."""


def hung_liver() -> gs.Simulation:
    """Return the shipped organ, hung from its anchor, with its tumour pulled aside."""
    mesh = gs.meshes.liver()
    held = np.unique(mesh.tetrahedra[mesh.cell_regions["tumour"]])
    loads = np.zeros((mesh.n_points, 3))
    loads[held] = RETRACTION / len(held)
    material = gs.Material(young_modulus=40e3, density=1060.0, viscosity=20.0)
    return gs.Simulation(mesh, material, pinned=mesh.point_regions["anchor"], gravity=GRAVITY, loads=loads,
                         integrator="symplectic_euler")  # fmt: skip


def cut_beside_tumour(simulation: gs.Simulation) -> None:
    """Remove a wedge beside the tumour, cut the faces behind it, and take away what came loose."""
    body = simulation.body
    centre = body.mesh.points[body.mesh.tetrahedra].mean(axis=1)
    beside = centre[:, 0] - PLANE_X
    is_wedge = (beside > 0.0) & (beside < OPENING * -centre[:, 1]) & ~body.mesh.cell_regions["tumour"]
    here, there = np.arange(body.gmap.image.size) // 4, body.gmap.image.ravel() // 24
    is_cut = (beside[here] < 0.0) & (beside[there] > 0.0) & (centre[here, 1] + centre[there, 1] < 2.0 * BACK_Y)
    is_cut &= ~is_wedge[here] & ~is_wedge[there]
    simulation.cut(faces=np.stack([here, there], axis=1)[is_cut], tetrahedra=np.flatnonzero(is_wedge))
    label = simulation.components()
    is_loose = (label >= 0) & (label != np.bincount(label[label >= 0]).argmax())
    simulation.cut(tetrahedra=np.flatnonzero(is_loose))


def cut_liver_picture() -> Array:
    """Return the picture, uint8 (600, 900, 3)."""
    simulation = hung_liver()
    cut_beside_tumour(simulation)
    simulation.advance(1.0)
    simulation.check_validity()
    camera = Camera.fit(simulation.body.nodes.position, azimuth=-84.0, elevation=42.0, aspect=SIZE[0] / SIZE[1], margin=1.06)
    tumour = simulation.body.mesh.cell_regions["tumour"]
    return render_body(simulation.body, highlight=tumour, camera=camera, size=SIZE)
