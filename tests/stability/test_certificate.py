"""The certificate of the stable step, on bodies that Hypothesis chooses."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gmapspring import stability
from gmapspring.integrators import INTEGRATORS
from tests.stability.cases.certificate import MESHES, energy_check, frequency_check, frequency_ratio, random_state
from tests.stability.cases.linear import mode_matrices, modes, needs_drag, swing

SEEDS = st.integers(0, 2**32 - 1)
DTYPES = st.sampled_from([np.float64, np.float32])


@settings(max_examples=60)
@given(mesh_name=st.sampled_from(MESHES), seed=SEEDS, scheme=st.sampled_from(sorted(INTEGRATORS)), dtype=DTYPES)
def test_no_cut_body_has_a_frequency_above_the_bound_or_an_energy_above_its_swing(mesh_name, seed, scheme, dtype):
    sim = random_state(scheme, dtype, seed, mesh_name)
    assert frequency_check(frequency_ratio(sim), dtype).passed
    check = energy_check(sim)
    assert check.passed, check


@settings(max_examples=60)
@given(mesh_name=st.sampled_from(MESHES), seed=SEEDS)
def test_the_true_modes_are_below_the_assembled_frequency(mesh_name, seed):
    body = random_state("rk4", np.float64, seed, mesh_name).body
    if not body.nodes.is_pinned.all():
        assert modes(body).max() <= stability.assembled_frequency(body) * (1 + 1e-12)


def test_the_swing_of_undamped_schemes_has_closed_forms():
    for a in (0.1, 0.5, 0.9):  # h omega / 2
        turn = np.linspace(0.0, 2 * a, 200)
        assert np.isclose(swing("symplectic_euler", 1.0, turn), (1 + a) / (1 - a), rtol=1e-2)
        assert np.isclose(swing("velocity_verlet", 1.0, turn), 1 / (1 - a**2), rtol=1e-2)
        assert np.isclose(swing("rk4", 1.0, turn), 1.0, rtol=1e-12)
        assert np.isclose(swing("backward_euler", 1.0, turn), 1.0, rtol=1e-12)


def test_a_scheme_needs_drag_exactly_where_it_makes_undamped_motion_grow_at_any_step():
    for scheme in INTEGRATORS:
        growth = np.abs(np.linalg.eigvals(mode_matrices(scheme, 1e-2, [1.0], 0.0))).max()
        assert needs_drag(scheme) == (growth > 1.0 + 1e-5)
