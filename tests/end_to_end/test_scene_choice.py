"""Which scene an episode of Resect-v0 plays: as its seed says, or its options."""

import gymnasium as gym
import numpy as np
import pytest

from envs.order import replay
from envs.resect import ResectEnv
from gmapspring import meshes
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh
from tests.small_scene import BENT, first_scenes, play, small_scene, with_certificate

SCENES = [small_scene(seed) for seed in range(4)]


@pytest.fixture
def env():
    """Return an environment on four small scenes."""
    return ResectEnv(SCENES)


def test_a_seed_fixes_the_whole_sequence_of_scenes(env):
    assert first_scenes(env, seed=5) == first_scenes(env, seed=5)
    assert len(set(first_scenes(env, 40, seed=5))) == len(SCENES)


def test_the_sequence_is_the_same_in_every_wrapper_and_however_episodes_end(env):
    expected = first_scenes(env, seed=5)
    assert first_scenes(gym.make("envs:ResectFlat-v0", scene=SCENES), seed=5) == expected
    seen = []
    for i in range(len(expected)):
        _, info = env.reset(seed=5) if i == 0 else env.reset()
        seen.append(info["scene_seed"])
        for _ in range(i):
            if env.step(int(np.flatnonzero(env.action_masks())[-1]))[2]:
                break
    assert seen == expected


def test_autoreset_in_a_vector_goes_on_with_the_same_sequence(env):
    expected = first_scenes(env, 3, seed=5)
    vector = gym.make_vec("envs:Resect-v0", num_envs=1, vectorization_mode="sync", scene=SCENES)
    _, info = vector.reset(seed=[5])
    seen = [int(info["scene_seed"][0])]
    while len(seen) < 3:
        mask = vector.envs[0].unwrapped.action_masks()
        _, _, terminated, truncated, _ = vector.step(np.array([np.flatnonzero(mask)[0]]))
        if terminated[0] or truncated[0]:
            seen.append(int(vector.step(np.array([0]))[4]["scene_seed"][0]))
    assert seen == expected


def test_options_do_not_shift_the_scenes_that_follow(env):
    expected = first_scenes(env, 4, seed=5)
    seen = [env.reset(seed=5)[1]["scene_seed"]]
    env.reset(options={"index": 2})
    seen += [None, env.reset()[1]["scene_seed"], env.reset()[1]["scene_seed"]]
    assert seen[2:] == expected[2:]


def test_options_choose_a_scene(env):
    assert env.reset(options={"index": 2})[1]["scene_seed"] == 2
    assert env.reset(options={"scene_seed": 3})[1]["scene_seed"] == 3
    other = small_scene(17)
    assert env.reset(options={"scene": other})[1]["scene_seed"] == 17
    assert env.scene is other


def test_options_change_a_scene_for_one_episode(env):
    env.reset(options={"index": 0})
    load, strain = env.task.load, env.task.tissue.healthy_strain
    env.reset(options={"index": 0, "load_factor": 2.0})
    assert np.array_equal(env.task.load, 2.0 * load)
    assert env.task.tissue.healthy_strain > strain
    assert env.optimum == pytest.approx(SCENES[0].certificate.optimum, rel=1e-12)
    env.reset(options={"index": 0})
    assert np.array_equal(env.task.load, load)
    stiff = np.full(48, 1e4)
    env.reset(options={"index": 0, "young_modulus": stiff, "load": [0.0, 0.0, 0.0]})
    assert np.array_equal(env.scene.young_modulus, stiff) and not env.task.load.any()
    target = np.zeros(48, dtype=bool)
    target[-18:-12] = True  # the top cube beside
    observation, _ = env.reset(options={"index": 0, "target": target})
    assert np.array_equal(observation["tetrahedra"][:, 2], target)
    assert env.scene.certificate is None and env.optimum > 0.0


def test_scenes_of_a_list_must_be_of_one_size():
    env = ResectEnv([small_scene(), small_scene(cells=(2, 2, 1))])
    first, _ = env.reset(seed=0, options={"index": 0})
    with pytest.raises(ConfigError, match=r"this environment was made for 72 and 48"):
        env.reset(options={"index": 1})
    again, _ = env.reset(options={"index": 0})
    assert all(np.array_equal(first[key], again[key]) for key in first)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"indx": 1}, r"options\.indx: unknown option; did you mean 'index'\?"),
        ({"load_facto": 1, "scen": 2}, r"(?s)'load_factor'.*'scene'"),
        ({"index": 4}, r"options\.index = 4 is not a whole number from 0 to 3"),
        ({"index": True}, r"options\.index"),
        ({"index": 1, "scene_seed": 1}, r"index and scene_seed each choose a scene"),
        ({"scene_seed": 99}, r"options\.scene_seed = 99 is none of the 4"),
        ({"scene": "box"}, r"options\.scene is 'box'; give an envs\.scene\.Scene"),
        ({"scene": small_scene(cells=(2, 2, 1))}, r"this environment was made for 72 and 48"),
        ({"load_factor": "much"}, r"options\.load_factor must be a finite number"),
        ({"load": [1.0, 2.0]}, r"options\.load must be finite numbers of shape \(3,\)"),
        ({"target": np.zeros(48, bool)}, r"options\.target"),
        ({"young_modulus": np.zeros(48)}, r"options\.young_modulus must be positive"),
        ({"kappa": 1.0}, r"options\.kappa = 1 does not lie between 0 and 1"),
        ({"kappa": "hard"}, r"options\.kappa must be a finite number"),
        ({"mesh": "box"}, r"options\.mesh must be a gmapspring Mesh, not str"),
        ({"mesh": meshes.box((2, 2, 1))}, r"options\.mesh has \(18, 24, 32\) points, .*; the scene's has \(27, 48, 72\)"),
        ({"mesh": Mesh(BENT.points, BENT.tetrahedra[::-1])}, r"options\.mesh has target tetrahedra at pinned points"),
    ],
)
def test_an_option_that_does_not_fit_is_an_error(env, options, message):
    with pytest.raises(ConfigError, match=message):
        env.reset(options=options)


@pytest.mark.parametrize("kappa", [0.3, 0.5])
@pytest.mark.parametrize("certificate", ["its own", None])
def test_the_load_can_be_scaled_to_a_kappa_and_that_is_proven_anew(kappa, certificate):
    scene = SCENES[1] if certificate else with_certificate(SCENES[1], None)
    env = ResectEnv(scene)
    env.reset(options={"kappa": kappa})
    proved = env.scene.certificate
    assert proved.peak_strain == pytest.approx(kappa * 0.5, rel=0.02)
    assert replay(env.task, proved.order).peak_strain == proved.peak_strain
    assert env.optimum == pytest.approx(SCENES[1].certificate.optimum, rel=1e-12)
    np.testing.assert_allclose(env.scene.load, proved.load_factor * SCENES[1].load, rtol=1e-12)
    assert (proved.order == SCENES[1].certificate.order) == bool(certificate)
    plan = iter(proved.order)
    steps = play(env, lambda *_: next(plan), options={"kappa": kappa})
    assert steps[-1][4]["is_success"]
    assert env.reset(options=None) and np.array_equal(env.task.load, scene.load)


def test_a_kappa_that_the_body_does_not_survive_is_an_error_by_name():
    # No tissue that is strained by 0.45 keeps 95 % of its volume everywhere.
    env = ResectEnv(small_scene(1, limits=SCENES[0].limits.model_copy(update={"volume_ratio": 0.95})))
    with pytest.raises(ConfigError, match=r"scene 'small', seed 1: no load gives kappa = 0\.9: tissue turns inside out"):
        env.reset(options={"kappa": 0.9})
    with pytest.raises(ConfigError, match=r"kappa = 0\.5: a load of zero has no direction"):
        env.reset(options={"kappa": 0.5, "load": [0.0, 0.0, 0.0]})


def test_another_mesh_takes_the_place_of_the_scene_s_and_all_else_stays(env):
    env.reset(options={"index": 0, "mesh": BENT})
    scene, old = env.scene, SCENES[0]
    assert scene.mesh is BENT and scene.certificate is None
    for name in ("target", "pinned", "anchor", "young_modulus", "load"):
        assert np.array_equal(getattr(scene, name), getattr(old, name)), name
    np.testing.assert_allclose(env.task.table.volume, BENT.volumes)
    assert env.optimum != pytest.approx(old.certificate.optimum, rel=1e-4)
    env.reset(options={"index": 0})
    assert env.scene is old
