"""Observations: their table, their values against a slow reading of the body, and what they never tell."""

import numpy as np
import pytest

from envs.observation import COLUMNS, IDS
from envs.resect import ResectEnv
from tests.small_scene import SPACING, fake_certificate, play, random_policy, small_scene, variant_scene, with_certificate

PLACE = {name: {column.name: i for i, column in enumerate(columns)} for name, columns in COLUMNS.items()}


@pytest.fixture
def env():
    """Return an environment on one small scene."""
    return ResectEnv(small_scene())


def after_some_cuts(env, seed=0, n_cuts=5):
    """Return the observation after some random cuts that do not end the episode."""
    env.reset(seed=0)
    rng = np.random.default_rng(seed)
    for _ in range(n_cuts):
        action = int(rng.choice(np.flatnonzero(env.action_masks()[: env.task.table.n_faces])))
        observation, _, terminated, truncated, _ = env.step(action)
        assert not (terminated or truncated)
    return observation


def test_the_space_has_the_documented_tables(env):
    space, n_tets, n_faces = env.observation_space, 48, 72
    rows = {"nodes": 4 * n_tets, "faces": n_faces, "tetrahedra": n_tets}
    for name, columns in COLUMNS.items():
        assert space[name].shape == ((rows[name], len(columns)) if name in rows else (len(columns),))
    for name, (owner, n_columns, _, _) in IDS.items():
        assert space[name].shape == ((rows[owner], n_columns) if n_columns else (rows[owner],))
    assert space["action_mask"].shape == (n_tets + n_faces,)
    assert {space[name].dtype for name in space if name != "action_mask"} == {np.dtype(np.float32)}


def test_column_names_are_unique():
    assert all(len(PLACE[name]) == len(columns) for name, columns in COLUMNS.items())


@pytest.mark.parametrize("seed", range(5))
def test_every_observation_lies_in_its_space(seed):
    env = ResectEnv(small_scene(load=0.2))
    observation, _ = env.reset(seed=seed)
    assert env.observation_space.contains(observation)
    assert all(env.observation_space.contains(step[0]) for step in play(env, random_policy(seed), seed))


def test_a_body_that_blows_up_is_still_inside_the_space(env):
    env.reset(seed=0)
    env.task.simulation.body.nodes.velocity[:] = 1e200
    observation, _, terminated, _, info = env.step(0)
    assert terminated and info["reason"] == "numerical"
    assert env.observation_space.contains(observation)


def test_nodes_are_those_of_the_body(env):
    observation = after_some_cuts(env)
    body, scene = env.task.simulation.body, env.scene
    rows = observation["tetrahedron_nodes"].astype(int)
    table, place = observation["nodes"], PLACE["nodes"]
    # One row for each node, and all corners of a node name it.
    pairs = {(row, node) for row, node in zip(rows.ravel(), body.vertex_of.ravel(), strict=True)}
    assert len(pairs) == len({row for row, _ in pairs}) == body.n_nodes
    assert np.array_equal(np.flatnonzero(table[:, place["alive"]]), sorted(row for row, _ in pairs))
    for row, node in pairs:
        position = body.nodes.position[node]
        star = (body.vertex_of == node).any(axis=1)
        mass = env.task.simulation.body.tetrahedra.mass[star]
        expected = [
            1.0,
            *position / SPACING,
            *(position - scene.mesh.points[body.nodes.point[node]]) / SPACING,
            *body.nodes.velocity[node] * 0.12 / SPACING,
            body.nodes.is_pinned[node],
            body.nodes.mass[node] * scene.mesh.n_points / body.tetrahedra.mass.sum(),
            (mass * scene.target[star]).sum() / mass.sum(),
            env.task.strain[star].max() / 0.5,
            (mass * np.log(scene.young_modulus[star] / 5000.0)).sum() / mass.sum(),
        ]
        np.testing.assert_allclose(table[row], expected, rtol=2e-6, atol=2e-6)


def test_a_nodes_row_is_that_of_its_lowest_corner(env):
    rows = after_some_cuts(env)["tetrahedron_nodes"].astype(int)
    vertex_of = env.task.simulation.body.vertex_of
    for node in range(env.task.simulation.body.n_nodes):
        assert set(rows[vertex_of == node]) == {int(np.flatnonzero(vertex_of.ravel() == node)[0])}


@pytest.mark.parametrize("variant", ["plain", "vessel"])
def test_tetrahedra_are_those_of_the_body(variant):
    env = ResectEnv(variant_scene(variant))
    env.reset(seed=0)
    assert env.scene.vessel.any() == (variant == "vessel")
    first = int(np.flatnonzero(env.action_masks()[env.task.table.n_faces :])[-1])
    observation = env.step(env.task.table.n_faces + first)[0]
    table, place = observation["tetrahedra"], PLACE["tetrahedra"]
    body, scene = env.task.simulation.body, env.scene
    slots = np.arange(4 * 48).reshape(-1, 4)
    is_free = body.gmap.image // 6 == slots
    is_cut = is_free & (env.task.table.face_of_slot >= 0)
    alive = body.is_alive
    expected = {
        "alive": np.ones(48), "attached": np.ones(48), "target": scene.target, "anchor": scene.anchor,
        "strain": env.task.strain / 0.5, "volume_ratio": env.task.volume_ratio,
        "stiffness": np.log(scene.young_modulus / 5000.0), "volume": 6 * scene.mesh.volumes / SPACING**3,
        "free_faces": is_free.mean(axis=1), "cut_faces": is_cut.mean(axis=1), "vessel": scene.vessel,
    }  # fmt: skip
    assert list(expected) == list(place)
    for name, values in expected.items():
        np.testing.assert_allclose(table[:, place[name]], np.where(alive, values, 0.0), rtol=1e-6, atol=1e-7)
    beyond = np.where(is_free | ~alive[:, None], -1, body.gmap.image // 24)
    assert np.array_equal(observation["tetrahedron_neighbours"], beyond)
    assert np.array_equal(observation["components"], env.task.simulation.components())


def test_what_is_gone_is_a_row_of_zeros_with_ids_of_minus_one(env):
    env.reset(seed=0)
    gone = int(np.flatnonzero(env.action_masks()[env.task.table.n_faces :])[-1])
    observation = env.step(env.task.table.n_faces + gone)[0]
    assert not observation["tetrahedra"][gone].any()
    assert (observation["tetrahedron_nodes"][gone] == -1).all()
    assert (observation["tetrahedron_neighbours"][gone] == -1).all()
    assert observation["components"][gone] == -1
    sides = observation["face_tetrahedra"]
    nodes = observation["face_nodes"].reshape(-1, 2, 3)
    assert ((nodes == -1).all(axis=2) == (sides == gone)).all()
    assert not observation["faces"][(sides == gone).any(axis=1)].any()


def test_a_sewn_face_has_the_same_nodes_on_both_sides(env):
    observation = after_some_cuts(env)
    nodes = observation["face_nodes"].reshape(-1, 2, 3)
    sewn = observation["faces"][:, PLACE["faces"]["sewn"]] == 1
    assert np.array_equal(sewn, observation["action_mask"][: len(sewn)])
    assert np.array_equal(nodes[sewn, 0], nodes[sewn, 1])
    assert not observation["faces"][~sewn].any()


def test_faces_show_their_area_and_place_at_rest(env):
    observation, _ = env.reset(seed=0)
    mesh, table = env.scene.mesh, env.task.table
    np.testing.assert_allclose(observation["faces"][:, 1], table.face_area / SPACING**2, rtol=1e-6)
    corners = mesh.points[mesh.tetrahedra[table.face_tetrahedra[:, 0, None], table.face_corners[:, 0]]]
    np.testing.assert_allclose(observation["faces"][:, 2:], corners.mean(axis=1) / SPACING, rtol=1e-6)
    assert np.array_equal(observation["face_tetrahedra"], table.face_tetrahedra)


def test_globals_are_those_of_the_task(env):
    observation = after_some_cuts(env)
    task, load = env.task, env.scene.load
    size = np.linalg.norm(load)
    expected = {
        "load_direction_x": load[0] / size, "load_direction_y": load[1] / size, "load_direction_z": load[2] / size,
        "load": size / (5000.0 * SPACING**2),
        "healthy_strain": task.strain[~env.scene.target].max() / 0.5,
        "target_strain": task.strain[env.scene.target].max() / 0.5,
        "healthy_share": task.is_attached[~env.scene.target].mean(),
        "target_share": task.is_attached[env.scene.target].mean(),
        "cost": task.cost / 10, "steps": 5 / 100,
        "lowest_volume_ratio": task.volume_ratio[~env.scene.target & task.is_attached].min(),
        "components": task.n_components / 10,
    }  # fmt: skip
    assert list(expected) == list(PLACE["globals"])
    np.testing.assert_allclose(observation["globals"], list(expected.values()), rtol=1e-6)


def test_observations_belong_to_the_receiver(env):
    observation, _ = env.reset(seed=0)
    kept = {name: array.copy() for name, array in observation.items()}
    env.step(int(np.flatnonzero(env.action_masks())[0]))
    for name, array in observation.items():
        assert np.array_equal(array, kept[name])
        array[:] = 7
    assert all(np.array_equal(array, kept[name]) for name, array in env.reset(seed=0)[0].items())


def test_the_same_body_looks_the_same_in_whatever_order_it_was_cut(env):
    faces = [3, 17, 40, 55]
    seen = []
    for order in (faces, faces[::-1]):
        env.reset(seed=0)
        for face in order:
            env.task.apply(face)
        seen.append(env._observe())
    np.testing.assert_equal(seen[0], seen[1])


def test_an_observation_tells_nothing_of_the_optimum_or_the_certificate():
    scene = small_scene()
    true = scene.certificate.optimum
    others = [fake_certificate(true * 1.5, (1, 2, 3)), fake_certificate(true * 1.1), None]
    plain = ResectEnv(scene)
    for certificate in others:
        other = ResectEnv(with_certificate(scene, certificate))
        assert other.observation_space == plain.observation_space
        assert other.step_limit == plain.step_limit
        np.testing.assert_equal(other.reset(seed=0)[0], plain.reset(seed=0)[0])
        for action in (5, 30, 60, 71, 75, 30):
            one, two = plain.step(action), other.step(action)
            np.testing.assert_equal(one[0], two[0])
            assert one[2:4] == two[2:4] == (False, False)
