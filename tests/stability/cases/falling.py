"""Thousands of random cuts, sutures and removals while a free body falls."""

import numpy as np

import gmapspring as gs
from gmapspring import measure
from tests.stability.cases.bodies import build, drag_of, sewn_pairs
from tests.stability.cases.linear import is_implicit
from tests.stability.cases.verdict import Check, Verdict, all_finite

N_CUTS = 10_000
GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2]."""
REMOVED_SHARE = 0.003
"""Of all operations."""
N_LEAST = 12
"""Tetrahedra that are left in any case."""
MOST_OPEN = 0.3
"""The share of faces that are cut at most: more, and the pieces fly apart for good."""


def cuts_while_falling(scheme, dtype, n_cuts=1000):
    """Split, sew and now and then remove at random, a substep after each, while a free body falls."""
    sim = build(scheme, dtype, gs.meshes.box((2, 2, 2), 0.1), gravity=GRAVITY, damping_ratio=0.3)
    # Short steps, so that the fall stays short; an implicit one is dear and comes after every tenth cut.
    n_between = 10 if is_implicit(scheme) else 1
    step = 0.01 * n_between * build("symplectic_euler", dtype).stable_step
    cutter, ledger = RandomCutter(sim, seed=5), MomentumLedger(sim, step)
    for number in range(n_cuts):
        ledger.note_removal(cutter.cut())
        if number % n_between == 0:
            sim.advance(step)
            ledger.note_step()
    sim.check_validity()
    expected = "stays valid and finite; the momentum is what gravity gave, less drag and what was removed, to round-off"
    return Verdict(expected, (ledger.check(), all_finite(sim)))


def ten_thousand_cuts_while_falling(scheme, dtype):
    """The same, ten times as long."""
    return cuts_while_falling(scheme, dtype, N_CUTS)


class RandomCutter:
    """Draws operations that can be done to a body, and does them."""

    def __init__(self, sim, seed):
        self.sim, self.rng = sim, np.random.default_rng(seed)
        slots, beyond = np.arange(sim.body.gmap.image.size), sim.body.gmap.image.ravel() // 6
        self.slots = slots[slots < beyond]
        self.pairs = sewn_pairs(sim.body)

    def cut(self):
        """Do one operation; return the momentum [kg m/s] that it took away, (3,)."""
        body, rng = self.sim.body, self.rng
        alive = np.flatnonzero(body.is_alive)
        if rng.uniform() < REMOVED_SHARE and len(alive) > N_LEAST:
            tetrahedron = int(alive[rng.integers(len(alive))])
            velocity = body.nodes.velocity[body.vertex_of[tetrahedron]].astype(float)
            self.sim.remove_tetrahedron(tetrahedron)
            return 0.25 * body.tetrahedra.mass[tetrahedron] * velocity.sum(axis=0)
        is_sewn = body.gmap.image.ravel()[self.slots] // 6 != self.slots
        is_open = ~is_sewn & body.is_alive[self.pairs].all(axis=1)
        n_sewn, n_open = int(is_sewn.sum()), int(is_open.sum())
        if n_open and rng.uniform() * MOST_OPEN * (n_sewn + n_open) < n_open:
            self.sim.sew_face(*self.nearest(self.pairs[is_open]))
        else:
            self.sim.split_face(*self.pairs[is_sewn][rng.integers(n_sewn)].tolist())
        return np.zeros(3)

    def nearest(self, pairs):
        """Return the pair of tetrahedra whose middles are closest: sewing pulls both together at once."""
        body = self.sim.body
        middle = body.nodes.position[body.vertex_of[pairs]].mean(axis=2)
        return pairs[np.argmin(np.sum((middle[:, 0] - middle[:, 1]) ** 2, axis=1))].tolist()


class MomentumLedger:
    """Follows the momentum that a falling body should have, and how much round-off may have changed it."""

    def __init__(self, sim, step):
        self.sim, self.step = sim, step
        self.expected, self.granted = measure.momentum(sim.body), 0.0

    def note_removal(self, momentum):
        """Take away what a removed tetrahedron owned; a suture rounds the mean of two velocities."""
        self.expected = self.expected - momentum
        self.granted += self.grain()

    def note_step(self):
        """Add what gravity gives in a step, less drag at the old velocity, as schemes of first order take it."""
        mass = self.sim.body.nodes.mass.sum()
        push = mass * np.array(GRAVITY) - drag_of(self.sim) * self.expected
        self.expected = self.expected + self.step * push
        self.granted += self.grain() + self.grain_of_forces()

    def grain(self):
        """Return eps times the sum of the sizes of the nodes' momenta [kg m/s]."""
        nodes = self.sim.body.nodes
        speed = np.linalg.norm(nodes.velocity.astype(float), axis=1)
        return float(np.finfo(nodes.state.dtype).eps) * float(nodes.mass @ speed)

    def grain_of_forces(self):
        """Return eps times the sizes of all impulses that springs give in a step [kg m/s].

        What an implicit scheme solves for is known to the round-off of positions, eps |x|, times the matrix M + h^2 K over h.
        """
        body, eps = self.sim.body, float(np.finfo(self.sim.body.nodes.state.dtype).eps)
        stiffness = float(body.springs.stiffness.astype(float).sum())
        if is_implicit(self.sim.integrator.name):
            reach = float(np.abs(body.nodes.position).max())
            return eps * reach * (body.nodes.mass.sum() / self.step + 4.0 * self.step * stiffness)
        return eps * self.step * stiffness * float(body.springs.rest_length.max())

    def check(self):
        """Hold the momentum against what is expected."""
        error = np.linalg.norm(measure.momentum(self.sim.body) - self.expected)
        return Check("error of the momentum [kg m/s]", float(error), self.granted)


CASES = {"1,000 cuts while falling": cuts_while_falling}
LONG_CASES = {"10,000 cuts while falling": ten_thousand_cuts_while_falling}
