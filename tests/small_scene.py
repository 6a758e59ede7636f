"""Small scenes made on the spot, so that tests of the environment need no shipped file."""

import numpy as np

from envs.action_table import action_table
from envs.optimum import minimum_cut
from envs.scene import Certificate, Scene
from envs.scene_config import Limits, Physics
from envs.targets import Channel
from gmapspring import meshes
from gmapspring.mesh import Mesh

SPACING = 0.01
CUBES = meshes.box((2, 2, 2), spacing=SPACING)
BENT = Mesh(CUBES.points + 0.1 * SPACING * np.sin(300.0 * CUBES.points[:, [1, 2, 0]]), CUBES.tetrahedra)
"""The same box of unequal tetrahedra."""


VARIANTS = ("plain", "vessel", "tool", "two targets", "all together")
"""Rules that a scene may add to the plain ones."""


def variant_scene(variant, seed=0, **changes):
    """Return a small scene under other rules."""
    scene = small_scene(seed, **changes)
    n_tets, rules = scene.mesh.n_tetrahedra, {}
    if variant in ("two targets", "all together"):
        # the top cubes of two opposite corners: they share an edge and no face
        rules["target"] = np.isin(np.arange(n_tets) // 6, (1, n_tets // 6 - 1))
    if variant in ("vessel", "all together"):
        target = rules.get("target", scene.target)
        rules["no_cut"] = Channel(kind="channel").draw(scene.mesh, target, scene.pinned, np.random.default_rng(seed))
    if variant in ("tool", "all together"):
        rules["tool_radius"] = 0.6
    return small_scene(seed, **changes | rules)


def small_scene(seed=0, cells=(2, 2, 2), load=0.2, **changes):
    """Return a box whose top corner cube is the target, unevenly stiff, pulled by a force [N] in a random direction.

    Its certificate names the least cost, and no order: `certificate=None` takes it away.
    """
    rng = np.random.default_rng(seed)
    mesh = meshes.box(cells, spacing=SPACING)
    target = np.zeros(mesh.n_tetrahedra, dtype=bool)
    target[-6:] = True
    direction = rng.normal(size=3)
    direction[2] = abs(direction[2]) + 0.5
    values = {
        "name": "small",
        "seed": seed,
        "mesh": mesh,
        "target": target,
        "pinned": mesh.points[:, 2] < 1e-9,
        "young_modulus": 5000.0 * np.exp(rng.normal(size=mesh.n_tetrahedra)),
        "load": load * direction / np.linalg.norm(direction),
        "spacing": SPACING,
        "reference_modulus": 5000.0,
        "physics": Physics(
            density=1000.0,
            viscosity=30.0,
            settle_seconds=0.12,
            initial_settle_seconds=0.48,
            integrator="symplectic_euler",
        ),
        "limits": Limits(strain=0.5, volume_ratio=0.05, healthy_share=0.75),
        "budget": 2.0,
    }
    scene = Scene(**values | {name: value for name, value in changes.items() if name != "certificate"})
    if "certificate" in changes:
        return with_certificate(scene, changes["certificate"])
    cut = minimum_cut(scene, action_table(scene.mesh))
    return with_certificate(scene, fake_certificate(cut.cost, tuple(int(action) for action in cut.actions)))


def fake_certificate(optimum, order=()):
    """Return a certificate that was never checked."""
    return Certificate(optimum, order, load_factor=1.0, peak_strain=0.4, lowest_volume_ratio=0.5)


def with_certificate(scene, certificate):
    """Return a scene with another certificate."""
    values = {name: getattr(scene, name) for name in scene.__dataclass_fields__}
    return Scene(**values | {"certificate": certificate})


def play(env, choose, seed=0, options=None):
    """Play one episode; choose(env, observation) gives an action. Return the list of all steps' results."""
    observation, _ = env.reset(seed=seed, options=options)
    steps = []
    while True:
        steps.append(env.step(choose(env.unwrapped, observation)))
        observation, _, terminated, truncated, _ = steps[-1]
        if terminated or truncated:
            return steps


def first_scenes(env, n=8, **seed):
    """Return the seeds of the first scenes that an environment plays."""
    return [env.reset(**(seed if i == 0 else {}))[1]["scene_seed"] for i in range(n)]


def random_policy(seed=0):
    """Return a policy that draws among the legal actions."""
    rng = np.random.default_rng(seed)
    return lambda env, observation: int(rng.choice(np.flatnonzero(env.action_masks())))


def randomly_cut(env, n_cuts=4, seed=0):
    """Return the observations of an episode of random cuts."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=0)
    found = [observation]
    for _ in range(n_cuts):
        observation, *_ = env.step(int(rng.choice(np.flatnonzero(observation["action_mask"]))))
        found.append(observation)
    return found


def side_by_side(observations):
    """Return single observations as a batch."""
    return {name: np.stack([observation[name] for observation in observations]) for name in observations[0]}


def quiet_scenes(variant="plain"):
    """Return two scenes whose load is small enough that many episodes end well."""
    return [variant_scene(variant, seed, load=0.02) for seed in (2, 3)]


def drawn(observation, rng):
    """Return a legal action for each row."""
    return np.array([rng.choice(np.flatnonzero(mask)) for mask in observation["action_mask"]])
