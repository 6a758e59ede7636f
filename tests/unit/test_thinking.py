"""Policies that think: what they try leaves no trace, is counted to the step, and keeps a body standing that else collapses."""

import numpy as np
import pytest

from agents.choice import home_of, make_policy
from agents.evaluation import evaluate, play_episode
from agents.scripted import ScriptedPolicy
from agents.search import SearchPolicy
from agents.shield import ShieldedPolicy
from agents.trials import Trials, has_collapsed, n_simulated
from envs.baselines import cheapest_plan, levers
from envs.collapse import SEPARATED
from envs.resect import ResectEnv
from envs.task import Resection
from gmapspring.errors import ConfigError
from tests.bits import assert_same_bits, bits_of
from tests.small_scene import small_scene

THINKERS = (
    "lookahead", "search:40", "shield:min-cut-index", "shield:lookahead", "shield:search:40", "foresight:40:min-cut-index",
    "foresight:40:shield:rim-first",
)  # fmt: skip
FIRST = np.array([True])


def level_0(n_scenes, **how):
    """Return the environment of the first validation scenes of level 0."""
    env = ResectEnv("box-48", "validation", **how)
    return ResectEnv([env.scenes[index] for index in range(n_scenes)], **how)


def outcomes(env, actions):
    """Return after which of some actions the body gives way and how far its healthy tissue strains, (n,) each."""
    found = []
    for action in actions:
        with Trials().after(env.task, int(action)):
            found.append((has_collapsed(env.task), env.task.tissue.healthy_strain))
    return np.array(found).T


def can_survive(task, plan):
    """Return whether any order of a plan's actions frees the target, by trying them all."""
    if task.outcome == SEPARATED:
        return True
    for action in plan:
        with Trials().after(task, action):
            if not has_collapsed(task) and can_survive(task, plan - {action}):
                return True
    return False


class WorstPolicy:
    """Propose the legal cut after which healthy tissue strains most."""

    def __init__(self, env):
        self.env, self.n_asked = env, 0
        self._known = None

    def predict(self, observation, state=None, episode_start=None, deterministic=False, action_masks=None):
        legal = np.flatnonzero(observation["action_mask"])
        if self._known is None or self._known[0] != self.env.n_steps:
            self._known = self.env.n_steps, legal[np.argsort(-outcomes(self.env, legal)[1], kind="stable")]
        self.n_asked += 1
        return next(int(action) for action in self._known[1] if action_masks is None or action_masks[action]), state


class ForgetfulPolicy(SearchPolicy):
    """Do something else than was searched, at every other step."""

    def choose(self, situation):
        found = super().choose(situation)
        return found if situation.env.n_steps % 2 else int(situation.legal[-1])


@pytest.fixture
def n_real_steps(monkeypatch):
    """Return a list that grows with every step that any simulator takes."""
    taken, step = [], Resection.step
    monkeypatch.setattr(Resection, "step", lambda task, action: taken.append(action) or step(task, action))
    return taken


# What all have in common ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", THINKERS)
@pytest.mark.parametrize("mask", ["all", "reachable"])
def test_thinking_leaves_no_trace(name, mask):
    thoughtful, blank = level_0(1, mask=mask), level_0(1, mask=mask)
    policy = make_policy(name, thoughtful, seed=0)
    seen, same = thoughtful.reset(seed=0)[0], blank.reset(seed=0)[0]
    has_ended = False
    while not has_ended:
        before = bits_of(thoughtful.task.simulation)
        action, _ = policy.predict(seen)
        assert_same_bits(bits_of(thoughtful.task.simulation), before)
        seen, *judged = thoughtful.step(action)
        same, *expected = blank.step(action)
        assert_same_bits(seen, same)
        assert judged == expected
        has_ended = judged[1] or judged[2]
    assert policy.n_simulated > 0


@pytest.mark.parametrize("name", [*THINKERS, "certificate", "shield:shield:search:7"])
def test_every_step_of_the_simulator_is_counted(name, n_real_steps):
    env = level_0(2)
    policy = make_policy(name, env, seed=0)
    episodes = evaluate(policy, env, name=name)
    assert sum(episode.n_simulated for episode in episodes) == n_simulated(policy)
    assert n_simulated(policy) == len(n_real_steps) - sum(episode.n_steps for episode in episodes)


# The shield -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("index", [0, 1, 5])
def test_a_shielded_policy_survives_wherever_a_safe_cut_existed(index):
    env = level_0(index + 1)
    observation, _ = env.reset(seed=0, options={"index": index, "load_factor": 1.5})
    worst, _ = WorstPolicy(env).predict(observation)
    assert outcomes(env, [worst])[0].all(), "the wrapped policy collapses at once"
    shield, has_ended = ShieldedPolicy(WorstPolicy(env), env), False
    while not has_ended:
        is_fatal, _ = outcomes(env, np.flatnonzero(observation["action_mask"]))
        action, _ = shield.predict(observation)
        observation, _, terminated, truncated, _ = env.step(action)
        has_ended = terminated or truncated
        assert has_collapsed(env.task) == is_fatal.all()
    assert env.n_steps > 1


def test_where_nothing_is_safe_the_first_proposal_is_done():
    env = ResectEnv(small_scene(load=5.0))
    observation, _ = env.reset(seed=0)
    legal = np.flatnonzero(observation["action_mask"])
    assert outcomes(env, legal)[0].all()
    shield = ShieldedPolicy(ScriptedPolicy("min-cut-index").bind(env), env)
    assert shield.predict(observation)[0] == ScriptedPolicy("min-cut-index").bind(env).predict(observation)[0]
    assert shield.n_simulated == len(legal)


def test_a_shield_asks_no_more_often_than_it_may():
    env = ResectEnv(small_scene(load=5.0))
    observation, _ = env.reset(seed=0)
    worst = WorstPolicy(env)
    ShieldedPolicy(worst, env, n_proposals=3).predict(observation)
    assert worst.n_asked == 3
    with pytest.raises(ConfigError, match="at least 1"):
        ShieldedPolicy(worst, env, n_proposals=0)


def test_a_shield_takes_a_batch_of_one_and_a_narrower_mask():
    env = ResectEnv(small_scene(load=0.02))
    observation, _ = env.reset(seed=0)
    shield = ShieldedPolicy(ScriptedPolicy("min-cut-index").bind(env), env)
    alone, _ = shield.predict(observation)
    (batched,), _ = shield.predict({key: array[None] for key, array in observation.items()}, episode_start=FIRST)
    assert alone == batched
    mask = np.zeros(env.action_space.n, dtype=bool)
    mask[[3, 40]] = True
    assert shield.predict(observation, action_masks=mask)[0] in (3, 40)
    assert np.flatnonzero(mask).tolist() == [3, 40], "the mask of the caller is left as it was"


def test_a_learned_policy_can_be_shielded():
    pytest.importorskip("torch")
    from agents.candidate_policy import CandidatePolicy
    from agents.training_config import NetworkSettings

    env = level_0(2)
    observation, _ = env.reset(seed=0, options={"index": 1, "load_factor": 1.5})
    network = NetworkSettings(hidden=16, rounds=1)
    learned = CandidatePolicy(env.observation_space, env.action_space, lambda _: 0.0, network=network)
    shield = ShieldedPolicy(learned, env)
    safe = np.flatnonzero(observation["action_mask"])[outcomes(env, np.flatnonzero(observation["action_mask"]))[0] == 0]
    assert 0 < len(safe) < observation["action_mask"].sum()
    assert shield.predict(observation, deterministic=True)[0] in safe
    batch = {key: array[None] for key, array in observation.items()}
    assert shield.predict(batch, deterministic=True)[0].tolist()[0] in safe


def test_one_step_of_foresight_is_not_enough():
    env = ResectEnv("box-108", "validation")
    index = 4
    observation, _ = env.reset(seed=0, options={"index": index})
    shield = make_policy("shield:min-cut-index", env, 0)
    while (action := shield.predict(observation)[0]) in cheapest_plan(env.task):
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated
    # Every cut was safe, and now no cut of the plan is; other orders of the same cuts lead to the end.
    assert env.n_steps > 0
    assert outcomes(env, cheapest_plan(env.task))[0].all()
    found = play_episode(make_policy("search:300", env, 0), env, "search", 0, index)
    assert found.is_success
    assert found.cost_ratio == pytest.approx(1.0)


# The search -------------------------------------------------------------------------------------------------------


def test_an_ample_search_reaches_what_the_certificates_reach():
    env = level_0(8)
    found = evaluate(make_policy("search:2000", env, 0), env)
    known = evaluate(make_policy("certificate", env, 0), env)
    blind = evaluate(make_policy("min-cut-index", env, 0), env)
    assert [episode.total_return for episode in found] == pytest.approx([episode.total_return for episode in known])
    assert not all(episode.is_success for episode in blind)


def test_a_search_first_leaves_what_lies_behind_the_load_for_the_end():
    env, n_followed = level_0(8), 0
    for index in range(8):
        env.reset(seed=0, options={"index": index})
        task, left, order = env.task, cheapest_plan(env.task), []
        while task.outcome is None:
            left = left[task.action_mask()[left].astype(bool)]
            order.append(int(left[np.argmax(levers(task, left))]))
            task.step(order[-1])
        if task.outcome == SEPARATED:
            n_followed += 1
            observation, _ = env.reset(seed=0, options={"index": index})
            policy = SearchPolicy(len(order)).bind(env)
            for action in order:
                assert policy.predict(observation)[0] == action
                observation, *_ = env.step(action)
            assert policy.n_simulated == len(order)
    assert n_followed > 1


def test_a_search_of_some_descents_frees_more_than_the_best_rules_that_ask_no_simulator():
    env = ResectEnv("box-108", "validation")
    freed = {name: sum(episode.is_success for episode in evaluate(make_policy(name, env, 0), env))
             for name in ("search:60", "rim-first", "lever-first")}  # fmt: skip
    assert freed["search:60"] > max(freed["rim-first"], freed["lever-first"])


def test_where_no_order_of_the_plan_survives_a_search_finds_a_way_round():
    env = level_0(5)
    strong = {"index": 4, "load_factor": 1.6}
    observation, _ = env.reset(seed=0, options=strong)
    assert not can_survive(env.task, frozenset(cheapest_plan(env.task).tolist()))
    policy, info = SearchPolicy(500).bind(env), {}
    while not info.get("reason"):
        observation, _, _, _, info = env.step(policy.predict(observation)[0])
    assert info["is_success"]
    assert info["cost_ratio"] > 1.0


def test_a_search_without_a_budget_is_the_cheapest_plan_by_index():
    env = level_0(4)
    for index in range(4):
        searched, plain = (play_episode(make_policy(name, env, 0), env, name, 0, index) for name in ("search:0", "min-cut-index"))
        assert searched[3:-1] == plain[3:-1]


@pytest.mark.parametrize("budget", [0, 1, 7, 20, 60])
@pytest.mark.parametrize("load_factor", [1.0, 2.0])
@pytest.mark.parametrize("policy_class", [SearchPolicy, ForgetfulPolicy])
def test_a_search_never_exceeds_its_budget(budget, load_factor, policy_class, n_real_steps):
    env = level_0(1)
    policy = policy_class(budget).bind(env)
    n_played = 0
    for n_episodes in (1, 2):
        observation, _ = env.reset(seed=0, options={"load_factor": load_factor})
        has_ended = False
        while not has_ended:
            action, _ = policy.predict(observation)
            observation, _, terminated, truncated, _ = env.step(action)
            has_ended = terminated or truncated
        n_played += env.n_steps
        assert policy.n_simulated == len(n_real_steps) - n_played
        assert min(budget, 1) <= policy.n_simulated <= n_episodes * budget


def test_an_order_that_survives_is_played_to_the_end_without_thinking_again():
    env = level_0(1)
    policy = SearchPolicy(2000).bind(env)
    observation, _ = env.reset(seed=0)
    spent, info = [], {}
    while not info.get("reason"):
        action, _ = policy.predict(observation)
        spent.append(policy.n_simulated)
        observation, _, _, _, info = env.step(action)
    assert info["is_success"]
    assert 0 < spent[0] < 2000
    assert set(spent) == {spent[0]}


def test_an_order_that_was_not_followed_is_searched_anew():
    env = level_0(1)
    policy = SearchPolicy(2000).bind(env)
    observation, _ = env.reset(seed=0)
    found, _ = policy.predict(observation)
    spent = policy.n_simulated
    other = next(action for action in np.flatnonzero(observation["action_mask"]) if action != found and
                 not outcomes(env, [action])[0].any())  # fmt: skip
    observation, *_ = env.step(other)
    assert env.action_masks()[policy.predict(observation)[0]]
    assert policy.n_simulated > spent


# Names ------------------------------------------------------------------------------------------------------------


def test_names_may_be_nested():
    env = ResectEnv(small_scene())
    assert isinstance(make_policy("shield:search:100", env, 0), ShieldedPolicy)
    assert make_policy("search:100", env, 0).budget == 100
    assert home_of("shield:search:100") == home_of("search:0") == home_of("foresight:9:shield:random") == home_of("random")
    assert make_policy("foresight:9:shield:random", env, 0).budget == 9


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("sheild:random", "did you mean 'shield'"),
        ("seach:10", "did you mean 'search'"),
        ("shield:radnom", "did you mean 'random'"),
        ("shield:search:ten", "not 'ten'"),
        ("search:-1", "not '-1'"),
        ("search", "as in search:300"),
        ("shield:missing.zip", "cannot read missing.zip"),
        ("foresight:missing.zip", "not 'missing.zip'"),
        ("foresight:30:radnom", "did you mean 'random'"),
        ("forsight:30:random", "did you mean 'foresight'"),
    ],
)
def test_a_name_that_means_nothing_is_refused(name, words):
    with pytest.raises(ConfigError, match=words):
        home_of(name)
