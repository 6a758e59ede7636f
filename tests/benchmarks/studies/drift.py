"""What becomes of energy and momentum, which nothing should change, over a million steps without damping."""

import math
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from gmapspring import Material, Simulation, measure, meshes
from gmapspring.body import Body
from gmapspring.integrators import INTEGRATORS
from tests.benchmarks.studies.statics import spring_stiffness
from tests.benchmarks.study import Plan, Study, Table

MESH = meshes.box((3, 3, 2), spacing=1.0 / 3.0)
MATERIAL = Material(young_modulus=1.0, density=1.0)
SPIN, SHAKE = (0.1, 0.2, 0.3), 0.1
"""Angular velocity [rad/s], and the spread of random velocities [m/s] where waves run at about 1 m/s."""
THROW = (1e-4, 0.0, 0.0)
"""Velocity of the whole [m/s]: slow, so that coordinates stay small and single precision has digits left for strains."""
SHARES = (1.0, 0.5, 0.25)
"""Steps, over the scheme's default one."""
N_STEPS = {False: 1_000_000, True: 10_000}
"""By whether the study is quick."""
N_DEAR = {False: 10_000, True: 200}
"""Steps of schemes without a limit of stability: they solve equations in each."""
N_EARLY = 64
"""Steps at the default share over which errors of different steps are compared: in the same time, before energy is used up."""
N_RECORDS = 200
"""Looks at a body, evenly spaced in the logarithm of the number of steps."""
EXPECTED = {
    "rk4": "lost, by h⁵ in a given time, fast vibrations first",
    "symplectic_euler": "bounded, by h",
    "velocity_verlet": "bounded, by h²",
    "backward_euler": "lost, by h in a given time",
}
"""What theory says of the energy error."""
SMALL_SHARE = 0.1
"""An energy error that still tells the order of a scheme: one that has lost more has little left to lose."""
ROUND_OFF = 1e-9
"""An error below this comes of round-off alone."""
DTYPES = (np.float64, np.float32)


class Curve(NamedTuple):
    """The history of one run; all arrays are over records."""

    scheme: str
    dtype: type
    share: float
    """Step over the scheme's default."""
    step: float
    """[s]."""
    n_steps: np.ndarray
    """Steps taken."""
    energy: np.ndarray
    """Energy over that at the start, less 1."""
    momentum: np.ndarray
    """Change of momentum over the sum of m |v| at the start."""
    angular: np.ndarray
    """Change of angular momentum, over that at the start."""

    @property
    def label(self) -> dict[str, str | float]:
        """What a row of a table begins with."""
        return {"scheme": self.scheme, "precision": np.dtype(self.dtype).name, "share of default step": self.share}

    @property
    def largest(self) -> np.ndarray:
        """Return the largest energy error so far."""
        return np.maximum.accumulate(np.abs(self.energy))

    @property
    def late_mean(self) -> float:
        """Return the mean energy error over the last tenfold of steps: what is left when vibrations are averaged out."""
        return float(np.mean(self.energy[10 * self.n_steps >= self.n_steps[-1]]))

    def largest_until(self, n_steps: float) -> float:
        """Return the largest energy error within so many steps; NaN if fewer were taken."""
        within = self.largest[self.n_steps <= n_steps]
        return float(within[-1]) if n_steps <= self.n_steps[-1] else math.nan


def run(plan: Plan) -> Study:
    """Run every scheme that an undamped body can be stepped by."""
    curves, left_out = [], []
    for scheme in INTEGRATORS:
        if default_step(scheme) == 0.0:
            left_out.append(scheme)
            continue
        for dtype in DTYPES:
            for share in SHARES:
                plan.say(f"{scheme}, {np.dtype(dtype).name}, {share} of its default step")
                curves.append(record(scheme, dtype, share, n_steps_of(scheme, plan.is_quick)))
    return Study(
        "Drift over a million steps",
        "\n\n".join((method_text(plan.is_quick, left_out), energy_text(curves), momentum_text(curves))),
        tables=(
            Table("Largest relative error of the energy up to a number of steps, and its mean over the last tenfold of steps.",
                  energy_rows(curves)),
            Table(f"How the energy error of the first {N_EARLY} default steps shrinks with the step, in double precision: "
                  "its order in h, from the two shortest steps, unless too much is lost.", order_rows(curves)),
            Table("Momentum: its error at the end, over the sum of m |v|, and the exponent p in error ~ stepsᵖ (round-off: 0.5 "
                  "at random, 1 if it has a sign); angular momentum: the relative error at the end.", momentum_rows(curves)),
        ),
        figures={"curves": draw(curves)},
        hidden={"curves": curve_rows(curves)},
    )  # fmt: skip


def n_steps_of(scheme: str, is_quick: bool) -> int:
    """Return how many steps to take."""
    return (N_STEPS if math.isfinite(Simulation(MESH, MATERIAL, integrator=scheme).stable_step) else N_DEAR)[is_quick]


def default_step(scheme: str) -> float:
    """Return the step that a scheme takes by default [s], that of rk4 where it has no limit; 0 if none is stable."""
    simulation = Simulation(MESH, MATERIAL, integrator=scheme)
    return simulation.default_step if math.isfinite(simulation.stable_step) else default_step("rk4")


def thrown(scheme: str, dtype: type) -> Simulation:
    """Return a free body that flies, spins and vibrates; its momentum is the throw's alone."""
    simulation = Simulation(MESH, MATERIAL, integrator=scheme, dtype=dtype)
    nodes = simulation.body.nodes
    position, mass = MESH.points[nodes.point], nodes.mass[:, None]
    centre = np.sum(mass * position, axis=0) / np.sum(mass)
    velocity = np.cross(SPIN, position - centre) + SHAKE * np.random.default_rng(0).standard_normal(position.shape)
    nodes.velocity[:] = velocity - np.sum(mass * velocity, axis=0) / np.sum(mass) + THROW
    return simulation


def record(scheme: str, dtype: type, share: float, n_steps: int) -> Curve:
    """Run a scheme and look at what should be conserved."""
    simulation, step = thrown(scheme, dtype), share * default_step(scheme)
    # The end of the early time is always looked at.
    looks = np.unique(np.append(np.geomspace(1, n_steps, N_RECORDS).round(), N_EARLY / share)).astype(np.int64)
    body = simulation.body
    energy, momentum, angular = conserved(body)
    throw = np.sum(body.nodes.mass * np.linalg.norm(body.nodes.velocity, axis=1))
    history = []
    for n_more in np.diff(looks, prepend=0):
        simulation.advance(n_more * step, step=step)
        now = conserved(body)
        history.append((
            now[0] / energy - 1.0, np.linalg.norm(now[1] - momentum) / throw,
            np.linalg.norm(now[2] - angular) / np.linalg.norm(angular),
        ))  # fmt: skip
    return Curve(scheme, dtype, share, step, looks, *np.array(history).T)


def conserved(body: Body) -> tuple[float, np.ndarray, np.ndarray]:
    """Return energy [J], momentum [kg m/s] and angular momentum [kg m^2/s]."""
    energy = measure.kinetic_energy(body) + measure.elastic_energy(body)
    return energy, measure.momentum(body), measure.angular_momentum(body)


def rk4_loss(step: float, n_steps: int) -> float:
    """Return the share of the energy that RK4 loses at first, by linear theory of the modes at rest.

    A mode of frequency w is multiplied by R(i y), y = h w, in each step; |R|^2 = 1 - y^6 / 72 + y^8 / 576.
    """
    body = thrown("rk4", np.float64).body
    of_point = np.argsort(body.nodes.point)
    root = np.repeat(np.sqrt(body.nodes.mass[of_point]), 3)
    squares, modes = np.linalg.eigh(spring_stiffness(body).toarray() / root[:, None] / root)
    energy = (modes.T @ (root * body.nodes.velocity[of_point].ravel())) ** 2
    y = step * np.sqrt(np.maximum(squares, 0.0))
    kept = (1.0 - y**6 / 72.0 + y**8 / 576.0) ** n_steps
    return float(np.sum(energy * (1.0 - kept)) / np.sum(energy))


# Tables -------------------------------------------------------------------------------------------------------------------


def energy_rows(curves: list[Curve]) -> list[dict]:
    """Return energy errors."""
    decades = [10**power for power in range(2, 7, 2)]
    return [
        curve.label | {f"{n} steps": curve.largest_until(n) for n in decades}
        | {"mean at the end": curve.late_mean, "expected": EXPECTED.get(curve.scheme, "")}
        for curve in curves
    ]  # fmt: skip


def order_rows(curves: list[Curve]) -> list[dict]:
    """Return early errors by step, their order, and what linear theory says of RK4's."""
    rows = []
    for scheme in dict.fromkeys(curve.scheme for curve in curves):
        chosen = {curve.share: curve for curve in curves if curve.scheme == scheme and curve.dtype is np.float64}
        errors = {share: curve.largest_until(N_EARLY / share) for share, curve in chosen.items()}
        row = {"scheme": scheme} | {f"share {share:g}": error for share, error in errors.items()}
        longer, shorter = SHARES[-2:]
        is_small = errors[longer] < SMALL_SHARE
        row["order"] = math.log(errors[longer] / errors[shorter]) / math.log(longer / shorter) if is_small else math.nan
        for share in SHARES[1:]:
            theory = rk4_loss(chosen[share].step, round(N_EARLY / share)) if scheme == "rk4" else math.nan
            row[f"theory, share {share:g}"] = theory
        rows.append(row)
    return rows


def momentum_rows(curves: list[Curve]) -> list[dict]:
    """Return errors of momentum and angular momentum."""
    return [
        curve.label | {"momentum": float(curve.momentum[-1]), "exponent": growth(curve)}
        | {"angular momentum": float(curve.angular[-1])}
        for curve in curves
    ]  # fmt: skip


def growth(curve: Curve) -> float:
    """Return the exponent with which the momentum error grows, fitted over the last two thirds of the decades."""
    late = (curve.n_steps >= curve.n_steps[-1] ** (1.0 / 3.0)) & (curve.momentum > 0.0)
    return float(np.polyfit(np.log(curve.n_steps[late]), np.log(curve.momentum[late]), 1)[0])


def curve_rows(curves: list[Curve]) -> list[dict]:
    """Return all records."""
    return [
        curve.label | {"steps": int(n), "energy": float(energy), "momentum": float(momentum), "angular momentum": float(angular)}
        for curve in curves
        for n, energy, momentum, angular in zip(curve.n_steps, curve.energy, curve.momentum, curve.angular, strict=True)
    ]


# Text ---------------------------------------------------------------------------------------------------------------------


def method_text(is_quick: bool, left_out: list[str]) -> str:
    """Say what is run."""
    text = (
        f"A free body of {MESH.n_tetrahedra} tetrahedra flies, spins and vibrates without damping, load or contact, for "
        f"{N_STEPS[is_quick]:,} steps of each scheme, at its default step and at parts of it. Schemes without a limit of "
        f"stability take RK4's steps, {N_DEAR[is_quick]:,} of them."
    )
    names = " and ".join(left_out)
    return text + (f" Left out, since no step of it is stable without damping: {names}." if left_out else "")


def energy_text(curves: list[Curve]) -> str:
    """Say what becomes of the energy."""
    orders = {row["scheme"]: row["order"] for row in order_rows(curves)}
    parts = []
    for scheme, order in orders.items():
        chosen = [curve for curve in curves if curve.scheme == scheme]
        double, single = (next(c for c in chosen if c.dtype is dtype and c.share == SHARES[-1]) for dtype in DTYPES)
        factor = double.largest[-1] / double.largest_until(N_EARLY / double.share)
        early = f"early error of order {order:.1f}" if math.isfinite(order) else "early error too large to show an order"
        parts.append(
            f"{scheme}: {early}; at {SHARES[-1]:g} of the default step it is at most "
            f"{double.largest[-1]:.1e} in the whole run, {factor:.3g} times that of the first {round(N_EARLY / double.share)} "
            f"steps, with a mean at the end of {double.late_mean:+.1e} in double and {single.late_mean:+.1e} in single precision"
        )
    return f"**Energy.** {'; '.join(parts)}."


def momentum_text(curves: list[Curve]) -> str:
    """Say what becomes of the momentum."""
    parts = []
    for dtype in DTYPES:
        chosen = [curve for curve in curves if curve.dtype is dtype]
        worst = max(float(curve.momentum.max()) for curve in chosen)
        exponent = np.median([growth(curve) for curve in chosen])
        name, epsilon = np.dtype(dtype).name, np.finfo(dtype).eps
        parts.append(
            f"in {name} its error stays below {worst:.1e} of the sum of m |v|, that is {worst / epsilon:.2g} times the precision "
            f"of a number, and grows like steps to the power of {exponent:.2f} (median over the runs)"
        )
    doubles = [curve for curve in curves if curve.dtype is np.float64]
    kept = [name for name in dict.fromkeys(c.scheme for c in doubles)
            if max(c.angular.max() for c in doubles if c.scheme == name) < ROUND_OFF]  # fmt: skip
    return (
        f"**Momentum** is kept up to round-off: {'; '.join(parts)}. Angular momentum is kept to {ROUND_OFF:.0e} in double "
        f"precision by: {', '.join(kept) or 'none'}."
    )


def draw(curves: list[Curve]) -> Figure:
    """Return a picture of energy and momentum errors over the number of steps."""
    figure, (energy, momentum) = plt.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    schemes = list(dict.fromkeys(curve.scheme for curve in curves))
    for curve in curves:
        if curve.share != SHARES[1]:
            continue
        style = {"color": f"C{schemes.index(curve.scheme)}", "linestyle": "-" if curve.dtype is np.float64 else "--"}
        label = f"{curve.scheme}, {np.dtype(curve.dtype).name}"
        energy.loglog(curve.n_steps, curve.largest, label=label, **style)
        momentum.loglog(curve.n_steps, curve.momentum, **style)
    energy.set(xlabel="steps", ylabel="largest relative energy error so far", title=f"Energy, {SHARES[1]:g} of the default step")
    momentum.set(xlabel="steps", ylabel="momentum error over the sum of m |v|", title="Momentum")
    energy.legend(fontsize=7)
    for axes in (energy, momentum):
        axes.grid(True, which="major", alpha=0.3)
    return figure
