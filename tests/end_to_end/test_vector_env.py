"""ResectVectorEnv: row i is, to the last bit, a ResectEnv with seed + i; the oracle is gymnasium's own loop over single ones."""

import multiprocessing
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space

from envs.actions import MASKS
from envs.resect import ResectEnv
from envs.vector import ResectVectorEnv
from gmapspring.errors import ConfigError
from tests.small_scene import BENT, VARIANTS, small_scene, variant_scene

SCENES = [small_scene(seed, load=0.1 + 0.1 * seed) for seed in range(4)]
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]
N = 5


def pair(mode=AutoresetMode.SAME_STEP, scenes=SCENES, n=N, n_threads=None, **arguments):
    """Return the batch, and single environments stepped one after the other."""
    single = SyncVectorEnv([lambda: ResectEnv(scenes, **arguments) for _ in range(n)], autoreset_mode=mode)
    return ResectVectorEnv(n, scenes, autoreset_mode=mode, n_threads=n_threads, **arguments), single


def assert_same(one, other, path=""):
    """Check that two nested results are equal to the last bit, and of the same types."""
    assert type(one) is type(other), (path, type(one), type(other))
    if isinstance(one, dict):
        assert one.keys() == other.keys(), (path, one.keys() ^ other.keys())
        for key in one:
            assert_same(one[key], other[key], f"{path}.{key}")
    elif isinstance(one, tuple) or (isinstance(one, np.ndarray) and one.dtype == object):
        assert len(one) == len(other), path
        for a, b in zip(one, other, strict=True):
            assert_same(a, b, path)
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape) == (other.dtype, other.shape), path
        assert one.tobytes() == other.tobytes(), path
    else:
        assert one == other, path


def choose(masks, rng, p_illegal=0.1):
    """Return a random action for each row, most of them legal."""
    actions = []
    for mask in masks:
        allowed = mask.astype(bool) if rng.random() > p_illegal and mask.any() else np.ones(len(mask), bool)
        actions.append(int(rng.choice(np.flatnonzero(allowed))))
    return np.array(actions)


def play_both(batch, single, n_steps=60, seed=3, rng=None):
    """Play both alike and compare all that they give; return how many episodes ended."""
    rng = np.random.default_rng(1) if rng is None else rng
    results = batch.reset(seed=seed), single.reset(seed=seed)
    assert_same(*results)
    n_ended = 0
    for _ in range(n_steps):
        masks = results[0][0]["action_mask"]
        assert np.array_equal(batch.action_masks(), masks.astype(bool))
        actions = choose(masks, rng)
        results = batch.step(actions), single.step(actions)
        assert_same(*results)
        n_ended += int((results[0][2] | results[0][3]).sum())
    return n_ended


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("mask", MASKS)
def test_rows_are_single_environments_to_the_last_bit_over_several_episodes(mode, mask):
    assert play_both(*pair(mode, mask=mask, reward={"cost": -0.7, "illegal": -0.3})) > 2 * N


@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("variant", VARIANTS[1:])
def test_rows_are_single_environments_under_other_rules_too(variant, mask):
    scenes = [variant_scene(variant, seed, load=0.05 + 0.1 * seed) for seed in range(3)]
    assert play_both(*pair(scenes=scenes, n=3, mask=mask), 40) > 3


def test_rows_under_different_rules_stand_side_by_side():
    scenes = [variant_scene(variant, seed, load=0.1) for seed, variant in enumerate(VARIANTS)]
    assert play_both(*pair(scenes=scenes), 60) > N


def test_rows_are_single_environments_on_a_shipped_level_too():
    arguments = dict(scene="box-192", split="validation", mask="reachable")
    batch = ResectVectorEnv(3, autoreset_mode=AutoresetMode.SAME_STEP, **arguments)
    single = SyncVectorEnv([lambda: ResectEnv(**arguments)] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    assert play_both(batch, single, 40) > 0


@pytest.mark.parametrize("integrator", ["rk4", "symplectic_euler", "backward_euler"])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_rows_are_single_environments_in_any_precision_and_by_any_integrator(integrator, dtype):
    physics = SCENES[0].physics.model_copy(update={"integrator": integrator, "dtype": dtype, "damping": 1e-4})
    assert play_both(*pair(scenes=[small_scene(seed, physics=physics) for seed in range(2)], n=2), 25)


def test_scenes_with_other_terms_and_meshes_stand_side_by_side():
    plain = SCENES[0].physics
    damped = plain.model_copy(update={"damping": 2e-4, "viscosity": 0.0})
    heavy = plain.model_copy(update={"gravity": (0.0, 0.0, -2.0), "rest_tolerance": 0.01, "settle_seconds": 0.2})
    scenes = [
        *SCENES,
        small_scene(5, physics=damped),
        small_scene(6, physics=heavy),
        small_scene(7, cells=(4, 1, 2), limits=SCENES[0].limits.model_copy(update={"strain": 0.4})),
    ]
    scenes = [scene for scene in scenes if ResectEnv(scene).task.table.n_actions == 120]
    assert len(scenes) >= 6
    assert play_both(*pair(scenes=scenes), 60)


def test_threads_change_no_bit():
    assert play_both(*pair(n_threads=3), 30)


def test_a_row_that_diverges_ends_its_own_episode_and_no_other_row_notices():
    batch, single = pair(AutoresetMode.NEXT_STEP)
    batch.reset(seed=0), single.reset(seed=0)
    for row in (1, 3):
        batch._rows.body(row).nodes.velocity[:] = 1e200
        single.envs[row].task.simulation.body.nodes.velocity[:] = 1e200
    actions = choose(single._observations["action_mask"], np.random.default_rng(0), 0.0)
    results = batch.step(actions), single.step(actions)
    assert_same(*results)
    observation, _, terminated, _, info = results[0]
    assert terminated[[1, 3]].all() and info["reason"][1] == info["reason"][3] == "numerical"
    assert batch.observation_space.contains(observation)
    actions = choose(observation["action_mask"], np.random.default_rng(1), 0.0)
    assert_same(batch.step(actions), single.step(actions))


# Seeds and options --------------------------------------------------------------------------------------------------


def test_seeds_may_be_given_one_by_one_and_go_on_where_none_is_given():
    batch, single = pair()
    for seed in ([7, None, 3, 3, 0], None, 11, [None] * N):
        if seed is not None and not isinstance(seed, int) and None in seed and seed != [None] * N:
            # What is not seeded is random: seed it once before.
            assert_same(batch.reset(seed=1), single.reset(seed=1))
        assert_same(batch.reset(seed=seed), single.reset(seed=seed))


def test_without_a_seed_rows_differ_from_run_to_run():
    seen = {tuple(ResectVectorEnv(12, SCENES).reset()[1]["scene_seed"]) for _ in range(3)}
    assert len(seen) == 3


@pytest.mark.parametrize(
    "options",
    [{"index": 2}, {"scene_seed": 3}, {"load_factor": 2.0}, {"index": 1, "load": [0.0, 0.0, 0.0]}, {"scene": small_scene(17)},
     {"kappa": 0.3}, {"index": 1, "mesh": BENT}, {"scene_seed": 2, "mesh": BENT, "kappa": 0.5}],
)
def test_options_do_what_they_do_in_a_single_environment_and_shift_nothing(options):
    batch, single = pair()
    batch.reset(seed=5), single.reset(seed=5)
    for given in (options, None):
        results = batch.reset(options=given), single.reset(options=given)
        assert_same(*results)
        for _ in range(3):
            actions = choose(results[0][0]["action_mask"], np.random.default_rng(2))
            results = batch.step(actions), single.step(actions)
            assert_same(*results)


def test_some_rows_alone_can_be_reset():
    batch, single = pair(AutoresetMode.NEXT_STEP)
    results = batch.reset(seed=5), single.reset(seed=5)
    rng = np.random.default_rng(0)
    mask = np.array([True, False, False, True, False])
    for _ in range(12):
        actions = choose(results[0][0]["action_mask"], rng)
        batch.step(actions), single.step(actions)
        results = [env.reset(options={"reset_mask": mask, "index": 1}) for env in (batch, single)]
        assert_same(*results)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"indx": 1}, r"options\.indx: unknown option; did you mean 'index'\?"),
        ({"scene": small_scene(cells=(2, 2, 1))}, r"this environment was made for 72 and 48"),
        (
            {"scene": small_scene(physics=SCENES[0].physics.model_copy(update={"dtype": "float32"}))},
            r"asks for symplectic_euler in float32, but this environment was made for symplectic_euler in float64",
        ),
        ({"reset_mask": np.zeros(N, bool)}, r"options\.reset_mask"),
        ({"reset_mask": [1, 0]}, r"options\.reset_mask"),
    ],
)
def test_an_option_that_does_not_fit_is_an_error(options, message):
    batch = ResectVectorEnv(N, SCENES)
    with pytest.raises(ConfigError, match=message):
        batch.reset(seed=0, options=options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, r"num_envs must be a whole number above 0, not 0"),
        ({"mask": "al"}, r"no mask 'al'; did you mean 'all'\?"),
        ({"reward": {"colapse": 1.0}}, r"reward\.colapse"),
        ({"render_mode": "human"}, r"no render mode 'human'"),
        ({"autoreset_mode": AutoresetMode.DISABLED}, r"no autoreset mode"),
        ({"autoreset_mode": "same"}, r"no autoreset mode 'same'"),
    ],
)
def test_a_constructor_argument_that_does_not_fit_is_an_error(arguments, message):
    with pytest.raises(ConfigError, match=message):
        ResectVectorEnv(**{"scene": SCENES} | arguments)


def test_actions_that_cannot_be_are_refused_with_nothing_changed():
    batch = ResectVectorEnv(2, SCENES)
    with pytest.raises(gym.error.ResetNeeded):
        batch.step(np.zeros(2, int))
    before, _ = batch.reset(seed=0)
    bad = ([0, 120], "row 1: action 120 is out of range 0..119"), ([0], "one for each of 2 rows"), ([0.5, 1], "float64")
    for actions, message in bad:
        with pytest.raises(ValueError, match=message):
            batch.step(np.array(actions))
    with pytest.raises(ValueError, match="3 seeds were given for 2 rows"):
        batch.reset(seed=[1, 2, 3])
    assert_same(before, batch.reset(seed=0)[0])


# As its users meet it -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_it_is_made_by_name(mode):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        batch = gym.make_vec(
            "envs:Resect-v0", num_envs=3, vectorization_mode="vector_entry_point", scene=SCENES, autoreset_mode=mode, mask="focus"
        )
    assert isinstance(batch, ResectVectorEnv)
    assert batch.metadata["autoreset_mode"] is mode
    assert batch.observation_space == batch_space(batch.single_observation_space, 3)
    observation, _ = batch.reset(seed=0)
    assert batch.observation_space.contains(observation)
    assert batch.single_observation_space == ResectEnv(SCENES).observation_space


def test_observations_belong_to_the_receiver():
    batch = ResectVectorEnv(3, SCENES, autoreset_mode=AutoresetMode.SAME_STEP)
    rng = np.random.default_rng(0)
    observation, info = batch.reset(seed=0)
    for _ in range(20):
        kept, kept_info = {name: array.copy() for name, array in observation.items()}, repr(info)
        actions = choose(observation["action_mask"], rng)
        following, _, _, _, following_info = batch.step(actions)
        assert_same(observation, kept)
        assert repr(info) == kept_info
        for array in observation.values():
            array[:] = 7
        observation, info = following, following_info


def test_frames_show_each_body():
    batch = ResectVectorEnv(2, SCENES, render_mode="rgb_array")
    batch.reset(seed=0)
    frames = batch.render()
    assert len(frames) == 2 and frames[0].shape == (480, 480, 3)
    single = ResectEnv(SCENES, render_mode="rgb_array")
    single.reset(seed=0)
    assert np.array_equal(frames[0], single.render())
    assert ResectVectorEnv(1, SCENES).render() is None


def few_steps(n_threads):
    """Play some steps in a process of its own."""
    batch, rng = ResectVectorEnv(4, SCENES, n_threads=n_threads), np.random.default_rng(0)
    observation, _ = batch.reset(seed=0)
    return sum(batch.step(choose(observation["action_mask"], rng, 0.0))[1].sum() for _ in range(4))


@pytest.mark.parametrize("method", ["fork", "forkserver", "spawn"])
def test_it_plays_in_processes_of_any_kind(method):
    expected = few_steps(2)
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.apply_async(few_steps, (2,)).get(120) == expected
