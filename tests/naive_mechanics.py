"""Mechanics of a naive body: shares of tetrahedra summed over cells, forces, schemes and energies in plain numpy."""

import itertools

import numpy as np
from scipy.optimize import fsolve

from tests.naive import EDGES


def sum_over(body, cells, shares, width):
    """Sum the shares of all members of each cell in ascending order; NaN where removed."""
    shape = (body.n, width, *np.shape(next(iter(shares.values()))))
    total = np.full(shape, np.nan)
    for members in {id(cell): cell for cell in cells.values()}.values():
        summed = sum((shares[member] for member in members[1:]), start=shares[members[0]])
        for member in members:
            total[member] = summed
    return total


def node_mass(body):
    """Return the mass [kg] of the node at each corner (n, 4): a quarter of every tetrahedron around it."""
    cells = body.vertex_cells()
    return sum_over(body, cells, {corner: body.mass[corner[0]] / 4 for corner in cells}, 4)


def node_viscosity(body):
    """Return the viscosity [N s/m] of the node at each corner (n, 4)."""
    cells = body.vertex_cells()
    return sum_over(body, cells, {corner: body.viscosity[corner[0]] / 4 for corner in cells}, 4)


def node_load(body):
    """Return the constant force [N] on the node at each corner (n, 4, 3): weight and loads."""
    cells = body.vertex_cells()
    shares = {c: body.load[c] + body.mass[c[0]] / 4 * body.gravity for c in cells}
    return sum_over(body, cells, shares, 4)


def rest_length(body):
    """Return the rest length [m] of every tetrahedron edge (n, 6), NaN where removed."""
    is_alive = np.isin(np.arange(body.n), sorted(body.alive))
    return np.where(is_alive[:, None], body.mesh_lengths, np.nan)


def spring_stiffness(body):
    """Return the stiffness [N/m] of the spring at every tetrahedron edge (n, 6): sum of E V / l^2."""
    cells = body.edge_cells()
    return sum_over(body, cells, {e: body.modulus[e[0]] for e in cells}, 6) / rest_length(body) ** 2


def spring_damping(body):
    """Return the damping [N s/m] of the spring at every tetrahedron edge (n, 6)."""
    cells = body.edge_cells()
    return sum_over(body, cells, {e: body.damping[e[0]] for e in cells}, 6) / rest_length(body) ** 2


def corner_array(body, state):
    """Lay a dictionary over corners out as an array (n, 4, ...), NaN where removed."""
    array = np.full((body.n, 4, *np.shape(next(iter(state.values())))), np.nan)
    for tet, corner in itertools.product(body.alive, range(4)):
        array[tet, corner] = state[tet, corner]
    return array


def assembled(body):
    """Return the body as compact arrays, one row per node and per spring, by name."""
    vertex_of, edge_of = body.vertex_labels(), body.edge_labels()
    node_names, node_at = np.unique(vertex_of[vertex_of >= 0], return_index=True)
    _, spring_at = np.unique(edge_of[edge_of >= 0], return_index=True)
    ends = np.stack([vertex_of[:, list(side)] for side in zip(*EDGES, strict=True)], axis=-1)
    corners = [divmod(int(name), 4) for name in node_names]
    return {
        "names": node_names,
        "endpoints": np.searchsorted(node_names, ends[edge_of >= 0][spring_at]),
        "position": np.array([body.position[c] for c in corners]),
        "velocity": np.array([body.velocity[c] for c in corners]),
        "is_pinned": np.array([body.is_pinned[c] for c in corners]),
        "mass": node_mass(body)[vertex_of >= 0][node_at],
        "viscosity": node_viscosity(body)[vertex_of >= 0][node_at],
        "load": node_load(body)[vertex_of >= 0][node_at],
        "rest_length": rest_length(body)[edge_of >= 0][spring_at],
        "stiffness": spring_stiffness(body)[edge_of >= 0][spring_at],
        "damping": spring_damping(body)[edge_of >= 0][spring_at],
    }


def advance(body, scheme, step, n_steps):
    """Take steps [s] of a named scheme and write the state back to all corners."""
    system = assembled(body)
    position, velocity = system["position"], system["velocity"]
    for _ in range(n_steps):
        position, velocity = SCHEMES[scheme](system, position, velocity, step)
    rows = dict(zip(system["names"].tolist(), range(len(position)), strict=True))
    for corner, label in np.ndenumerate(body.vertex_labels()):
        if label >= 0:
            body.position[corner] = position[rows[int(label)]].copy()
            body.velocity[corner] = velocity[rows[int(label)]].copy()


def kinetic_energy(body):
    """Return the sum of m v^2 / 2 [J] over nodes."""
    system = assembled(body)
    return 0.5 * float(np.sum(system["mass"] * np.sum(system["velocity"] ** 2, axis=1)))


def elastic_energy(body):
    """Return the sum of k (l - l0)^2 / 2 [J] over springs."""
    system = assembled(body)
    ends = system["position"][system["endpoints"]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return 0.5 * float(np.sum(system["stiffness"] * (length - system["rest_length"]) ** 2))


def momentum(body):
    """Return the sum of m v [kg m/s] over nodes."""
    system = assembled(body)
    return np.sum(system["mass"][:, None] * system["velocity"], axis=0)


def acceleration(system, position, velocity):
    """Return (load + spring forces - viscosity v) / mass [m/s^2], zero at pinned nodes."""
    first, second = system["endpoints"].T
    difference = position[second] - position[first]
    length = np.linalg.norm(difference, axis=1)
    direction = difference / length[:, None]
    rate = np.sum((velocity[second] - velocity[first]) * direction, axis=1)
    tension = system["stiffness"] * (length - system["rest_length"]) + system["damping"] * rate
    force = system["load"] - system["viscosity"][:, None] * velocity
    np.add.at(force, first, tension[:, None] * direction)
    np.add.at(force, second, -tension[:, None] * direction)
    return np.where(system["is_pinned"][:, None], 0.0, force / system["mass"][:, None])


def symplectic_euler_step(system, position, velocity, step):
    """Kick with the force at the old place, then drift with the new velocity."""
    velocity = velocity + step * acceleration(system, position, velocity)
    return position + step * velocity, velocity


def rk4_step(system, position, velocity, step):
    """Take one step of the classical fourth-order Runge-Kutta scheme."""
    slopes = []
    for share in (0.0, 0.5, 0.5, 1.0):
        dx, dv = slopes[-1] if slopes else (0.0, 0.0)
        x, v = position + share * step * dx, velocity + share * step * dv
        slopes.append((v, acceleration(system, x, v)))
    (x1, v1), (x2, v2), (x3, v3), (x4, v4) = slopes
    return position + step / 6 * (x1 + 2 * x2 + 2 * x3 + x4), velocity + step / 6 * (v1 + 2 * v2 + 2 * v3 + v4)


def explicit_euler_step(system, position, velocity, step):
    """Kick with the force at the old place, and drift with the old velocity."""
    return position + step * velocity, velocity + step * acceleration(system, position, velocity)


def velocity_verlet_step(system, position, velocity, step):
    """Kick, drift, kick; the last kick with the force at the velocity that it nearly ends with."""
    velocity = velocity + step / 2 * acceleration(system, position, velocity)
    position = position + step * velocity
    late = velocity + step / 2 * acceleration(system, position, velocity)
    return position, velocity + step / 2 * acceleration(system, position, late)


def backward_euler_step(system, position, velocity, step):
    """Drift with the new velocity, which is the old one kicked with the force at the new place: by SciPy's root finder."""

    def excess(flat):
        """Return the new velocity less what it should be."""
        late = flat.reshape(velocity.shape)
        return (late - velocity - step * acceleration(system, position + step * late, late)).ravel()

    late = fsolve(excess, velocity.ravel(), xtol=1e-13).reshape(velocity.shape)
    return position + step * late, late


SCHEMES = {"symplectic_euler": symplectic_euler_step, "rk4": rk4_step, "explicit_euler": explicit_euler_step,
           "velocity_verlet": velocity_verlet_step, "backward_euler": backward_euler_step}  # fmt: skip
