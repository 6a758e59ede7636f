"""The certificate of the stable step: random bodies, cut at random, whose frequencies and energies are held against the bound."""

import zlib

import numpy as np

import gmapspring as gs
from gmapspring import stability
from tests import zoo
from tests.stability.cases.bodies import cut_at_random, n_steps_for, near_bound, sewn_pairs, throw
from tests.stability.cases.linear import needs_drag, round_off, swing, total_energy
from tests.stability.cases.verdict import Check, Verdict

MESHES = ("two", "ring", "fan", "star", "box", "slab", "torus", "pinched_block")
DAMPING_RATIOS = (0.0, 0.0, 0.03, 0.3, 3.0)
N_STATES, N_STATES_LONG = 20, 500
"""Bodies for each scheme and precision."""
ENERGY = "peak energy / what linear theory allows"


def random_state(scheme, dtype, seed, mesh_name=None):
    """Return a body of uneven material, some nodes pinned, cut at random: not at all, in part, or to pieces.

    Stiffness spreads over two orders of magnitude and more, density over one. The damping is beta K + gamma M, beta from none to
    thrice critical for the fastest tetrahedron, gamma what the scheme needs.
    """
    rng = np.random.default_rng(seed)
    mesh = zoo.build(mesh_name or MESHES[seed % len(MESHES)])
    young_modulus = 5e3 * np.exp(rng.normal(0.0, 1.5, mesh.n_tetrahedra))
    density = 1e3 * np.exp(rng.normal(0.0, 0.7, mesh.n_tetrahedra))
    omega = stability.element_frequency(gs.Simulation(mesh, gs.Material(young_modulus, density)).body)
    damping = 2.0 * float(rng.choice(DAMPING_RATIOS)) / omega
    material = gs.Material(young_modulus, density, damping, 0.5 * omega if needs_drag(scheme) else 0.0)
    pinned = rng.uniform(size=mesh.n_points) < 0.2 * rng.uniform()
    sim = gs.Simulation(mesh, material, pinned=pinned, integrator=scheme, dtype=dtype)
    kind = rng.integers(4)
    if kind == 0:
        sim.cut(faces=sewn_pairs(sim.body))
    elif kind < 3:
        cut_at_random(sim, rng)
    return sim


def frequency_ratio(sim) -> float:
    """Return the highest frequency of a body as it is over the bound of its elements."""
    return stability.assembled_frequency(sim.body) / stability.element_frequency(sim.body)


def frequency_check(ratio, dtype) -> Check:
    """Hold a frequency ratio against 1, and round-off.

    In float32 a stiffness k / l0^2 holds the round-offs of k and twice that of l0, half an eps each: a frequency half of that.
    """
    return Check("highest frequency / bound", ratio, 1.0 + 1e-12 + 0.75 * float(np.finfo(dtype).eps))


def energy_check(sim, n_steps=60) -> Check:
    """Throw a body, step it at 0.99 of the bound; the swing allowed is that of all frequencies up to its highest."""
    throw(sim, 1e-4 * float(np.sqrt(5e3 / 1e3)))
    step, n_steps, start = near_bound(sim), n_steps_for(sim, n_steps), total_energy(sim)
    if start == 0.0:
        return Check(ENERGY, 0.0, 1.0)
    frequency = np.linspace(0.0, stability.assembled_frequency(sim.body) * (1.0 + float(np.finfo(sim.body.real.dtype).eps)), 60)
    material = sim.body.material
    limit = swing(sim.integrator.name, step, frequency, material.damping * frequency**2 + material.viscosity, 300)
    limit *= round_off(sim, n_steps, start)
    peak = 0.0
    for _ in range(n_steps):
        sim.advance(step, step=step)
        peak = np.maximum(peak, total_energy(sim))
    return Check(ENERGY, float(peak / start / limit), 1.0)


def certify(scheme, dtype, n_states=N_STATES):
    """Hold the frequencies and the energies of random bodies against the bound."""
    first_seed = zlib.crc32(f"{scheme} {np.dtype(dtype).name}".encode())
    ratios, joined_ratios, energies = [], [0.0], []
    for seed in range(first_seed, first_seed + n_states):
        sim = random_state(scheme, dtype, seed)
        ratios.append(frequency_ratio(sim))
        if is_fastest_joined(sim.body):
            joined_ratios.append(ratios[-1])
        energies.append(energy_check(sim).worst)
    checks = (
        frequency_check(float(np.max(ratios)), dtype),
        Check("the same, the fastest tetrahedron joined to others", float(np.max(joined_ratios)), 1.0),
        Check(ENERGY, float(np.max(energies)), 1.0),
    )
    return Verdict("no frequency is above the bound of single tetrahedra; at 0.99 of it no energy is above its swing", checks)


def is_fastest_joined(body) -> bool:
    """Tell whether the tetrahedron that gives the bound is sewn to another: cut free, it has that frequency exactly."""
    fastest = int(np.argmax(stability.element_frequencies(body.mesh, body.tetrahedra)))
    return bool(body.is_alive[fastest]) and fastest in sewn_pairs(body)


def certify_many(scheme, dtype):
    """The same for many more."""
    return certify(scheme, dtype, N_STATES_LONG)


CASES = {f"{N_STATES} random cut bodies each": certify}
LONG_CASES = {f"{N_STATES_LONG} random cut bodies each": certify_many}
