"""The candidate policy: blind to numbering, deaf to what is illegal, and read from files that cannot run code."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents import features  # noqa: E402
from agents.candidate_network import CandidateNetwork  # noqa: E402
from agents.candidate_policy import CandidatePolicy, _drawn  # noqa: E402
from agents.features import N_FEATURES, OWN_FEATURES, SIDE_FEATURES, Observed, gather_candidates, join  # noqa: E402
from agents.segments import highest, log_softmax, segments, spread, total  # noqa: E402
from envs.observation import COLUMNS  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from tests.small_scene import small_scene  # noqa: E402


@pytest.fixture(scope="module")
def env():
    """Return an environment of 48 tetrahedra."""
    return ResectEnv(small_scene(seed=2, load=0.02))


@pytest.fixture(scope="module")
def policy(env):
    """Return an untrained policy whose logits differ: by design the last layer starts near zero."""
    torch.manual_seed(0)
    made = CandidatePolicy(env.observation_space, env.action_space, lambda _: 1e-3, hidden=16)
    torch.nn.init.normal_(made.network.logit.weight)
    return made


def states(env, n_cuts=4, seed=0):
    """Return the observations of an episode of random cuts."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=0)
    found = [observation]
    for _ in range(n_cuts):
        observation, *_ = env.step(int(rng.choice(np.flatnonzero(observation["action_mask"]))))
        found.append(observation)
    return found


def renumbered(observation, rng):
    """Return the same state with faces and tetrahedra renumbered and the sides of faces swapped, and old action ids.

    The old id of new action a is `old[a]`.
    """
    n_faces, n_tets = len(observation["faces"]), len(observation["tetrahedra"])
    face, tet = rng.permutation(n_faces), rng.permutation(n_tets)
    new_of = np.append(np.argsort(tet), -1).astype(np.float32)
    swapped = dict(observation)
    for name in ("tetrahedra", "tetrahedron_nodes", "tetrahedron_neighbours", "components"):
        swapped[name] = observation[name][tet]
    swapped["tetrahedron_neighbours"] = new_of[swapped["tetrahedron_neighbours"].astype(int)]
    swapped["faces"] = observation["faces"][face]
    sides = new_of[observation["face_tetrahedra"][face].astype(int)]
    swapped["face_tetrahedra"] = np.where(rng.random(n_faces)[:, None] < 0.5, sides, sides[:, ::-1])
    old = np.concatenate([face, n_faces + tet])
    swapped["action_mask"] = observation["action_mask"][old]
    return swapped, old


def log_probabilities(policy, observation):
    """Return the log-probability of every legal action by id, and the value."""
    batch = {key: torch.as_tensor(array)[None] for key, array in observation.items()}
    legal = np.flatnonzero(observation["action_mask"])
    batch = {key: tensor.expand(len(legal), *tensor.shape[1:]) for key, tensor in batch.items()}
    with torch.no_grad():
        value, log_probability, _ = policy.evaluate_actions(batch, torch.as_tensor(legal))
    found = np.full(len(observation["action_mask"]), np.nan)
    found[legal] = log_probability.numpy()
    return found, float(value[0, 0])


def test_renumbering_the_mesh_permutes_the_probabilities_and_keeps_the_value(env, policy, rng):
    for observation in states(env):
        other, old = renumbered(observation, rng)
        expected, value = log_probabilities(policy, observation)
        found, other_value = log_probabilities(policy, other)
        # Sums over candidates run in another order: float32 round-off.
        np.testing.assert_allclose(found, expected[old], atol=1e-4)
        assert other_value == pytest.approx(value, abs=1e-4)
        assert np.nanstd(expected) > 1e-2


def test_probabilities_of_the_legal_actions_sum_to_one(env, policy):
    for observation in states(env):
        found, _ = log_probabilities(policy, observation)
        assert np.nansum(np.exp(found)) == pytest.approx(1.0, abs=1e-5)


def test_only_legal_actions_are_predicted(env, policy):
    torch.manual_seed(0)
    for observation in states(env):
        narrow = dict(observation)
        narrow["action_mask"] = np.zeros_like(observation["action_mask"])
        narrow["action_mask"][[1, 5, len(narrow["action_mask"]) - 1]] = 1
        drawn = {int(policy.predict(narrow)[0]) for _ in range(60)}
        assert drawn == set(np.flatnonzero(narrow["action_mask"]))


def test_a_mask_that_is_handed_over_counts_instead_of_the_observation_s(env, policy):
    observation = states(env)[0]
    mask = np.zeros(env.action_space.n, dtype=bool)
    mask[7] = True
    assert policy.predict(observation, action_masks=mask)[0] == 7


def test_a_batch_gives_the_same_as_one_observation_after_the_other(env, policy):
    found = states(env, n_cuts=8)
    batch = {key: np.stack([observation[key] for observation in found]) for key in found[0]}
    together, _ = policy.predict(batch, deterministic=True)
    alone = [policy.predict(observation, deterministic=True)[0] for observation in found]
    assert together.tolist() == [int(action) for action in alone]


def test_what_the_policy_does_not_read_may_be_absent(env, policy):
    observation = states(env)[-1]
    reduced = {key: array for key, array in observation.items() if key in (*Observed._fields, "action_mask")}
    assert policy.predict(reduced, deterministic=True)[0] == policy.predict(observation, deterministic=True)[0]


def test_a_state_without_a_legal_action_has_a_finite_value_and_leaves_the_others_alone(env, policy):
    found = states(env)
    batch = {key: torch.as_tensor(np.stack([observation[key] for observation in found])) for key in found[0]}
    before = policy.predict_values(batch)
    batch["action_mask"][1] = 0
    after = policy.predict_values(batch)
    assert torch.isfinite(after).all()
    others = [0, *range(2, len(found))]
    torch.testing.assert_close(before[others], after[others])
    assert policy(batch)[0][1] == 0


def test_features_are_what_a_slow_loop_finds(env):
    observation = states(env)[-1]
    observed = Observed(*(observation[name][None] for name in Observed._fields))
    candidates = gather_candidates(observed, observation["action_mask"][None])
    assert candidates.offset.tolist() == [0, observation["action_mask"].sum()]
    for action, row in zip(candidates.action, candidates.features, strict=True):
        np.testing.assert_allclose(row, slow_features(observation, action), atol=1e-5)


def test_a_batch_is_gathered_as_its_observations_are(env):
    found = states(env, n_cuts=5)
    observed = Observed(*(np.stack([observation[name] for observation in found]) for name in Observed._fields))
    mask = np.stack([observation["action_mask"] for observation in found])
    together = gather_candidates(observed, mask)
    for number, first in enumerate(together.offset[:-1]):
        alone = gather_candidates(Observed(*(part[number : number + 1] for part in observed)), mask[number : number + 1])
        own = slice(first, together.offset[number + 1])
        np.testing.assert_array_equal(together.action[own], np.flatnonzero(mask[number]))
        np.testing.assert_array_equal(together.features[own], alone.features)


def test_candidates_that_are_taken_apart_and_joined_are_the_same(env):
    found = states(env, n_cuts=5)
    observed = Observed(*(np.stack([observation[name] for observation in found]) for name in Observed._fields))
    candidates = gather_candidates(observed, np.stack([observation["action_mask"] for observation in found]))
    parts = candidates.split()
    assert [len(part.action) for part in parts] == np.diff(candidates.offset).tolist()
    for one, other in zip(join(parts), candidates, strict=True):
        np.testing.assert_array_equal(one, other)


def slow_features(observation, action):
    """Return the features of one candidate, found by names of columns and without haste."""
    n_faces = len(observation["faces"])
    is_face = action < n_faces
    if is_face:
        tetrahedra = observation["face_tetrahedra"][action].astype(int)
        place, area = observation["faces"][action, 2:], observation["faces"][action, column("faces", "area")]
    else:
        tetrahedra = [action - n_faces] * 2
        place, area = slow_centroid(observation, tetrahedra[0]), 0.0
    sides = [slow_side(observation, tet) for tet in tetrahedra]
    sides.sort(key=lambda side: [side[name] for name in SIDE_FEATURES], reverse=True)
    tets = observation["tetrahedra"]
    target = [tet for tet in range(len(tets)) if tets[tet, column("tetrahedra", "target")]]
    offset = 0.5 * (place - np.mean([slow_centroid(observation, tet) for tet in target], axis=0))
    own = {
        "is a face": float(is_face),
        "area": area,
        "both sides target": sides[0]["target"] * sides[1]["target"],
        "one side target": abs(sides[0]["target"] - sides[1]["target"]),
        "an anchor": max(side["anchor"] for side in sides),
        "highest healthy strain": max(side["strain"] * (1.0 - side["target"]) for side in sides),
        "offset x": offset[0],
        "offset y": offset[1],
        "offset z": offset[2],
        "distance": np.linalg.norm(offset),
        "distance along the load": offset @ observation["globals"][:3],
    }
    return [own[name] for name in OWN_FEATURES] + [side[name] for side in sides for name in SIDE_FEATURES]


def slow_side(observation, tet):
    """Return what a tetrahedron shows as a side, by name."""
    row = {item.name: observation["tetrahedra"][tet, i] for i, item in enumerate(COLUMNS["tetrahedra"])}
    neighbours = observation["tetrahedron_neighbours"][tet].astype(int)
    targets = observation["tetrahedra"][neighbours[neighbours >= 0], column("tetrahedra", "target")]
    nodes = observation["tetrahedron_nodes"][tet].astype(int)
    more = {
        "free faces": row["free_faces"],
        "cut faces": row["cut_faces"],
        "volume ratio": row["volume_ratio"],
        "target neighbours": targets.sum() / 4.0,
        "healthy neighbours": (1.0 - targets).sum() / 4.0,
        "node mass": observation["nodes"][nodes, column("nodes", "mass")].mean(),
    }
    return row | more


def slow_centroid(observation, tet):
    """Return the rest centroid of a live tetrahedron."""
    rows = observation["nodes"][observation["tetrahedron_nodes"][tet].astype(int)]
    position, displacement = column("nodes", "position_x"), column("nodes", "displacement_x")
    return (rows[:, position : position + 3] - rows[:, displacement : displacement + 3]).mean(axis=0)


def column(table, name):
    """Return the number of a column of the observation."""
    return [item.name for item in COLUMNS[table]].index(name)


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
    assert N_FEATURES == len(OWN_FEATURES) + 2 * len(SIDE_FEATURES)


def test_nothing_that_the_optimum_is_made_of_is_read():
    assert not {"cost_ratio", "optimum"} & {item.name for item in COLUMNS["globals"]}


# Segments ---------------------------------------------------------------------------------------------------------

COUNTS = [3, 1, 40, 7]
"""Rows of some states."""


def ragged():
    """Return the segments of some states, and which rows they are."""
    offset = np.append(0, np.cumsum(COUNTS))
    return segments(offset), [slice(first, last) for first, last in zip(offset[:-1], offset[1:], strict=True)]


def slow_spread(states, own):
    """Return each state's numbers once for each of its rows."""
    return torch.cat([states[i].expand(rows.stop - rows.start, *states.shape[1:]) for i, rows in enumerate(own)])


# Functions of numbers and segments, the same of numbers and slices, and the shape of the numbers.
TWINS = {
    "total": (total, lambda rows, own: torch.stack([rows[part].sum(0) for part in own]), (sum(COUNTS), 5)),
    "total of one lane": (total, lambda rows, own: torch.stack([rows[part].sum() for part in own]), (sum(COUNTS),)),
    "spread": (spread, slow_spread, (len(COUNTS), 5)),
    "spread of one lane": (spread, slow_spread, (len(COUNTS),)),
    "maximum": (
        lambda rows, of: rows.gather(0, highest(rows, of)),
        lambda rows, own: torch.stack([rows[part].amax(0) for part in own]),
        (sum(COUNTS), 5),
    ),
    "log_softmax": (
        lambda rows, of: log_softmax(60.0 * rows, of),
        lambda rows, own: torch.cat([(60.0 * rows[part]).log_softmax(0) for part in own]),
        (sum(COUNTS),),
    ),
}


@pytest.mark.parametrize(("fast", "slow", "shape"), TWINS.values(), ids=TWINS)
def test_what_is_done_to_segments_has_the_value_and_the_slope_of_a_loop(fast, slow, shape, rng):
    of, own = ragged()
    numbers = [torch.tensor(rng.normal(size=shape), dtype=torch.float32, requires_grad=True) for _ in range(2)]
    numbers[1].data.copy_(numbers[0].data)
    found, expected = fast(numbers[0], of), slow(numbers[1], own)
    weight = torch.tensor(rng.normal(size=tuple(expected.shape)), dtype=torch.float32)
    for result in (found, expected):
        (weight * result).sum().backward()
    # Sums of 40 numbers of size 1, or logits of size 200, in float32.
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-5)
    torch.testing.assert_close(numbers[0].grad, numbers[1].grad, atol=1e-3, rtol=1e-4)


def slow_forward(network, features, of_state):
    """Return the log-probabilities of one state's candidates, and its value, layer by layer as the module draws it."""
    encoded = network.encoder(features)
    context = network.context(torch.cat([encoded.mean(0), encoded.amax(0), of_state]))
    joined = network.from_candidate(encoded) + network.from_context(context)
    return network.logit(joined.relu())[:, 0].log_softmax(0), network.value(network.value_encoder(context))[0]


def test_the_network_has_the_values_and_the_slopes_of_one_state_after_the_other(rng):
    of, own = ragged()
    torch.manual_seed(0)
    network = CandidateNetwork(6, 16)
    torch.nn.init.normal_(network.logit.weight)
    features = torch.tensor(rng.normal(size=(sum(COUNTS), N_FEATURES)), dtype=torch.float32)
    of_state = torch.tensor(rng.normal(size=(len(COUNTS), 6)), dtype=torch.float32)
    weight = torch.tensor(rng.normal(size=sum(COUNTS)), dtype=torch.float32)
    parts = [slow_forward(network, features[rows], of_state[i]) for i, rows in enumerate(own)]
    expected = torch.cat([logs for logs, _ in parts]), torch.stack([value for _, value in parts])
    found = network(features, of, of_state)
    slopes = []
    for logs, value in (expected, found):
        network.zero_grad()
        ((weight * logs).sum() + (value**2).sum()).backward()
        slopes.append([parameter.grad.clone() for parameter in network.parameters()])
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(slopes[1], slopes[0], atol=1e-4, rtol=1e-3)


def test_rows_are_drawn_as_often_as_they_are_likely():
    probability = torch.tensor([0.5, 0.2, 0.3, 1.0, 0.0, 1.0])
    of, n_draws = segments(np.array([0, 3, 4, 6])), 4000
    torch.manual_seed(0)
    drawn = np.array([_drawn(probability.log(), of).numpy() for _ in range(n_draws)])
    frequency = np.bincount(drawn[:, 0], minlength=3) / n_draws
    # Four standard errors of a frequency of a half.
    np.testing.assert_allclose(frequency, probability[:3], atol=4 * 0.5 / np.sqrt(n_draws))
    assert (drawn[:, 1:] == [3, 5]).all()
