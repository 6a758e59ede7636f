"""Numbers anew: all that a tetrahedron knows stays, who moved is reported, and steps go on as before."""

import numpy as np
import pytest

import gmapspring as gs
from tests.bits import assert_same_bits, bits_of


def cut_box(dtype=np.float64, **terms):
    """Return a box that has been cut at random and moves, with its random numbers."""
    rng = np.random.default_rng(7)
    mesh = gs.meshes.box((4, 3, 3), spacing=0.1)
    sim = gs.Simulation(mesh, gs.Material(5e3, 1e3, **terms), pinned=mesh.points[:, 2] < 0.05, dtype=dtype)
    nodes = sim.body.nodes
    nodes.velocity[:] = np.where(nodes.is_pinned[:, None], 0.0, rng.normal(0.0, 0.1, nodes.velocity.shape))
    for _ in range(6):
        cut_somewhere(sim, rng)
    return sim, rng


def cut_somewhere(sim, rng):
    """Split some faces and remove some tetrahedra."""
    split_somewhere(sim, rng)
    remove_somewhere(sim, rng)


def split_somewhere(sim, rng):
    """Split some faces; return the report and one of the pairs of tetrahedra."""
    slots = rng.choice(np.flatnonzero(~gs.topology.gmap.is_free(sim.body.gmap).ravel()), 5)
    pairs = np.stack((slots // 4, sim.body.gmap.image.ravel()[slots] // 24), axis=1)
    return sim.cut(faces=pairs), pairs[0]


def remove_somewhere(sim, rng):
    """Remove some tetrahedra; return the report."""
    return sim.cut(tetrahedra=rng.choice(np.flatnonzero(sim.body.is_alive), 3))


def known_to_tetrahedra(sim):
    """Return what each corner and each edge of a live tetrahedron finds at its node and spring."""
    body = sim.body
    corners, edges = body.gmap.vertex_of[body.is_alive], body.gmap.edge_of[body.is_alive]
    nodes, springs = body.nodes, body.springs
    at_corners = [nodes.state, nodes.mass, nodes.inverse_mass, nodes.viscosity, nodes.external, nodes.is_pinned, nodes.point]
    at_edges = [springs.rest_length, springs.stiffness, springs.damping]
    ends = nodes.state[springs.endpoints[: body.n_springs]][edges]
    return [rows[corners] for rows in at_corners if len(rows)] + [rows[edges] for rows in at_edges if len(rows)] + [ends]


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("terms", [{}, {"damping": 1e-3, "viscosity": 2.0}])
def test_tetrahedra_find_what_they_found_before(dtype, terms):
    sim, _ = cut_box(dtype, **terms)
    before, labels = known_to_tetrahedra(sim), sim.components()
    report = sim.renumber()
    assert len(report.moved_nodes) and len(report.moved_springs)
    assert len(report.new_nodes) == len(report.new_springs) == len(report.boundary_faces) == report.n_removed_nodes == 0
    assert repr(report).endswith(f" {len(report.moved_nodes)} moved nodes, {len(report.moved_springs)} moved springs)")
    for one, other in zip(before, known_to_tetrahedra(sim), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(labels, sim.components())
    sim.check_validity()


def test_numbers_follow_the_tetrahedra_and_are_given_once():
    sim, _ = cut_box()
    sim.renumber()
    for cell_of in (sim.body.gmap.vertex_of, sim.body.gmap.edge_of):
        met = cell_of[sim.body.is_alive].ravel()
        _, first = np.unique(met, return_index=True)
        # Those of one tetrahedron stand in the order of their darts; tetrahedra follow one another.
        assert (np.diff(first // cell_of.shape[1]) >= 0).all()
    before = bits_of(sim)
    report = sim.renumber()
    assert len(report.moved_nodes) == len(report.moved_springs) == 0
    assert_same_bits(before, bits_of(sim))


def test_springs_of_an_uncut_body_are_in_order():
    assert len(gs.Simulation(gs.meshes.box((4, 3, 3)), gs.Material(5e3, 1e3)).renumber().moved_springs) == 0


@pytest.mark.parametrize("what", ["renumber", "guarded cut"])
def test_an_interrupt_leaves_the_body_as_it_was(what, monkeypatch):
    sim, rng = cut_box()
    sim.keep_manifold = True
    before = bits_of(sim)

    def interrupted(*given):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        if what == "renumber":
            monkeypatch.setattr(gs.layout, "_places", interrupted)
            sim.renumber()
        else:
            monkeypatch.setattr(gs.cut, "CutReport", interrupted)
            sim.cut(tetrahedra=np.flatnonzero(sim.body.is_alive)[:2])
    assert_same_bits(before, bits_of(sim))


def test_steps_and_cuts_go_on_as_before_up_to_round_off():
    sims = [cut_box(damping=1e-3)[0] for _ in range(2)]
    sims[0].renumber()
    for sim in sims:
        sim.advance(0.02)
        cut_somewhere(sim, np.random.default_rng(3))
        sim.advance(0.02)
        sim.check_validity()
    for one, other in zip(*(known_to_tetrahedra(sim) for sim in sims), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-13)


def follow(rows, moved, new, n):
    """Return an array of one's own over nodes, or springs, after an operation, by the words of CutReport."""
    result = np.zeros(max(n, len(rows)))
    result[: len(rows)] = rows
    result[moved[:, 1]] = rows[moved[:, 0]]
    result[new[:, 1]] = result[new[:, 0]]
    return result[:n]


def test_reports_let_arrays_of_ones_own_follow():
    sim, rng = cut_box()
    body = sim.body
    points, lengths = body.nodes.point[: body.n_nodes], body.springs.rest_length[: body.n_springs]
    n_moved = 0
    for _ in range(8):
        pair = None
        for operation in ("split", "sew", "remove", "renumber"):
            points, lengths = points.copy(), lengths.copy()
            if operation == "split":
                report, pair = split_somewhere(sim, rng)
            elif operation == "sew":
                report = sim.sew_face(*pair)
            else:
                report = remove_somewhere(sim, rng) if operation == "remove" else sim.renumber()
            points = follow(points, report.moved_nodes, report.new_nodes, body.n_nodes)
            lengths = follow(lengths, report.moved_springs, report.new_springs, body.n_springs)
            np.testing.assert_array_equal(points, body.nodes.point[: body.n_nodes])
            np.testing.assert_array_equal(lengths, body.springs.rest_length[: body.n_springs])
            n_moved += len(report.moved_nodes)
    assert n_moved > 50
