"""Collapse: what is measured, against NumPy; and which reason is given."""

import numpy as np
import pytest

from envs.collapse import COLLAPSE_RULES, SEPARATED, Tissue, collapse_reason, collapse_reasons
from envs.scene_config import Limits
from envs.task import Resection
from tests.small_scene import small_scene, variant_scene

EDGES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
LIMITS = Limits(strain=0.5, volume_ratio=0.05, healthy_share=0.75)
SOUND = Tissue(0.4, 0.9, 0.2, 7.5e-6, 1e-6, True, False)


def move(task, transform):
    """Put every node where a function takes its rest position, and measure."""
    nodes, mesh = task.simulation.body.nodes, task.scene.mesh
    nodes.position[:] = transform(mesh.points[nodes.point])
    task._measure()
    task._judge()


def naive_measures(task):
    """Return strain and volume ratio of every tetrahedron, by NumPy."""
    body, mesh = task.simulation.body, task.scene.mesh
    strain, ratio = np.zeros(mesh.n_tetrahedra), np.zeros(mesh.n_tetrahedra)
    for tet in np.flatnonzero(body.is_alive):
        now, rest = body.nodes.position[body.vertex_of[tet]], mesh.points[mesh.tetrahedra[tet]]
        length = [np.linalg.norm(now[a] - now[b]) / np.linalg.norm(rest[a] - rest[b]) for a, b in EDGES]
        strain[tet] = max(length) - 1.0
        ratio[tet] = np.linalg.det(now[1:] - now[0]) / np.linalg.det(rest[1:] - rest[0])
    return strain, ratio


def test_measures_equal_the_naive_ones(rng):
    task = Resection(small_scene(load=0.05))
    for _ in range(5):
        strain, ratio = naive_measures(task)
        np.testing.assert_allclose(task.strain, strain, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(task.volume_ratio, ratio, rtol=1e-9, atol=1e-12)
        healthy = task.is_attached & ~task.scene.target
        assert task.tissue.healthy_strain == max(task.strain[healthy].max(), 0.0)
        assert task.tissue.lowest_volume_ratio == task.volume_ratio[healthy].min()
        assert task.tissue.healthy_volume == pytest.approx(task.table.volume[healthy].sum(), rel=1e-14)
        task.step(int(rng.choice(np.flatnonzero(task.action_mask()))))


def test_a_sound_body_has_no_reason():
    assert collapse_reason(SOUND, 0.8, LIMITS) is None


@pytest.mark.parametrize(
    ("tissue", "share", "reason"),
    [
        (SOUND._replace(healthy_strain=0.51), 0.8, "tear"),
        (SOUND._replace(lowest_volume_ratio=0.04), 0.8, "inverted"),
        (SOUND._replace(is_touched=True, healthy_strain=0.51), 0.74, "vessel"),
        (SOUND._replace(is_finite=False, is_touched=True), 0.8, "numerical"),
        (SOUND, 0.74, "volume"),
        (SOUND._replace(is_finite=False, healthy_strain=9.0), 0.1, "numerical"),
    ],
)
def test_each_limit_has_its_reason(tissue, share, reason):
    assert collapse_reason(tissue, share, LIMITS) == reason


def test_many_bodies_at_once_are_judged_as_one_by_one(rng):
    n = 200
    columns = [rng.uniform(0.0, 1.0, n), rng.uniform(0.0, 1.0, n), rng.uniform(-0.2, 1.0, n), rng.uniform(0.0, 1.0, n),
               rng.uniform(0.0, 1.0, n), rng.random(n) < 0.8,
               rng.random(n) < 0.1]  # fmt: skip
    share = rng.uniform(0.6, 1.0, n)
    reasons = collapse_reasons(Tissue(*columns), share, LIMITS)
    one_by_one = [collapse_reason(Tissue(*(column[i] for column in columns)), share[i], LIMITS) for i in range(n)]
    assert reasons.tolist() == one_by_one
    assert set(one_by_one) == {None, *COLLAPSE_RULES}


def test_limits_themselves_are_borne():
    tissue = SOUND._replace(healthy_strain=0.5, lowest_volume_ratio=0.05)
    assert collapse_reason(tissue, 0.75, LIMITS) is None


def test_the_target_may_stretch_at_will():
    assert collapse_reason(SOUND._replace(target_strain=5.0), 0.8, LIMITS) is None


def test_reasons_are_all_that_a_body_can_end_with():
    assert list(COLLAPSE_RULES) == ["numerical", "vessel", "volume", "tear", "inverted"]
    assert SEPARATED not in COLLAPSE_RULES


def test_stretching_a_body_by_more_than_the_limit_tears_it():
    task = Resection(small_scene())
    move(task, lambda points: points * [1.0, 1.0, 1.49])
    assert task.outcome is None
    move(task, lambda points: points * [1.0, 1.0, 1.51])
    assert task.outcome == "tear"
    # Edges along z are 1.51 of their length: strain 0.51.
    assert task.tissue.healthy_strain == pytest.approx(0.51, rel=1e-12)


def test_flattening_a_body_inverts_it():
    task = Resection(small_scene())
    move(task, lambda points: points * [1.0, 1.0, 0.06])
    assert task.outcome is None
    move(task, lambda points: points * [1.0, 1.0, 0.04])
    assert task.outcome == "inverted"


def test_losing_more_than_a_quarter_of_the_healthy_volume_is_a_collapse():
    task = Resection(small_scene())
    tets = np.flatnonzero(~task.scene.anchor & ~task.scene.target)
    n_healthy = np.count_nonzero(~task.scene.target)
    while task.outcome is None:
        legal = [tet for tet in tets if task.action_mask()[task.table.n_faces + tet]]
        task.apply(task.table.n_faces + int(legal[0]))
        task._measure()
        task._judge()
        lost = n_healthy - np.count_nonzero(task.is_attached & ~task.scene.target)
    assert task.outcome == "volume"
    assert lost / n_healthy > 0.25
    assert task.healthy_share == pytest.approx(1 - lost / n_healthy)


def test_a_collapse_counts_even_where_the_target_has_come_free():
    task = Resection(small_scene())
    for tet in np.flatnonzero(task.scene.target):
        if task.is_attached[tet]:
            task.apply(task.table.n_faces + int(tet))
    move(task, lambda points: points)
    assert task.outcome == SEPARATED
    move(task, lambda points: points * [1.0, 1.0, 1.6])
    assert task.outcome == "tear"


def test_a_state_that_blows_up_ends_the_episode_as_numerical():
    task = Resection(small_scene())
    task.simulation.body.nodes.velocity[:] = 1e300
    task.settle()
    assert task.outcome == "numerical"
    assert np.isfinite(task.simulation.body.nodes.position).all()


def naive_touches(task, action):
    """Tell whether an action lays open a face of a vessel's tetrahedron in the uncut mesh."""
    sides, vessel = task.table.face_tetrahedra.tolist(), set(np.flatnonzero(task.scene.vessel).tolist())
    if action < task.table.n_faces:
        return bool(vessel & set(sides[action]))
    tet = action - task.table.n_faces
    return tet in vessel or any(tet in pair and vessel & set(pair) for pair in sides)


def test_any_cut_that_lays_a_vessel_open_ends_the_episode_and_no_other_does():
    task = Resection(variant_scene("vessel", load=0.0))
    legal, seen = np.flatnonzero(task.action_mask()), []
    for action in legal.tolist():
        task.reset()
        task.step(action)
        seen.append(task.outcome == "vessel")
        assert seen[-1] == naive_touches(task, action)
    assert any(seen) and not all(seen)


def test_a_vessel_that_comes_loose_counts_as_laid_open():
    # A tower of three cubes; the vessel is the free corner of the topmost, which no cut below it touches.
    scene = small_scene(cells=(1, 1, 3), load=0.0)
    target = np.arange(18) // 6 == 1
    table = Resection(scene).table
    far = [tet for tet in range(12, 18) if not any(tet in pair and target[pair].any() for pair in table.face_tetrahedra)]
    vessel = np.isin(np.arange(18), far[:1])
    limits = scene.limits.model_copy(update={"healthy_share": 0.01})
    task = Resection(small_scene(cells=(1, 1, 3), load=0.0, target=target, no_cut=vessel, limits=limits, certificate=None))
    below = np.flatnonzero((table.face_tetrahedra < 6).any(axis=1) & (table.face_tetrahedra >= 6).any(axis=1))
    for face in below.tolist():
        assert task.outcome is None
        task.step(face)
    assert not task.is_attached[vessel].any()
    assert task.outcome == "vessel"
    task.reset()
    task.settle()
    assert task.outcome is None
