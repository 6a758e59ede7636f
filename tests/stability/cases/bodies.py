"""The bodies of the hard cases, how they are set in motion, and how far they are stepped."""

import numpy as np

import gmapspring as gs
from gmapspring import stability
from tests.stability.cases.linear import is_implicit, modes, needs_drag, round_off, swing, total_energy
from tests.stability.cases.verdict import Check

YOUNG_MODULUS, DENSITY = 5e3, 1e3
"""Soft tissue [Pa], [kg/m^3]."""
N_STEPS = 2000
"""Substeps of a case; an implicit scheme takes a tenth of them, each worth a hundred of an explicit one's longest."""
NEAR = 0.99
"""Near the bound: this share of it."""
ALLOWED_STIFFENING = 1.01
"""Motions that strain springs by a thousandth change frequencies by about as much; ten times that is allowed for."""


def small_box() -> gs.Mesh:
    """Return a box of 24 tetrahedra, 0.1 m each cube."""
    return gs.meshes.box((2, 2, 1), 0.1)


def build(scheme, dtype, mesh=None, *, young_modulus=YOUNG_MODULUS, density=DENSITY, damping_ratio=0.0, **options):
    """Return a simulation; damping_ratio is beta omega / 2 of its fastest tetrahedron, along the springs.

    A scheme that has no stable step without drag gets gamma = omega / 2.
    """
    mesh = small_box() if mesh is None else mesh
    plain = gs.Material(young_modulus, density)
    omega = stability.element_frequency(gs.Simulation(mesh, plain).body)
    drag = 0.5 * omega if needs_drag(scheme) else 0.0
    material = gs.Material(young_modulus, density, damping=2.0 * damping_ratio / omega, viscosity=drag)
    return gs.Simulation(mesh, material, integrator=scheme, dtype=dtype, **options)


def held_at_low_x(mesh) -> np.ndarray:
    """Return a mask of the points at the lowest x, to be pinned."""
    return mesh.points[:, 0] == mesh.points[:, 0].min()


def drag_of(sim) -> float:
    """Return the drag gamma of a body that has the same everywhere [1/s]."""
    return float(sim.body.material.viscosity)


def near_bound(sim) -> float:
    """Return a step [s] just below the stable one; for an implicit scheme, 100 times what an explicit one could take."""
    return 10.0 * sim.default_step if np.isinf(sim.stable_step) else NEAR * sim.stable_step


def explicit_step(sim) -> float:
    """Return the default step [s]; for an implicit scheme, one that explicit schemes could take too."""
    return 0.05 * sim.default_step if np.isinf(sim.stable_step) else sim.default_step


def n_steps_for(sim, n_steps: int = N_STEPS) -> int:
    """Return how many steps a case takes with the scheme of a simulation."""
    return n_steps // 10 if is_implicit(sim.integrator.name) else n_steps


def throw(sim, speed: float, seed: int = 9) -> None:
    """Give the free nodes random velocities of about this speed [m/s]."""
    nodes = sim.body.nodes
    velocity = speed * np.random.default_rng(seed).standard_normal((sim.body.n_nodes, 3))
    nodes.velocity[:] = np.where(nodes.is_pinned[:, None], 0.0, velocity)


def gentle_speed(sim, strain: float = 1e-3) -> float:
    """Return a speed [m/s] that strains the slowest and smallest tetrahedra of a body by about so much."""
    shortest = float(sim.body.springs.rest_length.min())
    return strain * shortest * float(stability.element_frequencies(sim.body.mesh, sim.body.tetrahedra).min())


def peak_energy(sim, step: float, n_steps: int, n_records: int = 40) -> float:
    """Step, and return the largest energy [J] that is met at regular times from then on, NaN where one is not a number."""
    record = []
    for _ in range(n_records):
        n_between = max(n_steps // n_records, 1)
        sim.advance(n_between * step, step=step)
        record.append(total_energy(sim))
    return float(np.max(record))


def gentle_motion(sim, speed: float | None = None, n_steps: int = N_STEPS) -> Check:
    """Throw a body gently, step it near the bound, and hold its energy against what linear theory allows."""
    throw(sim, gentle_speed(sim) if speed is None else speed)
    step, n_steps, start = near_bound(sim), n_steps_for(sim, n_steps), total_energy(sim)
    frequency = ALLOWED_STIFFENING * modes(sim.body)
    damping_rate = float(sim.body.material.damping) * frequency**2 + drag_of(sim)
    limit = swing(sim.integrator.name, step, frequency, damping_rate, n_steps) * round_off(sim, n_steps, start)
    return Check("peak energy / start", peak_energy(sim, step, n_steps) / start, limit)


def swing_of_any_cut(sim, step: float) -> float:
    """Return the swing that is allowed whatever the body is cut into, from the element bound alone, without springs' damping."""
    frequency = np.linspace(0.0, stability.element_frequency(sim.body), 400)
    return swing(sim.integrator.name, step, frequency, drag_of(sim))


def cut_at_random(sim, rng, removed_share: float = 0.3) -> None:
    """Split a random share of the faces and remove up to some share of the tetrahedra."""
    pairs = sewn_pairs(sim.body)
    removed = rng.permutation(sim.body.mesh.n_tetrahedra)[: int(rng.uniform(0, removed_share) * sim.body.mesh.n_tetrahedra)]
    sim.cut(pairs[rng.uniform(size=len(pairs)) < rng.uniform()], removed)


def sewn_pairs(body) -> np.ndarray:
    """Return the two tetrahedra at every sewn face, (k, 2)."""
    beyond = body.gmap.image.ravel() // 6
    slots = np.arange(beyond.size)
    is_lower = slots < beyond
    return np.stack([slots[is_lower] // 4, beyond[is_lower] // 4], axis=1)
