"""What schemes are compared on: bodies at the start of a motion, each the same in both precisions and for every scheme."""

import dataclasses
from collections.abc import Callable
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from envs.library import load_scenes
from envs.scene import Scene as ResectionScene
from envs.task import Resection
from gmapspring import Material, Mesh, Simulation, meshes
from gmapspring.stability import element_limits
from tests.benchmarks.groups.cuts import interior_faces

YOUNG_MODULUS, DENSITY = 2e4, 1000.0
"""Of a body that bends and does not fold up under its own weight [Pa], [kg/m^3]."""
DAMPING, VISCOSITY = 1e-3, 5.0
"""Spring damping over stiffness at that modulus [s]; drag over mass [1/s]."""
SPACING = 0.01
"""Edge of a cube of six tetrahedra [m]."""
GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2]."""
STIFF = 100.0
"""How much stiffer the stiff beam is."""
LAYERS = 1000.0
"""How much stiffer every other layer of the laminate is."""
LIGHT_LAYERS = 30.0
"""The same of the laminate whose springs have no damping."""
TWIST = 0.5 * np.pi
"""Angle between the ends of the twisted bar [rad]."""
BLOW = 0.5
"""Velocity of the end of the struck beam, where waves run at about ten times this [m/s]."""
THROW = 0.2
"""Speed at which the free body turns and stretches, at a distance of half its length [m/s]."""


class Scene(NamedTuple):
    """A motion to be followed."""

    name: str
    description: str
    """A few words."""
    seconds: float
    """How long it is followed [s]."""
    build: Callable[[str, type], Simulation]
    """build(integrator, dtype) -> the body at the start."""


class Facts(NamedTuple):
    """What is known of a body before it moves."""

    scene: str
    description: str
    seconds: float
    tetrahedra: int
    size: float
    """Longest side [m]."""
    frequency: float
    """Highest frequency of any element [rad/s]."""
    median_frequency: float
    """Median over elements of their highest frequency [rad/s]."""
    damping_ratio: float
    """Median over elements of their damping rate over twice that frequency: below 1 they swing."""


def facts_of(scene: Scene) -> Facts:
    """Return what is known of a scene's body."""
    simulation = scene.build("symplectic_euler", np.float64)
    limits = element_limits(simulation.body.mesh, simulation.body.tetrahedra)
    return Facts(
        scene.name, scene.description, scene.seconds, simulation.body.n_tetrahedra, size_of(simulation.body.mesh),
        float(np.max(limits.frequency)), float(np.median(limits.frequency)),
        float(np.median(limits.damping_rate / (2.0 * limits.frequency))),
    )  # fmt: skip


def size_of(mesh: Mesh) -> float:
    """Return the longest side of the box round a mesh [m]."""
    return float(np.ptp(mesh.points, axis=0).max())


def damped_scenes(is_quick: bool) -> list[Scene]:
    """Return the scenes on which errors are measured; in the light ones springs have no damping, and drag alone calms them."""
    length, width, seconds = (5, 2, 0.1) if is_quick else (9, 3, 0.3)
    beam = meshes.box((length, width, width), SPACING)
    bar = meshes.box((width, width, length), SPACING)
    return [
        Scene("beam", "a beam, held at one end, falls under its weight", seconds, partial(hanging, beam, damped(1.0))),
        Scene("light beam", "the same without damping of springs", seconds, partial(hanging, beam, light(1.0))),
        Scene("twisted bar", "a bar, held at one end, is let go after a quarter turn", seconds,
              partial(twisted, bar, damped(1.0))),
        Scene("light twisted bar", "the same without damping of springs", seconds, partial(twisted, bar, light(1.0))),
        Scene("struck beam", "the light beam, whose free end gets a blow upward", seconds, partial(struck, beam, light(1.0))),
        Scene("liver", "the shipped organ, cut half through, sags", seconds / 2, cut_liver),
        Scene("resection", "a light body of level 2 after half of the cuts of its certificate",
              resection_scene().physics.settle_seconds, half_resected),
        Scene("stiff beam", f"the beam, {STIFF:g} times stiffer", seconds, partial(hanging, beam, damped(STIFF))),
        Scene("laminate", f"the beam, every other layer {LAYERS:g} times stiffer", seconds,
              partial(hanging, beam, damped(laminated(beam, LAYERS)))),
        Scene("light laminate", f"the light beam, every other layer {LIGHT_LAYERS:g} times stiffer", seconds,
              partial(hanging, beam, light(laminated(beam, LIGHT_LAYERS)))),
    ]  # fmt: skip


def layered_scenes(is_quick: bool) -> list[Scene]:
    """Return small beams of which one layer is stiffer and stiffer."""
    beam, seconds = meshes.box((6, 3, 3), SPACING), 0.05 if is_quick else 0.2
    ratios = (1.0, 1e2, 1e4) if is_quick else (1.0, 1e1, 1e2, 1e3, 1e4, 1e5)
    return [
        Scene(f"layer {ratio:g}", f"a short beam, one layer {ratio:g} times stiffer", seconds,
              partial(hanging, beam, damped(one_stiff_layer(beam, ratio))))
        for ratio in ratios
    ]  # fmt: skip


def free_scene(is_quick: bool) -> Scene:
    """Return an undamped body that nothing holds: it keeps energy and momentum."""
    return Scene("free bar", "an undamped bar that nothing holds turns and stretches", 0.05 if is_quick else 0.2, thrown)


def damped(stiffness: float | np.ndarray) -> Material:
    """Return a material so many times as stiff; its springs all have the same damping ratio, as beta sqrt(k) is the same."""
    return Material(YOUNG_MODULUS * stiffness, DENSITY, DAMPING / np.sqrt(stiffness), VISCOSITY)


def light(stiffness: float | np.ndarray) -> Material:
    """Return a material so many times as stiff, whose springs have no damping."""
    return Material(YOUNG_MODULUS * stiffness, DENSITY, viscosity=VISCOSITY)


def hanging(mesh: Mesh, material: Material, scheme: str, dtype: type) -> Simulation:
    """Return a body at rest, held where x is least, on which its weight begins to act."""
    pinned = mesh.points[:, 0] < 1e-9
    return Simulation(mesh, material, pinned=pinned, gravity=GRAVITY, integrator=scheme, dtype=dtype)


def struck(mesh: Mesh, material: Material, scheme: str, dtype: type) -> Simulation:
    """Return a body, held where x is least, whose farthest layer of cubes gets a velocity."""
    simulation = hanging(mesh, material, scheme, dtype)
    x = mesh.points[simulation.body.nodes.point, 0]
    simulation.body.nodes.velocity[x > x.max() - 1.5 * SPACING, 2] = BLOW
    return simulation


def laminated(mesh: Mesh, ratio: float) -> np.ndarray:
    """Return stiffness by which every other layer across x has so many times that of the held one, (n_tets,)."""
    return np.where(layer_of(mesh) % 2 == 1, ratio, 1.0)


def one_stiff_layer(mesh: Mesh, ratio: float) -> np.ndarray:
    """Return stiffness by which the third layer across x has so many times that of the others, (n_tets,)."""
    return np.where(layer_of(mesh) == 2, ratio, 1.0)


def layer_of(mesh: Mesh) -> np.ndarray:
    """Return the layer of cubes that each tetrahedron lies in, counted along x, (n_tets,)."""
    return (mesh.points[mesh.tetrahedra].mean(axis=1)[:, 0] / SPACING).astype(int)


def twisted(mesh: Mesh, material: Material, scheme: str, dtype: type) -> Simulation:
    """Return a bar along z, held at its foot, turned about its axis in proportion to height, at rest."""
    simulation = Simulation(mesh, material, pinned=mesh.points[:, 2] < 1e-9, integrator=scheme, dtype=dtype)
    points = mesh.points[simulation.body.nodes.point]
    centre = points.mean(axis=0)
    angle = TWIST * points[:, 2] / points[:, 2].max()
    x, y = (points - centre)[:, :2].T
    simulation.body.nodes.position[:, 0] = centre[0] + np.cos(angle) * x - np.sin(angle) * y
    simulation.body.nodes.position[:, 1] = centre[1] + np.sin(angle) * x + np.cos(angle) * y
    return simulation


@lru_cache(maxsize=1)
def liver() -> Mesh:
    """Return the shipped organ."""
    return meshes.liver()


def cut_liver(scheme: str, dtype: type) -> Simulation:
    """Return the organ at rest, hung by its anchor, cut from the front to its middle, on which its weight begins to act."""
    mesh = liver()
    pinned = np.zeros(mesh.n_points, dtype=bool)
    pinned[mesh.point_regions["anchor"]] = True
    simulation = Simulation(mesh, damped(1.0), pinned=pinned, gravity=GRAVITY, integrator=scheme, dtype=dtype)
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    middle = 0.5 * (mesh.points.min(axis=0) + mesh.points.max(axis=0))
    faces = np.array(interior_faces(simulation))
    is_across = (centre[faces, 0] < middle[0]).sum(axis=1) == 1
    is_in_front = (centre[faces, 1] < middle[1]).all(axis=1)
    simulation.cut(faces[is_across & is_in_front])
    return simulation


def thrown(scheme: str, dtype: type) -> Simulation:
    """Return a free undamped bar that turns about one axis and stretches along another."""
    mesh = meshes.box((6, 2, 2), SPACING)
    simulation = Simulation(mesh, Material(YOUNG_MODULUS, DENSITY), integrator=scheme, dtype=dtype)
    nodes = simulation.body.nodes
    arm = mesh.points[nodes.point] - mesh.points.mean(axis=0)
    arm /= 0.5 * size_of(mesh)
    nodes.velocity[:] = THROW * (np.cross((0.0, 0.0, 1.0), arm) + np.array([1.0, -0.5, -0.5]) * arm)
    return simulation


# Resection ----------------------------------------------------------------------------------------------------------------


def resection_scene() -> ResectionScene:
    """Return the scene of level 2 that is cut."""
    return load_scenes("box-192", "validation")[0]


@lru_cache(maxsize=1)
def settled_state() -> np.ndarray:
    """Return the state of the uncut body under its load, as the scene's own physics has led to it, (n_nodes, 8)."""
    return Resection(resection_scene()).simulation.body.nodes.state.copy()


def half_resected(scheme: str, dtype: type) -> Simulation:
    """Return a loaded body right after the first half of its certificate's cuts; all schemes begin with the same state."""
    scene = resection_scene()
    # No time passes before the cuts, so that it does not matter which scheme would fill it.
    changes = {"integrator": scheme, "dtype": np.dtype(dtype).name, "initial_settle_seconds": 0.0}
    task = Resection(dataclasses.replace(scene, physics=scene.physics.model_copy(update=changes)))
    task.simulation.body.nodes.state[:] = settled_state()
    order = scene.certificate.order if scene.certificate else ()
    for action in order[: len(order) // 2]:
        task.apply(action)
    return task.simulation
