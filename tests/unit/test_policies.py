"""Scripted policies: each plays by its rule, through stable-baselines3's predict, and finishes what it starts."""

import numpy as np
import pytest

from agents.evaluation import estimate, evaluate, play_episode, summarise
from agents.scripted import POLICIES, ScriptedPolicy
from agents.table import HEADERS, as_markdown, summary_rows
from envs.library import load_scenes
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError, GmapspringError
from tests.small_scene import VARIANTS, fake_certificate, small_scene, variant_scene, with_certificate


@pytest.fixture
def env():
    """Return an environment whose scene has a certificate that names the cheapest plan backwards."""
    scene = small_scene(seed=1, load=0.02)
    order = scene.certificate.order[::-1]
    return ResectEnv(with_certificate(scene, fake_certificate(scene.certificate.optimum, order)))


def plays(policy, env):
    """Return the actions of an episode and its last info."""
    observation, _ = env.reset(seed=0)
    actions, state, has_ended, info = [], None, False, {}
    while not has_ended:
        action, state = policy.predict(observation, state, np.array([not actions]), deterministic=True)
        assert observation["action_mask"][action]
        actions.append(action)
        observation, _, terminated, truncated, info = env.step(action)
        has_ended = terminated or truncated
    return actions, info


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_plays_legal_actions_to_the_end_of_an_episode(name, env):
    actions, info = plays(ScriptedPolicy(name, np.random.default_rng(0)).bind(env), env)
    assert info["reason"] is not None
    assert len(set(actions)) == len(actions)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_plays_under_other_rules_too(name, variant):
    env = ResectEnv(variant_scene(variant, seed=1, load=0.02))
    _, info = plays(ScriptedPolicy(name).bind(env), env)
    assert info["reason"] is not None


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_goes_on_where_no_cuts_spare_the_vessel(name):
    scene = small_scene(seed=1, load=0.02)
    certificate = fake_certificate(scene.certificate.optimum, scene.certificate.order)
    env = ResectEnv(small_scene(seed=1, load=0.02, no_cut=~scene.target & ~scene.anchor, certificate=certificate))
    _, info = plays(ScriptedPolicy(name).bind(env), env)
    assert info["reason"] is not None and not info["is_success"]


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_plays_the_same_again_from_the_same_seed(name, env):
    first, second = (plays(ScriptedPolicy(name, np.random.default_rng(3)).bind(env), env)[0] for _ in range(2))
    assert first == second


PLANNERS = ["rim-first", "lever-first", "min-cut-index", "min-cut-random", "min-cut-lever", "lookahead", "certificate"]


@pytest.mark.parametrize("name", PLANNERS)
def test_a_policy_with_a_plan_frees_the_target_where_nothing_tears(name, env):
    _, info = plays(ScriptedPolicy(name).bind(env), env)
    assert info["is_success"]


def test_minimum_cut_policies_pay_the_least_cost(env):
    for name in ("min-cut-index", "min-cut-random", "min-cut-lever", "lookahead"):
        assert plays(ScriptedPolicy(name).bind(env), env)[1]["cost_ratio"] == pytest.approx(1.0, abs=1e-6)


def test_the_certificate_is_followed_in_its_order(env):
    actions, _ = plays(ScriptedPolicy("certificate").bind(env), env)
    assert tuple(actions) == env.scene.certificate.order


def test_rim_first_cuts_only_the_interface_and_the_outermost_face_first(env):
    actions, _ = plays(ScriptedPolicy("rim-first").bind(env), env)
    table, target = env.task.table, env.scene.target
    is_interface = target[table.face_tetrahedra].sum(axis=1) == 1
    distance = np.linalg.norm(table.face_centroid - table.face_centroid[is_interface].mean(axis=0), axis=1)
    assert is_interface[actions].all()
    assert distance[actions[0]] == pytest.approx(distance[is_interface].max())


@pytest.mark.parametrize("n_targets", [1, 2])
def test_lever_first_cuts_the_interface_farthest_from_the_line_of_the_load_as_the_body_hangs(n_targets):
    env = ResectEnv(small_scene(seed=1, load=0.02) if n_targets == 1 else load_scenes("box-288-two", "test")[:1])
    observation, _ = env.reset(seed=0)
    region_of = env.task.rules.region_of
    assert len(np.unique(region_of[env.scene.target])) == n_targets
    task, policy = env.task, ScriptedPolicy("lever-first").bind(env)
    while True:
        body, table, target = task.simulation.body, task.table, task.scene.target
        place = body.nodes.position[body.vertex_of]  # of each corner of each tetrahedron
        expected = {}
        for face, (one, other) in enumerate(table.face_tetrahedra):
            if observation["action_mask"][face] and target[one] != target[other]:
                left = target & task.is_attached & (region_of == region_of[one if target[one] else other])
                middle = (place[left].mean(axis=1) * table.volume[left, None]).sum(axis=0) / table.volume[left].sum()
                shared = np.intersect1d(body.vertex_of[one], body.vertex_of[other])
                # The area of a parallelogram over its base: distance from a line.
                arm = body.nodes.position[shared].mean(axis=0) - middle
                expected[face] = np.linalg.norm(np.cross(arm, task.load)) / np.linalg.norm(task.load)
        action, _ = policy.predict(observation)
        assert expected[action] == pytest.approx(max(expected.values()))
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break


def test_looking_ahead_leaves_the_simulator_as_it_was(env):
    observation, _ = env.reset(seed=0)
    before = env.task.simulation.body.nodes.position.copy()
    ScriptedPolicy("lookahead").bind(env).predict(observation)
    assert np.array_equal(env.task.simulation.body.nodes.position, before)
    assert env.task.cost == 0.0


def test_looking_ahead_picks_the_action_after_which_healthy_tissue_strains_least(env):
    observation, _ = env.reset(seed=0)
    chosen, _ = ScriptedPolicy("lookahead").bind(env).predict(observation)
    strains = {}
    for action in env.scene.certificate.plan:
        env.task.reset()
        env.task.step(action)
        strains[action] = env.task.tissue.healthy_strain
    assert chosen == min(strains, key=strains.get)


def test_a_policy_obeys_a_narrower_mask_than_the_observation_s(env):
    observation, _ = env.reset(seed=0)
    for name in POLICIES:
        mask = np.zeros(env.action_space.n, dtype=bool)
        mask[[3, 40]] = True
        action, _ = ScriptedPolicy(name).bind(env).predict(observation, action_masks=mask)
        assert action in (3, 40)


def test_predict_takes_a_batch_of_one_as_stable_baselines3_hands_it_over(env):
    observation, _ = env.reset(seed=0)
    batch = {key: array[None] for key, array in observation.items()}
    actions, _ = ScriptedPolicy("min-cut-index").bind(env).predict(batch, None, episode_start=np.array([True]))
    assert actions.shape == (1,)


def test_a_policy_that_needs_the_simulator_asks_to_be_bound(env):
    observation, _ = env.reset(seed=0)
    with pytest.raises(GmapspringError, match="bind"):
        ScriptedPolicy("lookahead").predict(observation)


def test_an_unknown_policy_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="did you mean 'lookahead'"):
        ScriptedPolicy("look-ahead")


def test_a_scene_without_a_certificate_cannot_be_played_by_it():
    env = ResectEnv(small_scene(certificate=None))
    observation, _ = env.reset(seed=0)
    with pytest.raises(ConfigError, match="no certificate"):
        ScriptedPolicy("certificate").bind(env).predict(observation)


def test_an_evaluation_plays_every_scene_once_and_in_order():
    env = ResectEnv([small_scene(seed=seed, load=0.02) for seed in (4, 7, 5)])
    episodes = evaluate(ScriptedPolicy("min-cut-index").bind(env), env, name="plan")
    assert [episode.scene_seed for episode in episodes] == [4, 7, 5]
    assert {episode.policy for episode in episodes} == {"plan"}


def test_a_return_is_the_sum_of_rewards(env):
    episode = play_episode(ScriptedPolicy("min-cut-index").bind(env), env, "plan", seed=0, index=0)
    # Success at the least cost: 1.5 - 0.5 J*/J*.
    assert episode.is_success
    assert episode.total_return == pytest.approx(1.0, abs=1e-6)


def test_an_estimate_tells_error_and_spread_apart():
    values = np.array([1.0, 2.0, 3.0, 6.0])
    found = estimate(values)
    assert found.mean == 3.0
    assert found.spread == pytest.approx(np.sqrt(((values - 3.0) ** 2).sum() / 3.0))
    assert found.error == pytest.approx(found.spread / 2.0)


def test_cost_is_averaged_over_successes_alone(env):
    episode = play_episode(ScriptedPolicy("min-cut-index").bind(env), env, "plan", seed=0, index=0)
    failure = episode._replace(is_success=False, cost_ratio=0.1, reason="tear")
    summary = summarise([episode, failure])
    assert summary.cost_ratio.mean == pytest.approx(1.0, abs=1e-6)
    assert summary.success.mean == 0.5
    assert summary.reasons == {"separated": 1, "tear": 1}


def test_the_table_has_a_line_for_every_policy_and_a_dash_for_what_cannot_be_averaged(env):
    episode = play_episode(ScriptedPolicy("random").bind(env), env, "random", seed=0, index=0)
    rows = summary_rows([summarise([episode._replace(is_success=False)])])
    lines = as_markdown(HEADERS, rows).splitlines()
    assert len(lines) == 3
    assert len({len(line) for line in lines}) == 1
    assert lines[2].split("|")[5].strip() == "-"
