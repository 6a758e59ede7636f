"""The studies of labels and simplifications: what they compare, and the margin that certificates keep."""

import math

import numpy as np
import pytest

from envs.library import load_scene_config, load_scenes, shipped_scenes
from envs.task import Resection
from gmapspring.integrators import INTEGRATORS
from gmapspring.measure import edge_strains
from tests.benchmarks.studies import labels, simplifications
from tests.benchmarks.studies.scene_keeping import Keeper, outer_faces
from tests.benchmarks.studies.scene_margin import Margin, room_left, stated_margin
from tests.benchmarks.studies.scene_refine import refine
from tests.benchmarks.studies.scene_replay import (
    FAMILIES,
    INVERTED,
    SHIPPED,
    SINGLE,
    Trace,
    Variant,
    compare,
    one_by_one,
    orders_of,
    play,
    play_all,
    sample,
    task_of,
)
from tests.benchmarks.studies.scene_schemes import schemes_for
from tests.benchmarks.study import Plan

SPLITS = [(name, split) for name in shipped_scenes() for split in load_scene_config(name).splits]
OTHERS = [Variant("longer", settle=2.0), Variant("finer", step=0.5), Variant("rk4", physics={"integrator": "rk4"}), SINGLE]
QUICK = Plan(is_quick=True, say=lambda _: None)


@pytest.fixture(scope="module")
def scene():
    """Return a small certified scene."""
    return sample("box-48", "train", 2)[1]


def trace_of(strains, reasons=(), ratios=()):
    """Return a trace of given strains; the body stands and is whole where nothing else is said."""
    n = len(strains)
    ratio = np.array([*ratios, *[0.9] * (n - len(ratios))])
    return Trace(np.array(strains), ratio, np.ones(n), [*reasons, *[None] * (n - len(reasons))])


# Margin -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "split"), SPLITS)
def test_every_shipped_certificate_keeps_the_stated_margin(name, split):
    config = load_scene_config(name)
    for scene in load_scenes(name, split):
        trace = play(Resection(scene), one_by_one(scene.certificate.order))
        assert stated_margin(config).holds(room_left(trace, config.limits)), scene.seed
        # What is played is what was certified.
        assert trace.strain.max() == pytest.approx(scene.certificate.peak_strain, rel=1e-6)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_stated_margin_covers_what_other_physics_move_in_training_scenes(family):
    played = [each for scene in sample(family, "train", 16) for each in play_all(scene, "train", [SHIPPED, *OTHERS], 0)]
    worst, stated = labels.worst_moves(played), stated_margin(load_scene_config(family))
    assert max(worst.strain) <= stated.strain
    assert np.mean(np.array(worst.volume_ratio) <= stated.volume_ratio) > 0.5
    assert max(worst.healthy_share) <= stated.healthy_share
    # Physics that moved nothing would be no test.
    assert min(max(worst.strain), max(worst.volume_ratio)) > 1e-3


@pytest.mark.parametrize("short", [Margin(0.09, 0.5, 0.2), Margin(0.2, 0.04, 0.2), Margin(0.2, 0.5, -0.01)])
def test_too_little_room_to_any_one_limit_breaks_the_margin(short):
    stated = stated_margin(load_scene_config("box-48"))
    assert stated.holds(Margin(0.11, 0.06, 0.01))
    assert not stated.holds(short)


@pytest.mark.parametrize(("kappa", "strain"), [(0.6, 0.16), (0.75, 0.1), (0.9, 0.04)])
def test_the_room_below_the_limit_of_the_strain_shrinks_as_kappa_grows(kappa, strain):
    # 0.8 (1 - kappa) limit, and the limit is 0.5
    config = load_scene_config("box-48").model_copy(update={"kappa": kappa})
    assert stated_margin(config) == pytest.approx(Margin(strain, 0.05, 0.0))


# Comparing two plays ------------------------------------------------------------------------------------------------


def test_a_move_is_the_difference_of_peaks_while_both_stand():
    move = compare(trace_of([0.1, 0.3, 0.2]), trace_of([0.1, 0.25, 0.26]))
    assert move.strain == pytest.approx(0.3 - 0.26)
    assert (move.n_labels, move.is_flipped, move.ends_otherwise, move.reason) == (2, False, False, None)


def test_plays_are_compared_up_to_the_first_collapse_in_either():
    move = compare(trace_of([0.1, 0.49, 0.7], [None, None, "tear"]), trace_of([0.1, 0.51, 0.9], [None, "tear", "tear"]))
    assert move.strain == pytest.approx(0.49 - 0.51)
    # One of one label differs, though both orders end in a collapse.
    assert (move.n_labels, move.is_flipped, move.ends_otherwise, move.reason) == (1, True, False, "tear")


def test_tissue_that_turns_inside_out_is_a_label_and_no_move():
    move = compare(trace_of([0.1, 0.2, 2.0], [None, None, INVERTED], [0.9, 0.8, -1.0]), trace_of([0.1, 0.21, 0.22]))
    assert move.strain == pytest.approx(0.2 - 0.21)
    assert move.volume_ratio == pytest.approx(0.8 - 0.9)
    assert (move.is_flipped, move.ends_otherwise, move.reason) == (True, True, INVERTED)


# Playing under other physics ----------------------------------------------------------------------------------------


def test_random_orders_are_the_same_at_every_call_and_hold_the_certificates_cuts(scene):
    orders = orders_of(scene, 3)
    assert orders == orders_of(scene, 3)
    assert orders[0] == one_by_one(scene.certificate.order)
    assert all(sorted(order) == sorted(orders[0]) for order in orders)
    assert len({tuple(order) for order in orders}) > 1


def test_longer_settling_takes_as_many_more_substeps(scene):
    counts = []
    for factor in (1.0, 2.0, 4.0):
        task = task_of(scene, Variant("", settle=factor))
        before = task.simulation.n_substeps
        task.step(scene.certificate.order[0])
        counts.append(task.simulation.n_substeps - before)
    assert counts == pytest.approx([counts[0], 2 * counts[0], 4 * counts[0]], abs=4)


def test_half_the_substep_is_taken_from_the_start(scene):
    whole, half = (task_of(scene, Variant("", step=step)) for step in (1.0, 0.5))
    assert half.simulation.n_substeps == pytest.approx(2 * whole.simulation.n_substeps, abs=2)
    assert half.simulation.stable_step == 0.5 * whole.simulation.stable_step


def test_schemes_without_a_stable_step_are_left_out_and_those_stable_at_any_take_the_scenes_own(scene, monkeypatch):
    rk4 = INTEGRATORS["rk4"]
    for name in set(INTEGRATORS) - {"rk4", scene.physics.integrator}:
        monkeypatch.delitem(INTEGRATORS, name)
    for name, step in (("never", 0.0), ("hardly", 1e-7), ("always", math.inf)):
        monkeypatch.setitem(INTEGRATORS, name, rk4._replace(name=name, stable_step=lambda limits, step=step: step))
    schemes = schemes_for(scene)
    assert schemes.skipped == {"never": "its stable step is 0.0e+00 s", "hardly": "its stable step is 1.0e-07 s"}
    assert [variant.step for variant in schemes.variants if variant.physics["integrator"] == "always"] == [4.0, 1.0, 0.25]
    assert {variant.physics["integrator"] for variant in schemes.cheap} == {"rk4", "symplectic_euler"}
    always = Variant("always", physics={"integrator": "always"}, step=0.25)
    order = orders_of(scene, 0)[0]
    own = play(task_of(scene, Variant("rk4", physics={"integrator": "rk4"})), order)
    # The same scheme with smaller steps: the two differ by its error.
    assert play(task_of(scene, always), order).strain == pytest.approx(own.strain, abs=0.05)


# Finer meshes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [2, 3])
def test_a_finer_scene_has_the_geometry_material_target_and_pins_of_the_coarse_one(scene, factor):
    refined = refine(scene, load_scenes("box-48").config, factor)
    fine, coarse = refined.scene, scene
    volumes = np.bincount(refined.parent, fine.mesh.volumes)
    np.testing.assert_allclose(volumes, coarse.mesh.volumes, rtol=1e-12)
    assert (np.bincount(refined.parent) == factor**3).all()
    np.testing.assert_allclose(
        np.bincount(refined.parent, fine.mesh.volumes * fine.young_modulus), coarse.mesh.volumes * coarse.young_modulus
    )
    assert fine.mesh.volumes[fine.target].sum() == pytest.approx(coarse.mesh.volumes[coarse.target].sum())
    assert fine.mesh.points[fine.pinned, 2].max() == coarse.mesh.points[coarse.pinned, 2].max()
    # Each fine tetrahedron lies in its parent: so does its centre.
    corners = coarse.mesh.points[coarse.mesh.tetrahedra[refined.parent]]
    centres = fine.mesh.points[fine.mesh.tetrahedra].mean(axis=1)
    weights = np.linalg.solve(
        np.concatenate([corners, np.ones((len(corners), 4, 1))], axis=2).swapaxes(1, 2),
        np.concatenate([centres, np.ones((len(centres), 1))], axis=1)[:, :, None],
    )
    assert weights.min() > 0.0


def test_the_parts_of_a_coarse_cut_cover_the_same_surface(scene):
    refined = refine(scene, load_scenes("box-48").config, 2)
    coarse, fine = Resection(scene).table, Resection(refined.scene).table
    for action in range(coarse.n_faces):
        parts = refined.cuts([(action,)])[0]
        assert len(parts) == 4
        assert fine.face_area[parts].sum() == pytest.approx(coarse.face_area[action])
        # In the same plane, and round the same centre.
        np.testing.assert_allclose(fine.face_centroid[parts].mean(axis=0), coarse.face_centroid[action], atol=1e-12)
    (removal,) = refined.cuts([(coarse.n_faces + 30,)])
    assert (refined.parent[np.array(removal) - fine.n_faces] == 30).all()
    assert len(removal) == 8


def test_the_finer_body_comes_apart_where_the_coarse_one_does(scene):
    refined = refine(scene, load_scenes("box-48").config, 2)
    task, order = task_of(refined.scene, SHIPPED), orders_of(scene, 0)[0]
    for number, _ in enumerate(play_states(task, refined.cuts(order))):
        # The target hangs on until the last cut, and then on nothing.
        assert (task.target_share == 0.0) == (number == len(order))


def test_strain_along_coarse_edges_of_an_unrefined_body_is_its_own_strain(scene):
    refined = refine(scene, load_scenes("box-48").config, 1)
    task = task_of(refined.scene, SHIPPED)
    own = edge_strains(task.simulation.body)[np.unique(task.simulation.body.edge_of[~scene.target])].max()
    assert refined.gauge_strain(task) == pytest.approx(own) == pytest.approx(task.tissue.healthy_strain)


def play_states(task, order):
    """Yield the task after each cut, and before the first."""
    task.reset()
    yield task
    for cut in order:
        for action in cut:
            task.apply(action)
        task.settle()
        yield task


# Loose pieces -------------------------------------------------------------------------------------------------------


def test_a_body_that_keeps_what_comes_loose_moves_its_attached_part_alike(scene):
    task = task_of(scene, SHIPPED)
    keeper = Keeper(task)
    before = keeper.simulation.body.nodes.position.copy()
    for face in outer_faces(task, 0.5):
        if task.action_mask()[face]:
            keeper.apply(face)
    keeper.settle()
    assert task.is_attached.sum() == 24 < keeper.simulation.body.is_alive.sum() == 48
    assert keeper.farthest() < 1e-12 * scene.spacing
    assert np.abs(keeper.simulation.body.nodes.position[: len(before)] - before).max() > 1e-3 * scene.spacing
    assert keeper.tissue.healthy_strain == pytest.approx(task.tissue.healthy_strain, abs=1e-12)
    assert keeper.reason == task.outcome


# The studies --------------------------------------------------------------------------------------------------------


# That of labels plays every scheme in both precisions, which takes a minute where kernels are still to be compiled.
@pytest.mark.parametrize("study", [pytest.param(labels, marks=pytest.mark.slow), simplifications])
def test_a_quick_study_says_what_it_measured(study):
    result = study.run(QUICK)
    assert all(table.rows for table in result.tables)
    assert len(result.figures) == 1
    assert "nan" not in result.text.lower()
