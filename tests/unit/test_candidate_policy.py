"""The candidate policy: blind to numbering, deaf to what is illegal, and the same for one state as for many."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

torch = pytest.importorskip("torch")

from agents.candidate_network import SAID, SIDE_OFFSET, STRAINED, TURNED  # noqa: E402
from agents.candidate_policy import OBSERVATION_KEYS, CandidatePolicy, _drawn, _prepared, read_candidates  # noqa: E402
from agents.features import OWN_FEATURES, SIDE_FEATURES  # noqa: E402
from agents.segments import segments  # noqa: E402
from agents.training_config import NetworkSettings  # noqa: E402
from envs.observation import COLUMNS  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from tests.small_scene import randomly_cut as states  # noqa: E402
from tests.small_scene import side_by_side, small_scene  # noqa: E402

SETTINGS = NetworkSettings(hidden=16, rounds=2, heads=3)


def make_policy(env, settings):
    """Return an untrained policy whose logits and values differ: by design the last layers start near zero."""
    torch.manual_seed(0)
    made = CandidatePolicy(env.observation_space, env.action_space, lambda _: 1e-3, network=settings)
    torch.nn.init.normal_(made.network.logit.weight)
    torch.nn.init.normal_(made.network.value.weight)
    return made


@pytest.fixture(scope="module")
def env():
    """Return an environment of 48 tetrahedra."""
    return ResectEnv(small_scene(seed=2, load=0.02))


@pytest.fixture(scope="module")
def policy(env):
    """Return a policy that sees everything."""
    return make_policy(env, SETTINGS)


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
    batch = side_by_side(found)
    together, _ = policy.predict(batch, deterministic=True)
    alone = [policy.predict(observation, deterministic=True)[0] for observation in found]
    assert together.tolist() == [int(action) for action in alone]


def test_what_the_policy_does_not_read_may_be_absent(env, policy):
    observation = states(env)[-1]
    reduced = {key: array for key, array in observation.items() if key in OBSERVATION_KEYS}
    assert policy.predict(reduced, deterministic=True)[0] == policy.predict(observation, deterministic=True)[0]


def test_a_state_without_a_legal_action_has_a_finite_value_and_leaves_the_others_alone(env, policy):
    found = states(env)
    batch = {key: torch.as_tensor(array) for key, array in side_by_side(found).items()}
    before = policy.predict_values(batch)
    batch["action_mask"][1] = 0
    after = policy.predict_values(batch)
    assert torch.isfinite(after).all()
    others = [0, *range(2, len(found))]
    torch.testing.assert_close(before[others], after[others])
    assert policy(batch)[0][1] == 0


# The network ------------------------------------------------------------------------------------------------------


def slow_forward(network, state):
    """Return the log-probabilities of one state's candidates, and its value, layer by layer as the module draws it."""
    columns = OWN_FEATURES, SIDE_FEATURES, [column.name for column in COLUMNS["globals"]]
    tables = (state.features, state.tetrahedra, state.of_state[0])
    features, tetrahedra, of_state = (
        torch.from_numpy(np.where(np.isin(names, TURNED), np.float32(0.0), table))
        for table, names in zip(tables, columns, strict=True)
    )
    links = torch.zeros(len(tetrahedra), len(tetrahedra))
    for row, others in enumerate(state.neighbours.tolist()):
        links[row, [other for other in others if other >= 0]] = 1.0
    known = network.embedding(tetrahedra).relu()
    for own, sent in zip(network.own, network.sent, strict=True):
        known = known + (own(known) + 0.5 * links @ sent(known)).relu()
    weight, said, place = (
        network.weight(known).softmax(0),
        network.said(known),
        torch.from_numpy(state.tetrahedra[:, SIDE_OFFSET : SIDE_OFFSET + 3]),
    )
    heard, centres = (weight.T @ said).flatten(), weight.T @ place
    assert said.shape[1] == SAID
    context = network.context(torch.cat([known.mean(0), known.amax(0), heard, of_state]))
    logits = []
    offsets = torch.from_numpy(state.features[:, [OWN_FEATURES.index(f"offset {axis}") for axis in "xyz"]])
    for own, offset, (one, two) in zip(features, offsets, state.sides.tolist(), strict=True):
        distance = torch.stack([(offset - centre) @ (offset - centre) for centre in centres])
        joined = network.of_candidate(own) + network.from_context(context) + network.from_distance(distance)
        joined = joined + network.of_sides[0](known[one]) + network.of_sides[1](known[two])
        logits.append(network.logit(network.encoder(joined.relu()).relu())[0])
    return torch.stack(logits).log_softmax(0), network.value(network.value_encoder(context))[0]


def test_the_network_has_the_values_and_the_slopes_of_one_state_after_the_other(env, policy, rng):
    # the last state has lost tetrahedra: rows of a state are not its ids
    candidates = read_candidates(side_by_side(states(env, n_cuts=8, seed=1)[::4]))
    weight = torch.tensor(rng.normal(size=len(candidates.action)), dtype=torch.float32)
    parts = [slow_forward(policy.network, state) for state in candidates.split()]
    expected = torch.cat([logs for logs, _ in parts]), torch.stack([value for _, value in parts])
    found = policy._score(candidates, None)[2:]
    slopes = []
    for logs, value in (expected, found):
        policy.zero_grad()
        ((weight * logs).sum() + (value**2).sum()).backward()
        slopes.append({name: parameter.grad.clone() for name, parameter in policy.network.named_parameters()})
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    for name, slope in slopes[0].items():
        # float32, sums over hundreds of candidates: round-off beside the largest slope of a layer
        torch.testing.assert_close(slopes[1][name], slope, atol=1e-4 * float(slope.abs().max()) + 1e-5, rtol=1e-3, msg=name)
        assert slope.any(), name


def test_what_is_far_away_is_heard_of_within_as_many_rounds_as_it_is_steps_off(env):
    """A change in one tetrahedron reaches, beside what all hear, only those within `rounds` steps."""
    state = read_candidates(side_by_side(states(env)[:1]))
    changed = state._replace(tetrahedra=state.tetrahedra.copy())
    changed.tetrahedra[0] += 1.0
    steps, near = {0: 0}, [0]
    for row in near:
        for other in state.neighbours[row].tolist():
            if other >= 0 and other not in steps:
                steps[other] = steps[row] + 1
                near.append(other)
    for rounds in (0, 1, 3):
        made = make_policy(env, NetworkSettings(hidden=16, rounds=rounds))
        with torch.no_grad():
            known = [made.network._known(torch.from_numpy(each.tetrahedra), graph_of(each)) for each in (state, changed)]
        differs = (known[0] != known[1]).any(dim=1)
        assert set(torch.nonzero(differs).flatten().tolist()) <= {row for row, step in steps.items() if step <= rounds}
        assert max(steps[row] for row in torch.nonzero(differs).flatten().tolist()) == rounds


def test_the_tetrahedra_of_a_batch_are_numbered_through(env):
    batch = read_candidates(side_by_side(states(env, n_cuts=3, seed=1)))
    seen, graph = _prepared(batch)
    sides, neighbours = [], []
    for state in range(len(batch.of_state)):
        start, stop = batch.tetrahedron_offset[state : state + 2]
        sides += [start + pair for pair in batch.sides[batch.offset[state] : batch.offset[state + 1]]]
        neighbours += [[start + other for other in four if other >= 0] for four in batch.neighbours[start:stop]]
    np.testing.assert_array_equal(seen.sides.T, sides)
    ends = graph.offset.tolist()
    assert [graph.neighbours[first:last].tolist() for first, last in zip(ends, ends[1:], strict=False)] == neighbours
    assert ends[-1] == len(graph.neighbours)


def graph_of(state):
    """Return who is sewn to whom in a single state."""
    return _prepared(state)[1]


def turned(observation, rng):
    """Return the same state with the whole scene turned, mirrored and moved."""
    turn, other = Rotation.random(random_state=rng).as_matrix() @ np.diag([1.0, 1.0, -1.0]), dict(observation)
    for table, column_names in COLUMNS.items():
        other[table] = observation[table].copy()
        names = [column.name for column in column_names]
        for place, name in enumerate(names):
            if name.endswith("_x"):
                other[table][..., place : place + 3] = observation[table][..., place : place + 3] @ turn.T
    for table, name in (("nodes", "position_x"), ("faces", "centroid_x")):
        place = [column.name for column in COLUMNS[table]].index(name)
        other[table][..., place : place + 3] += (0.3, -0.7, 1.1)
    return other


def test_to_turn_mirror_and_move_the_whole_scene_changes_nothing(env, policy, rng):
    for observation in states(env):
        expected, value = log_probabilities(policy, observation)
        found, other_value = log_probabilities(policy, turned(observation, rng))
        # float32 round-off, of coordinates of the order of ten
        np.testing.assert_allclose(found, expected, atol=1e-3)
        assert other_value == pytest.approx(value, abs=1e-3)


# Blindness to strain ----------------------------------------------------------------------------------------------

SHOWS_STRAIN = {
    "nodes": ("strain",),
    "tetrahedra": ("strain", "volume_ratio"),
    "globals": ("healthy_strain", "target_strain", "lowest_volume_ratio"),
}
"""Columns of the observation that tell how strained the body is."""


def strained_otherwise(observation, rng):
    """Return the same body, strained in another way."""
    other = {name: array.copy() for name, array in observation.items()}
    for table, names in SHOWS_STRAIN.items():
        for name in names:
            place = [column.name for column in COLUMNS[table]].index(name)
            other[table][..., place] += rng.uniform(0.1, 0.5, other[table].shape[:-1])
    return other


def test_only_a_policy_that_is_not_blind_to_strain_heeds_it(env, policy, rng):
    blind = make_policy(env, SETTINGS.model_copy(update={"is_blind_to_strain": True}))
    for observation in states(env):
        other = strained_otherwise(observation, rng)
        for reader, is_blind in ((blind, True), (policy, False)):
            before, after = (log_probabilities(reader, seen) for seen in (observation, other))
            assert np.array_equal(before[0], after[0], equal_nan=True) == is_blind
            assert (before[1] == after[1]) == is_blind


def test_each_single_number_of_a_strain_is_hidden_and_no_other(env, policy):
    blind = make_policy(env, SETTINGS.model_copy(update={"is_blind_to_strain": True}))
    candidates = read_candidates(side_by_side(states(env)[:1]))
    of_state = [column.name for column in COLUMNS["globals"]]
    for part, names in (("features", OWN_FEATURES), ("tetrahedra", SIDE_FEATURES), ("of_state", of_state)):
        for place, name in enumerate(names):
            table = getattr(candidates, part).copy()
            table[:, place] += np.linspace(1.0, 2.0, len(table))
            changed = candidates._replace(**{part: table})
            for reader, sees in ((policy, True), (blind, name not in STRAINED)):
                sees &= not name.startswith("load_direction")  # it is in the distances along the load
                with torch.no_grad():
                    before, after = (reader._score(each, None)[2:] for each in (candidates, changed))
                assert sees != all(map(torch.equal, before, after)), name


# Drawing ----------------------------------------------------------------------------------------------------------


def test_rows_are_drawn_as_often_as_they_are_likely():
    probability = torch.tensor([0.5, 0.2, 0.3, 1.0, 0.0, 1.0])
    of, n_draws = segments(np.array([0, 3, 4, 6])), 4000
    torch.manual_seed(0)
    drawn = np.array([_drawn(probability.log(), of).numpy() for _ in range(n_draws)])
    frequency = np.bincount(drawn[:, 0], minlength=3) / n_draws
    # Four standard errors of a frequency of a half.
    np.testing.assert_allclose(frequency, probability[:3], atol=4 * 0.5 / np.sqrt(n_draws))
    assert (drawn[:, 1:] == [3, 5]).all()
