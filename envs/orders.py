"""How many orders of a scene's cheapest cuts spare the body: all of them counted, or random ones tried."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from envs.collapse import SEPARATED
from envs.task import Resection


class OrderTable(NamedTuple):
    """What becomes of the body in all orders of a few cuts, by the set of cuts done: bit i stands for cut i, (2^n,) each.

    The settled body is taken to depend on which cuts are done and not on their order, up to what a settling leaves undone:
    each set is reached once, by the gentlest way to one cut less.
    """

    strain: np.ndarray
    """Largest healthy strain, NaN of sets that no way leads to."""
    stands: np.ndarray
    """Whether the body stands there, bool; False of sets that no way leads to."""
    n_orders: np.ndarray
    """Orders of these cuts that it stands all the way."""
    peak: np.ndarray
    """Least largest strain on the way there over all these orders, infinite where there is none."""

    @property
    def feasible_share(self) -> float:
        """Return the share of orders of all cuts that the body stands to the end: n! orders in all."""
        n_cuts = len(self.strain).bit_length() - 1
        return float(self.n_orders[-1] / np.prod(np.arange(1, n_cuts + 1), dtype=np.float64))


def all_orders(task: Resection, plan: Sequence[int]) -> OrderTable:
    """Return what becomes of the body in all orders of a plan, by dynamic programming over sets of its cuts.

    An order is a path through sets, each with one cut more, so their numbers add up: of the paths to a set, those through
    each set with one cut less.
    """
    task.reset()
    n_sets = 1 << len(plan)
    table = OrderTable(np.full(n_sets, np.nan), np.zeros(n_sets, bool), np.zeros(n_sets, np.int64), np.full(n_sets, np.inf))
    states = {0: task.save_state()}
    table.strain[0] = table.peak[0] = task.tissue.healthy_strain
    table.stands[0], table.n_orders[0] = stands(task), 1
    for _ in plan:
        following = {}
        # The gentlest first: it is the way by which what follows is reached.
        for before, state in sorted(states.items(), key=lambda item: (table.peak[item[0]], item[0])):
            for place in (place for place in range(len(plan)) if not before >> place & 1):
                after = before | 1 << place
                if np.isnan(table.strain[after]):
                    task.load_state(state)
                    task.step(plan[place])
                    table.strain[after], table.stands[after] = task.tissue.healthy_strain, stands(task)
                    if table.stands[after]:
                        following[after] = task.save_state()
                if table.stands[after]:
                    table.n_orders[after] += table.n_orders[before]
                    table.peak[after] = min(table.peak[after], max(table.peak[before], table.strain[after]))
        states = following
    return table


class Agreement(NamedTuple):
    """How plays compare with a table of all orders, cut by cut."""

    moves: list[float]
    """Differences of the healthy strain, where the body stands in both."""
    n_labels: int
    """Cuts compared, up to and with the first after which the body does not stand."""
    n_differing: int
    """Cuts after which it stands in one and not in the other."""


def agreement(task: Resection, plan: Sequence[int], table: OrderTable, orders: Sequence[Sequence[int]]) -> Agreement:
    """Carry out orders of a plan cut by cut, and compare with what the table says of the same sets of cuts."""
    moves: list[float] = []
    n_labels = n_differing = 0
    for order in orders:
        task.reset()
        cuts = 0
        for action in order:
            cuts |= 1 << plan.index(action)
            task.step(action)
            n_labels += 1
            n_differing += stands(task) != table.stands[cuts]
            if not (stands(task) and table.stands[cuts]):
                break
            moves.append(abs(task.tissue.healthy_strain - float(table.strain[cuts])))
    return Agreement(moves, n_labels, n_differing)


def feasible_share(task: Resection, orders: Sequence[Sequence[int]]) -> float:
    """Return the share of some orders that the body stands to the end."""
    return float(np.mean([survives(task, order) for order in orders]))


def survives(task: Resection, order: Sequence[int]) -> bool:
    """Tell whether the body stands an order to the end, each cut being legal when it is done."""
    task.reset()
    for action in order:
        if not task.action_mask()[action]:
            return False
        task.step(action)
        if not stands(task):
            return False
    return True


def stands(task: Resection) -> bool:
    """Tell whether the body has not collapsed."""
    return task.outcome in (None, SEPARATED)


def random_orders(plan: Sequence[int], count: int, rng: np.random.Generator) -> list[list[int]]:
    """Return random orders of a plan."""
    return [rng.permutation(plan).tolist() for _ in range(count)]


def gentlest_order(table: OrderTable, plan: Sequence[int]) -> tuple[int, ...]:
    """Return the order of a plan whose largest strain is the least by the table, or () where none stands."""
    cuts, backwards = len(table.strain) - 1, []
    if not table.n_orders[cuts]:
        return ()
    while cuts:
        before = [cuts & ~(1 << place) for place in range(len(plan)) if cuts >> place & 1]
        # What leads nowhere has an infinite peak.
        best = min(before, key=lambda some: table.peak[some])
        backwards.append(plan[(cuts ^ best).bit_length() - 1])
        cuts = best
    return tuple(reversed(backwards))
