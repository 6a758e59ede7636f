"""Resect-v0 as its users meet it: made by name, checked by the checkers, learned on, and true to its rules."""

import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import LEVELS
from envs.actions import MASKS
from envs.costs import CostParts
from envs.library import shipped_scenes
from envs.resect import ResectEnv
from envs.rewards import REWARD_TERMS
from gmapspring.errors import ConfigError
from tests.bits import assert_same_bits, bits_of
from tests.small_scene import play, random_policy, small_scene, variant_scene, with_certificate

SCENES = [small_scene(seed) for seed in range(4)]


@pytest.fixture
def env():
    """Return an environment on four small scenes."""
    return ResectEnv(SCENES)


def test_it_is_made_by_name_with_no_import():
    program = (
        "import gymnasium as gym; env = gym.make('envs:Resect-v0', scene='box-48', split='test', mask='reachable');"
        "env.reset(seed=0); print(env.spec.id, env.action_space.n)"
    )
    printed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert printed.stdout.split() == ["Resect-v0", "120"]


@pytest.mark.parametrize("name", ["envs:Resect-v0", "envs:ResectFlat-v0"])
def test_gymnasium_finds_no_fault(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # It tries every render mode, a window too, which a machine without a display cannot have.
        warnings.filterwarnings("ignore", "there is no display")
        check_env(gym.make(name, scene=SCENES, render_mode="rgb_array").unwrapped)


def test_stable_baselines_finds_no_fault():
    from stable_baselines3.common.env_checker import check_env as check_for_sb3

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Tables of rows are what they are; a network that wants one vector takes ResectFlat-v0.
        warnings.filterwarnings("ignore", "Your observation .* has an unconventional shape")
        check_for_sb3(gym.make("envs:Resect-v0", scene=SCENES).unwrapped)
        check_for_sb3(gym.make("envs:ResectFlat-v0", scene=SCENES))


@pytest.mark.parametrize(
    ("name", "policy"), [("Resect-v0", "MultiInputPolicy"), ("ResectFlat-v0", "MlpPolicy")]
)
def test_maskable_ppo_learns_out_of_the_box(name, policy):
    from sb3_contrib import MaskablePPO
    from stable_baselines3.common.env_util import make_vec_env

    envs = make_vec_env(f"envs:{name}", n_envs=2, env_kwargs={"scene": SCENES})
    model = MaskablePPO(policy, envs, n_steps=8, batch_size=8, n_epochs=1, device="cpu", seed=0)
    model.learn(32)
    observation = envs.reset()
    masks = np.stack(envs.env_method("action_masks"))
    actions, _ = model.predict(observation, action_masks=masks)
    assert masks[[0, 1], actions].all()


def test_masks_are_found_through_wrappers_and_before_a_reset():
    wrapped = gym.make("envs:ResectFlat-v0", scene=SCENES, mask="focus")
    before = wrapped.get_wrapper_attr("action_masks")()
    assert before.dtype == bool and before.any()
    wrapped.reset(seed=0, options={"index": 0})
    assert np.array_equal(before, wrapped.get_wrapper_attr("action_masks")())


def test_the_flat_variant_holds_the_tables_one_after_another():
    flat, plain = gym.make("envs:ResectFlat-v0", scene=SCENES), ResectEnv(SCENES)
    vector, tables = flat.reset(seed=3)[0], plain.reset(seed=3)[0]
    expected = [tables[name].ravel() for name in ("nodes", "faces", "tetrahedra", "globals")]
    assert vector.dtype == np.float32
    assert np.array_equal(vector, np.concatenate(expected))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mask": "al"}, r"no mask 'al'; did you mean 'all'\?"),
        ({"reward": {"colapse": 1.0}}, r"reward\.colapse: unknown term; did you mean 'collapse'\?"),
        ({"render_mode": "ansi"}, r"no render mode 'ansi'"),
        ({"render_style": "tisue"}, r"no render style 'tisue'; did you mean 'tissue'"),
        ({"scene": []}, r"list of scenes is empty"),
        ({"scene": ["box-48"]}, r"'box-48' in the list of scenes is no Scene"),
        ({"scene": 5}, r"5 is no scene; give a name"),
        ({"reward": [1]}, r"reward is \[1\]; give the weights of terms by their names"),
        ({"scene": "box-109"}, r"no scene 'box-109'"),
        ({"scene": "box-48", "split": "tset"}, r"no split 'tset'; did you mean 'test'\?"),
    ],
)
def test_a_constructor_argument_that_does_not_fit_is_an_error(arguments, message):
    with pytest.raises(ConfigError, match=message):
        ResectEnv(**{"scene": SCENES} | arguments)


@pytest.mark.parametrize("name", LEVELS)
def test_every_shipped_scene_has_an_id_of_its_own(name):
    env = gym.make(f"envs:Resect-{name}-v0", split="test")
    assert env.unwrapped.scene.name == name
    batch = gym.make_vec(f"envs:Resect-{name}-v0", num_envs=1, vectorization_mode="vector_entry_point", split="test")
    assert batch.scene_of(0).name == name


def test_no_id_names_a_scene_that_does_not_ship():
    assert LEVELS == tuple(shipped_scenes())
    ids = {f"Resect-{name}-v0" for name in shipped_scenes()} | {"Resect-v0", "ResectFlat-v0"}
    assert {name for name in gym.registry if name.startswith("Resect")} == ids


# Rules ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MASKS)
def test_an_illegal_action_changes_no_bit_of_the_body_and_is_flagged(mode):
    env = ResectEnv(SCENES, mask=mode)
    env.reset(seed=0)
    env.step(int(np.flatnonzero(env.action_masks())[0]))
    before, cost = bits_of(env.task.simulation), env.task.cost
    for action in np.flatnonzero(~env.action_masks())[:5]:
        _, reward, terminated, truncated, info = env.step(int(action))
        assert info["is_illegal"] and not (terminated or truncated)
        assert reward == info["reward_terms"]["illegal"]["weighted"] == -0.1
        assert env.task.cost == cost
    assert_same_bits(before, bits_of(env.task.simulation))


def test_a_run_of_illegal_actions_ends(env):
    steps = play(env, lambda env, _: int(np.flatnonzero(~env.action_masks())[0]))
    assert len(steps) == env.step_limit
    assert steps[-1][3] and steps[-1][4]["reason"] == "budget" and not steps[-1][4]["is_success"]


def test_an_episode_is_cut_short_past_twice_the_least_cost(env):
    # Faces within the pinned layer and the target cost without freeing anything.
    def waste(env, _):
        mask = env.action_masks()[: env.task.table.n_faces]
        sides = env.task.table.face_tetrahedra
        idle = mask & env.scene.anchor[sides].all(axis=1)
        return int(np.flatnonzero(idle if idle.any() else mask)[0])

    steps = play(env, waste, options={"index": 0, "load_factor": 0.0})
    last = steps[-1][4]
    assert last["reason"] == "budget" and steps[-1][3] and not steps[-1][2]
    assert last["cost_ratio"] > 2.0 >= steps[-2][4]["cost_ratio"]


def test_without_a_load_the_cheapest_cuts_free_the_target_for_a_return_of_one(env):
    plan = iter(SCENES[1].certificate.order)
    steps = play(env, lambda env, _: next(plan), options={"index": 1, "load_factor": 0.0})
    assert steps[-1][2] and steps[-1][4]["is_success"] and steps[-1][4]["reason"] == "separated"
    assert steps[-1][4]["cost_ratio"] == pytest.approx(1.0, abs=1e-9)
    assert sum(step[1] for step in steps) == pytest.approx(1.0, abs=1e-9)


def test_a_load_that_is_too_much_is_a_collapse_by_name(env):
    steps = play(env, random_policy(0), options={"index": 0, "load_factor": 10.0})
    assert steps[-1][2] and steps[-1][4]["reason"] in ("tear", "inverted")
    assert steps[-1][4]["reward_terms"]["collapse"] == {"raw": 1.0, "weighted": -1.0}


def test_a_vessel_laid_open_is_a_collapse_by_name():
    env = ResectEnv(variant_scene("vessel"))
    env.reset(seed=0)
    sides = env.task.table.face_tetrahedra
    face = np.flatnonzero(env.scene.vessel[sides].any(axis=1))[0]
    _, reward, terminated, _, info = env.step(int(face))
    assert terminated and info["reason"] == "vessel" and not info["is_success"]
    assert info["reward_terms"]["collapse"]["weighted"] == -1.0 > reward
    env.reset(seed=0)
    assert env.step(int(env.scene.certificate.order[0]))[4]["reason"] != "vessel"


def test_a_scene_that_cannot_be_solved_without_laying_the_vessel_open_is_refused():
    vessel = ~SCENES[0].target
    with pytest.raises(ConfigError, match="scene 'small', seed 0: no cuts free the target and spare the vessel"):
        ResectEnv(small_scene(no_cut=vessel, certificate=None))


@pytest.mark.parametrize("seed", range(6))
def test_reward_terms_sum_to_the_reward_to_the_last_bit(env, seed):
    for _, reward, _, _, info in play(env, random_policy(seed), seed):
        assert list(info["reward_terms"]) == list(REWARD_TERMS)
        assert sum(term["weighted"] for term in info["reward_terms"].values()) == reward


@pytest.mark.parametrize("seed", range(6))
def test_the_cost_is_area_and_volume_cut_and_healthy_volume_lost(env, seed):
    choose = random_policy(seed)
    env.reset(seed=seed)
    table, h, total = env.task.table, 0.01, 0.0
    while True:
        before, action = env.task.is_attached.copy(), choose(env, None)
        _, _, terminated, truncated, info = env.step(action)
        lost = before & ~env.task.is_attached & ~env.scene.target
        if action < table.n_faces:
            total += table.face_area[action] / h**2
        else:
            lost[action - table.n_faces] = False
            total += 6.6 * table.volume[action - table.n_faces] / h**3
        total += 1.5 * table.volume[lost].sum() / h**3
        assert info["cost"] == pytest.approx(total, rel=1e-12)
        assert info["cost_ratio"] == info["cost"] / env.optimum
        if terminated or truncated:
            return


def test_parts_of_a_cost_sum_to_it():
    assert CostParts(1.0, 2.0, 0.5).total == 3.5


def test_loose_pieces_leave_the_body_and_the_load_stays_whole(env):
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        legal = np.flatnonzero(env.task.action_mask())
        env.task.apply(int(rng.choice(legal)))
        body, task = env.task.simulation.body, env.task
        assert np.array_equal(body.is_alive, task.is_attached)
        held = task.is_attached & env.scene.target
        total = body.nodes.external[:, :3].sum(axis=0)
        np.testing.assert_allclose(total, env.scene.load if held.any() else 0.0, atol=1e-12)
        task.simulation.check_validity()
        if not held.any():
            break


def test_each_of_several_targets_bears_its_share_of_the_load_until_it_is_free():
    scene = variant_scene("two targets")
    env = ResectEnv(scene)
    env.reset(seed=0)
    task, target = env.task, np.flatnonzero(scene.target)
    one, other = target[:6], target[6:]
    # two cubes of equal volume: half of the load each
    for free in (one, other):
        attached = [cube for cube in (one, other) if task.is_attached[cube].any()]
        for cube in attached:
            held = task.simulation.body.tetrahedra.load[cube].sum(axis=(0, 1))
            np.testing.assert_allclose(held, 0.5 * scene.load, rtol=1e-12)
        assert task.outcome != "separated"
        for tet in free.tolist():
            if task.is_attached[tet]:
                task.apply(task.table.n_faces + tet)
                if task.is_attached[free].any():
                    held = task.simulation.body.tetrahedra.load[free].sum(axis=(0, 1))
                    np.testing.assert_allclose(held, 0.5 * scene.load, rtol=1e-12)
    task.settle()
    assert not task.is_attached[target].any()


def test_a_finished_episode_asks_for_a_reset(env):
    env.reset(seed=0)
    with pytest.raises(TypeError, match="float"):
        env.step(1.5)
    with pytest.raises(ValueError, match=r"action 120 is out of range 0\.\.119"):
        env.step(120)
    play(env, random_policy())
    with pytest.raises(gym.error.ResetNeeded, match="call reset"):
        env.step(0)


def test_a_scene_without_a_certificate_can_be_played():
    scene = with_certificate(SCENES[0], None)
    env = ResectEnv(scene)
    assert env.optimum == pytest.approx(SCENES[0].certificate.optimum, rel=1e-12)


def test_single_precision_plays_the_same_episode_to_its_own_accuracy():
    physics = SCENES[0].physics.model_copy(update={"dtype": "float32"})
    episodes = [
        play(ResectEnv(small_scene(0, physics=physics_of)), random_policy(3))
        for physics_of in (SCENES[0].physics, physics)
    ]
    assert [step[1] for step in episodes[0]] == [step[1] for step in episodes[1]]
    for double, single in zip(*episodes, strict=True):
        np.testing.assert_allclose(single[0]["globals"], double[0]["globals"], rtol=1e-2, atol=1e-3)


def test_a_settling_may_end_early_where_a_scene_says_so():
    plain = SCENES[0].physics
    physics = plain.model_copy(update={"settle_seconds": 0.6, "rest_tolerance": 1e-3})
    whole = physics.model_copy(update={"rest_tolerance": None})
    fixed, early = (ResectEnv(small_scene(0, physics=each)) for each in (whole, physics))
    for env in (fixed, early):
        env.reset(seed=0)
    for action in (0, 30, 71):
        one, two = fixed.step(action), early.step(action)
        assert one[2:4] == two[2:4] == (False, False)
        # No node could have come any further than 1e-3 h.
        moved = np.abs(one[0]["nodes"][:, 1:4] - two[0]["nodes"][:, 1:4]).max()
        assert moved < 1e-3
    assert early.task.simulation.n_substeps < 0.8 * fixed.task.simulation.n_substeps
    assert early.task.simulation.time == pytest.approx(fixed.task.simulation.time)


def test_a_settling_takes_its_whole_time_unless_a_scene_says_otherwise(env):
    assert SCENES[0].physics.rest_tolerance is None
    env.reset(seed=0)
    before, seconds = env.task.simulation.n_substeps, SCENES[0].physics.settle_seconds
    env.step(0)
    assert env.task.simulation.n_substeps - before == np.ceil(seconds / env.task.simulation.stable_step)


def test_frames_show_the_body():
    env = ResectEnv(SCENES, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    env.step(int(np.flatnonzero(env.action_masks())[-1]))
    assert first.dtype == np.uint8 and first.shape == (480, 480, 3)
    assert (first != env.render()).any()
    assert ResectEnv(SCENES).render() is None
