"""Cases of loads beyond all bounds, and of loads on what is not there."""

import numpy as np

import gmapspring as gs
from gmapspring import measure
from tests.stability.cases.bodies import build, held_at_low_x, n_steps_for, near_bound, small_box, swing_of_any_cut
from tests.stability.cases.linear import laplacian
from tests.stability.cases.verdict import Check, Verdict, all_finite, differing, refused

HUGE = 1e9
"""[N]; it pulls a box of soft tissue to about ten thousand kilometres."""


def end_load(mesh, force):
    """Return a force [N] along x, shared by the points at the highest x, (n_points, 3)."""
    is_end = mesh.points[:, 0] == mesh.points[:, 0].max()
    return np.where(is_end[:, None], (force / is_end.sum(), 0.0, 0.0), 0.0)


def a_huge_load(scheme, dtype):
    """Pull a box to ten million times its length."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh), loads=end_load(mesh, HUGE))
    step, n_records = near_bound(sim), 100
    still = static_solution(sim.body)
    start, peak = energy_about(sim.body, still, np.zeros_like(still)), 0.0
    for _ in range(n_records):
        sim.advance(n_steps_for(sim) / n_records * step, step=step)
        peak = np.maximum(peak, energy_about(sim.body, still, sim.body.nodes.position.astype(float)))
    # Rest lengths are what is left out: a share of l0 / l in force, so twice of that in energy.
    reach = float(np.abs(still).max()) / float(sim.body.springs.rest_length.max())
    limit = swing_of_any_cut(sim, step) * (1.0 + 2.0 * sim.body.n_springs / reach)
    check = Check("peak energy about the place of rest / start", peak / start, limit)
    return Verdict("stays finite; swings about where F = K x, with rest lengths left out, within the element bound's swing",
                   (check, all_finite(sim)))  # fmt: skip


def static_solution(body):
    """Return where springs without rest lengths hold the loads [m], (n_nodes, 3)."""
    is_free, matrix = ~body.nodes.is_pinned, laplacian(body, body.springs.stiffness.astype(float))
    place = body.nodes.position.astype(float)
    held = matrix[:, ~is_free] @ place[~is_free]
    place[is_free] = np.linalg.solve(matrix[is_free][:, is_free], (body.nodes.external[:, :3].astype(float) - held)[is_free])
    return place


def energy_about(body, still, position):
    """Return the kinetic energy [J] and that of springs without rest lengths about a place of rest."""
    offset = position - still
    offset[body.nodes.is_pinned] = 0.0
    stretch = laplacian(body, body.springs.stiffness.astype(float)) @ offset
    return measure.kinetic_energy(body) + 0.5 * float(np.sum(offset * stretch))


def a_load_beyond_the_numbers(scheme, dtype):
    """Pull with a force whose square no number can hold."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh))
    before = sim.body.nodes.state.copy()
    sim.set_loads(end_load(mesh, 0.1 * float(np.finfo(dtype).max)))
    checks = [refused([lambda: sim.advance(n_steps_for(sim) * sim.default_step)], gs.DivergenceError, "last finite state")]
    checks += [all_finite(sim)]
    sim.set_loads(None)
    sim.body.nodes.state[:] = before
    sim.advance(sim.default_step)
    checks += [all_finite(sim)]
    for bad in (np.inf, np.nan):
        checks.append(refused([lambda bad=bad: sim.set_loads(end_load(mesh, bad))], ValueError, "finite"))
    return Verdict("ends in a DivergenceError, and the body holds its last finite state; loads that are not finite are refused",
                   tuple(checks))  # fmt: skip


def loads_on_what_is_removed(scheme, dtype):
    """Pull on two points of a free body, and remove all tetrahedra at one of them, some of which are at the other too."""
    mesh = small_box()
    lost = int(np.lexsort(mesh.points.T)[-1])
    is_gone = (mesh.tetrahedra == lost).any(axis=1)
    shared = int(np.intersect1d(mesh.tetrahedra[is_gone], mesh.tetrahedra[~is_gone])[0])
    loads = np.zeros((mesh.n_points, 3))
    loads[lost], loads[shared] = (3.0, 0.0, 0.0), (0.0, 2.0, 0.0)
    sim = build(scheme, dtype, mesh, loads=loads)
    sim.advance(sim.default_step)
    sim.cut(tetrahedra=np.flatnonzero(is_gone))
    # The other load loses the share, by mass, that the removed tetrahedra had of it.
    mass, is_around = sim.body.tetrahedra.mass, (mesh.tetrahedra == shared).any(axis=1)
    left = loads[shared] * mass[is_around & ~is_gone].sum() / mass[is_around].sum()
    pull = sim.body.nodes.external[:, :3].astype(float).sum(axis=0)
    before = sim.body.nodes.state.copy()
    # Each of so many corners' loads is rounded once.
    limit = 2.0 * int(is_around.sum()) * float(np.finfo(dtype).eps)
    checks = [
        Check("force besides what is left [N]", float(np.abs(pull - left).max()), limit),
        refused([lambda: sim.set_loads(loads)], ValueError, f"point {lost} has nothing to act on"),
        differing("entries that the refused call changed", sim.body.nodes.state, before),
    ]
    sim.advance(n_steps_for(sim, 200) * sim.default_step)
    return Verdict("the load is gone with what it pulled; loads on what is gone are refused", (*checks, all_finite(sim)))


CASES = {
    "a huge load": a_huge_load,
    "a load beyond the numbers": a_load_beyond_the_numbers,
    "loads on what is removed": loads_on_what_is_removed,
}
