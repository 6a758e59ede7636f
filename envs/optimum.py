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
from envs.flow import reached
from envs.scene import Scene
from gmapspring.jit import kernel, part

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


class MinimumCuts(NamedTuple):
    """The same of several bodies of one mesh size, as masks."""

    is_part: Array
    """Actions of each, bool (k, n_actions)."""
    is_lost: Array
    """Healthy tetrahedra that come loose, bool (k, n_tetrahedra)."""
    is_possible: Array
    """Whether there is a way at all, bool (k,)."""
    is_exact: Array
    """Whether it is proven that no cheaper way exists, bool (k,)."""


class Prices(NamedTuple):
    """What the cuts of a scene cost."""

    actions: Array
    """Each by itself, before any healthy tissue comes loose, shape (n_actions,)."""
    losses: Array
    """Each tetrahedron that comes loose, shape (n_tetrahedra,)."""


class Terms(NamedTuple):
    """What kernels need of the scenes of several bodies; a price that is infinite forbids."""

    sides: Array
    """The two tetrahedra of each face, int32 (k, n_faces, 2)."""
    is_target: Array
    """bool (k, n_tetrahedra), and is_anchor."""
    is_anchor: Array
    face_price: Array
    """What it costs to cut each face, (k, n_faces)."""
    removal_price: Array
    """To remove each tetrahedron, (k, n_tetrahedra)."""
    loss_price: Array
    """To lose each, (k, n_tetrahedra)."""


_KNOWN: WeakKeyDictionary[Scene, tuple[Prices, Terms]] = WeakKeyDictionary()


def prices_of(scene: Scene, table: ActionTable) -> Prices:
    """Return what the cuts of a scene cost; they are the same however far it has been cut."""
    return _known(scene, table)[0]


def terms_of(scene: Scene, table: ActionTable) -> Terms:
    """Return the terms of one scene, k = 1; they are the same however far it has been cut."""
    return _known(scene, table)[1]


def _known(scene: Scene, table: ActionTable) -> tuple[Prices, Terms]:
    """Return what stays the same while a scene is played."""
    if scene not in _KNOWN:
        actions = np.concatenate([face_costs(table.face_area, scene.spacing), tetrahedron_costs(table.volume, scene.spacing)])
        prices = Prices(actions, loss_costs(table.volume, ~scene.target, scene.spacing))
        for array in prices:
            array.flags.writeable = False
        # No price is high enough to lay open a vessel.
        face_price, removal_price = np.split(np.where(touching_actions(table, scene.vessel), np.inf, actions), [table.n_faces])
        terms = (
            table.face_tetrahedra.astype(np.int32), scene.target, scene.anchor, face_price, removal_price,
            np.where(scene.vessel, np.inf, prices.losses),
        )  # fmt: skip
        # Copies, all writable: kernels are compiled for one kind of array.
        _KNOWN[scene] = prices, Terms(*(np.array(part)[None] for part in terms))
    return _KNOWN[scene]


def minimum_cut(scene: Scene, table: ActionTable, is_attached: Array | None = None, is_sewn: Array | None = None) -> MinimumCut:
    """Return the cheapest cuts that free the target, from the uncut body or from any later state.

    Args:
        scene: target, anchors and unit of length.
        table: the actions of its mesh.
        is_attached: tetrahedra that hang on an anchor, bool (n_tetrahedra,); all, if not given.
        is_sewn: interior faces that are not cut, bool (n_faces,); all, if not given.
    """
    prices, terms = _known(scene, table)
    attached = np.ones(table.n_tetrahedra, bool) if is_attached is None else np.asarray(is_attached, bool)
    sewn = np.ones(table.n_faces, bool) if is_sewn is None else np.asarray(is_sewn, bool)
    (is_part,), (is_lost,), (is_possible,), (is_exact,) = minimum_cuts(terms, attached[None], sewn[None])
    actions = np.flatnonzero(is_part)
    cost = float(prices.actions[actions].sum() + prices.losses[is_lost].sum()) if is_possible else np.inf
    return MinimumCut(actions, cost, is_lost, bool(is_exact))


def minimum_cuts(terms: Terms, is_attached: Array, is_sewn: Array) -> MinimumCuts:
    """Return the cheapest cuts that free the targets of several bodies, in any state.

    Args:
        terms: of their scenes.
        is_attached: tetrahedra that hang on an anchor, bool (k, n_tetrahedra).
        is_sewn: interior faces that are not cut, bool (k, n_faces).
    """
    (k, n_tets), n_faces = is_attached.shape, is_sewn.shape[1]
    found = MinimumCuts(np.zeros((k, n_faces + n_tets), bool), np.zeros((k, n_tets), bool), np.zeros(k, bool), np.zeros(k, bool))
    _find_cuts(terms, np.ascontiguousarray(is_attached), np.array(is_sewn), found)
    return found


@kernel
def _find_cuts(terms, is_attached, is_sewn, found):
    """Fill in the cheapest cuts of all bodies, one after the other."""
    for body in range(len(is_attached)):
        own = Terms(
            terms.sides[body], terms.is_target[body], terms.is_anchor[body],
            terms.face_price[body], terms.removal_price[body], terms.loss_price[body],
        )  # fmt: skip
        found.is_possible[body], found.is_exact[body] = _find_cut(
            own, is_attached[body], is_sewn[body], found.is_part[body], found.is_lost[body]
        )


@part
def _find_cut(terms, is_attached, is_sewn, is_part, is_lost):
    """Mark the actions of the cheapest cut and the healthy tetrahedra lost by it; return (is there one, is it exact)."""
    n_faces, n_tets = len(terms.sides), len(is_attached)
    for face in range(n_faces):
        is_sewn[face] = is_sewn[face] and is_attached[terms.sides[face, 0]] and is_attached[terms.sides[face, 1]]
    # What hangs on the target alone is lost with it; the flow itself does not know that tissue must hang on something.
    off = is_attached & ~_held(terms, is_sewn, is_attached & ~terms.is_target)
    is_exact = True
    while True:
        limit = _limit(terms, is_sewn, off)
        if limit == np.inf:
            return False, is_exact
        tails, heads, capacities = _network(terms, is_attached, is_sewn, off, limit)
        is_reached = reached(2 * n_tets, 2 * n_tets + 1, 2 * n_tets + 2, tails, heads, capacities)
        comes_off = is_reached[n_tets : 2 * n_tets] & is_attached
        is_removed = is_reached[:n_tets] & is_attached & ~comes_off
        stays = is_attached & ~comes_off & ~is_removed
        islands = stays & ~_held(terms, is_sewn, stays)
        if not islands.any():
            break
        is_exact = False
        off = off | islands
    for face in range(n_faces):
        one, other = terms.sides[face]
        is_part[face] = is_sewn[face] and comes_off[one] != comes_off[other] and not (is_removed[one] or is_removed[other])
    for tet in range(n_tets):
        is_part[n_faces + tet] = is_removed[tet]
        is_lost[tet] = comes_off[tet] and not terms.is_target[tet]
    return True, is_exact


@part
def _held(terms, is_sewn, members):
    """Return which of some tetrahedra hang on an anchor by chains of sewn faces among themselves, bool.

    Faces are few and chains short, so sweeps need no queue.
    """
    sides, held = terms.sides, members & terms.is_anchor
    is_growing = True
    while is_growing:
        is_growing = False
        for face in range(len(sides)):
            one, other = sides[face]
            if held[one] != held[other] and is_sewn[face] and members[one] and members[other]:
                held[one] = held[other] = is_growing = True
    return held


@part
def _limit(terms, is_sewn, off):
    """Return what it costs to cut what must come off all around.

    It is infinite only where there is no way at all: a vessel's tetrahedron among what must come off is lost however it is done,
    and one across a face can neither be cut from it nor have it removed.
    """
    limit = 0.0
    for face in range(len(terms.sides)):
        one, other = terms.sides[face]
        if is_sewn[face] and off[one] != off[other]:
            limit += terms.face_price[face]
    for tet in range(len(off)):
        if off[tet]:
            limit += terms.loss_price[tet]
    return limit


@part
def _network(terms, is_attached, is_sewn, off, limit):
    """Return arcs as (tails, heads, capacities in whole numbers); nodes are all in, all out, source, sink.

    limit: what it costs to cut all around what must come off. No flow exceeds that, and no capacity need be larger.
    """
    n_tets, n_sewn = len(is_attached), np.count_nonzero(is_sewn)
    n_arcs = 2 * (n_sewn + np.count_nonzero(is_attached)) + np.count_nonzero(off)
    tails, heads, capacities = np.empty(n_arcs, np.int64), np.empty(n_arcs, np.int64), np.empty(n_arcs, np.int64)
    scale = FLOW_LIMIT / limit if limit > 0.0 else 1.0
    # One above the limit on the whole flow is as good as endless.
    endless = np.float64(FLOW_LIMIT + n_sewn + n_tets)
    arc = 0
    for tet in range(n_tets):
        if is_attached[tet]:
            removal, loss = terms.removal_price[tet], terms.loss_price[tet]
            if terms.is_anchor[tet]:
                removal = loss = np.inf
            tails[arc], heads[arc], capacities[arc] = tet, n_tets + tet, _whole(removal, scale, endless)
            tails[arc + 1], heads[arc + 1], capacities[arc + 1] = n_tets + tet, 2 * n_tets + 1, _whole(loss, scale, endless)
            arc += 2
        if off[tet]:
            tails[arc], heads[arc], capacities[arc] = 2 * n_tets, tet, np.int64(endless)
            arc += 1
    for face in range(len(is_sewn)):
        if is_sewn[face]:
            one, other = terms.sides[face]
            tails[arc], heads[arc] = n_tets + one, other
            tails[arc + 1], heads[arc + 1] = n_tets + other, one
            capacities[arc] = capacities[arc + 1] = _whole(terms.face_price[face], scale, endless)
            arc += 2
    return tails, heads, capacities


@part
def _whole(price, scale, endless):
    """Return a price as a capacity."""
    return np.int64(min(np.rint(price * scale), endless))
