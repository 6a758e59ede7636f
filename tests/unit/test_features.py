"""What the candidate policy is shown: of each legal cut and of each of its sides, what a slow loop finds by name."""

import numpy as np
import pytest

from agents import features
from agents.features import N_OWN, N_SIDE, OWN_FEATURES, SIDE_FEATURES, Candidates, Observed, gather_candidates, join
from envs.observation import COLUMNS
from envs.resect import ResectEnv
from tests.small_scene import randomly_cut, side_by_side, small_scene

STRAINED = ("strain", "volume ratio")
"""What sides are compared by last."""


@pytest.fixture(scope="module", params=[("all", (2, 2, 2)), ("focus", (3, 3, 2))], ids=["all", "focus"])
def states(request):
    """Return the states of an episode in which some tetrahedra are taken away; mask "focus" hides those far from the target."""
    mask, cells = request.param
    found = randomly_cut(ResectEnv(small_scene(seed=2, load=0.02, cells=cells), mask=mask), n_cuts=8, seed=1)
    n_attached, n_shown = ([len(count(observation)) for observation in found] for count in (slow_attached, slow_shown))
    assert n_attached[-1] < n_attached[0] == 6 * np.prod(cells)
    assert n_shown == n_attached if mask == "all" else n_shown[0] < n_attached[0]
    return found


def gathered(observations):
    """Return the candidates of a batch of observations."""
    batch = side_by_side(observations)
    return gather_candidates(Observed(*(batch[name] for name in Observed._fields)), batch["action_mask"])


def column(table, name):
    """Return the number of a column of the observation."""
    return [item.name for item in COLUMNS[table]].index(name)


def slow_attached(observation):
    """Return the ids of the tetrahedra that hang on an anchor."""
    return np.flatnonzero(observation["tetrahedra"][:, column("tetrahedra", "attached")])


def slow_shown(observation):
    """Return the ids of the tetrahedra that are a side of a legal action, ascending."""
    legal, n_faces = np.flatnonzero(observation["action_mask"]), len(observation["faces"])
    sides = observation["face_tetrahedra"][legal[legal < n_faces]].astype(int)
    return np.unique(np.concatenate([sides.ravel(), legal[legal >= n_faces] - n_faces]))


def slow_centroid(observation, tet):
    """Return the rest centroid of a live tetrahedron."""
    rows = observation["nodes"][observation["tetrahedron_nodes"][tet].astype(int)]
    position, displacement = column("nodes", "position_x"), column("nodes", "displacement_x")
    return (rows[:, position : position + 3] - rows[:, displacement : displacement + 3]).mean(axis=0)


def slow_offset(observation, place):
    """Return how far a place lies from the centre of the target, scaled, by axis and along two directions."""
    target, anchors = (slow_centre(observation, kind) for kind in ("target", "anchor"))
    offset = features.OFFSET_SCALE * (place - target)
    start = column("globals", "load_direction_x")
    return dict(zip(("offset x", "offset y", "offset z"), offset, strict=True)) | {
        "distance": np.linalg.norm(offset),
        "distance along the load": offset @ observation["globals"][start : start + 3],
        "distance towards the anchors": offset @ (anchors - target) / np.linalg.norm(anchors - target),
    }


def slow_centre(observation, kind):
    """Return the mean rest centroid of the tetrahedra of a kind."""
    is_kind = observation["tetrahedra"][:, column("tetrahedra", kind)] > 0.0
    return np.mean([slow_centroid(observation, tet) for tet in slow_attached(observation) if is_kind[tet]], axis=0)


def slow_side(observation, tet):
    """Return what a tetrahedron shows, by name."""
    row = {item.name.replace("_", " "): observation["tetrahedra"][tet, i] for i, item in enumerate(COLUMNS["tetrahedra"])}
    neighbours = observation["tetrahedron_neighbours"][tet].astype(int)
    targets = observation["tetrahedra"][neighbours[neighbours >= 0], column("tetrahedra", "target")]
    nodes = observation["tetrahedron_nodes"][tet].astype(int)
    more = {
        "target neighbours": targets.sum() / 4.0,
        "healthy neighbours": (1.0 - targets).sum() / 4.0,
        "node mass": observation["nodes"][nodes, column("nodes", "mass")].mean(),
    }
    return row | more | slow_offset(observation, slow_centroid(observation, tet))


def slow_candidate(observation, action):
    """Return (features of one candidate, the ids of its sides, the higher first)."""
    n_faces = len(observation["faces"])
    if action < n_faces:
        tetrahedra = observation["face_tetrahedra"][action].astype(int).tolist()
        start = column("faces", "centroid_x")
        place = observation["faces"][action, start : start + 3]
        area = observation["faces"][action, column("faces", "area")]
    else:
        tetrahedra = [int(action) - n_faces] * 2
        place, area = slow_centroid(observation, tetrahedra[0]), 0.0
    order = [name for name in SIDE_FEATURES if name not in STRAINED] + list(STRAINED)
    shown = {tet: slow_side(observation, tet) for tet in tetrahedra}
    tetrahedra.sort(key=lambda tet: [shown[tet][name] for name in order], reverse=True)
    one, other = (shown[tet] for tet in tetrahedra)
    offset = slow_offset(observation, place)
    own = offset | {
        "is a face": float(action < n_faces),
        "area": area,
        "both sides target": one["target"] * other["target"],
        "one side target": abs(one["target"] - other["target"]),
        "an anchor": max(one["anchor"], other["anchor"]),
        "highest healthy strain": max(side["strain"] * (1.0 - side["target"]) for side in (one, other)),
    }
    return [own[name] for name in OWN_FEATURES], tetrahedra


def test_what_candidates_show_and_their_sides_are_what_a_slow_loop_finds(states):
    for observation in (states[0], states[-1]):
        found, shown = gathered([observation]), slow_shown(observation)
        np.testing.assert_array_equal(found.action, np.flatnonzero(observation["action_mask"]))
        for action, own, sides in zip(found.action, found.features, found.sides, strict=True):
            expected, tetrahedra = slow_candidate(observation, action)
            np.testing.assert_allclose(own, expected, atol=1e-5)
            assert shown[sides].tolist() == tetrahedra


def test_what_tetrahedra_show_is_what_a_slow_loop_finds(states):
    for observation in (states[0], states[-1]):
        shown = slow_shown(observation)
        found = gathered([observation]).tetrahedra
        assert len(found) == len(shown)
        for tet, side in zip(shown, found, strict=True):
            expected = slow_side(observation, tet)
            np.testing.assert_allclose(side, [expected[name] for name in SIDE_FEATURES], atol=1e-5)


def test_neighbours_are_the_shown_tetrahedra_across_sewn_faces(states):
    for observation in states:
        shown = slow_shown(observation).tolist()
        across = observation["tetrahedron_neighbours"][shown].astype(int)
        expected = [[shown.index(other) if other in shown else -1 for other in row] for row in across.tolist()]
        found = gathered([observation]).neighbours
        assert found.tolist() == expected
        links = {(row, other) for row, others in enumerate(found.tolist()) for other in others if other >= 0}
        assert links == {(other, row) for row, other in links}
        # a face is sewn where its row is not of zeros: no other pair may speak to each other
        sewn = observation["faces"][:, column("faces", "sewn")] > 0.0
        pairs = observation["face_tetrahedra"][sewn].astype(int)
        pairs = pairs[np.isin(pairs, shown).all(axis=1)]
        assert {(shown[row], shown[other]) for row, other in links} == set(map(tuple, np.vstack([pairs, pairs[:, ::-1]])))


def test_a_batch_is_gathered_as_its_observations_are(states):
    together = gathered(states).split()
    assert len(together) == len(states)
    for one, observation in zip(together, states, strict=True):
        for name, part, alone in zip(Candidates._fields, one, gathered([observation]), strict=True):
            np.testing.assert_array_equal(part, alone, err_msg=name)


def test_candidates_that_are_taken_apart_and_joined_in_another_order_are_the_same(states):
    parts = gathered(states).split()
    assert [len(part.action) for part in parts] == [int(observation["action_mask"].sum()) for observation in states]
    for name, one, other in zip(Candidates._fields, join(parts[::-1]), gathered(states[::-1]), strict=True):
        np.testing.assert_array_equal(one, other, err_msg=name)
        assert one.dtype == other.dtype, name


def test_what_was_gathered_stays_when_the_observation_is_overwritten(states):
    batch = side_by_side(states[:2])
    found = gather_candidates(Observed(*(batch[name] for name in Observed._fields)), batch["action_mask"])
    before = [part.copy() for part in found]
    for array in batch.values():
        array[:] = 0
    for one, other in zip(found, before, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_state_without_a_legal_action_or_a_tetrahedron_has_one_of_each_that_shows_nothing(states):
    nothing = {name: np.zeros_like(array) for name, array in states[0].items()}
    first, empty, last = gathered([states[0], nothing, states[-1]]).split()
    for part in ("action", "features", "tetrahedra", "sides"):
        found = getattr(empty, part)
        assert len(found) == 1 and not found.any(), part
    assert empty.neighbours.tolist() == [[-1] * 4]
    for found, observation in ((first, states[0]), (last, states[-1])):
        for one, other in zip(found, gathered([observation]), strict=True):
            np.testing.assert_array_equal(one, other)


def test_the_numbers_of_columns_are_those_of_the_observation():
    expected = {
        "POSITION": ("nodes", "position_x"),
        "DISPLACEMENT": ("nodes", "displacement_x"),
        "NODE_MASS": ("nodes", "mass"),
        "AREA": ("faces", "area"),
        "CENTROID": ("faces", "centroid_x"),
        "ATTACHED": ("tetrahedra", "attached"),
        "IS_TARGET": ("tetrahedra", "target"),
        "LOAD_DIRECTION": ("globals", "load_direction_x"),
    }
    assert {name: getattr(features, name) for name in expected} == {name: column(*at) for name, at in expected.items()}
    copied = [item.name.replace("_", " ") for item in COLUMNS["tetrahedra"]][features.IS_TARGET :]
    assert tuple(copied) == SIDE_FEATURES[: len(copied)]
    assert (N_OWN, N_SIDE) == (len(OWN_FEATURES), len(SIDE_FEATURES))


def test_nothing_that_the_optimum_is_made_of_is_read():
    assert not {"cost_ratio", "optimum"} & {item.name for item in COLUMNS["globals"]}
