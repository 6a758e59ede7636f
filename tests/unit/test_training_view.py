"""What training sees: rewards that are shaped and yet worth the same, and scenes of several sizes side by side."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from rich.console import Console  # noqa: E402

from agents.candidate_policy import CandidatePolicy, read_candidates  # noqa: E402
from agents.checkpoint import read_page  # noqa: E402
from agents.choice import home_of  # noqa: E402
from agents.demonstrations import demonstrate, together  # noqa: E402
from agents.evaluation import evaluate, summarise  # noqa: E402
from agents.learner import CandidatePPO  # noqa: E402
from agents.mixed_view import MixedView  # noqa: E402
from agents.potentials import POTENTIALS, interface_area  # noqa: E402
from agents.progress import ProgressReport  # noqa: E402
from agents.training import Trainer  # noqa: E402
from agents.training_config import NetworkSettings, Shaping, TrainingConfig  # noqa: E402
from agents.training_view import TrainingView, make_environments  # noqa: E402
from agents.vector_face import ResectVecEnv  # noqa: E402
from envs.action_table import action_table  # noqa: E402
from envs.optimum import prices_of  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from gmapspring.config import check_config  # noqa: E402
from gmapspring.errors import ConfigError  # noqa: E402
from tests.small_scene import drawn, quiet_scenes, small_scene  # noqa: E402

ROUND_OFF = 1e-5
"""Of sums of some ten rewards: they are float32 and of size 1."""
SETTINGS = {
    "scene": ["box-48", "box-108"],
    "seed": 5,
    "network": {"hidden": 8, "rounds": 1},
    "ppo": {
        "n_envs": 4, "n_steps": 4, "batch_size": 8, "n_epochs": 1, "learning_rate": 1e-2, "learning_rate_half_life": 100,
        "clip_range": 0.2, "entropy": 0.01, "gamma": 0.99, "gae_lambda": 0.95,
    },
    "stop": {"steps": 16},
    "validation": {"every_updates": 1, "episodes": 2},
}  # fmt: skip
"""A run of one update on scenes of two sizes."""


def view_of(scenes, shaping=None, gamma=0.9, n_envs=3, seed=0):
    """Return environments as training sees them, and what they show at first."""
    view = TrainingView(ResectVecEnv(n_envs, scene=scenes), shaping, gamma)
    view.seed(seed)
    return view, view.reset()


def interface_faces(scene):
    """Return the faces between target and healthy tissue."""
    return np.flatnonzero(scene.target[action_table(scene.mesh).face_tetrahedra].sum(axis=1) == 1)


# Shaping ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", ["plain", "vessel"])
@pytest.mark.parametrize("potential", POTENTIALS)
def test_shaping_moves_the_discounted_return_of_every_episode_by_the_same_amount(potential, variant):
    gamma, weight, scenes = 0.9, 2.0, quiet_scenes(variant)
    (plain, observation), (shaped, _) = view_of(scenes), view_of(scenes, Shaping(potential=potential, weight=weight), gamma)
    rng, returns, factor, differences = np.random.default_rng(0), np.zeros(3), np.ones(3), []
    while len(differences) < 8:
        actions = drawn(observation, rng)
        observation, rewards, dones, _ = plain.step(actions)
        returns += factor * (shaped.step(actions)[1] - rewards)
        differences += list(returns[dones])
        returns, factor = np.where(dones, 0.0, returns), np.where(dones, 1.0, factor * gamma)
    # The potential at the start is minus the weight, at the end 0.
    np.testing.assert_allclose(differences, weight, atol=ROUND_OFF)


def test_without_shaping_rewards_are_those_of_the_environments():
    scenes = quiet_scenes()
    (view, observation), bare, rng = view_of(scenes), ResectVecEnv(3, scene=scenes), np.random.default_rng(0)
    bare.seed(0), bare.reset()
    for _ in range(20):
        actions = drawn(observation, rng)
        observation, rewards, _, _ = view.step(actions)
        np.testing.assert_array_equal(rewards, bare.step(actions)[1])


def test_an_ended_episode_tells_its_plain_return_its_length_and_its_success():
    scenes = quiet_scenes()
    (view, observation), bare = view_of(scenes, Shaping(weight=2.0)), ResectVecEnv(3, scene=scenes)
    bare.seed(0), bare.reset()
    rng, totals, lengths, n_ended = np.random.default_rng(3), np.zeros(3), np.zeros(3), 0
    while n_ended < 5:
        actions = drawn(observation, rng)
        observation, _, dones, infos = view.step(actions)
        _, rewards, _, expected = bare.step(actions)
        totals, lengths = totals + rewards, lengths + 1
        for row, has_ended in enumerate(dones):
            assert ("episode" in infos[row]) == has_ended
            if has_ended:
                assert infos[row]["episode"]["r"] == pytest.approx(totals[row], abs=ROUND_OFF)
                assert infos[row]["episode"]["l"] == lengths[row]
                assert infos[row]["is_success"] == expected[row]["is_success"]
                totals[row], lengths[row], n_ended = 0.0, 0, n_ended + 1


def test_an_episode_that_overruns_its_budget_is_over():
    view, observation = view_of(small_scene(seed=2, load=0.02), n_envs=1)
    view.venv.envs.step_limit = 3
    rng = np.random.default_rng(1)
    for has_ended in (False, False, True):
        observation, _, dones, infos = view.step(drawn(observation, rng))
        assert dones[0] == has_ended
    assert not infos[0]["TimeLimit.truncated"]


def test_the_interface_shrinks_by_the_area_of_a_face_that_is_cut():
    scene = small_scene(seed=2, load=0.02)
    environments = ResectVecEnv(1, scene=scene)
    before, face = environments.reset(), interface_faces(scene)[0]
    after = environments.step(np.array([face]))[0]
    area = action_table(scene.mesh).face_area[face] / scene.spacing**2
    assert interface_area(before) - interface_area(after) == pytest.approx(area, rel=1e-5)


def test_an_episode_that_begins_after_another_counts_from_its_own_start():
    scenes, shaping = [small_scene(seed, load=0.02, target=small_target(seed)) for seed in (0, 1)], Shaping(weight=2.0)
    view, observation = view_of(scenes, shaping, gamma=1.0, n_envs=1)
    rng, met = np.random.default_rng(1), set()
    while len(met) < 2:
        dones = [False]
        while not dones[0]:
            observation, _, dones, _ = view.step(drawn(observation, rng))
        scene = view.venv.scene_of(0)
        met.add(scene.seed)
        faces, areas = interface_faces(scene), action_table(scene.mesh).face_area / scene.spacing**2
        observation, rewards, _, _ = view.step(faces[:1])
        worth = 2.0 * areas[faces[0]] / areas[faces].sum() - 0.5 * areas[faces[0]] / scene.certificate.optimum
        assert rewards[0] == pytest.approx(worth, abs=ROUND_OFF)


def small_target(seed):
    """Return a target of one or two cubes at the top."""
    return np.arange(48) // 6 >= (7 if seed == 0 else 6)


def test_every_cut_of_the_cheapest_way_is_rewarded_by_its_cost_at_once():
    scene, weight = small_scene(seed=2, load=0.02), 2.0
    view, _ = view_of(scene, Shaping(potential="minimum-cut", weight=weight), gamma=1.0, n_envs=1)
    table, optimum = action_table(scene.mesh), scene.certificate.optimum
    assert scene.certificate.optimum > 0.0 and len(scene.certificate.order) > 2
    for action in scene.certificate.order[:-1]:
        _, rewards, dones, _ = view.step(np.array([action]))
        cost = prices_of(scene, table).actions[action]
        assert not dones[0] and rewards[0] == pytest.approx((weight - 0.5) * cost / optimum, abs=ROUND_OFF)


def test_an_unknown_potential_is_refused_with_the_one_that_was_meant():
    with pytest.raises(ConfigError, match="'minimum-cut'"):
        check_config({"potential": "minimumcut", "weight": 1.0}, Shaping)


# Several scenes -----------------------------------------------------------------------------------------------------


def mixed(shaping=None):
    """Return environments of two sizes, two rows of the one and three of the other, and the parts by themselves."""
    of_sizes = [[small_scene(seed, cells, load=0.02) for seed in (2, 3)] for cells in ((2, 2, 2), (3, 2, 2))]
    parts = [[TrainingView(ResectVecEnv(n, scene=scenes), shaping, 0.9) for n, scenes in zip((2, 3), of_sizes, strict=True)]
             for _ in range(2)]  # fmt: skip
    return MixedView(parts[0]), parts[1]


def test_rows_of_a_mixture_are_those_of_its_parts():
    view, (one, other) = mixed(Shaping(weight=1.0))
    view.seed(4), one.seed(4), other.seed(6)
    seen, alone, rng, n_ended = view.reset(), [one.reset(), other.reset()], np.random.default_rng(0), 0
    for _ in range(20):
        expected = [state for observation in alone for state in read_candidates(observation).split()]
        for state, its_own in zip(seen.split(), expected, strict=True):
            assert all(map(np.array_equal, state, its_own))
        actions = [drawn(observation, rng) for observation in alone]
        seen, rewards, dones, infos = view.step(np.concatenate(actions))
        steps = [part.step(its_own) for part, its_own in zip((one, other), actions, strict=True)]
        alone = [step[0] for step in steps]
        np.testing.assert_array_equal(rewards, np.concatenate([step[1] for step in steps]))
        np.testing.assert_array_equal(dones, np.concatenate([step[2] for step in steps]))
        assert [info.get("is_success") for info in infos] == [info.get("is_success") for step in steps for info in step[3]]
        n_ended += dones.sum()
    assert n_ended > 2


def test_a_mixture_finds_the_rows_of_its_parts():
    view, _ = mixed()
    view.reset()
    sizes = [len(mask) for mask in view.env_method("action_masks")]
    small, large = (part.action_space.n for part in view._parts)
    assert sizes == [small, small, large, large, large]
    assert [len(mask) for mask in view.env_method("action_masks", indices=[4, 1])] == [large, small]
    assert view.get_attr("n_actions", 2) == [large] and view.action_space.n == large


def test_one_policy_learns_on_meshes_of_several_sizes():
    view, _ = mixed(Shaping(potential="minimum-cut", weight=1.0))
    model = CandidatePPO(CandidatePolicy, view, policy_kwargs={"network": NetworkSettings(hidden=8)}, n_steps=8, batch_size=20,
                         n_epochs=1, seed=1, device="cpu")  # fmt: skip
    before = [weights.clone() for weights in model.policy.parameters()]
    model.learn(40, use_masking=False)
    assert any(not torch.equal(*pair) for pair in zip(before, model.policy.parameters(), strict=True))
    assert len({len(state.tetrahedra) for state in model.rollout_buffer.states[:5]}) == 2


def test_the_environments_are_divided_among_the_scenes():
    view = make_environments(check_config(SETTINGS, TrainingConfig))
    assert [part.num_envs for part in view._parts] == [2, 2]
    assert [part.venv.scene_of(0).name for part in view._parts] == SETTINGS["scene"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scene": ["box-48", "box-108", "box-192"]}, "3 scenes cannot share ppo.n_envs = 4 evenly"),
        ({"network": {"kind": "flat"}}, "a flat network is made for one size of mesh"),
        ({"scene": []}, "scene"),
    ],
)
def test_scenes_that_do_not_fit_are_refused_with_one_error(changes, message):
    with pytest.raises(ConfigError, match=message):
        check_config(SETTINGS | changes, TrainingConfig)


def test_one_scene_in_a_list_is_as_good_as_none():
    settings = SETTINGS | {"scene": ["box-48"], "network": {"kind": "flat"}}
    assert isinstance(make_environments(check_config(settings, TrainingConfig)), TrainingView)


def test_certificates_of_several_scenes_are_cloned_together():
    one, other = (demonstrate([small_scene(seed, cells, load=0.02)], "train", "all") for seed, cells in
                  ((2, (2, 2, 2)), (3, (3, 2, 2))))  # fmt: skip
    both = together([one, other])
    assert both.actions.tolist() == [*one.actions, *other.actions]
    assert [id(state) for state in both.states] == [id(state) for part in (one, other) for state in part.states]


def test_a_run_on_several_scenes_learns_from_all_and_is_validated_on_all(tmp_path, monkeypatch):
    asked = []

    def demonstrate_one(scene, split, mask):
        asked.append((scene, split))
        return demonstrate([small_scene(2, load=0.02)], split, mask)

    def interrupt(report):
        raise KeyboardInterrupt

    monkeypatch.setattr("agents.training.demonstrate", demonstrate_one)
    n_steps = SETTINGS["ppo"]["n_envs"] * SETTINGS["ppo"]["n_steps"]
    config = check_config(SETTINGS | {"warm_start": {"epochs": 1}, "stop": {"steps": n_steps}}, TrainingConfig)
    trainer = Trainer(config, tmp_path / "run")
    # Cloned, and stopped before the first update: what is saved is what was validated.
    monkeypatch.setattr(trainer, "_update", interrupt)
    trainer.run(ProgressReport(Console(quiet=True), "test"))
    assert asked == [(scene, "train") for scene in SETTINGS["scene"]]
    assert home_of(str(tmp_path / "run" / "best.zip")).scene == SETTINGS["scene"][0]
    returns = [summarise(evaluate(trainer.model, ResectEnv(scene, "validation"), 2)).total_return.mean
               for scene in SETTINGS["scene"]]  # fmt: skip
    page = read_page(tmp_path / "run" / "best.zip")
    assert page.scene == "box-48 + box-108"
    assert page.best_return == pytest.approx(np.mean(returns))
