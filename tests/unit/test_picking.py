"""Picking: a click cuts what lies behind it."""

import numpy as np
import pytest

from agents.picking import action_corners, cuttable_edges, face_cut, hit, removal, skin_of
from envs.resect import ResectEnv
from gmapspring.render import free_faces
from tests.small_scene import small_scene

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture
def env():
    """Return an environment at the beginning of an episode."""
    env = ResectEnv(small_scene(load=0.02))
    env.reset(seed=0)
    return env


def whole(env):
    """Return the skin of the whole body, and where its nodes are."""
    body = env.task.simulation.body
    return skin_of(body, np.ones(body.mesh.n_tetrahedra, dtype=bool)), body.nodes.position


def test_the_skin_of_all_is_the_surface_of_the_body(env):
    for _ in range(4):
        body = env.task.simulation.body
        skin, _ = whole(env)
        assert np.array_equal(skin.slots, free_faces(body))
        assert np.array_equal(skin.triangles, body.surface())
        assert skin.is_bare.all()
        env.step(int(np.flatnonzero(env.action_masks())[-1]))


def test_what_is_left_by_peeling_is_closed_and_shows_the_faces_that_it_bares(env):
    body, table = env.task.simulation.body, env.task.table
    is_shown = np.arange(body.mesh.n_tetrahedra) % 5 < 3
    skin = skin_of(body, is_shown)
    assert is_shown[skin.slots // 4].all()
    bared = table.face_of_slot.ravel()[skin.slots[~skin.is_bare]]
    sides = table.face_tetrahedra[bared]
    assert len(bared) and (is_shown[sides].sum(axis=1) == 1).all()
    # On a closed surface the areas, as vectors, add up to nothing.
    one, two, three = np.moveaxis(body.nodes.position[skin.triangles], 1, 0)
    areas = np.cross(two - one, three - one)
    np.testing.assert_allclose(areas.sum(axis=0), 0.0, atol=1e-12 * np.abs(areas).sum() + 1e-18)


def test_a_ray_meets_the_nearest_of_all_triangles_that_it_goes_through(env, rng):
    skin, position = whole(env)
    met = 0
    for _ in range(200):
        aim = position[rng.integers(len(position))] + 0.002 * rng.normal(size=3)
        origin = aim + 0.1 * rng.normal(size=3)
        expected = slowly_hit(origin, aim - origin, position[skin.triangles])
        found = hit(origin, aim - origin, skin, position)
        if expected is None:
            assert found is None
            continue
        met += 1
        assert found.slot == skin.slots[expected[0]]
        np.testing.assert_allclose(found.point, origin + expected[1] * (aim - origin), atol=1e-12)
    assert 50 < met < 200


def slowly_hit(origin, direction, corners):
    """Return the first triangle on a ray and how far it is, by solving for the weights of its corners, or None."""
    best = None
    for number, (a, b, c) in enumerate(corners):
        matrix = np.column_stack([b - a, c - a, -direction])
        if abs(np.linalg.det(matrix)) < 1e-18:
            continue
        u, v, distance = np.linalg.solve(matrix, origin - a)
        if min(u, v, 1.0 - u - v, distance) >= 0.0 and (best is None or distance < best[1]):
            best = number, distance
    return best


def test_a_ray_that_goes_away_or_aside_meets_nothing(env):
    skin, position = whole(env)
    above = position.max(axis=0) + 0.01
    assert hit(above, -DOWN, skin, position) is None
    assert hit(above, DOWN, skin, position) is None


def test_a_click_near_an_edge_cuts_the_face_behind_that_edge(env):
    skin, position = whole(env)
    table, legal = env.task.table, env.action_masks()
    n_cut = 0
    for triangle, slot in zip(skin.triangles, skin.slots, strict=True):
        corners = position[triangle]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normal /= np.linalg.norm(normal)
        for opposite in range(3):
            weights = np.full(3, 0.48)
            weights[opposite] = 0.04
            met = hit(weights @ corners + 1e-4 * normal, -normal, skin, position)
            assert met.slot == slot
            action = face_cut(table, legal, met)
            edge = set(np.delete(triangle, opposite).tolist())
            behind = [face for face in table.face_of_slot[slot // 4] if face >= 0]
            candidates = [face for face in behind if edge <= corner_nodes(env, face)]
            if candidates:
                n_cut += 1
                assert [action] == candidates
    assert n_cut > 40


def corner_nodes(env, action):
    """Return the nodes of the triangles that show an action."""
    return set(action_corners(env.task.table, action, env.task.simulation.body).ravel().tolist())


def test_a_face_laid_bare_by_peeling_is_cut_by_a_click_on_it(env):
    body, table = env.task.simulation.body, env.task.table
    skin = skin_of(body, np.arange(body.mesh.n_tetrahedra) % 2 == 0)
    bared = skin.slots[~skin.is_bare]
    for slot, triangle in zip(bared, skin.triangles[~skin.is_bare], strict=True):
        corners = body.nodes.position[triangle]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        met = hit(corners.mean(axis=0) + 1e-3 * normal, -normal, skin, body.nodes.position)
        assert met.slot == slot
        assert face_cut(table, env.action_masks(), met) == table.face_of_slot.ravel()[slot]


def test_a_click_removes_the_tetrahedron_below_unless_it_is_an_anchor(env):
    skin, position = whole(env)
    table, legal = env.task.table, env.action_masks()
    seen = set()
    for triangle, slot in zip(skin.triangles, skin.slots, strict=True):
        corners = position[triangle]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        met = hit(corners.mean(axis=0) + 1e-3 * normal, -normal, skin, position)
        is_anchor = bool(env.scene.anchor[slot // 4])
        seen.add(is_anchor)
        assert removal(table, legal, met) == (None if is_anchor else table.n_faces + slot // 4)
    assert seen == {True, False}


def test_edges_are_marked_where_a_click_cuts_and_nowhere_else(env):
    skin, _ = whole(env)
    table, nothing = env.task.table, np.zeros(env.task.table.n_actions, dtype=bool)
    assert cuttable_edges(table, nothing, skin, is_removing=False).shape == (0, 2)
    face = int(np.flatnonzero(table.face_of_slot[skin.slots[0] // 4] >= 0)[0])
    action = int(table.face_of_slot[skin.slots[0] // 4, face])
    only = nothing.copy()
    only[action] = True
    marked = cuttable_edges(table, only, skin, is_removing=False)
    assert len(marked) and all(set(edge) <= corner_nodes(env, action) for edge in marked.tolist())
    assert cuttable_edges(table, only, skin, is_removing=True).shape == (0, 2)
    tet = nothing.copy()
    tet[table.n_faces + skin.slots[0] // 4] = True
    marked = cuttable_edges(table, tet, skin, is_removing=True)
    assert len(marked) == 3 * int((skin.slots // 4 == skin.slots[0] // 4).sum())
