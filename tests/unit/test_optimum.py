"""The cheapest set of cuts, against all sets of cuts there are."""

import dataclasses

import numpy as np
import pytest

from envs.action_table import action_table
from envs.library import load_scene_config
from envs.optimum import minimum_cut, prices_of
from envs.scene import build_scene
from envs.task import Resection
from gmapspring.mesh import Mesh
from gmapspring.meshes import box

FACE, REMOVAL, LOSS = 1.0, 6.6, 1.5
"""Prices per h^2, h^3 and h^3, written down anew."""


def tiny_scene(seed, n_tetrahedra):
    """Return a face-connected piece of a skewed box with random targets and one random pinned point."""
    rng = np.random.default_rng(seed)
    whole = box((2, 2, 1), spacing=0.01)
    sides = action_table(whole).face_tetrahedra
    chosen = {int(rng.integers(whole.n_tetrahedra))}
    while len(chosen) < n_tetrahedra:
        rim = [side for pair in sides for side in pair if (pair[0] in chosen) != (pair[1] in chosen)]
        chosen.add(int(rng.choice(rim)))
    ids, corners = np.unique(whole.tetrahedra[sorted(chosen)], return_inverse=True)
    # A random stretch: areas and volumes differ, so that the cheapest set is one of a kind.
    points = whole.points[ids] @ (np.eye(3) + rng.uniform(-0.3, 0.3, (3, 3)))
    mesh = Mesh(points, corners.reshape(-1, 4).astype(np.int32))
    pinned = np.zeros(mesh.n_points, dtype=bool)
    # the point with the fewest tetrahedra among three drawn, so that not all of them are anchors
    drawn = rng.choice(mesh.n_points, 3, replace=False)
    pinned[drawn[np.argmin([(mesh.tetrahedra == point).sum() for point in drawn])]] = True
    anchor = pinned[mesh.tetrahedra].any(axis=1)
    target = ~anchor & (rng.random(mesh.n_tetrahedra) < 0.4)
    target[np.flatnonzero(~anchor)[:1]] = True
    frame = build_scene(load_scene_config("box-48"), 0)
    modulus = np.full(mesh.n_tetrahedra, 5e3)
    return dataclasses.replace(frame, mesh=mesh, pinned=pinned, target=target, young_modulus=modulus, spacing=0.01)


def touches_vessel(scene, table, is_done, lost):
    """Tell whether a set of actions lays open a face of a vessel's tetrahedron of the uncut mesh, or loses one."""
    vessel, n_faces = set(np.flatnonzero(scene.vessel).tolist()), table.n_faces
    removed = set(np.flatnonzero(is_done[n_faces:]).tolist())
    opened = [set(pair) for face, pair in enumerate(table.face_tetrahedra.tolist()) if is_done[face] or removed & set(pair)]
    return bool(vessel & (removed | set(lost)) or any(vessel & pair for pair in opened))


def true_cost(scene, table, is_done):
    """Return what a set of actions costs if it frees the target and spares the vessel, else infinity: by flooding."""
    n_faces, sides = table.n_faces, table.face_tetrahedra
    alive = ~is_done[n_faces:]
    held, front = set(), [int(tet) for tet in np.flatnonzero(scene.anchor)]
    while front:
        tet = front.pop()
        if tet in held:
            continue
        held.add(tet)
        for face, (one, other) in enumerate(sides):
            if not is_done[face] and tet in (one, other) and alive[one] and alive[other]:
                front.append(int(other if tet == one else one))
    if any(scene.target[tet] for tet in held):
        return np.inf
    lost = [tet for tet in range(table.n_tetrahedra) if alive[tet] and not scene.target[tet] and tet not in held]
    if touches_vessel(scene, table, is_done, lost):
        return np.inf
    h = scene.spacing
    return float(
        FACE * table.face_area[is_done[:n_faces]].sum() / h**2
        + REMOVAL * table.volume[is_done[n_faces:]].sum() / h**3
        + LOSS * table.volume[lost].sum() / h**3
    )


def every_set(scene, table):
    """Return all sets of actions, anchors kept, as rows of a bool array."""
    free = np.flatnonzero(np.concatenate([np.ones(table.n_faces, bool), ~scene.anchor]))
    sets = np.zeros((2 ** len(free), table.n_actions), dtype=bool)
    sets[:, free] = np.arange(len(sets))[:, None] >> np.arange(len(free)) & 1
    return sets


def cheapest(scene, table):
    """Return the least cost of any set of actions, trying them all in the order of what they cost by themselves."""
    sets = every_set(scene, table)
    alone = sets @ prices_of(scene, table).actions
    best = np.inf
    for index in np.argsort(alone, kind="stable"):
        if alone[index] >= best:
            break
        best = min(best, true_cost(scene, table, sets[index]))
    return best


def as_set(cut, table):
    """Return the actions of a cut as a mask."""
    is_done = np.zeros(table.n_actions, dtype=bool)
    is_done[cut.actions] = True
    return is_done


@pytest.mark.parametrize("seed", range(24))
def test_no_set_of_cuts_is_cheaper(seed):
    scene = tiny_scene(seed, n_tetrahedra=6 + seed % 4)
    table = action_table(scene.mesh)
    cut = minimum_cut(scene, table)
    assert cut.is_exact
    assert cut.cost == pytest.approx(true_cost(scene, table, as_set(cut, table)), rel=1e-12)
    # Capacities are whole numbers of about 2e-9 of the optimum; a few dozen of them may round one way.
    assert cut.cost == pytest.approx(cheapest(scene, table), rel=1e-6)


def with_vessel(scene, seed):
    """Return a scene with a vessel of one healthy tetrahedron, if possible without a face in common with the target."""
    sides = action_table(scene.mesh).face_tetrahedra
    neighbours = set(sides[scene.target[sides].any(axis=1)].ravel().tolist())
    healthy = np.flatnonzero(~scene.target).tolist()
    apart = [tet for tet in healthy if tet not in neighbours]
    chosen = np.random.default_rng(seed).choice(apart or healthy)
    return dataclasses.replace(scene, no_cut=np.arange(scene.mesh.n_tetrahedra) == chosen)


def test_no_set_of_cuts_that_spares_the_vessel_is_cheaper():
    dearer = impossible = 0
    for seed in range(30):
        scene = with_vessel(tiny_scene(seed, n_tetrahedra=8), seed)
        table = action_table(scene.mesh)
        cut, least = minimum_cut(scene, table), cheapest(scene, table)
        if np.isinf(cut.cost):
            impossible += 1
            assert not len(cut.actions) and (np.isinf(least) or not cut.is_exact)
            continue
        assert cut.cost == pytest.approx(true_cost(scene, table, as_set(cut, table)), rel=1e-12)
        assert cut.cost >= least * (1 - 1e-6)
        assert not cut.is_exact or cut.cost == pytest.approx(least, rel=1e-6)
        dearer += cut.cost > 1.001 * minimum_cut(dataclasses.replace(scene, no_cut=None), table).cost
    assert dearer >= 5 and 5 <= impossible <= 15


def test_removals_and_losses_are_among_the_cheapest_plans():
    cuts, tables = [], []
    for seed in range(24):
        scene = tiny_scene(seed, n_tetrahedra=6 + seed % 4)
        tables.append(action_table(scene.mesh))
        cuts.append(minimum_cut(scene, tables[-1]))
    assert any((cut.actions >= table.n_faces).any() for cut, table in zip(cuts, tables, strict=True))
    assert any((cut.actions < table.n_faces).any() for cut, table in zip(cuts, tables, strict=True))
    assert any(cut.lost.any() for cut in cuts)


@pytest.mark.parametrize("seed", [52, 1841, 3867])
def test_a_bound_that_is_not_proven_says_so(seed):
    # Here the flow leaves healthy tissue standing on nothing; the plan is repaired, and a cheaper one does exist.
    scene = tiny_scene(seed, n_tetrahedra=10)
    table = action_table(scene.mesh)
    cut = minimum_cut(scene, table)
    assert not cut.is_exact
    assert cut.cost == pytest.approx(true_cost(scene, table, as_set(cut, table)), rel=1e-12)
    assert cut.cost > cheapest(scene, table)


def test_the_target_of_a_whole_cube_is_freed_through_its_interface():
    # a cube at the corner of the box: two sides and the bottom, of area h^2 each
    config = load_scene_config("box-108")
    scene = next(scene for seed in range(99) if (scene := build_scene(config, seed)).target[6 * 17])
    table = action_table(scene.mesh)
    cut = minimum_cut(scene, table)
    assert cut.cost == pytest.approx(3.0, rel=1e-12)
    sides = scene.target[table.face_tetrahedra]
    np.testing.assert_array_equal(cut.actions, np.flatnonzero(sides[:, 0] != sides[:, 1]))
    assert not cut.lost.any()


def test_healthy_tissue_that_hangs_on_the_target_alone_is_lost_and_paid_for():
    # a row of three cubes: pinned, target, healthy; the last goes with the second, 1.5 V / h^3 with V = h^3
    frame = build_scene(load_scene_config("box-48"), 0)
    mesh = box((3, 1, 1), spacing=0.01)
    cube_of = np.arange(18) // 6
    scene = dataclasses.replace(frame, mesh=mesh, target=cube_of == 1, pinned=mesh.points[:, 0] == 0.0, spacing=0.01)
    cut = minimum_cut(scene, action_table(mesh))
    np.testing.assert_array_equal(np.flatnonzero(cut.lost), np.flatnonzero(cube_of == 2))
    assert cut.cost == pytest.approx(1.0 + 1.5, rel=1e-12)


def test_what_is_already_cut_need_not_be_paid_again():
    scene = build_scene(load_scene_config("box-108"), 0)
    table = action_table(scene.mesh)
    whole = minimum_cut(scene, table)
    costs = prices_of(scene, table).actions
    is_sewn = np.ones(table.n_faces, dtype=bool)
    for n_done in range(len(whole.actions) + 1):
        is_sewn[whole.actions[:n_done]] = False
        rest = minimum_cut(scene, table, is_sewn=is_sewn)
        assert rest.cost == pytest.approx(whole.cost - costs[whole.actions[:n_done]].sum(), abs=1e-12)
        np.testing.assert_array_equal(rest.actions, whole.actions[n_done:])


def test_a_target_that_is_gone_costs_nothing():
    scene = build_scene(load_scene_config("box-108"), 0)
    cut = minimum_cut(scene, action_table(scene.mesh), is_attached=~scene.target)
    assert cut.cost == 0.0
    assert len(cut.actions) == 0


@pytest.mark.parametrize("seed", range(6))
def test_the_task_charges_the_optimum_for_the_plan_in_any_order(seed):
    task = Resection(tiny_scene(seed, n_tetrahedra=18))
    cut = minimum_cut(task.scene, task.table)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        task.reset()
        for action in rng.permutation(cut.actions):
            task.apply(int(action))
        assert not (task.is_attached & task.scene.target).any()
        assert task.cost == pytest.approx(cut.cost, rel=1e-12)
