"""Actions and their masks against a slow count over all pairs of tetrahedra."""

from itertools import combinations

import numpy as np
import pytest

from envs.action_table import action_table
from envs.actions import MASKS
from envs.task import Resection
from gmapspring.errors import TopologyError
from tests.bits import assert_same_bits, bits_of
from tests.small_scene import VARIANTS, small_scene, variant_scene


def naive_faces(mesh):
    """Map every face of two tetrahedra, as a frozen set of points, to them in ascending order."""
    owners = {}
    for tet, corners in enumerate(mesh.tetrahedra.tolist()):
        for face in combinations(corners, 3):
            owners.setdefault(frozenset(face), []).append(tet)
    return {face: pair for face, pair in owners.items() if len(pair) == 2}


def naive_mask(task, mode, last=None):
    """Return the legal actions, worked out from the nodes and springs alone, given the last action."""
    mask, scene = naive_mode(task, mode), task.scene
    if scene.tool_radius is None or last is None:
        return mask
    places = [scene.mesh.points[sorted(face)].mean(axis=0) for face in ordered_faces(task)]
    places += list(scene.mesh.points[scene.mesh.tetrahedra].mean(axis=1))
    steps = np.linalg.norm(np.array(places) - places[last], axis=1) / scene.spacing
    near = mask * (steps < scene.tool_radius + 1e-6)
    return near.astype(np.int8) if near.any() else mask


def ordered_faces(task):
    """Return the points of every face that is an action, in the order of their ids."""
    of_pair = {tuple(pair): face for face, pair in naive_faces(task.scene.mesh).items()}
    return [of_pair[tuple(pair)] for pair in task.table.face_tetrahedra.tolist()]


def naive_mode(task, mode):
    """Return what a mode allows without a tool."""
    body, table, scene = task.simulation.body, task.table, task.scene
    is_alive = body.is_alive
    faces = []
    for first, second in table.face_tetrahedra:
        slot = [4 * first + f for f in range(4)] if is_alive[first] and is_alive[second] else []
        faces.append(any(body.gmap.image[first, s % 4] // 24 == second for s in slot))
    tets = list(is_alive & ~scene.anchor)
    if mode == "reachable":
        free = {
            tet: [f for f in range(4) if body.gmap.image[tet, f] // 6 == 4 * tet + f]
            for tet in np.flatnonzero(is_alive)
        }
        edges = list(combinations(range(4), 2))
        outer = {
            body.edge_of[tet, e]
            for tet in free
            for f in free[tet]
            for e, pair in enumerate(edges)
            if f not in pair
        }
        for face in np.flatnonzero(faces):
            tet, local = divmod(table.face_slots[face, 0], 4)
            faces[face] = any(
                body.edge_of[tet, e] in outer for e, pair in enumerate(edges) if local not in pair
            )
        tets = [ok and bool(free[tet]) for tet, ok in enumerate(tets)]
    if mode == "focus":
        points = set()
        for face, (first, second) in naive_faces(scene.mesh).items():
            if scene.target[first] != scene.target[second]:
                points |= face
        near = [bool(points & set(corners)) for corners in scene.mesh.tetrahedra.tolist()]
        faces = [ok and near[a] and near[b] for ok, (a, b) in zip(faces, table.face_tetrahedra, strict=True)]
        tets = [ok and near[tet] for tet, ok in enumerate(tets)]
    return np.array([*faces, *tets], dtype=np.int8)


def test_every_interior_face_is_one_action(any_mesh):
    table, expected = action_table(any_mesh), naive_faces(any_mesh)
    points = any_mesh.tetrahedra[table.face_tetrahedra[:, :, None], table.face_corners]
    assert table.n_actions == len(expected) + any_mesh.n_tetrahedra
    assert {
        frozenset(face.tolist()): pair.tolist()
        for face, pair in zip(points[:, 0], table.face_tetrahedra, strict=True)
    } == expected


def test_both_sides_of_a_face_name_its_corners_in_the_same_order(any_mesh):
    table = action_table(any_mesh)
    points = any_mesh.tetrahedra[table.face_tetrahedra[:, :, None], table.face_corners]
    assert np.array_equal(points[:, 0], points[:, 1])


def test_faces_are_numbered_by_their_lower_slot_and_can_be_found_from_both(any_mesh):
    table = action_table(any_mesh)
    assert (table.face_slots[:, 0] < table.face_slots[:, 1]).all()
    assert (np.diff(table.face_slots[:, 0]) > 0).all()
    found = table.face_of_slot.ravel()[table.face_slots]
    assert np.array_equal(found, np.repeat(np.arange(table.n_faces)[:, None], 2, axis=1))
    assert np.count_nonzero(table.face_of_slot >= 0) == 2 * table.n_faces


def test_areas_are_herons(any_mesh):
    table = action_table(any_mesh)
    corners = any_mesh.points[
        any_mesh.tetrahedra[table.face_tetrahedra[:, 0, None], table.face_corners[:, 0]]
    ]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    half = sides.sum(axis=1) / 2
    heron = np.sqrt(half * (half[:, None] - sides).prod(axis=1))
    # Heron's formula loses about half of the digits of thin triangles.
    np.testing.assert_allclose(table.face_area, heron, rtol=1e-7)
    np.testing.assert_allclose(table.face_centroid, corners.mean(axis=1))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("mode", MASKS)
def test_masks_equal_the_naive_ones_until_the_target_is_free(mode, variant, rng):
    task, last = Resection(variant_scene(variant)), None
    while (task.is_attached & task.scene.target).any():
        mask = task.action_mask(mode)
        assert np.array_equal(mask, naive_mask(task, mode, last))
        last = int(rng.choice(np.flatnonzero(mask)))
        task.apply(last)


def test_a_tool_reaches_what_lies_near_its_last_cut_and_is_set_down_anew_where_nothing_does(rng):
    task = Resection(variant_scene("tool"))
    assert np.array_equal(task.action_mask(), naive_mode(task, "all"))  # the first cut may be anywhere
    n_fewer = n_anew = 0
    while (task.is_attached & task.scene.target).any():
        # removals first: they use up what lies near
        task.apply(int(np.flatnonzero(task.action_mask())[-1]))
        left, everything = task.action_mask(), naive_mode(task, "all")
        n_fewer += left.sum() < everything.sum()
        n_anew += everything.any() and np.array_equal(left, everything)
    assert n_fewer > 0 and n_anew > 0


def test_a_snapshot_holds_the_place_of_the_tool(rng):
    task = Resection(variant_scene("tool"))
    masks, states = [], []
    for _ in range(4):
        masks.append(task.action_mask())
        states.append(task.save_state())
        task.apply(int(rng.choice(np.flatnonzero(masks[-1]))))
    assert len({mask.tobytes() for mask in masks}) == 4
    for mask, state in zip(masks, states, strict=True):
        task.load_state(state)
        assert np.array_equal(task.action_mask(), mask)
    task.reset()
    assert np.array_equal(task.action_mask(), masks[0])


@pytest.mark.parametrize("mode", MASKS)
@pytest.mark.parametrize("seed", range(5))
def test_no_mask_runs_empty_before_the_target_is_free(mode, seed):
    rng, task = np.random.default_rng(seed), Resection(small_scene(cells=(3, 2, 2)))
    while (task.is_attached & task.scene.target).any():
        task.apply(int(rng.choice(np.flatnonzero(task.action_mask(mode)))))


@pytest.mark.parametrize("mode", MASKS)
def test_anchors_cannot_be_removed(mode):
    task = Resection(small_scene())
    assert not task.action_mask(mode)[task.table.n_faces :][task.scene.anchor].any()


def test_an_action_outside_the_mask_is_refused_and_changes_no_bit(rng):
    task = Resection(small_scene())
    for _ in range(4):
        task.apply(int(rng.choice(np.flatnonzero(task.action_mask()))))
    before = bits_of(task.simulation)
    for action in np.flatnonzero(task.action_mask() == 0):
        with pytest.raises(TopologyError, match=f"action {action}"):
            task.apply(int(action))
    assert_same_bits(before, bits_of(task.simulation))


def test_an_action_out_of_range_is_named():
    task = Resection(small_scene())
    with pytest.raises(TopologyError, match=r"action 120 is out of range 0\.\.119"):
        task.apply(task.table.n_actions)
