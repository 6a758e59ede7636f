"""Which step to take where only a tolerance is given and the elements of a body are known: rules, fitted to runs, and judged.

A rule is a scheme, a precision and a unit of time that is known before a body moves; for each tolerance it takes a multiple of
the unit, the largest at which no body misses the tolerance, with a margin. It is judged by what it costs beside the best that was
measured, and by how it does on a body that it was not fitted to.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from gmapspring.choice import DAMPED
from gmapspring.integrators import INTEGRATORS, Limits
from tests.benchmarks.studies.precision_rows import LUCK, Row, fastest, is_explicit
from tests.benchmarks.studies.precision_scenes import Facts

MARGIN = 0.5
"""A rule aims at this part of the tolerance."""
WORTH_IT = 0.8
"""Two rules take the place of one where they cost less than this part of it."""
GAP = 2.0
"""Bodies are parted only between spreads that are so many times apart."""
EXACT = 1.0 - 1e-9
"""Steps that are equal up to round-off are equal."""


class Curve(NamedTuple):
    """The runs of one scheme in one precision on one body, longest step first."""

    facts: Facts
    scheme: str
    steps: np.ndarray
    """[s]."""
    errors: np.ndarray
    cpu: np.ndarray
    """CPU time per simulated second."""
    own_step: float
    """What shares of steps refer to [s]."""

    def taken(self, step: float) -> float:
        """Return the step [s] that is taken where one is asked for: none longer than what was tried, up to half of the motion.

        Nor one above the default step of an explicit scheme, beyond which violent motion may gain energy.
        """
        limit = self.own_step * default_share(self.scheme) if is_explicit(self.scheme) else math.inf
        return min(step, limit, float(self.steps[0]))

    def error_at(self, step: float) -> float:
        """Return the error with a step [s]: the larger one of the two runs with the steps next to it."""
        nearest = self._next_longer(step)
        return float(np.max(self.errors[nearest: nearest + 2]))

    def cpu_at(self, step: float) -> float:
        """Return the cost with a step [s]: between runs on a line in logarithms, below all of them as one over the step."""
        step = self.taken(step)
        known = max(step, self.steps[-1])
        logarithm = np.interp(math.log(known), np.log(self.steps[::-1]), np.log(self.cpu[::-1]))
        return float(np.exp(logarithm) * known / step)

    def longest_within(self, limit: float) -> float:
        """Return the longest step [s] with an error within a limit: infinite if any step will do, 0 if none."""
        if self.error_at(math.inf) <= limit:
            return math.inf
        return max((step for step in self.steps if step == self.taken(step) and self.error_at(step) <= limit), default=0.0)

    def _next_longer(self, step: float) -> int:
        """Return the run with the shortest step that is no shorter than this one [s]."""
        return int(np.flatnonzero(self.steps >= self.taken(step) * EXACT)[-1])


class Unit(NamedTuple):
    """A time that is known before a body moves."""

    name: str
    of: Callable[[Curve], float]
    """[s]."""


UNITS = (
    Unit("own step", lambda curve: curve.own_step),
    Unit("1 / median frequency", lambda curve: 1.0 / curve.facts.median_frequency),
    Unit("n^(1/3) / median frequency", lambda curve: curve.facts.tetrahedra ** (1.0 / 3.0) / curve.facts.median_frequency),
)
"""The step that is stable (or the default one), the time of an element, and about how long a wave needs through the body."""


class Rule(NamedTuple):
    """How to choose a step."""

    scheme: str
    precision: str
    unit: Unit


class Verdict(NamedTuple):
    """How a rule does at a tolerance, over some bodies."""

    tolerance: float
    rule: Rule
    multiple: float
    """Step over the unit."""
    worst_error: float
    """Over the tolerance, of all bodies."""
    left_out_error: float
    """The same of each body by the multiple that the others alone would give."""
    costs: tuple[float, ...]
    """CPU time over the least that was measured within the tolerance, for each body."""

    @property
    def mean_cost(self) -> float:
        """Return the geometric mean of the costs."""
        return float(np.exp(np.mean(np.log(self.costs))))


def curve_of(facts: Facts, rows: Sequence[Row], rule: Rule) -> Curve | None:
    """Return the runs of a rule's scheme on a body; None where there are none."""
    chosen = [row for row in rows if (row.scene, row.scheme, row.precision) == (facts.scene, rule.scheme, rule.precision)]
    chosen = [row for row in chosen if not math.isnan(row.step)]
    if not chosen:
        return None
    steps, errors, cpu = (np.array([getattr(row, name) for row in chosen]) for name in ("step", "error", "cpu"))
    # A run that diverged has no error: it is beyond every tolerance. One that was good by chance is as bad as those with shorter
    # steps, but for round-off.
    errors = np.nan_to_num(errors, nan=math.inf)
    errors = np.maximum(errors, np.maximum.accumulate(errors[::-1])[::-1] / LUCK)
    return Curve(facts, rule.scheme, steps, errors, cpu, chosen[0].step / chosen[0].share)


def default_share(scheme: str) -> float:
    """Return the default step of an explicit scheme over its stable one."""
    element = Limits(frequency=1.0, damping_rate=1.0, drag=1.0)
    return INTEGRATORS[scheme].default_step(element) / INTEGRATORS[scheme].stable_step(element)


def rules() -> list[Rule]:
    """Return all rules that are tried."""
    return [Rule(scheme, precision, unit) for scheme in INTEGRATORS for precision in ("float64", "float32") for unit in UNITS]


def judge(rule: Rule, facts: Sequence[Facts], rows: Sequence[Row], tolerance: float) -> Verdict | None:
    """Fit a rule to all bodies and to all but one; None where it has no runs on one of them, or no step keeps the tolerance."""
    found = [curve_of(body, rows, rule) for body in facts]
    curves = [curve for curve in found if curve]
    if len(curves) < len(facts):
        return None
    units = np.array([rule.unit.of(curve) for curve in curves])
    allowed = np.array([curve.longest_within(MARGIN * tolerance) for curve in curves]) / units
    # Where a body bears every step that it may take, the others decide; where all do, the multiple by which all reach it.
    largest = max(curve.taken(math.inf) / unit for curve, unit in zip(curves, units, strict=True))
    multiple = min(float(allowed.min()), largest)
    errors = [curve.error_at(multiple * unit) / tolerance for curve, unit in zip(curves, units, strict=True)]
    if not max(errors) <= MARGIN:
        return None
    others = [min(np.delete(allowed, i).min(initial=math.inf), largest) for i in range(len(curves))]
    left_out = [curve.error_at(m * unit) / tolerance for curve, m, unit in zip(curves, others, units, strict=True)]
    costs = [
        curve.cpu_at(multiple * unit) / least_cost(curve.facts, rows, tolerance)
        for curve, unit in zip(curves, units, strict=True)
    ]
    return Verdict(tolerance, rule, multiple, max(errors), max(left_out), tuple(costs))


def least_cost(facts: Facts, rows: Sequence[Row], tolerance: float) -> float:
    """Return the least CPU time of any run on a body within a tolerance; NaN if there is none."""
    best = fastest((row for row in rows if row.scene == facts.scene), tolerance)
    return best.cpu if best else math.nan


def best_of(verdicts: Sequence[Verdict | None]) -> Verdict | None:
    """Return the rule that costs least, if possible of those that keep the tolerance on bodies they were not fitted to."""
    judged = [verdict for verdict in verdicts if verdict]
    kept = [verdict for verdict in judged if verdict.left_out_error <= 1.0]
    return min(kept or judged, key=lambda verdict: verdict.mean_cost, default=None)


# Bodies that want different rules -----------------------------------------------------------------------------------------


class Proposal(NamedTuple):
    """What to do at a tolerance with bodies of a sort."""

    sort: str
    """By what is known of them."""
    verdict: Verdict


def spread_of(facts: Facts) -> float:
    """Return by how much the highest frequency is above the median one."""
    return facts.frequency / facts.median_frequency


def propose(facts: Sequence[Facts], rows: Sequence[Row], tolerance: float) -> list[Proposal]:
    """Return rules for light and for damped bodies, of each sort two, for even and uneven ones, where that is worth it."""
    proposals = []
    for sort, bodies in by_damping(facts).items():
        single = [Proposal(sort, verdict) for verdict in [best_rule(bodies, rows, tolerance)] if verdict]
        split = best_split(sort, bodies, rows, tolerance)
        proposals += split if split and (not single or mean_cost(split) < WORTH_IT * mean_cost(single)) else single
    return proposals


def by_damping(facts: Sequence[Facts]) -> dict[str, list[Facts]]:
    """Part bodies into light and damped ones, by names that say so."""
    parts: dict[str, list[Facts]] = {f"damping ratio below {DAMPED:g}": [], f"damping ratio from {DAMPED:g}": []}
    light, damped = parts.values()
    for body in facts:
        (light if body.damping_ratio < DAMPED else damped).append(body)
    return {sort: bodies for sort, bodies in parts.items() if bodies}


def best_rule(facts: Sequence[Facts], rows: Sequence[Row], tolerance: float) -> Verdict | None:
    """Return the best rule for all of some bodies."""
    return best_of([judge(rule, facts, rows, tolerance) for rule in rules()])


def best_split(sort: str, facts: Sequence[Facts], rows: Sequence[Row], tolerance: float) -> list[Proposal]:
    """Return the best two rules for bodies parted by spread, each fitted to two bodies at least; nothing where there are none."""
    spreads = sorted({spread_of(body) for body in facts})
    splits = []
    for below, above in zip(spreads, spreads[1:], strict=False):
        if above < GAP * below:
            continue
        limit = math.sqrt(below * above)
        parts = [[body for body in facts if (spread_of(body) > limit) == is_uneven] for is_uneven in (False, True)]
        verdicts = [best_rule(part, rows, tolerance) for part in parts if len(part) >= 2]
        names = (f"{sort}, spread up to {limit:.3g}", f"{sort}, spread above {limit:.3g}")
        pair = [Proposal(name, verdict) for name, verdict in zip(names, verdicts, strict=False) if verdict]
        splits += [pair] if len(pair) == 2 else []
    return min(splits, key=mean_cost, default=[])


def mean_cost(proposals: Sequence[Proposal]) -> float:
    """Return the geometric mean of the costs of all bodies."""
    return float(np.exp(np.mean([math.log(cost) for proposal in proposals for cost in proposal.verdict.costs])))
