"""Cases of cuts: all faces, all tetrahedra, a cut in every substep, at peak stretch, the last hold.

That cuts cannot pump energy into small undamped motions is proven for three schemes. A step of RK4 or backward Euler raises no
energy, and neither does a cut. Symplectic Euler conserves E - (h / 2) v . K x, a sum over tetrahedra whose terms are positive:
a split leaves it as it is, a removal takes its term, and throughout E is between 1 / (1 + a) and 1 / (1 - a) times it, with
a = h omega / 2 from the element bound. For the others the same swing is what is expected, without a proof.
"""

import numpy as np

import gmapspring as gs
from gmapspring import measure
from gmapspring.batch import BodyBatch
from tests.stability.cases.bodies import (
    build,
    drag_of,
    explicit_step,
    gentle_motion,
    held_at_low_x,
    n_steps_for,
    sewn_pairs,
    small_box,
    swing_of_any_cut,
    throw,
)
from tests.stability.cases.limits import LINEAR
from tests.stability.cases.linear import round_off, total_energy
from tests.stability.cases.verdict import Check, Verdict, all_finite, differing, refused

SPEED = 0.3
"""Of nodes that strain a box of soft tissue by about a tenth [m/s]."""


def every_face_split(scheme, dtype):
    """Cut a moving box into its tetrahedra: it then fills its capacity to the last row."""
    sim = build(scheme, dtype)
    sim.cut(faces=sewn_pairs(sim.body))
    checks = (*counts_of_pieces(sim.body), gentle_motion(sim), all_finite(sim))
    return Verdict("4T nodes and 6T springs exactly; " + LINEAR, checks)


def counts_of_pieces(body):
    """Compare the counts of a body that is cut into its tetrahedra, and its arrays, with 4T nodes and 6T springs."""
    n = body.n_tetrahedra
    return (
        Check("nodes besides 4T", abs(body.n_nodes - 4 * n), 0.0),
        Check("springs besides 6T", abs(body.n_springs - 6 * n), 0.0),
        Check("nodes beyond the rows there are", max(body.n_nodes - len(body.node_rows.state), 0), 0.0),
        Check("springs beyond the rows there are", max(body.n_springs - len(body.spring_rows.stiffness), 0), 0.0),
    )


def a_batch_row_at_its_bound(scheme, dtype):
    """Cut one row of a batch with no room to spare to pieces, and step it: as a body of its own, and its neighbours too."""
    alone = [build(scheme, dtype), build(scheme, dtype)]
    for sim in alone:
        throw(sim, SPEED)
    batch = BodyBatch(alone)
    pieces, whole = batch.bodies
    pairs = sewn_pairs(pieces)
    gs.cut.cut(pieces, pairs)
    alone[0].cut(pairs)
    n_steps = n_steps_for(alone[0], 200)
    batch.advance(n_steps * alone[0].default_step)
    for sim in alone:
        sim.advance(n_steps * sim.default_step)
    checks = (
        *counts_of_pieces(pieces),
        differing("entries unlike those of a body of its own", pieces.nodes.state, alone[0].body.nodes.state),
        differing("entries of the neighbour that changed", whole.nodes.state, alone[1].body.nodes.state),
        all_finite(alone[0]),
    )
    return Verdict("4T nodes and 6T springs exactly; bit for bit as a body of its own, the neighbour too", checks)


def removed_down_to_none(scheme, dtype):
    """Remove one tetrahedron after the other at random while the body moves, down to the last and beyond."""
    sim = build(scheme, dtype)
    throw(sim, SPEED)
    step, start = sim.default_step, total_energy(sim)
    n_between = n_steps_for(sim, 50)
    order = np.random.default_rng(3).permutation(sim.body.mesh.n_tetrahedra)
    limit = swing_of_any_cut(sim, step) * round_off(sim, n_between * len(order), start)
    peak, last = 0.0, (0, 0)
    for tetrahedron in order.tolist():
        last = sim.body.n_nodes, sim.body.n_springs
        sim.remove_tetrahedron(tetrahedron)
        sim.advance(n_between * step)
        peak = np.maximum(peak, total_energy(sim))
    checks = (
        Check("peak energy / start", peak / start, limit),
        Check("nodes and springs of the last besides 4 and 6", abs(last[0] - 4) + abs(last[1] - 6), 0.0),
        Check("nodes, springs and energy of none", sim.body.n_nodes + sim.body.n_springs + total_energy(sim), 0.0),
        refused([lambda: sim.remove_tetrahedron(0)], gs.TopologyError, "removed already"),
        all_finite(sim),
    )
    return Verdict("stays finite; the energy is within the swing of the element bound; an empty body steps on", checks)


def a_cut_in_every_substep(scheme, dtype):
    """Split a face, or now and then remove a tetrahedron, in every substep of a body at speed, until nothing is sewn."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh))
    throw(sim, SPEED)
    rng, step, start, peak, n_cuts = np.random.default_rng(4), sim.default_step, total_energy(sim), 0.0, 0
    while len(pairs := sewn_pairs(sim.body)):
        pair = pairs[rng.integers(len(pairs))].tolist()
        if rng.uniform() < 0.1:
            sim.remove_tetrahedron(pair[0])
        else:
            sim.split_face(*pair)
        sim.advance(step)
        peak, n_cuts = np.maximum(peak, total_energy(sim)), n_cuts + 1
    sim.check_validity()
    limit = swing_of_any_cut(sim, step) * round_off(sim, n_cuts, start)
    checks = (Check("peak energy / start", peak / start, limit), all_finite(sim))
    return Verdict("stays valid and finite; the energy is within the swing of the element bound, however many cuts", checks)


def at_peak_stretch(scheme, dtype):
    """Split all faces one by one at the moment of largest elastic energy, and compare totals across each cut."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh))
    nodes = sim.body.nodes
    nodes.velocity[~nodes.is_pinned] = 10.0 * nodes.position[~nodes.is_pinned]
    step = explicit_step(sim)
    before = -1.0
    while measure.elastic_energy(sim.body) > before:
        before = measure.elastic_energy(sim.body)
        sim.advance(step)
    worst = {"mass": 0.0, "momentum": 0.0, "kinetic energy": 0.0, "elastic energy": 0.0}
    n_changed = 0.0
    for tet_a, tet_b in sewn_pairs(sim.body).tolist():
        totals, corners = totals_of(sim.body), sim.body.nodes.state[sim.body.vertex_of]
        sim.split_face(tet_a, tet_b)
        n_changed += differing("", sim.body.nodes.state[sim.body.vertex_of], corners).worst
        for name, (value, scale) in totals_of(sim.body).items():
            worst[name] = max(worst[name], float(np.max(np.abs(value - totals[name][0]))) / scale)
    # Stiffness is stored in the body's precision: the halves of a spring need not sum to the whole. All else is float64.
    limits = {"elastic energy": max(1e-12, float(np.finfo(dtype).eps))}
    checks = [Check(f"{name}, relative change", found, limits.get(name, 1e-12)) for name, found in worst.items()]
    checks += [Check("entries of the state at corners that changed", n_changed, 0.0), all_finite(sim)]
    expected = "no bit of the state changes; mass, momentum and kinetic energy hold to 1e-12, elastic energy to 1e-12 or eps"
    return Verdict(expected, tuple(checks))


def totals_of(body):
    """Return totals of a body, each with its scale: the sum of the sizes of its parts."""
    speed = np.linalg.norm(body.nodes.velocity.astype(float), axis=1)
    kinetic, elastic = measure.kinetic_energy(body), measure.elastic_energy(body)
    return {
        "mass": (body.nodes.mass.sum(), body.nodes.mass.sum()),
        "momentum": (measure.momentum(body), body.nodes.mass @ speed),
        "kinetic energy": (kinetic, kinetic),
        "elastic energy": (elastic, elastic),
    }


def the_last_hold(scheme, dtype):
    """Cut away the only pinned node of a hanging body: its centre of mass falls freely."""
    mesh, gravity = small_box(), 9.81
    pinned = np.arange(mesh.n_points) == int(np.lexsort(mesh.points.T)[-1])
    sim = build(scheme, dtype, mesh, pinned=pinned, gravity=(0.0, 0.0, -gravity))
    step = explicit_step(sim)
    sim.advance(50 * step, step=step)
    holding = np.flatnonzero((sim.body.nodes.is_pinned[sim.body.vertex_of]).any(axis=1))
    sim.cut(tetrahedra=holding)
    place, velocity = centre_of_mass(sim.body), measure.momentum(sim.body) / sim.body.nodes.mass.sum()
    n_steps = 100
    seconds = n_steps * step
    sim.advance(seconds, step=step)
    expected = place + fallen(velocity, np.array([0.0, 0.0, -gravity]), drag_of(sim), seconds)
    error = float(np.linalg.norm(centre_of_mass(sim.body) - expected))
    fastest = np.linalg.norm(velocity) + gravity * seconds
    nodes, eps = sim.body.nodes, float(np.finfo(dtype).eps)
    reach = np.abs(nodes.position.astype(float)).max() + seconds * np.abs(nodes.velocity.astype(float)).max()
    limit = n_steps * eps * reach
    if sim.integrator.order == 1:
        # Euler's errors: half a step times the change of velocity, g t and, with drag, that of the speed it had.
        limit += 0.5 * step * (1.0 + 1e-6) * (gravity * seconds + drag_of(sim) * fastest * seconds)
    checks = (
        Check("error of the centre of mass [m]", error, limit),
        Check("pinned nodes left", int(nodes.is_pinned.sum()), 0.0),
        all_finite(sim),
    )
    expected = "its centre of mass falls by v t + g t^2 / 2, with drag by that law; schemes of order 1 lag by half a step"
    return Verdict(expected, checks)


def centre_of_mass(body):
    """Return the centre of mass [m], (3,)."""
    return body.nodes.mass @ body.nodes.position.astype(float) / body.nodes.mass.sum()


def fallen(velocity, gravity, drag, seconds):
    """Return how far a mass moves in some seconds under gravity, with drag [1/s] or without."""
    if drag == 0.0:
        return velocity * seconds + 0.5 * gravity * seconds**2
    decay = -np.expm1(-drag * seconds) / drag
    return velocity * decay + gravity * (seconds - decay) / drag


CASES = {
    "every face split": every_face_split,
    "a batch row at its bound": a_batch_row_at_its_bound,
    "removed down to none": removed_down_to_none,
    "a cut in every substep": a_cut_in_every_substep,
    "cut at peak stretch": at_peak_stretch,
    "the last hold cut away": the_last_hold,
}
