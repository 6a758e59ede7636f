"""BodyBatch: a row does, to the last bit, what a Simulation of its own does."""

import copy
import multiprocessing
import pickle

import numpy as np
import pytest

from gmapspring import measure
from gmapspring.arena import Arena, SavedRow, layout_of
from gmapspring.batch import BODY_EXTENTS, BodyBatch, room_for
from gmapspring.body import BodyArrays, Material
from gmapspring.cut import cut
from gmapspring.errors import CapacityError, StabilityError
from gmapspring.integrators import INTEGRATORS
from gmapspring.simulation import Simulation
from gmapspring.threads import Threads
from gmapspring.validity import check_body
from tests import zoo
from tests.bits import assert_same_bits, bits_of


class Row:
    """A row of a batch, as tests.bits reads simulations."""

    def __init__(self, batch, row, like):
        self.body, self.time, self.n_substeps = batch.bodies[row], like.time, like.n_substeps


def simulations(integrator="rk4", dtype=np.float64, names=zoo.SMALL):
    """Return bodies of several meshes and sets of terms, moving."""
    found = []
    for number, name in enumerate(names):
        mesh, rng = zoo.build(name), np.random.default_rng(number)
        drag = 10.0 if integrator == "explicit_euler" else 0.0  # without any it has no stable step
        material = Material(5e3, 1000.0, damping=1e-4 * (number % 2), viscosity=drag + 10.0 * (number % 3))
        pinned = mesh.points[:, 2] < mesh.points[:, 2].min() + 1e-9
        gravity = (0.0, 0.0, -9.81 * (number % 2))
        sim = Simulation(mesh, material, pinned=pinned, gravity=gravity, integrator=integrator, dtype=dtype)
        if number % 2:
            sim.set_loads(rng.normal(scale=1e-3, size=(mesh.n_points, 3)))
        sim.body.nodes.velocity[:] = rng.normal(scale=0.01, size=(sim.body.n_nodes, 3))
        found.append(sim)
    return found


def random_cut(body, rng):
    """Return some sewn faces, as pairs, and tetrahedra that are left."""
    image = body.gmap.image
    pairs = [(slot // 4, beyond // 24) for slot, beyond in enumerate(image.ravel().tolist()) if beyond // 6 > slot]
    alive = np.flatnonzero(body.is_alive)
    faces = [pairs[i] for i in rng.permutation(len(pairs))[:3]]
    return faces, rng.permutation(alive)[: 1 if len(alive) > 2 else 0].tolist()


def seconds_of(sim, n_substeps=7):
    """Return a time that takes so many substeps."""
    return n_substeps * 0.9 * sim.default_step


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("n_threads", [1, 3])
def test_rows_do_what_simulations_do_to_the_last_bit_whatever_is_cut(integrator, dtype, n_threads, rng):
    sims = simulations(integrator, dtype)
    batch = BodyBatch(sims, n_threads=n_threads)
    for _ in range(4):
        seconds = np.array([seconds_of(sim) for sim in sims])
        taken = batch.advance(seconds)
        assert not taken.has_diverged.any()
        for row, sim in enumerate(sims):
            assert sim.advance(seconds[row]) == taken.n_substeps[row]
            faces, tetrahedra = random_cut(sim.body, rng)
            sim.cut(faces, tetrahedra)
            cut(batch.bodies[row], faces, tetrahedra)
            check_body(batch.bodies[row])
            assert_same_bits(bits_of(sim), bits_of(Row(batch, row, sim)))
    assert batch.n_nodes.tolist() == [sim.body.n_nodes for sim in sims]
    assert batch.n_springs.tolist() == [sim.body.n_springs for sim in sims]


def test_the_arrays_of_all_rows_are_those_of_the_bodies():
    sims = simulations()
    batch = BodyBatch(sims)
    for row, sim in enumerate(sims):
        assert np.array_equal(batch.state[row, : batch.n_nodes[row]], sim.body.nodes.state)
        batch.state[row, 0, 4] = 7.0
        assert batch.bodies[row].nodes.velocity[0, 0] == 7.0
        assert sim.body.nodes.velocity[0, 0] != 7.0


def test_every_row_starts_on_a_cache_line():
    batch = BodyBatch(simulations())
    for body in batch.bodies:
        for array in (body.node_rows.state, body.node_rows.force, body.spring_rows.stiffness, body.spring_rows.endpoints):
            assert array.ctypes.data % 64 == 0


def test_a_row_that_diverges_is_reported_stays_as_it_was_and_no_other_row_notices():
    sims = simulations()
    sims[1].body.nodes.velocity[:] = 1e300
    batch, others = BodyBatch(sims), simulations()
    before = batch.bodies[1].nodes.state.copy()
    seconds = np.array([seconds_of(sim) for sim in sims])
    taken = batch.advance(seconds)
    assert taken.has_diverged.tolist() == [row == 1 for row in range(len(sims))]
    assert np.array_equal(batch.bodies[1].nodes.position, before[:, :3])
    for row, sim in enumerate(others):
        if row != 1:
            sim.advance(seconds[row])
            assert_same_bits(bits_of(sim), bits_of(Row(batch, row, sim)))


def test_a_row_can_go_on_from_another_simulation():
    sims = simulations()
    batch = BodyBatch(sims[:2], n_tetrahedra=max(sim.body.mesh.n_tetrahedra for sim in sims))
    for sim in (*sims, *reversed(sims)):
        batch.put(0, sim)
        assert_same_bits(bits_of(sim), bits_of(Row(batch, 0, sim)))
        check_body(batch.bodies[0])
    seconds = np.array([seconds_of(sims[0]), seconds_of(sims[1])])
    batch.advance(seconds)
    for row in range(2):
        sims[row].advance(seconds[row])
        assert_same_bits(bits_of(sims[row]), bits_of(Row(batch, row, sims[row])))


def test_a_row_that_is_not_there_is_refused_with_nothing_changed():
    sims = simulations()[:2]
    batch = BodyBatch(sims, n_tetrahedra=max(sim.body.mesh.n_tetrahedra for sim in sims))
    for row in (-1, 2):
        with pytest.raises(ValueError, match=rf"there is no row {row}: the batch has rows 0 to 1"):
            batch.put(row, sims[0])
    assert_same_bits(bits_of(sims[1]), bits_of(Row(batch, 1, sims[1])))
    with pytest.raises(ValueError, match="at least one simulation"):
        BodyBatch([])


@pytest.mark.parametrize("tolerance", [-1.0, np.nan])
def test_a_batch_refuses_what_a_simulation_refuses(tolerance):
    sim = simulations()[0]
    batch = BodyBatch([sim])
    for one in (sim, batch):
        with pytest.raises(ValueError, match="rest_tolerance must not be negative"):
            one.advance(0.01, rest_tolerance=tolerance)
        for arguments in ((1e300,), (0.01, 1e-300)):
            with pytest.raises(StabilityError, match=r"substeps, above 1e\+09; simulate less time"):
                one.advance(*arguments)


def test_a_body_that_might_outgrow_its_row_is_refused_by_the_bound():
    small, large = sorted(simulations(), key=lambda sim: sim.body.mesh.n_tetrahedra)[:: len(zoo.SMALL) - 1]
    batch, n = BodyBatch([small]), small.body.mesh.n_tetrahedra
    with pytest.raises(CapacityError, match=rf"row 0 has room for {n} tetrahedra, 4T = {4 * n} nodes and 6T = {6 * n} springs"):
        batch.put(0, large)
    with pytest.raises(CapacityError, match="row 1"):
        BodyBatch([small, large], n_tetrahedra=n)


def test_no_cut_ever_needs_more_than_the_bound():
    sim = simulations(names=zoo.SMALL[-1:])[0]
    batch = BodyBatch([sim])
    body = batch.bodies[0]
    pairs = [(slot // 4, beyond // 24) for slot, beyond in enumerate(body.gmap.image.ravel().tolist()) if beyond // 6 > slot]
    cut(body, pairs)
    n = body.mesh.n_tetrahedra
    assert (batch.n_nodes[0], batch.n_springs[0]) == (4 * n, 6 * n)
    check_body(body)


def test_rows_of_another_kind_are_refused():
    with pytest.raises(ValueError, match="one integrator and one precision, rk4 in float64; this body has symplectic_euler"):
        BodyBatch([*simulations("rk4"), *simulations("symplectic_euler")])
    with pytest.raises(ValueError, match="in float32"):
        BodyBatch([*simulations(), *simulations(dtype=np.float32)])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0,), "row 0: seconds must be finite and not negative, not -1.0"),
        ((np.nan,), "seconds"),
        ((1.0, 0.0), "row 0: step must be positive"),
        ((1.0, 10.0), "row 0: a step of 10 s is above the stable step"),
    ],
)
def test_times_that_cannot_be_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message) as raised:
        BodyBatch(simulations()).advance(*arguments)
    assert isinstance(raised.value, StabilityError) == ("stable" in message)


def test_a_time_of_zero_moves_nothing():
    sims = simulations()
    batch = BodyBatch(sims)
    assert not batch.advance(0.0).n_substeps.any()
    assert_same_bits(bits_of(sims[0]), bits_of(Row(batch, 0, sims[0])))


def test_bodies_at_rest_are_not_stepped_any_further():
    sims = simulations()
    for sim in sims:
        sim.body.nodes.velocity[:] = 0.0
    batch = BodyBatch(sims)
    seconds = np.array([seconds_of(sim, 200) for sim in sims])
    early = batch.advance(seconds, rest_tolerance=1.0).n_substeps
    assert (early < 200).all()
    for row, sim in enumerate(sims):
        assert sim.advance(seconds[row], rest_tolerance=1.0) == early[row]
        assert sim.time == pytest.approx(seconds[row])
        assert_same_bits(bits_of(sim), bits_of(Row(batch, row, sim)))


def test_a_body_of_a_batch_can_be_copied_and_the_batch_cannot():
    sims = simulations()
    batch = BodyBatch(sims)
    for twin in (copy.deepcopy(batch.bodies[0]), pickle.loads(pickle.dumps(batch.bodies[0]))):
        faces, _ = random_cut(twin, np.random.default_rng(0))
        cut(twin, faces)
        check_body(twin)
    assert_same_bits(bits_of(sims[0]), bits_of(Row(batch, 0, sims[0])))
    with pytest.raises(TypeError, match="build another one"):
        copy.deepcopy(batch)


def test_measures_take_bodies_of_a_batch():
    sims = simulations()
    batch = BodyBatch(sims)
    for body, sim in zip(batch.bodies, sims, strict=True):
        assert measure.kinetic_energy(body) == measure.kinetic_energy(sim.body)


# Rows of tables ----------------------------------------------------------------------------------------------------


def test_a_saved_row_restores_all_that_can_change(rng):
    for sim in simulations():
        body = sim.body
        example = BodyArrays(body.matter, body.gmap, body.room)
        layout = layout_of(example, BODY_EXTENTS)
        before = bits_of(sim)
        saved = SavedRow(layout, body.table, 0, body.gmap.counts)
        arena = Arena(room_for(body.mesh.n_tetrahedra, np.float64, 2), BODY_EXTENTS, 1)
        sim.cut(*random_cut(body, rng))
        for twin in (saved, copy.deepcopy(saved), pickle.loads(pickle.dumps(saved))):
            arena.put(0, arena.tenancy(body.table[0], body), twin.table, 0)
            view = arena.view(0, example)
            assert np.array_equal(view.matter.nodes.state[: len(before["nodes.state"])], before["nodes.state"])
            assert np.array_equal(view.gmap.image, before["gmap.image"])
            assert view.gmap.counts is view.matter.counts


# Threads ------------------------------------------------------------------------------------------------------------


def advance_in_threads(batch):
    """Advance a batch that was made before the process was."""
    return batch.advance(1e-3).n_substeps.tolist()


def test_threads_work_on_in_a_forked_process():
    batch = BodyBatch(simulations(), n_threads=2)
    expected = advance_in_threads(batch)
    receiving, sending = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=lambda: sending.send(advance_in_threads(batch)))
    process.start()
    assert receiving.poll(60) and receiving.recv() == expected
    process.join(60)


def make_and_advance():
    """Make a batch and advance it, in a process of its own."""
    return advance_in_threads(BodyBatch(simulations(), n_threads=2))


@pytest.mark.parametrize("method", ["forkserver", "spawn"])
def test_threads_work_in_processes_of_any_kind(method):
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.apply_async(make_and_advance).get(120) == make_and_advance()


@pytest.mark.parametrize("n_threads", [0, -1, 1.5, True, "2"])
def test_a_number_of_threads_must_be_whole(n_threads):
    with pytest.raises(ValueError, match="n_threads"):
        Threads(n_threads)


def test_an_error_in_a_thread_is_raised():
    def fail(rows):
        raise RuntimeError(f"rows {rows.tolist()}")

    with pytest.raises(RuntimeError, match="rows"):
        Threads(2).run(fail, np.arange(4))
