"""Foresight: a policy that is played out on the simulator first frees more, spends what it may, and shows nothing of it."""

import numpy as np
import pytest

from agents.choice import make_policy
from agents.evaluation import evaluate, play_episode
from agents.foresight import PATIENCE, ForesightPolicy
from agents.scripted import ScriptedPolicy
from envs.observation import COLUMNS
from envs.resect import ResectEnv
from envs.task import Resection
from tests.small_scene import small_scene


class Chooser:
    """Propose the first legal action of an order that is given, or of one of its own each time it is drawn."""

    def __init__(self, best, drawn=()):
        self.best, self.drawn, self.n_asked, self.n_drawn = best, drawn, 0, 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False, action_masks=None):
        self.n_asked += 1
        self.n_drawn += not deterministic
        order = self.best if deterministic or not len(self.drawn) else self.drawn
        mask = observation["action_mask"] if action_masks is None else action_masks
        return next(int(action) for action in [*order, *np.flatnonzero(mask)] if mask[action]), state


@pytest.fixture
def n_steps(monkeypatch):
    """Return a list that grows with every step that any simulator takes."""
    taken, step = [], Resection.step
    monkeypatch.setattr(Resection, "step", lambda task, action: taken.append(action) or step(task, action))
    return taken


def level_0(n_scenes, **how):
    """Return the environment of the first validation scenes of level 0."""
    env = ResectEnv("box-48", "validation", **how)
    return ResectEnv([env.scenes[index] for index in range(n_scenes)], **how)


@pytest.mark.parametrize("guide", ["rim-first", "min-cut-index"])
def test_foresight_frees_more_than_the_policy_that_it_looks_ahead_for_and_than_its_shield(guide):
    env = ResectEnv("box-108", "validation")
    freed = {name: sum(episode.is_success for episode in evaluate(make_policy(name, env, 0), env))
             for name in (guide, f"shield:{guide}", f"foresight:200:{guide}")}  # fmt: skip
    assert freed[guide] < freed[f"shield:{guide}"] < freed[f"foresight:200:{guide}"]


def test_where_the_policys_own_cuts_are_cheapest_and_hold_foresight_does_the_same_for_one_step_a_cut():
    env = level_0(8)
    alone = evaluate(make_policy("rim-first", env, 0), env)
    foreseen = evaluate(make_policy("foresight:100:rim-first", env, 0), env)
    assert any(episode.is_success for episode in alone)
    for one, other in zip(alone, foreseen, strict=True):
        if one.is_success:
            assert (other.total_return, other.n_steps, other.n_simulated) == (one.total_return, one.n_steps, one.n_steps)


def test_a_way_that_frees_the_target_is_planned_once_and_played_as_it_was_found(n_steps):
    env, policy = level_0(8), None
    for index in range(8):
        n_steps.clear()
        policy = make_policy("foresight:500:min-cut-index", env, 0)
        episode = play_episode(policy, env, "foresight", 0, index)
        planned, played = n_steps[: episode.n_simulated], n_steps[episode.n_simulated :]
        assert episode.is_success and len(played) == episode.n_steps
        # refused cuts lie between those that were kept
        remaining = iter(planned)
        assert all(action in remaining for action in played)


def test_a_certificate_is_seen_to_hold_at_once():
    env = level_0(3)
    for episode in evaluate(make_policy("foresight:100:certificate", env, 0), env):
        assert episode.total_return == pytest.approx(1.0)
        assert episode.n_simulated == episode.n_steps


def test_after_a_dead_end_the_policy_is_drawn_from():
    # the best proposals are those of lowest id, which lead to a dead end here; the drawn ones are those of the certificate
    env, _ = plan_of_two_ways()
    order = env.scene.certificate.order
    observation, _ = env.reset(seed=0)
    guide = Chooser((), order)
    policy = ForesightPolicy("chooser", 500, lambda twin: guide).bind(env)
    info = {}
    while not info.get("reason"):
        observation, _, _, _, info = env.step(policy.predict(observation)[0])
    assert info["is_success"]
    assert info["cost_ratio"] == pytest.approx(1.0)
    assert policy.n_simulated > len(order), "the best proposals were tried first"
    assert guide.n_drawn > 0


class Recorder(Chooser):
    """Propose the lowest legal action; note of each proposal the cuts before it, whether it was drawn, and what was legal."""

    def __init__(self):
        super().__init__(())
        self.asked = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False, action_masks=None):
        steps = [column.name for column in COLUMNS["globals"]].index("steps")
        n_cuts = round(100.0 * float(observation["globals"][steps]))
        self.asked.append((n_cuts, not deterministic, set(np.flatnonzero(action_masks).tolist())))
        return super().predict(observation, state, episode_start, deterministic, action_masks)

    @property
    def first_way(self):
        """Return how many proposals were made on the first way."""
        return [is_drawn for _, is_drawn, _ in self.asked].index(True)


def plan_of_two_ways():
    """Return the environment and the guide of a plan that was not found on the first way."""
    for scene in ResectEnv("box-108", "validation").scenes:
        env, guide = ResectEnv([scene]), Recorder()
        env.reset(seed=0)
        policy = ForesightPolicy("recorder", 500, lambda twin, guide=guide: guide).bind(env)
        if policy.plan(env, limit=500) and any(is_drawn for _, is_drawn, _ in guide.asked):
            return env, guide
    raise AssertionError("no scene is hard enough")


def test_what_a_way_had_left_when_it_ended_comes_first_on_the_next_one():
    env, guide = plan_of_two_ways()
    n_asked, plan = guide.first_way, set(env.scene.certificate.plan)
    assert guide.asked[0][2] == plan, "the cheapest cuts alone"
    way = guide.asked[:n_asked]
    cut = {min(legal) for (n_cuts, _, legal), (n_after, _, _) in zip(way, way[1:], strict=False) if n_after > n_cuts}
    assert cut and cut < plan
    n_cuts, _, legal = guide.asked[n_asked]
    assert n_cuts == 0 and legal and legal <= plan - cut


def test_the_cheapest_cuts_are_looked_at_first():
    env = ResectEnv("box-108", "validation")
    episodes = evaluate(make_policy("foresight:500:random", env, 0), env)
    assert sum(episode.is_success for episode in episodes) >= 0.95 * len(episodes)
    assert all(episode.cost_ratio == pytest.approx(1.0) for episode in episodes if episode.is_success)


def test_other_cuts_are_allowed_once_half_of_the_budget_is_spent():
    env, spent = ResectEnv([ResectEnv("box-108", "validation").scenes[0]]), []

    class Watcher(Recorder):
        def predict(self, *arguments, **keywords):
            spent.append(policy.n_simulated)
            return super().predict(*arguments, **keywords)

    env.reset(seed=0, options={"load_factor": 1.4})
    guide = Watcher()
    policy = ForesightPolicy("watcher", 60, lambda twin: guide).bind(env)
    policy.plan(env, limit=60)
    plan = set(env.scenes[0].certificate.plan)
    is_free = [not legal <= plan for _, _, legal in guide.asked]
    assert True in is_free and spent[is_free.index(True)] == 30


def test_where_the_cheapest_cuts_lead_nowhere_no_end_of_theirs_is_dead_any_more(monkeypatch):
    env = level_0(1)
    order = env.scene.certificate.order
    env.reset(seed=0, options={"index": 0})
    # all but the last of them: every way among these ends, and even the start is a dead end
    monkeypatch.setattr("agents.foresight.cheapest_plan", lambda task: np.array(order[:-1]))
    policy = ForesightPolicy("chooser", 500, lambda twin: Chooser(order)).bind(env)
    assert policy.plan(env, limit=500) == order


def test_ways_pay_only_for_what_they_do_not_share(monkeypatch):
    walked, taken, kept = {}, [], []
    save, load, step = ResectEnv.save_state, ResectEnv.load_state, ResectEnv.step

    def save_order(env):
        kept.append(save(env))
        walked[id(kept[-1])] = env.__dict__.get("order", ())
        return kept[-1]

    def load_order(env, state):
        env.order = walked[id(state)]
        return load(env, state)

    def note(env, action):
        env.order = (*env.order, action)
        taken.append(env.order)
        return step(env, action)

    for name, method in (("save_state", save_order), ("load_state", load_order), ("step", note)):
        monkeypatch.setattr(ResectEnv, name, method)
    env, guide = ResectEnv([ResectEnv("box-108", "validation").scenes[0]]), Recorder()
    env.reset(seed=0, options={"load_factor": 1.4})
    policy = ForesightPolicy("recorder", 200, lambda twin: guide).bind(env)
    assert policy.plan(env, limit=200) == (), "a load that is too much for any order"
    assert len(set(taken)) == len(taken) == policy.n_simulated
    assert len(guide.asked) > len(taken) + 10, "what ways share is proposed again"


def test_where_no_way_is_found_the_policy_does_what_it_would_have_done():
    env = ResectEnv(small_scene(load=5.0))
    observation, _ = env.reset(seed=0)
    policy = make_policy("foresight:50:min-cut-index", env, 0)
    assert policy.predict(observation)[0] == ScriptedPolicy("min-cut-index").bind(env).predict(observation)[0]
    # every cut is fatal: the start is a dead end, be it with the cheapest cuts or with all, and no more is spent on it
    assert policy.n_simulated == 2 * PATIENCE


@pytest.mark.parametrize("n_legal", [0, 1, 2])
def test_where_fewer_cuts_are_legal_than_it_has_patience_for_and_all_are_fatal_nothing_is_tried_twice(n_legal, monkeypatch):
    env = ResectEnv(small_scene(load=5.0))
    env.reset(seed=0)
    legal = np.flatnonzero(env.action_masks())[:n_legal]
    monkeypatch.setattr(ResectEnv, "action_masks", lambda env: np.isin(np.arange(env.action_space.n), legal))
    policy = ForesightPolicy("chooser", 50, lambda twin: Chooser(legal)).bind(env)
    assert policy.plan(env, limit=50) == ()
    assert policy.n_simulated == n_legal


def test_a_tool_that_reaches_little_leaves_foresight_an_end():
    env = ResectEnv(small_scene(load=1.0, tool_radius=0.4))
    for name in ("foresight:300:min-cut-index", "foresight:300:rim-first"):
        episode = play_episode(make_policy(name, env, 0), env, name, 0, 0)
        assert episode.n_simulated <= 300


@pytest.mark.parametrize("budget", [0, 1, 7, 60])
@pytest.mark.parametrize("load_factor", [1.0, 2.0])
def test_foresight_never_exceeds_its_budget(budget, load_factor, n_steps):
    env = level_0(1)
    policy = make_policy(f"foresight:{budget}:min-cut-index", env, 0)
    n_played = 0
    for n_episodes in (1, 2):
        observation, _ = env.reset(seed=0, options={"load_factor": load_factor})
        has_ended = False
        while not has_ended:
            observation, _, terminated, truncated, _ = env.step(policy.predict(observation)[0])
            has_ended = terminated or truncated
        n_played += env.n_steps
        assert policy.n_simulated == len(n_steps) - n_played
        assert policy.n_simulated <= n_episodes * budget


def test_a_narrower_mask_holds_for_what_is_done():
    env = level_0(1)
    observation, _ = env.reset(seed=0)
    planned, _ = make_policy("foresight:100:rim-first", env, 0).predict(observation)
    assert make_policy("foresight:100:rim-first", env, 0).plan(env, 100), "a way is found"
    mask = np.zeros(env.action_space.n, dtype=bool)
    mask[[action for action in np.flatnonzero(observation["action_mask"]) if action != planned][:2]] = True
    assert mask[make_policy("foresight:100:rim-first", env, 0).predict(observation, action_masks=mask)[0]]


def test_a_guide_that_simulates_is_counted_and_not_asked_any_more_once_the_budget_is_spent(n_steps):
    env = level_0(1)
    policy = make_policy("foresight:10:lookahead", env, 0)
    observation, _ = env.reset(seed=0)
    n_plan = int(len(env.scene.certificate.order))
    assert policy.plan(env, limit=10) == ()
    assert policy.n_simulated == len(n_steps)
    assert 10 <= policy.n_simulated < 10 + n_plan, "only one thought goes beyond the budget"


@pytest.mark.parametrize("budget", [20, 60, 100])
def test_no_thought_is_begun_once_the_budget_is_spent_however_many_ways_there_were(budget):
    scenes, begun = ResectEnv("box-108", "validation").scenes, []

    class Thinker(Recorder):
        n_simulated = 0

        def predict(self, *arguments, **keywords):
            begun.append(policy.n_simulated)
            # Each thought costs a step.
            self.n_simulated += 1
            return super().predict(*arguments, **keywords)

    for index in range(12):
        env, guide = ResectEnv([scenes[index]]), Thinker()
        env.reset(seed=0, options={"load_factor": 1.4})
        policy = ForesightPolicy("thinker", budget, lambda twin, guide=guide: guide).bind(env)
        begun.clear()
        policy.plan(env, limit=budget)
        assert max(begun) < budget and policy.n_simulated <= budget


def test_foresight_of_a_learned_policy_gives_the_same_episodes_again():
    pytest.importorskip("torch")
    from agents.candidate_policy import CandidatePolicy
    from agents.training_config import NetworkSettings

    env = level_0(4)

    def learned(twin):
        import torch

        torch.manual_seed(3)
        network = NetworkSettings(hidden=16, rounds=1)
        return CandidatePolicy(twin.observation_space, twin.action_space, lambda _: 0.0, network=network)

    def episodes():
        played = evaluate(ForesightPolicy("learned", 60, learned).bind(env), env)
        return [episode._replace(seconds=0.0) for episode in played]

    first = episodes()
    assert first == episodes()
    assert max(episode.n_simulated for episode in first) > 0
