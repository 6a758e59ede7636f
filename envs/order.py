"""The order of a plan's cuts: the same cuts tear the body in one order and spare it in another."""

from collections.abc import Iterable, Sequence
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


class _Path(NamedTuple):
    """One way to have carried out part of a plan."""

    peak: float
    """Danger met on the way."""

    strain: float
    """Danger now; of two ways with the same peak, the one with less is better."""

    order: tuple[int, ...]
    """Actions so far."""

    state: ResectionState
    """The body after them."""


_Key = tuple[frozenset[int], int | None]
"""Where a path leads: its set of cuts and, with a tool, the last of them."""


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
    strain = _danger(task)
    beam = [_Path(strain, strain, (), task.save_state())]
    for _ in plan:
        reached: dict[_Key, _Path] = {}
        for path in beam:
            task.load_state(path.state)
            allowed = task.action_mask()
            for action in sorted(set(plan) - set(path.order)):
                if allowed[action]:
                    _extend(task, path, action, reached)
        below = (path for path in reached.values() if path.peak < bound)
        beam = sorted(below, key=lambda path: path[:3])[:width]
        if not beam:
            return ()
    return beam[0].order


def _extend(task: Resection, path: _Path, action: int, reached: dict[_Key, _Path]) -> None:
    """Take one more action, unless where it leads is known already."""
    # What can be done next depends on what is cut, and with a tool on where it stands.
    key = frozenset((*path.order, action)), None if task.scene.tool_radius is None else action
    # Paths come in the order of their peaks, so the first to arrive at a set of cuts is the best way there.
    if key in reached:
        return
    task.load_state(path.state)
    task.step(action)
    strain = _danger(task)
    reached[key] = _Path(max(path.peak, strain), strain, (*path.order, action), task.save_state())


def _danger(task: Resection) -> float:
    """Return the healthy strain, raised where tissue comes near to turning inside out."""
    tissue = task.tissue
    if not tissue.is_finite:
        return np.inf
    is_near = tissue.lowest_volume_ratio < task.scene.limits.volume_ratio + INVERSION_MARGIN
    return tissue.healthy_strain + (INVERSION_PENALTY if is_near else 0.0)
