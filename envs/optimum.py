"""The cheapest set of cuts that frees the target: a minimum cut through tetrahedra and faces.

Every tetrahedron becomes an edge in -> out whose capacity is the cost of its removal, every sewn face a pair of edges
out -> in with the cost of its cut, and every healthy tetrahedron leaks from out to the sink what it costs to lose it:

                  removal               face
        target --> in ====> out --------------------> in ====> out --> sink (an anchor: without limit)
                             ^-----------------------           |
                                     face                       +--> sink (healthy: the cost of its loss)

What the source still reaches comes off. Where there is a vessel, what lays it open and its loss are without limit too.
(Ford and Fulkerson, 1956.)
"""

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from envs.action_table import ActionTable, touching_actions
from envs.costs import face_costs, loss_costs, tetrahedron_costs
from envs.flow import reached_from
from envs.scene import Scene
from gmapspring.jit import kernel

Array = np.ndarray[Any, Any]

FLOW_LIMIT = 2**29
"""Largest flow in whole numbers: costs are told apart to nine digits, and plans of the same cost always come out the same."""


class MinimumCut(NamedTuple):
    """What the cheapest way to free the target does."""

    actions: Array
    """Action ids, ascending, int64; none where nothing frees the target without laying open a vessel."""

    cost: float
    """Their costs and the cost of what they set loose, summed; infinite where there are none."""

    lost: Array
    """Healthy tetrahedra that come loose, bool, shape (n_tetrahedra,)."""

    is_exact: bool
    """Whether it is proven that no cheaper way exists; else the cost is an upper bound, seldom far off."""


class Prices(NamedTuple):
    """What the cuts of a scene cost."""

    actions: Array
    """Each by itself, before any healthy tissue comes loose, shape (n_actions,)."""
    losses: Array
    """Each tetrahedron that comes loose, shape (n_tetrahedra,)."""
    allowed_actions: Array
    """The same of actions, infinite for those that lay open a vessel: no price is high enough."""
    allowed_losses: Array
    """The same of tetrahedra, likewise."""


class _State(NamedTuple):
    """A body part way through."""

    is_attached: Array
    is_sewn: Array
    sides: Array
    prices: Prices


_PRICES: WeakKeyDictionary[Scene, Prices] = WeakKeyDictionary()


def prices_of(scene: Scene, table: ActionTable) -> Prices:
    """Return what the cuts of a scene cost; they are the same however far it has been cut."""
    if scene not in _PRICES:
        actions = np.concatenate([face_costs(table.face_area, scene.spacing), tetrahedron_costs(table.volume, scene.spacing)])
        losses = loss_costs(table.volume, ~scene.target, scene.spacing)
        is_touching = touching_actions(table, scene.vessel)
        prices = Prices(actions, losses, np.where(is_touching, np.inf, actions), np.where(scene.vessel, np.inf, losses))
        for array in prices:
            array.flags.writeable = False
        _PRICES[scene] = prices
    return _PRICES[scene]


def minimum_cut(scene: Scene, table: ActionTable, is_attached: Array | None = None, is_sewn: Array | None = None) -> MinimumCut:
    """Return the cheapest cuts that free the target, from the uncut body or from any later state.

    Args:
        scene: target, anchors and unit of length.
        table: the actions of its mesh.
        is_attached: tetrahedra that hang on an anchor, bool (n_tetrahedra,); all, if not given.
        is_sewn: interior faces that are not cut, bool (n_faces,); all, if not given.
    """
    attached = np.ones(table.n_tetrahedra, dtype=bool) if is_attached is None else is_attached
    sewn = np.ones(table.n_faces, dtype=bool) if is_sewn is None else is_sewn
    sides = table.face_tetrahedra
    state = _State(attached, sewn & attached[sides].all(axis=1), sides, prices_of(scene, table))
    # What hangs on the target alone is lost with it; the flow itself does not know that tissue must hang on something.
    off = attached & (scene.target | ~_held(state, attached & ~scene.target, scene.anchor))
    is_exact = True
    while True:
        limit = _limit(state, off)
        if np.isinf(limit):
            nothing = np.zeros(0, dtype=np.int64)
            return MinimumCut(nothing, np.inf, np.zeros(table.n_tetrahedra, dtype=bool), is_exact)
        comes_off, is_removed = _split(scene, table, state, off, limit)
        stays = attached & ~comes_off & ~is_removed
        islands = stays & ~_held(state, stays, scene.anchor)
        if not islands.any():
            break
        is_exact = False
        off = off | islands
    return _plan(scene, table, state, comes_off, is_removed)._replace(is_exact=is_exact)


def _plan(scene: Scene, table: ActionTable, state: _State, comes_off: Array, is_removed: Array) -> MinimumCut:
    """Return the actions that part what comes off from what stays, and their cost."""
    first, second = state.sides.T
    is_cut = state.is_sewn & (comes_off[first] != comes_off[second]) & ~is_removed[first] & ~is_removed[second]
    actions = np.concatenate([np.flatnonzero(is_cut), table.n_faces + np.flatnonzero(is_removed)])
    lost = comes_off & ~scene.target
    cost = float(state.prices.actions[actions].sum() + state.prices.losses[lost].sum())
    return MinimumCut(actions, cost, lost, True)


def _held(state: _State, members: Array, anchor: Array) -> Array:
    """Return which of some tetrahedra hang on an anchor by chains of sewn faces among themselves, bool."""
    held = members & anchor
    _spread(state.sides[state.is_sewn & members[state.sides].all(axis=1)], held)
    return held


@kernel
def _spread(links, is_met):
    """Mark all that is linked to what is marked; faces are few and chains short, so sweeps need no queue."""
    is_growing = True
    while is_growing:
        is_growing = False
        for link in range(links.shape[0]):
            if is_met[links[link, 0]] != is_met[links[link, 1]]:
                is_met[links[link, 0]] = is_met[links[link, 1]] = True
                is_growing = True


def _split(scene: Scene, table: ActionTable, state: _State, off: Array, limit: float) -> tuple[Array, Array]:
    """Return which tetrahedra come off and which are removed by the least cut that takes some off for certain."""
    n_tets = table.n_tetrahedra
    if not off.any():
        return np.zeros(n_tets, dtype=bool), np.zeros(n_tets, dtype=bool)
    is_reached = reached_from(2 * n_tets, 2 * n_tets + 1, 2 * n_tets + 2, *_network(scene, table, state, off, limit))
    reached_in, reached_out = is_reached[:n_tets], is_reached[n_tets : 2 * n_tets]
    return reached_out & state.is_attached, reached_in & ~reached_out & state.is_attached


def _limit(state: _State, off: Array) -> float:
    """Return what it costs to cut what must come off all around.

    It is infinite only where there is no way at all: a vessel's tetrahedron among what must come off is lost however it is done,
    and one across a face can neither be cut from it nor have it removed.
    """
    faces = np.flatnonzero(state.is_sewn)
    first, second = state.sides[faces].T
    return float(state.prices.allowed_actions[faces[off[first] != off[second]]].sum() + state.prices.allowed_losses[off].sum())


def _network(scene: Scene, table: ActionTable, state: _State, off: Array, limit: float) -> tuple[Array, Array, Array]:
    """Return arcs as (tails, heads, capacities in whole numbers); nodes are all in, all out, source, sink.

    limit: what it costs to cut all around what must come off. No flow exceeds that, and no capacity need be larger.
    """
    n_tets, n_faces, costs = table.n_tetrahedra, table.n_faces, state.prices.allowed_actions
    attached = np.flatnonzero(state.is_attached)
    faces = np.flatnonzero(state.is_sewn)
    first, second = state.sides[faces].T
    scale = FLOW_LIMIT / limit if limit > 0.0 else 1.0
    endless = np.inf
    removal = np.where(scene.anchor, endless, costs[n_faces:])
    leak = np.where(scene.anchor, endless, state.prices.allowed_losses)
    parts = [
        (attached, attached + n_tets, removal[attached]),
        (first + n_tets, second, costs[faces]),
        (second + n_tets, first, costs[faces]),
        (np.full(off.sum(), 2 * n_tets), np.flatnonzero(off), np.full(off.sum(), endless)),
        (attached + n_tets, np.full(len(attached), 2 * n_tets + 1), leak[attached]),
    ]
    tails, heads, capacities = (np.concatenate(column) for column in zip(*parts, strict=True))
    # One above the limit on the whole flow is as good as endless.
    whole = np.minimum(np.rint(capacities * scale), FLOW_LIMIT + len(faces) + n_tets).astype(np.int64)
    return tails, heads, whole
