"""The vector kernel and the quads: the same bits as their readable twins, on every instruction set."""

import hashlib
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from numba import config, njit

from gmapspring import Material, Simulation, meshes, spring_kernel
from gmapspring.addresses import address_row
from gmapspring.integrators import INTEGRATORS
from gmapspring.matter import BLOCK, GROUP, Matter, Nodes, aligned_zeros, empty_springs, no_matter
from gmapspring.quad import load, store
from gmapspring.spring_kernel import STRIDE

without_compiler = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="numba's compiler is switched off")
TARGETS = {"SSE2": "x86-64", "AVX2": "haswell", "AVX-512": "skylake-avx512"}


def network(n_nodes, n_springs, dtype, has_damping, seed=0):
    """Return nodes and springs without a map: random positions, velocities, ends and constants."""
    rng = np.random.default_rng(seed)
    state = aligned_zeros((n_nodes, 8), dtype)
    state[:, :3], state[:, 4:7] = rng.normal(size=(2, n_nodes, 3))
    nodes = Nodes(state, aligned_zeros((n_nodes, 4), dtype), np.zeros((0, 4), dtype), np.ones(n_nodes),
                  rng.uniform(0.5, 2.0, n_nodes).astype(dtype), np.zeros(0, dtype), np.zeros(n_nodes, bool),
                  np.zeros(n_nodes, np.int32))  # fmt: skip
    springs = empty_springs(n_springs, dtype, has_damping)
    first = rng.integers(0, n_nodes, n_springs)
    springs.endpoints[:n_springs] = np.stack([first, (first + rng.integers(1, n_nodes, n_springs)) % n_nodes], axis=1)
    springs.rest_length[:n_springs] = rng.uniform(0.5, 2.0, n_springs)
    springs.stiffness[:n_springs] = rng.uniform(0.5, 2.0, n_springs)
    springs.damping[:n_springs] = rng.uniform(0.0, 0.1, len(springs.damping[:n_springs]))
    return nodes, springs


@njit
def add_spring_forces(springs, n_springs, state, force):
    """Call what only kernels can call."""
    spring_kernel.add_spring_forces(springs, n_springs, state, force)


def trajectory_digest(dtype, scheme, has_damping):
    """Return a hash of the state after 200 steps of a network."""
    nodes, springs = network(40, 150, dtype, has_damping)
    work = aligned_zeros((40 * (INTEGRATORS[scheme].n_work + 1), 8), dtype)
    matter = Matter(nodes, springs, no_matter(dtype).tetrahedra, np.zeros(3), work, np.array([40, 150, 0, 0, 0]))
    taken = np.zeros(1, np.int64)
    INTEGRATORS[scheme].advance(address_row(matter)[None], taken.copy(), dtype(0), np.array([1e-2]), np.array([200]),
                                np.array([-1.0]), taken)  # fmt: skip
    assert taken[0] == 200
    assert np.isfinite(nodes.state).all() and np.abs(nodes.state).max() > 1.0
    return hashlib.sha256(nodes.state.tobytes()).hexdigest()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("has_damping", [False, True])
@pytest.mark.parametrize("n_springs", [1, GROUP - 1, GROUP, 3 * GROUP + 5, BLOCK + 7])
def test_the_vector_kernel_gives_the_bits_of_its_twin(dtype, has_damping, n_springs):
    nodes, springs = network(30, n_springs, dtype, has_damping)
    nodes.state[3] = nodes.state[5]
    springs.endpoints[0] = 3, 5  # of length zero
    expected, coefficient = np.zeros((30, 4), dtype), np.empty(n_springs, dtype)
    twins = [getattr(kernel, "py_func", kernel) for kernel in (spring_kernel.set_coefficients, spring_kernel.add_pulls)]
    for start in range(0, n_springs, BLOCK):
        stop = min(start + BLOCK, n_springs)
        twins[0](*springs[:4], nodes.state, start, stop, coefficient[start:])
        twins[1](springs.endpoints, coefficient[start:], nodes.state, start, stop, expected)
    add_spring_forces(springs, n_springs, nodes.state, nodes.force)
    assert coefficient[0] == 0.0 and (n_springs == 1 or coefficient[1:].all())
    assert nodes.force.tobytes() == expected.tobytes()


def share_that_wait(endpoints):
    """Return the part of springs that share a node with the one that is added to its nodes before them."""
    order = [s for start in range(0, len(endpoints), BLOCK) for first in range(start, start + STRIDE)
             for s in range(first, min(start + BLOCK, len(endpoints)), STRIDE)]  # fmt: skip
    before, after = endpoints[order[:-1]], endpoints[order[1:]]
    return np.mean((before[:, :, None] == after[:, None, :]).any(axis=(1, 2)))


@pytest.mark.parametrize("is_cut", [False, True])
def test_springs_seldom_wait_for_one_another_however_the_body_was_cut(is_cut):
    sim = Simulation(meshes.box((7, 7, 7)), Material(1e3, 1e3))
    if is_cut:
        rng = np.random.default_rng(4)
        for tetrahedron in rng.permutation(sim.body.mesh.n_tetrahedra)[:300]:
            sim.remove_tetrahedron(tetrahedron)
        for slot in rng.permutation(np.unique(sim.body.face_of))[:500]:
            if slot >= 0 and sim.body.gmap.image.item(slot) // 6 != slot:
                sim.split_face(slot // 4, sim.body.gmap.image.item(slot) // 24)
    endpoints = sim.body.springs.endpoints[: sim.body.n_springs]
    assert np.mean((endpoints[1:, :, None] == endpoints[:-1, None, :]).any(axis=(1, 2))) > 0.3
    assert share_that_wait(endpoints) < 0.05


@pytest.mark.parametrize("square", [0.0, np.nan])
def test_what_is_not_a_number_stays_where_it_is(square):
    nodes, springs = network(6, 40, np.float64, False)
    nodes.state[2, :3] = square
    add_spring_forces(springs, 40, nodes.state, nodes.force)
    touched = np.unique(springs.endpoints[:40][(springs.endpoints[:40] == 2).any(axis=1)])
    untouched = np.setdiff1d(np.arange(6), touched)
    assert np.isfinite(nodes.force[untouched]).all()
    if square == 0.0:
        assert np.isfinite(nodes.force).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_quads_are_rounded_lane_by_lane_like_numbers(dtype):
    def mix(array, other, factor):
        for i in range(len(array)):
            store(array, i, 4, load(array, i, 0) + factor * load(other, i, 0) - load(array, i, 4))

    array, other = np.random.default_rng(2).normal(size=(2, 50, 8)).astype(dtype)
    expected = array.copy()
    expected[:, 4:] = array[:, :4] + dtype(1.7) * other[:, :4] - array[:, 4:]
    twin = array.copy()
    mix(twin, other, dtype(1.7))
    njit(mix)(array, other, dtype(1.7))
    assert array.tobytes() == expected.tobytes() == twin.tobytes()


@without_compiler
@pytest.mark.parametrize(
    ("dtype", "scheme", "has_damping"),
    [("float64", "rk4", True), ("float32", "symplectic_euler", False),
     pytest.param("float64", "backward_euler", True, marks=pytest.mark.slow)],  # fmt: skip
)
def test_trajectories_have_the_same_bits_on_every_instruction_set(dtype, scheme, has_damping):
    program = ("import numpy as np; from tests.unit.test_spring_kernel import trajectory_digest; "
               f"print(trajectory_digest(np.{dtype}, {scheme!r}, {has_damping}))")
    found = {name: subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True,
        cwd=pathlib.Path(__file__).parents[2], env=os.environ | {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": FEATURES[name]},
    ).stdout.strip() for name, cpu in TARGETS.items() if runs_here(name)}  # fmt: skip
    assert "SSE2" in found and set(found.values()) == {trajectory_digest(getattr(np, dtype), scheme, has_damping)}


FEATURES = {"SSE2": "", "AVX2": "+avx2,+fma", "AVX-512": "+avx2,+fma,+avx512f,+avx512vl,+avx512dq,+avx512bw"}


def runs_here(target):
    """Tell whether this machine has the instructions of a target."""
    flags = pathlib.Path("/proc/cpuinfo").read_text() if pathlib.Path("/proc/cpuinfo").exists() else ""
    return all(feature.lstrip("+") in flags for feature in FEATURES[target].split(",") if feature)
