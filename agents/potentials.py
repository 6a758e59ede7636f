"""Potentials: how much is left to do until the target is free, of which shaping makes rewards that come at once.

A new one is a class with the methods of `Potential` and a line in POTENTIALS.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from agents.features import AREA, ATTACHED, IS_TARGET
from envs.action_table import action_table
from envs.observation import COLUMNS
from envs.optimum import MinimumCuts, Prices, Terms, minimum_cuts, prices_of, terms_of
from envs.scene import Scene

Array = np.ndarray[Any, Any]
SceneOf = Callable[[int], Scene]
"""Returns the scene that a row of environments plays."""
Parts = TypeVar("Parts", MinimumCuts, Terms, Prices)

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
        self._starts: WeakKeyDictionary[Scene, _Known] = WeakKeyDictionary()
        self._rows: _Known | None = None

    def begin(self, rows: Array, observation: dict[str, Array]) -> Array:
        """See `Potential`."""
        for row in rows.tolist():
            start = self._start_of(self._scene_of(row))
            if self._rows is None:
                self._rows = start.repeated(len(observation["globals"]))
            self._rows.put(row, start)
        return self._costs(rows)

    def proceed(self, rows: Array, actions: Array, observation: dict[str, Array]) -> Array:
        """See `Potential`."""
        assert self._rows is not None, "no episode has begun"
        there, known = what_is_there(observation, rows), self._rows
        ways, is_proven = follow(_some(known.ways, rows), actions, there)
        lost_track = np.flatnonzero(~is_proven)
        anew = search(_some(known.terms, rows[lost_track]), there[lost_track])
        for mine, way, found in zip(known.ways, ways, anew, strict=True):
            way[lost_track] = found
            mine[rows] = way
        return self._costs(rows)

    def _start_of(self, scene: Scene) -> "_Known":
        """Return what is known of a scene where it begins, one row."""
        if scene not in self._starts:
            table = action_table(scene.mesh)
            terms, prices = terms_of(scene, table), Prices(*(part[None] for part in prices_of(scene, table)))
            ways = search(terms, np.ones((1, table.n_actions), bool))
            self._starts[scene] = _Known(ways, terms, prices, scene.budget * cost_of(ways, prices))
        return self._starts[scene]

    def _costs(self, rows: Array) -> Array:
        """Return what the ways cost, as far as the budget goes."""
        assert self._rows is not None, "no episode has begun"
        costs: Array = np.minimum(cost_of(self._rows.ways, self._rows.prices), self._rows.limit)[rows]
        return costs


class _Known(NamedTuple):
    """The cheapest ways of some rows, and what they depend on."""

    ways: MinimumCuts
    terms: Terms
    prices: Prices
    """(n_rows, n_actions) and (n_rows, n_tetrahedra)."""
    limit: Array
    """The most that is counted, (n_rows,)."""

    def repeated(self, n: int) -> "_Known":
        """Return so many rows of one."""
        first = np.zeros(n, np.intp)
        return _Known(_some(self.ways, first), _some(self.terms, first), _some(self.prices, first), self.limit[first])

    def put(self, row: int, start: "_Known") -> None:
        """Let a row begin like the only one of another."""
        for mine, its in zip(self._arrays(), start._arrays(), strict=True):
            mine[row] = its[0]

    def _arrays(self) -> list[Array]:
        return [*self.ways, *self.terms, *self.prices, self.limit]


def what_is_there(observation: dict[str, Array], rows: Array) -> Array:
    """Return the actions of some rows whose face is sewn or whose tetrahedron is attached, bool (k, n_actions)."""
    seen = observation["faces"][rows, :, _SEWN], observation["tetrahedra"][rows, :, ATTACHED]
    return np.concatenate(seen, axis=1) > 0.0


def search(terms: Terms, there: Array) -> MinimumCuts:
    """Return the cheapest ways to free targets where faces are sewn and tetrahedra attached, bool (k, n_actions)."""
    n_faces = terms.sides.shape[1]
    return minimum_cuts(terms, there[:, n_faces:], there[:, :n_faces])


def follow(ways: MinimumCuts, actions: Array, there: Array) -> tuple[MinimumCuts, Array]:
    """Return what is left of ways after an action of each, (k,), and which of them are still known to be the cheapest.

    To do the action and then the cheapest is a way from the state before, so the action has saved at most what it cost,
    with what came loose at it. If it is part of a cheapest way, what is left of that costs less by just so much: then it
    is a cheapest way from here (Bellman, 1957). A way whose cost is but an upper bound proves nothing.
    """
    done = np.arange(len(actions)), actions
    is_proven = ways.is_exact & ways.is_part[done] & ~there[done]
    n_faces = there.shape[1] - ways.is_lost.shape[1]
    left = ways._replace(is_part=ways.is_part & there, is_lost=ways.is_lost & there[:, n_faces:])
    return left, is_proven


def cost_of(ways: MinimumCuts, prices: Prices) -> Array:
    """Return what ways cost, (k,); infinite where there is none."""
    cuts, losses = (np.einsum("ij,ij->i", *pair) for pair in zip(ways[:2], prices, strict=True))
    return np.where(ways.is_possible, cuts + losses, np.inf)


def _some(parts: Parts, rows: Array) -> Parts:
    """Return some rows of arrays, as copies."""
    return type(parts)(*(part[rows] for part in parts))


POTENTIALS: dict[str, Callable[[SceneOf], Potential]] = {"interface": InterfaceLeft, "minimum-cut": CutLeft}
"""All potentials by the name they have in training configurations."""
