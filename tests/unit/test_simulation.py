"""The shell: what it accepts, what it refuses, how it saves and goes back."""

import pickle

import numpy as np
import pytest

import gmapspring as gs
from gmapspring.simulation import Simulation
from tests.bits import assert_same_bits, bits_of

SOFT = gs.Material(young_modulus=5e3, density=1000.0, damping=1e-4, viscosity=5.0)


def hanging_box(**options):
    """Return a box that hangs by its top."""
    mesh = gs.meshes.box((2, 2, 2), spacing=0.01)
    return Simulation(mesh, SOFT, pinned=mesh.points[:, 2] > 0.0199, gravity=(0, 0, -9.81), **options)


def sewn_pair(sim, number=0):
    """Return two tetrahedra that share a face."""
    image = sim.body.gmap.image
    slots = np.flatnonzero(image.ravel() // 24 > np.arange(image.size) // 4)
    return int(slots[number] // 4), int(image.ravel()[slots[number]] // 24)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("integrator", sorted(gs.simulation.INTEGRATORS))
def test_advancing_counts_time_and_keeps_pinned_nodes_in_place(integrator, dtype):
    sim = hanging_box(integrator=integrator, dtype=dtype)
    before = sim.body.nodes.position.copy()
    n_substeps = sim.advance(0.05)
    assert n_substeps == sim.n_substeps == np.ceil(0.05 / sim.default_step)
    assert sim.time == pytest.approx(0.05)
    pinned = sim.body.nodes.is_pinned
    np.testing.assert_array_equal(sim.body.nodes.position[pinned], before[pinned])
    assert (sim.body.nodes.position[~pinned, 2] < before[~pinned, 2]).all()


def test_a_step_above_the_stable_one_is_refused_with_both_numbers():
    sim = hanging_box()
    with pytest.raises(gs.StabilityError, match=f"1 s is above the stable step of {sim.stable_step:.6g} s for rk4"):
        sim.advance(2.0, step=1.0)
    assert sim.time == 0.0 and sim.n_substeps == 0


def test_a_step_below_the_stable_one_is_kept():
    sim = hanging_box()
    assert sim.advance(0.01, step=sim.stable_step / 4) == int(np.ceil(0.04 / sim.stable_step))


@pytest.mark.parametrize("portion", [1, 3])
@pytest.mark.parametrize("integrator", sorted(gs.simulation.INTEGRATORS))
def test_portions_of_substeps_give_the_same_bits(integrator, portion, monkeypatch):
    sims = [hanging_box(integrator=integrator) for _ in range(2)]
    assert sims[0].advance(10 * sims[0].default_step) == 10
    set_portion(monkeypatch, sims[1], portion)
    assert sims[1].advance(10 * sims[1].default_step) == 10
    assert_same_bits(*map(bits_of, sims))


def set_portion(monkeypatch, sim, n_substeps):
    """Let one call of a kernel take so many substeps of a simulation."""
    monkeypatch.setattr(gs.simulation, "PORTION", n_substeps * sim.integrator.n_sweeps * sim.body.n_springs)


def test_what_ends_at_rest_ends_there_whatever_the_portion(monkeypatch):
    sims = [hanging_box() for _ in range(2)]
    n_taken = sims[0].advance(5.0, rest_tolerance=1e-4)
    assert 100 < n_taken < 0.9 * 5.0 / sims[0].default_step
    set_portion(monkeypatch, sims[1], 7)
    assert sims[1].advance(5.0, rest_tolerance=1e-4) == n_taken
    assert_same_bits(*map(bits_of, sims))


def test_a_later_portion_that_diverges_says_so_as_one_call_does(monkeypatch):
    found = set()
    for portion in (2000, 7, 1):
        sim = hanging_box()
        sim.body.nodes.velocity[~sim.body.nodes.is_pinned] = 1e-3
        set_portion(monkeypatch, sim, portion)
        with pytest.raises(gs.DivergenceError) as raised:
            sim._take_substeps(40 * sim.stable_step, 2000)
        assert f"finite in substep {sim.n_substeps + 1} of 2000" in str(raised.value)
        assert sim.n_substeps > 14 and sim.time == pytest.approx(sim.n_substeps * 40 * sim.stable_step)
        assert np.isfinite(sim.body.nodes.state).all()
        found.add((sim.n_substeps, sim.body.nodes.state.tobytes()))
    assert len(found) == 1


def test_an_interrupt_is_heard_between_portions_and_the_clock_stays_true(monkeypatch):
    sim, twin = hanging_box(), hanging_box()
    step = sim.default_step / 5
    set_portion(monkeypatch, sim, 3)
    whole = sim.integrator.advance

    def interrupted(*given):
        whole(*given)
        raise KeyboardInterrupt

    for expected in (3, 6):
        monkeypatch.setattr(sim, "integrator", sim.integrator._replace(advance=interrupted))
        with pytest.raises(KeyboardInterrupt):
            sim.advance(100 * step, step=step)
        assert sim.n_substeps == expected and sim.time == pytest.approx(expected * step)
    for _ in range(2):
        twin.advance(3 * step, step=step)
    assert_same_bits(bits_of(sim), bits_of(twin))


def test_divergence_raises_and_leaves_the_last_finite_state():
    sim = hanging_box()
    loads = np.zeros((sim.body.mesh.n_points, 3))
    loads[0] = 1e305
    sim.set_loads(loads)
    with pytest.raises(gs.DivergenceError, match="stopped being finite in substep"):
        sim.advance(1.0)
    assert np.isfinite(sim.body.nodes.state).all()
    sim.check_validity()
    assert sim.time == pytest.approx(sim.n_substeps / np.ceil(1.0 / (0.8 * sim.stable_step)))


@pytest.mark.parametrize("bad, message", [
    (dict(integrator="rk5"), "rk5.*rk4"),
    (dict(dtype=np.int32), "float32"),
    (dict(pinned=[1, 2]), "mask"),
    (dict(gravity=(0, 1)), "gravity"),
    (dict(gravity=(0, 0, np.nan)), "gravity"),
    (dict(loads=np.zeros((3, 3))), "loads"),
])  # fmt: skip
def test_bad_settings_are_refused(bad, message):
    with pytest.raises(ValueError, match=message):
        Simulation(gs.meshes.box((2, 2, 2), spacing=0.01), SOFT, **bad)


@pytest.mark.parametrize(
    "name, value", [("young_modulus", -1.0), ("density", 0.0), ("damping", np.inf), ("viscosity", [1.0, 2.0])]
)
def test_bad_materials_are_refused_by_name(name, value):
    values = dict(young_modulus=5e3, density=1000.0) | {name: value}
    with pytest.raises(ValueError, match=f"material.{name}"):
        Simulation(gs.meshes.single(), gs.Material(**values))


@pytest.mark.parametrize("seconds", [-1.0, np.nan, np.inf])
def test_bad_durations_are_refused(seconds):
    with pytest.raises(ValueError, match="seconds"):
        hanging_box().advance(seconds)


def test_going_back_to_a_state_repeats_the_future_to_the_last_bit():
    sim = hanging_box()
    sim.split_face(*sewn_pair(sim))
    sim.advance(0.02)
    state = sim.save_state()
    for _ in range(2):
        sim.remove_tetrahedron(7)
        sim.split_face(*sewn_pair(sim, 3))
        sim.advance(0.03)
        if sim.time > 0.0:
            future = pickle.dumps(sim.save_state())
        sim.load_state(state)
        sim.check_validity()
    sim.remove_tetrahedron(7)
    sim.split_face(*sewn_pair(sim, 3))
    sim.advance(0.03)
    assert pickle.dumps(sim.save_state()) == future


def test_a_state_taken_before_loads_were_named_can_be_put_back():
    mesh = gs.meshes.box((2, 2, 2), spacing=0.01)
    sim = Simulation(mesh, SOFT)
    assert len(sim.body.nodes.external) == 0
    state = sim.save_state()
    sim.set_loads(np.full((mesh.n_points, 3), 1e-3))
    loaded = sim.save_state()
    sim.load_state(state)
    assert len(sim.body.nodes.external) == 0
    sim.load_state(loaded)
    np.testing.assert_allclose(sim.body.nodes.external[:, :3].sum(axis=0), mesh.n_points * 1e-3)


BOX = gs.meshes.box((2, 2, 2), spacing=0.01)
OTHERS = {
    "fewer tetrahedra": (gs.meshes.single(), SOFT),
    "other points": (gs.meshes.box((2, 2, 2), spacing=0.02), SOFT),
    "another order of tetrahedra": (gs.Mesh(BOX.points, BOX.tetrahedra[::-1]), SOFT),
    "no damping": (BOX, gs.Material(5e3, 1e3)),
}


@pytest.mark.parametrize("what", OTHERS)
def test_the_state_of_another_body_is_refused_and_changes_nothing(what):
    sim, other = hanging_box(), Simulation(*OTHERS[what], gravity=(0, 0, -9.81))
    before = pickle.dumps(sim.save_state())
    with pytest.raises(gs.StateFileError, match="set of terms" if what == "no damping" else "another mesh"):
        sim.load_state(other.save_state())
    assert pickle.dumps(sim.save_state()) == before


def test_the_state_of_a_twin_on_an_equal_mesh_can_be_taken_over():
    sim, twin = hanging_box(), hanging_box()
    twin.split_face(*sewn_pair(twin))
    twin.advance(0.02)
    sim.load_state(pickle.loads(pickle.dumps(twin.save_state())))
    assert_same_bits(bits_of(sim), bits_of(twin))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_saved_file_brings_everything_back_to_the_last_bit(tmp_path, dtype):
    sim = hanging_box(dtype=dtype, integrator="symplectic_euler", keep_manifold=True)
    sim.set_loads(np.full((sim.body.mesh.n_points, 3), 1e-4))
    sim.advance(0.02)
    sim.cut([sewn_pair(sim)], ())
    sim.advance(0.02)
    sim.save(tmp_path / "body.npz")
    again = Simulation.load(tmp_path / "body.npz")
    assert_same_bits(bits_of(sim), bits_of(again))
    for each in (sim, again):
        each.advance(0.02)
    assert_same_bits(bits_of(sim), bits_of(again))
    assert again.keep_manifold and again.time == sim.time and again.n_substeps == sim.n_substeps
    assert list(tmp_path.iterdir()) == [tmp_path / "body.npz"]


def test_foreign_truncated_and_missing_files_get_one_clear_error(tmp_path):
    sim = hanging_box()
    path = tmp_path / "body.npz"
    sim.save(path)
    whole = path.read_bytes()
    for content, message in ((whole[: len(whole) // 2], "not a whole state file"), (b"", "not a whole state file"),
                             (b"hello", "not a whole state file")):  # fmt: skip
        path.write_bytes(content)
        with pytest.raises(gs.StateFileError, match=message):
            Simulation.load(path)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(gs.StateFileError, match="not a state file of gmapspring"):
        Simulation.load(path)
    with pytest.raises(gs.StateFileError, match="no such file"):
        Simulation.load(tmp_path / "nothing.npz")


def test_a_file_with_corrupted_topology_is_refused(tmp_path):
    sim = hanging_box()
    path = tmp_path / "body.npz"
    sim.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    arrays["gmap.1"] = arrays["gmap.1"][::-1].copy()
    np.savez(path, **arrays)
    with pytest.raises(gs.StateFileError, match="contradicts itself"):
        Simulation.load(path)


def test_loads_are_shared_by_mass_when_their_node_splits_and_gone_with_their_tetrahedra():
    sim = Simulation(gs.meshes.box((2, 2, 2), spacing=0.01), SOFT)
    loads = np.random.default_rng(0).normal(size=(sim.body.mesh.n_points, 3))
    sim.set_loads(loads)
    image = sim.body.gmap.image
    slots = np.flatnonzero(image.ravel() // 24 > np.arange(image.size) // 4)
    sim.cut([(s // 4, image.ravel()[s] // 24) for s in slots])
    np.testing.assert_allclose(sim.body.nodes.external[:, :3].sum(axis=0), loads.sum(axis=0), rtol=1e-12, atol=1e-14)
    own = sim.body.tetrahedra.load[5].sum(axis=0)
    before = sim.body.nodes.external[:, :3].sum(axis=0)
    sim.remove_tetrahedron(5)
    np.testing.assert_allclose(sim.body.nodes.external[:, :3].sum(axis=0), before - own, rtol=1e-12, atol=1e-14)


def test_a_load_on_a_point_that_is_gone_is_refused():
    sim = Simulation(gs.meshes.single(), SOFT)
    sim.remove_tetrahedron(0)
    with pytest.raises(ValueError, match="load on point 0"):
        sim.set_loads(np.ones((4, 3)))
    sim.set_loads(None)
    assert sim.body.n_nodes == sim.body.n_springs == 0
    sim.advance(0.1)
    sim.check_validity()


def test_terms_that_are_not_named_take_no_rows():
    sim = Simulation(gs.meshes.box((2, 2, 2), spacing=0.01), gs.Material(5e3, 1000.0))
    rows = sim.body.node_rows.external, sim.body.node_rows.viscosity, sim.body.spring_rows.damping, sim.body.tetrahedra.load
    assert [len(array) for array in rows] == [0, 0, 0, 0]


def test_the_node_of_a_point_follows_the_piece_with_its_lowest_dart():
    sim = hanging_box()
    for tetrahedron in (3, 0, 11, 20):
        sim.remove_tetrahedron(tetrahedron)
    body = sim.body
    node_of_point = body.node_of_point
    for point in range(body.mesh.n_points):
        corners = np.argwhere((body.mesh.tetrahedra == point) & body.is_alive[:, None])
        assert node_of_point[point] == (body.vertex_of[tuple(corners[0])] if len(corners) else -1)


def test_the_surface_is_closed_and_its_triangles_face_outward():
    body = hanging_box().body
    triangles = body.surface()
    corners = body.nodes.position[triangles]
    # Divergence theorem: the volume inside an outward surface is the sum of a . (b x c) / 6.
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(body.mesh.volumes.sum())
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    np.testing.assert_array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    normals = body.surface_normals()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1) - body.nodes.position.mean(axis=0)) > 0).all()


@pytest.mark.parametrize("number", [-1, 10**6, 2**62, -(2**63), 10**30])
def test_a_tetrahedron_that_no_mesh_has_is_refused_by_every_cut(number):
    sim = hanging_box()
    before = bits_of(sim)
    for attempt in (
        lambda: sim.remove_tetrahedron(number), lambda: sim.split_face(0, number), lambda: sim.split_face(number, 0),
        lambda: sim.cut(faces=[(number, 1)]), lambda: sim.cut(tetrahedra=[0, number]),
    ):  # fmt: skip
        with pytest.raises(gs.errors.TopologyError, match=f"tetrahedron {number} is out of range"):
            attempt()
    assert_same_bits(before, bits_of(sim))
