"""The order of a plan's cuts: the same cuts tear the body in one order and spare it in another."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from envs.task import SEPARATED, Resection, ResectionState

EXACT_LENGTH = 10
"""Plans of up to so many cuts are searched over all their subsets."""
BEAM_WIDTH = 6
"""Sets of cuts kept at each length of a longer plan."""
INVERSION_MARGIN = 0.05
"""Volume ratio above the limit that a searched order should keep."""
INVERSION_PENALTY = 10.0
"""What an order that does not keep it is charged, in strain."""


class Replay(NamedTuple):
    """What a body went through while a plan was carried out."""

    peak_strain: float
    """Largest healthy strain, the settled start included."""

    lowest_volume_ratio: float
    """Smallest volume ratio of healthy tissue."""

    peak_danger: float
    """Largest healthy strain, raised where tissue comes near to turning inside out."""

    inverts: bool
    """Whether tissue comes near to turning inside out."""

    survives: bool
    """Whether the tool reached every cut, the target came free, and nothing collapsed before or then."""

    cost: float
    """What the cuts cost."""

    is_in_reach: bool
    """Whether the tool reached every cut from the one before."""


class Way(NamedTuple):
    """One way to have carried out part of a plan."""

    peak: float
    """Danger met on the way."""

    strain: float
    """Danger now; of two ways with the same peak, the one with less is better."""

    order: tuple[int, ...]
    """Actions so far."""

    state: ResectionState
    """The body after them."""


def replay(task: Resection, order: Iterable[int]) -> Replay:
    """Carry out a plan from the start, going on past a collapse, and return what the body went through."""
    task.reset()
    strains, ratios, dangers = [task.tissue.healthy_strain], [task.tissue.lowest_volume_ratio], [_danger(task)]
    stands = is_in_reach = True
    for action in order:
        stands = stands and task.outcome is None
        is_in_reach = is_in_reach and bool(task.action_mask()[action])
        task.step(action)
        strains.append(task.tissue.healthy_strain)
        ratios.append(task.tissue.lowest_volume_ratio)
        dangers.append(_danger(task))
    survives = stands and is_in_reach and task.outcome == SEPARATED
    inverts = max(dangers) >= INVERSION_PENALTY
    return Replay(max(strains), min(ratios), max(dangers), inverts, survives, task.cost, is_in_reach)


def beam_order(task: Resection, plan: Sequence[int]) -> tuple[int, ...]:
    """Return an order of a plan with a small peak strain of healthy tissue: a beam over sets of cuts, one cut at a time.

    Of all ways to the same set of cuts, with a tool those that end at the same cut, only the best is kept. There may be no order
    that a tool can follow: then, or where the beam loses them all, it is ().
    """
    return _beam(task, plan, BEAM_WIDTH, np.inf)


def exact_order(task: Resection, plan: Sequence[int], bound: float) -> tuple[int, ...]:
    """Return the order of a short plan with the smallest peak strain, or () where none is below a bound.

    Dynamic programming over all subsets: a beam that nothing falls off. Exact in so far as the settled body depends on
    what is cut and not on the order.
    """
    return _beam(task, plan, None, bound)


def _beam(task: Resection, plan: Sequence[int], width: int | None, bound: float) -> tuple[int, ...]:
    """Return the best order whose peak is below the bound, or () where there is none."""
    task.reset()
    beam, has_tool = [way_so_far(task)], task.scene.tool_radius is not None
    for _ in plan:
        beam = next_beam(beam, plan, width, partial(one_more, task), bound=bound, has_tool=has_tool)
        if not beam:
            return ()
    return beam[0].order


def way_so_far(task: Resection) -> Way:
    """Return the beginning of every way that leads on from the body as it stands."""
    strain = _danger(task)
    return Way(strain, strain, (), task.save_state())


def one_more(task: Resection, way: Way, action: int) -> Way:
    """Return a way with one more action, carried out on the task; its peak is infinite where a tool does not reach that."""
    task.load_state(way.state)
    if not task.action_mask()[action]:
        return way._replace(peak=np.inf)
    task.step(action)
    strain = _danger(task)
    return Way(max(way.peak, strain), strain, (*way.order, action), task.save_state())


def next_beam(
    beam: Sequence[Way],
    plan: Iterable[int],
    width: int | None,
    extend: Callable[[Way, int], Way],
    *,
    bound: float = np.inf,
    has_tool: bool = False,
) -> list[Way]:
    """Return the best ways with one more action of a plan, the best first; of all ways to the same set of cuts only the best.

    Args:
        beam: ways of equal length, the best first.
        plan: the actions that they take, each once.
        width: how many ways to keep; None for all.
        extend: gives a way with one more action.
        bound: only ways whose peak is below it are kept.
        has_tool: what can be done next depends on the last cut too, and so the best way to each set and last cut is kept.
    """
    reached: dict[tuple[frozenset[int], int], Way] = {}
    for way in beam:
        for action in sorted(set(plan) - set(way.order)):
            key = frozenset((*way.order, action)), action if has_tool else -1
            # Ways come in the order of their peaks, so the first to arrive is the best way there, unless it cannot go on.
            if key not in reached or reached[key].peak == np.inf:
                reached[key] = extend(way, action)
    below = (way for way in reached.values() if way.peak < bound)
    return sorted(below, key=lambda way: way[:3])[:width]


def _danger(task: Resection) -> float:
    """Return the healthy strain, raised where tissue comes near to turning inside out."""
    tissue = task.tissue
    if not tissue.is_finite:
        return np.inf
    is_near = tissue.lowest_volume_ratio < task.scene.limits.volume_ratio + INVERSION_MARGIN
    return tissue.healthy_strain + (INVERSION_PENALTY if is_near else 0.0)
