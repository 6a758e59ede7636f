"""A tolerance is kept on bodies and motions that no rule was made from, and what cannot be chosen is refused."""

import numpy as np
import pytest

import gmapspring as gs
from gmapspring import choice
from gmapspring.integrators import INTEGRATORS, Limits
from tests import zoo

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)
SOFT = {"young_modulus": 5e3, "density": 1e3}


def sagging_ball(**how):
    """Return a ball that hangs by its top, lightly damped."""
    mesh = gs.meshes.ball(2, 0.05)
    pinned = mesh.points[:, 2] > 0.035
    return gs.Simulation(mesh, gs.Material(**SOFT, viscosity=2.0), pinned=pinned, gravity=(0, 0, -9.81), **how)


def spinning_torus(**how):
    """Return a free ring of uneven stiffness that spins and is bent, without any damping."""
    mesh = zoo.build("torus")
    mesh = gs.Mesh(0.02 * mesh.points, mesh.tetrahedra)
    modulus = 5e3 * np.exp(np.random.default_rng(1).normal(0, 0.7, mesh.n_tetrahedra))
    sim = gs.Simulation(mesh, gs.Material(modulus, 1e3), **how)
    x, y, z = (sim.body.nodes.position - sim.body.nodes.position.mean(axis=0)).T.astype(float)
    sim.body.nodes.velocity[:] = np.stack([-20 * y, 20 * x, 300 * x * y], axis=1)
    return sim


def slit_slab(**how):
    """Return a damped slab, cut half through, that is pulled apart."""
    mesh = gs.meshes.box((6, 4, 2), 0.02)
    sim = gs.Simulation(mesh, gs.Material(**SOFT, damping=4e-3, viscosity=1.0), pinned=mesh.points[:, 0] < 0.01, **how)
    middle = mesh.points[mesh.tetrahedra].mean(axis=1)
    pairs = [(t, int(n)) for t in range(mesh.n_tetrahedra) for n in sim.body.gmap.image[t] // 24
             if middle[t, 1] < 0.04 <= middle[n, 1] and middle[t, 0] > 0.06]  # fmt: skip
    sim.cut(faces=pairs)
    sim.set_loads(np.where(mesh.points[:, :1] > 0.11, 1e-2 * np.sign(mesh.points[:, 1:2] - 0.04) * [0.0, 1.0, 0.3], 0.0))
    return sim


def reinforced_beam(**how):
    """Return a damped beam with a core 20000 times stiffer than the rest, let go under its weight."""
    mesh = gs.meshes.box((6, 2, 2), 0.02)
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    is_core = (np.abs(centre[:, 1:] - 0.01) < 0.01).all(axis=1) & (centre[:, 0] < 0.04)
    modulus = np.where(is_core, 1e8, 5e3)
    damping = 4e-3 * np.sqrt(5e3 / modulus)
    return gs.Simulation(mesh, gs.Material(modulus, 1e3, damping=damping), pinned=mesh.points[:, 0] < 0.01,
                         gravity=(0, 0, -9.81), **how)  # fmt: skip


def plucked_slab(**how):
    """Return a lightly damped slab that is let go at 1.1 times its length: waves run through it."""
    mesh = gs.meshes.box((5, 3, 1), 0.02)
    sim = gs.Simulation(mesh, gs.Material(**SOFT, viscosity=5.0), pinned=mesh.points[:, 0] < 0.01, **how)
    sim.body.nodes.position[:, 0] *= 1.1
    return sim


SCENES = {"sagging ball": (sagging_ball, 0.3), "spinning torus": (spinning_torus, 0.1), "slit slab": (slit_slab, 0.3),
          "reinforced beam": (reinforced_beam, 0.2), "plucked slab": (plucked_slab, 0.1)}  # fmt: skip


def end_of(name, share=1.0, **how):
    """Return positions [m] and strains at the end of a scene's motion, float64."""
    make, seconds = SCENES[name]
    sim = make(**how)
    sim.advance(seconds, step=share * sim.default_step)
    return sim.body.nodes.position.astype(float), gs.measure.edge_strains(sim.body)


@pytest.fixture(scope="module", params=SCENES)
def scene(request):
    """Return a scene's name and how it ends exactly."""
    exact, coarser = (end_of(request.param, share, integrator="rk4") for share in (1 / 40, 1 / 20))
    assert all(np.abs(a - b).max() < 1e-6 for a, b in zip(exact, coarser, strict=True))
    return request.param, exact


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_the_tolerance_is_kept_on_scenes_that_the_rules_were_not_made_from(scene, tolerance):
    name, (positions, strains) = scene
    found, found_strains = end_of(name, tolerance=tolerance)
    size = np.ptp(SCENES[name][0]().body.mesh.points, axis=0).max()
    error = np.sqrt(np.mean(np.sum((found - positions) ** 2, axis=1))) / size
    assert error <= tolerance
    assert np.abs(found_strains - strains).max() <= tolerance


def chosen(tolerance, omega=100.0, rate=0.0):
    """Return what is chosen for elements of one kind."""
    return choice.choose(Limits(np.full(3, omega), np.full(3, rate)), tolerance)


def test_a_simulation_takes_what_is_chosen_and_says_so():
    sim = sagging_ball(tolerance=1e-2)
    expected = choice.choose(gs.stability.element_limits(sim.body.mesh, sim.body.tetrahedra), 1e-2)
    assert (sim.integrator.name, type(sim.body.real), sim.default_step) == expected
    assert sim.advance(10 * sim.default_step) == 10


def test_finer_tolerances_never_allow_longer_steps_and_every_step_is_stable():
    for rate in (0.0, 10.0, 1e3):
        choices = [chosen(tolerance, rate=rate) for tolerance in np.geomspace(0.5, 1e-8, 60)]
        for finer, coarser in zip(choices[1:], choices, strict=False):
            assert finer.integrator != coarser.integrator or finer.step <= coarser.step
        for each in choices:
            assert 0 < each.step <= INTEGRATORS[each.integrator].stable_step(Limits(100.0, rate))
    assert chosen(1e-8).step == pytest.approx(chosen(1e-4).step / 10)
    assert chosen(1e-8).dtype is np.float64


def test_where_nothing_acts_any_step_will_do():
    assert chosen(1e-3, omega=0.0).step == np.inf
    sim = gs.Simulation(zoo.build("two"), gs.Material(young_modulus=0.0, density=1.0), tolerance=1e-3)
    sim.body.nodes.velocity[:] = 1.0
    assert sim.advance(2.0) == 1
    np.testing.assert_allclose(sim.body.nodes.position, sim.body.mesh.points[sim.body.nodes.point] + 2.0, rtol=1e-6)


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, 1.0, 1e-12, np.nan])
def test_a_tolerance_that_cannot_be_is_refused(tolerance):
    with pytest.raises(ValueError, match="tolerance"):
        sagging_ball(tolerance=tolerance)


@pytest.mark.parametrize("how", [{"integrator": "rk4"}, {"dtype": np.float32}])
def test_a_tolerance_beside_a_scheme_or_a_precision_is_refused(how):
    with pytest.raises(ValueError, match="leave"):
        sagging_ball(tolerance=1e-3, **how)


def test_a_saved_simulation_goes_on_with_what_was_chosen(tmp_path):
    sim = slit_slab(tolerance=1e-1)
    sim.advance(0.01)
    sim.save(tmp_path / "state.npz")
    again = gs.Simulation.load(tmp_path / "state.npz")
    assert (again.tolerance, again.default_step, again.integrator) == (sim.tolerance, sim.default_step, sim.integrator)
    sim.advance(0.01)
    again.advance(0.01)
    assert sim.body.nodes.state.tobytes() == again.body.nodes.state.tobytes()
