"""Potentials: how much is left to do until the target is free, of which shaping makes rewards that come at once.

A new one is a class with the methods of `Potential` and a line in POTENTIALS.
"""

from collections.abc import Callable
from typing import Any, Protocol
from weakref import WeakKeyDictionary

import numpy as np

from agents.features import AREA, ATTACHED, IS_TARGET
from envs.action_table import action_table
from envs.observation import COLUMNS
from envs.optimum import MinimumCut, minimum_cut, prices_of
from envs.scene import Scene

Array = np.ndarray[Any, Any]
SceneOf = Callable[[int], Scene]
"""Returns the scene that a row of environments plays."""

_SEWN = [column.name for column in COLUMNS["faces"]].index("sewn")


class Potential(Protocol):
    """Tell of rows of environments how much is left to do, in any unit, above 0 where an episode begins."""

    def begin(self, rows: Array, observation: dict[str, Array]) -> Array:
        """Return what is left in some rows where an episode begins, (k,), given what all rows show."""
        ...

    def proceed(self, rows: Array, actions: Array, observation: dict[str, Array]) -> Array:
        """Return what is left in some rows, (k,), after actions, (k,), that have not ended their episodes."""
        ...


class InterfaceLeft:
    """The area of the sewn faces between target and healthy tissue, over h^2: quick, and blind to detours that pay."""

    def __init__(self, scene_of: SceneOf) -> None:
        """Remember nothing: what is left can be seen."""

    def begin(self, rows: Array, observation: dict[str, Array]) -> Array:
        """See `Potential`."""
        return interface_area(observation)[rows]

    def proceed(self, rows: Array, actions: Array, observation: dict[str, Array]) -> Array:
        """See `Potential`."""
        return interface_area(observation)[rows]


def interface_area(observations: dict[str, Array]) -> Array:
    """Return the area of the sewn faces between target and healthy tissue, over h^2, of a batch, shape (batch,)."""
    sides = observations["face_tetrahedra"].astype(np.intp)
    is_target = observations["tetrahedra"][..., IS_TARGET] > 0.0
    one, other = (np.take_along_axis(is_target, sides[..., side], axis=1) for side in range(2))
    # A face that is not sewn shows no area.
    area: Array = np.einsum("ij,ij->i", observations["faces"][..., AREA], one != other, dtype=np.float64)
    return area


class CutLeft:
    """The cost of the cheapest way to free the target: exact about cost, and blind to the load.

    Where no way is left, or none that the budget would pay for, it is the budget.
    """

    def __init__(self, scene_of: SceneOf) -> None:
        """Know no way yet."""
        self._scene_of = scene_of
        self._starts: WeakKeyDictionary[Scene, MinimumCut] = WeakKeyDictionary()
        self._ways: dict[int, MinimumCut] = {}

    def begin(self, rows: Array, observation: dict[str, Array]) -> Array:
        """See `Potential`."""
        for row in rows.tolist():
            scene = self._scene_of(row)
            if scene not in self._starts:
                self._starts[scene] = minimum_cut(scene, action_table(scene.mesh))
            self._ways[row] = self._starts[scene]
        return self._costs(rows)

    def proceed(self, rows: Array, actions: Array, observation: dict[str, Array]) -> Array:
        """See `Potential`."""
        for row, action in zip(rows.tolist(), actions.tolist(), strict=True):
            scene, there = self._scene_of(row), what_is_there(observation, row)
            self._ways[row] = follow(scene, self._ways[row], action, there) or search(scene, there)
        return self._costs(rows)

    def _costs(self, rows: Array) -> Array:
        """Return what the ways cost, as far as the budget goes."""
        costs = np.empty(len(rows))
        for place, row in enumerate(rows.tolist()):
            scene = self._scene_of(row)
            costs[place] = min(self._ways[row].cost, scene.budget * self._starts[scene].cost)
        return costs


def what_is_there(observation: dict[str, Array], row: int) -> Array:
    """Return the actions of a row whose face is sewn or whose tetrahedron is attached, bool (n_actions,)."""
    return np.concatenate([observation["faces"][row, :, _SEWN], observation["tetrahedra"][row, :, ATTACHED]]) > 0.0


def search(scene: Scene, there: Array) -> MinimumCut:
    """Return the cheapest way to free the target where faces are sewn and tetrahedra attached, bool (n_actions,)."""
    table = action_table(scene.mesh)
    return minimum_cut(scene, table, there[table.n_faces :], there[: table.n_faces])


def follow(scene: Scene, way: MinimumCut, action: int, there: Array) -> MinimumCut | None:
    """Return what is left of a way after an action; None where it need not be the cheapest any more.

    To do the action and then the cheapest is a way from the state before, so the action has saved at most what it cost,
    with what came loose at it. If it is part of a cheapest way, what is left of that costs less by just so much: then it
    is a cheapest way from here (Bellman, 1957). A way whose cost is but an upper bound proves nothing.
    """
    if not way.is_exact or there[action] or action not in way.actions:
        return None
    table = action_table(scene.mesh)
    actions, lost = way.actions[there[way.actions]], way.lost & there[table.n_faces :]
    prices = prices_of(scene, table)
    return MinimumCut(actions, float(prices.actions[actions].sum() + prices.losses[lost].sum()), lost, True)


POTENTIALS: dict[str, Callable[[SceneOf], Potential]] = {"interface": InterfaceLeft, "minimum-cut": CutLeft}
"""All potentials by the name they have in training configurations."""
