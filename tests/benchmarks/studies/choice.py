"""Which scheme, precision and step to choose for a tolerance: the fastest runs that were measured, and rules made from them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gmapspring.choice import DAMPED, rule_for
from tests.benchmarks.studies import work_precision
from tests.benchmarks.studies.precision_rows import Row, fastest, read_rows, unique
from tests.benchmarks.studies.precision_rules import (
    MARGIN,
    UNITS,
    Proposal,
    Rule,
    Verdict,
    best_of,
    by_damping,
    curve_of,
    default_share,
    judge,
    least_cost,
    mean_cost,
    propose,
    rules,
    spread_of,
)
from tests.benchmarks.studies.precision_scenes import Facts
from tests.benchmarks.study import Plan, Study, Table

TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)
"""On the larger one of the errors of position and strain."""


def run(plan: Plan) -> Study:
    """Look for the fastest runs and for the best rules among the rows of work-precision."""
    facts, rows = measured(plan)
    proposals = {tolerance: propose(facts, rows, tolerance) for tolerance in TOLERANCES}
    candidates = candidate_rows(facts, rows)
    return Study(
        "Which scheme and step to choose",
        "\n\n".join((method_text(facts), outcome_text(proposals))),
        tables=(
            Table("The fastest run within each tolerance, and the fastest of any other scheme. Step: over the stable step, for "
                  "backward Euler over the default step; CPU: seconds for each simulated second.", fastest_rows(facts, rows)),
            Table("Proposed rules: step over the unit, worst error over the tolerance, the same of bodies that were left out of "
                  "the fit, and cost over that of the fastest run, mean and worst.",
                  [{"bodies": each.sort} | verdict_row(each.verdict) for found in proposals.values() for each in found]),
            Table("The best rule of each scheme, for comparison.", candidates),
            Table("What `Simulation(tolerance=...)` takes, which asks for more room: worst error over the tolerance; cost over "
                  "that of the fastest run, mean and worst.", shipped_rows(facts, rows)),
        ),
    )  # fmt: skip


def measured(plan: Plan) -> tuple[list[Facts], list[Row]]:
    """Return bodies and runs as work-precision has written them; measure them where it has not."""
    folder = plan.folder / "work-precision"
    if (folder / "rows.csv").exists():
        return read_rows(folder / "scenes.csv", Facts), read_rows(folder / "rows.csv", Row)
    scenes, layers = work_precision.measure_scenes(plan)
    return scenes.facts + layers.facts, scenes.rows + layers.rows


# Tables -------------------------------------------------------------------------------------------------------------------


def fastest_rows(facts: Sequence[Facts], rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the fastest run for each body and tolerance, and what the next best scheme costs beside it."""
    result = []
    for body in facts:
        for tolerance in TOLERANCES:
            runs = [row for row in rows if row.scene == body.scene]
            best = fastest(runs, tolerance)
            if best is None:
                continue
            other = fastest((row for row in runs if row.scheme != best.scheme), tolerance)
            result.append({
                "scene": body.scene, "tolerance": tolerance, "fastest": best.label, "step": best.share, "error": best.error,
                "CPU": best.cpu, "next best": other.label if other else "none",
                "its step": other.share if other else float("nan"), "costs": other.cpu / best.cpu if other else float("nan"),
            })  # fmt: skip
    return result


def shipped_rows(facts: Sequence[Facts], rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return how the rules of gmapspring.choice do on all bodies."""
    result = []
    for sort, bodies in by_damping(facts).items():
        for tolerance in TOLERANCES:
            rule = rule_for(bodies[0].damping_ratio < DAMPED, tolerance)
            as_measured = Rule(rule.integrator, np.dtype(rule.dtype).name, UNITS[0])
            curves = [curve for curve in (curve_of(body, rows, as_measured) for body in bodies) if curve]
            if not curves:
                continue
            steps = [rule.share * default_share(rule.integrator) * curve.own_step for curve in curves]
            pairs = list(zip(curves, steps, strict=True))
            costs = [curve.cpu_at(step) / least_cost(curve.facts, rows, tolerance) for curve, step in pairs]
            result.append({
                "bodies": sort, "tolerance": tolerance, "scheme": rule.integrator, "precision": as_measured.precision,
                "step over default": rule.share,
                "worst error": max(curve.error_at(step) / tolerance for curve, step in pairs),
                "mean cost": float(np.exp(np.mean(np.log(costs)))), "worst cost": max(costs),
            })  # fmt: skip
    return result


def candidate_rows(facts: Sequence[Facts], rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the cheapest rule of each scheme for each sort of bodies and tolerance."""
    result = []
    for sort, bodies in by_damping(facts).items():
        for tolerance in TOLERANCES:
            judged = [verdict for verdict in (judge(rule, bodies, rows, tolerance) for rule in rules()) if verdict]
            for scheme in unique(verdict.rule.scheme for verdict in judged):
                best = best_of([verdict for verdict in judged if verdict.rule.scheme == scheme])
                result += [{"bodies": sort} | verdict_row(best)] if best else []
    return result


def verdict_row(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as a row."""
    return {
        "tolerance": verdict.tolerance, "scheme": verdict.rule.scheme, "precision": verdict.rule.precision,
        "unit": verdict.rule.unit.name, "step over unit": verdict.multiple, "worst error": verdict.worst_error,
        "worst left out": verdict.left_out_error, "mean cost": verdict.mean_cost, "worst cost": max(verdict.costs),
    }  # fmt: skip


# Text ---------------------------------------------------------------------------------------------------------------------


def method_text(facts: Sequence[Facts]) -> str:
    """Say how rules are made and judged."""
    spreads, ratios = [spread_of(body) for body in facts], [body.damping_ratio for body in facts]
    return (
        "A run is within a tolerance where both the position error over the size of the body and the largest strain error are. "
        "Before a body moves nobody knows which run that will be. So rules are tried that take a scheme, a precision, and a "
        "step from what is known: a multiple of the scheme's own step (the stable one, for backward Euler the default one), of "
        "the time of the median element, or of the time that a wave takes through the body. An explicit scheme is never given "
        f"more than its default step. A multiple is the largest that keeps all bodies below {MARGIN:g} of the tolerance; errors "
        "between two runs are taken to be the larger one of both. Light bodies and damped ones have rules of their own, and so "
        f"have even and uneven ones where that is worth it: the {len(facts)} bodies have damping ratios from {min(ratios):.2g} "
        f"to {max(ratios):.2g} and highest frequencies {min(spreads):.3g} to {max(spreads):.3g} times their median ones. Each "
        "rule is tried as well on each body with the multiple that the other bodies alone would give; rules that keep the "
        "tolerance there too are preferred."
    )


def outcome_text(proposals: dict[float, list[Proposal]]) -> str:
    """Say which rules come out, and how far they can be trusted."""
    lines = []
    for tolerance, found in proposals.items():
        rules_text = "; ".join(f"{each.sort}: {rule_text(each.verdict)}" for each in found)
        cost = f" Cost, in the mean: {mean_cost(found):.2g} times the least that was measured." if found else ""
        lines.append(f"- {tolerance:g}: {rules_text or 'no rule keeps it'}.{cost}")
    verdicts = [each.verdict for found in proposals.values() for each in found]
    missed = [verdict for verdict in verdicts if verdict.left_out_error > 1.0]
    worst = max((verdict.left_out_error for verdict in verdicts), default=0.0)
    return (
        "The best rules, by tolerance:\n\n" + "\n".join(lines) + f"\n\nOn bodies that were left out of the fit {len(missed)} of "
        f"{len(verdicts)} rules miss their tolerance; the worst error is {worst:.2g} times it."
    )


def rule_text(verdict: Verdict) -> str:
    """Say a rule in a few words."""
    return (
        f"{verdict.rule.scheme} in {verdict.rule.precision} with {verdict.multiple:.3g} times its {verdict.rule.unit.name} "
        f"(worst error {verdict.worst_error:.2g} of the tolerance)"
    )
