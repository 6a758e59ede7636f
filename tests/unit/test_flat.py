"""The flat policy: a plain network to compare with, held to the same rules, and to the one mesh it was made for."""

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")

from sb3_contrib import MaskablePPO  # noqa: E402
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy  # noqa: E402
from stable_baselines3.common.torch_layers import CombinedExtractor  # noqa: E402

from agents.checkpoint import CheckpointError, load_policy, read_page  # noqa: E402
from agents.command_line import main  # noqa: E402
from agents.flat import FlatPolicy  # noqa: E402
from agents.training import Trainer  # noqa: E402
from agents.training_config import FlatSettings  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from envs.wrappers import FLAT_PARTS, FlatObservation  # noqa: E402
from gmapspring.errors import ConfigError  # noqa: E402
from tests.small_run import SMALL, UPDATE, is_same, optimizer_tensors, small_config, trained  # noqa: E402
from tests.small_scene import randomly_cut, side_by_side, small_scene  # noqa: E402

FLAT = {"kind": "flat", "layers": [16, 8]}
EVERY = SMALL["validation"] | {"every_updates": 1}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Return a run of one update."""
    return trained(tmp_path_factory.mktemp("flat") / "run", 1, network=FLAT, validation=EVERY)[0]


@pytest.fixture(scope="module")
def env():
    """Return an environment of as many tetrahedra as the run's."""
    return ResectEnv(small_scene(seed=2, load=0.02))


@pytest.fixture(scope="module")
def policy(env):
    """Return an untrained policy whose logits and values differ: by design the last layers start near zero."""
    torch.manual_seed(0)
    made = FlatPolicy(env.observation_space, env.action_space, lambda _: 1e-3, network=FlatSettings(**FLAT))
    for layer in (made.action_net, made.value_net):
        torch.nn.init.normal_(layer.weight)
    return made


def as_tensors(observations):
    """Return observations as a batch of what the policy reads."""
    batch = side_by_side(observations)
    return {name: torch.as_tensor(batch[name]) for name in (*FLAT_PARTS, "action_mask")}


# What it sees and does --------------------------------------------------------------------------------------------


def test_it_sees_what_the_flat_observation_shows(env, policy):
    wrapped = FlatObservation(env)
    for observation in randomly_cut(env):
        seen = policy.features_extractor(as_tensors([observation]))
        np.testing.assert_array_equal(seen[0], wrapped.observation(observation))


def test_probabilities_are_those_of_the_legal_logits_alone(env, policy):
    for observation in randomly_cut(env):
        legal = np.flatnonzero(observation["action_mask"])
        assert 0 < len(legal) < env.action_space.n
        seen = torch.as_tensor(FlatObservation(env).observation(observation))
        with torch.no_grad():
            expected = policy.action_net(policy.mlp_extractor.policy_net(seen))[legal].log_softmax(0)
            worth = policy.value_net(policy.mlp_extractor.value_net(seen))
            batch = {name: tensor.expand(len(legal), *tensor.shape[1:]) for name, tensor in as_tensors([observation]).items()}
            values, found, entropy = policy.evaluate_actions(batch, torch.as_tensor(legal))
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(values[0], worth, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(entropy[0], -(expected.exp() * expected).sum(), atol=1e-4, rtol=1e-4)


def test_only_legal_actions_are_predicted(env, policy):
    torch.manual_seed(0)
    allowed = [1, 5, env.action_space.n - 1]
    for observation in randomly_cut(env, n_cuts=2):
        narrow = observation | {"action_mask": np.zeros_like(observation["action_mask"])}
        narrow["action_mask"][allowed] = 1
        with torch.no_grad():
            probability = policy.get_distribution(as_tensors([narrow])).distribution.probs[0].double()
        assert float(probability[allowed].sum()) == pytest.approx(1.0, abs=1e-6)
        drawn = {int(policy.predict(narrow)[0]) for _ in range(100)}
        # At a chance of a tenth, a hundred draws miss an action once in 40000 times.
        likely = {action for action in allowed if probability[action] > 0.1}
        assert likely <= drawn <= set(allowed)
        assert int(policy.predict(narrow, deterministic=True)[0]) == int(probability.argmax())


def test_a_mask_that_is_handed_over_counts_beside_the_observation_s(env, policy):
    observation = randomly_cut(env)[0]
    mask = np.zeros(env.action_space.n, dtype=bool)
    mask[7] = True
    assert policy.predict(observation, action_masks=mask)[0] == 7


def test_a_batch_gives_the_same_as_one_observation_after_the_other(env, policy):
    found = randomly_cut(env, n_cuts=8)
    together, _ = policy.predict(side_by_side(found), deterministic=True)
    alone = [int(policy.predict(observation, deterministic=True)[0]) for observation in found]
    assert together.tolist() == alone
    with torch.no_grad():
        values, logs, _ = policy.evaluate_actions(as_tensors(found), torch.as_tensor(together))
        for number, observation in enumerate(found):
            value, log, _ = policy.evaluate_actions(as_tensors([observation]), torch.as_tensor(together[number : number + 1]))
            torch.testing.assert_close((values[number], logs[number]), (value[0], log[0]), atol=1e-5, rtol=1e-5)


# Training ---------------------------------------------------------------------------------------------------------


def test_an_update_changes_every_layer_and_is_kept(run, tmp_path):
    start = Trainer(small_config(network=FLAT), tmp_path / "start").model.policy.state_dict()
    after = run.model.policy.state_dict()
    assert run.n_steps == UPDATE
    assert [layer.out_features for layer in run.model.policy.mlp_extractor.policy_net if hasattr(layer, "out_features")] == [
        16,
        8,
    ]
    for name, weights in start.items():
        assert not torch.equal(weights, after[name]), name
    page = read_page(run.folder.last)
    assert (page.n_steps, page.network) == (UPDATE, FLAT)


def test_illegal_actions_have_no_part_in_what_is_learnt(run):
    buffer, policy = run.model.rollout_buffer, run.model.policy
    seen = buffer.observations["action_mask"].reshape(-1, run.model.action_space.n).any(axis=0)
    place = [name for name, _ in policy.named_parameters()].index("action_net.bias")
    slope = policy.optimizer.state_dict()["state"][place]["exp_avg_sq"].sqrt().numpy()
    assert seen.any() and not seen.all()
    # The slope of a logit that was never legal is round-off: float32 beside 1.
    assert slope[~seen].max() < 1e-5 * slope[seen].min()


def test_its_optimizer_is_the_one_of_stable_baselines3_but_fused(env, policy):
    plain = MaskableActorCriticPolicy(
        env.observation_space,
        env.action_space,
        lambda _: 1e-3,
        net_arch=FLAT["layers"],
        features_extractor_class=CombinedExtractor,
    )
    expected, found = (each.optimizer.param_groups[0] | {"params": None} for each in (plain, policy))
    assert type(policy.optimizer) is type(plain.optimizer)
    assert found == expected | {"fused": True}


def test_a_resumed_run_goes_on_bit_for_bit(run, tmp_path):
    whole, _ = trained(tmp_path / "whole", 2, network=FLAT, validation=EVERY)
    trained(tmp_path / "run", 1, network=FLAT, validation=EVERY)
    resumed, result = trained(tmp_path / "run", 2, resume=True, network=FLAT, validation=EVERY)
    assert result.n_steps == 2 * UPDATE
    assert is_same(resumed.model.policy, whole.model.policy) and not is_same(resumed.model.policy, run.model.policy)
    tensors = [optimizer_tensors(trainer) for trainer in (resumed, whole)]
    assert len(tensors[0]) == len(tensors[1]) > 0 and all(map(torch.equal, *tensors))


def test_a_saved_policy_plays_the_same_here_and_in_stable_baselines3(run, env):
    here = load_policy(run.folder.last, env.observation_space, env.action_space)
    there = MaskablePPO.load(run.folder.last)
    assert isinstance(here, FlatPolicy) and is_same(here, there.policy)
    for observation in randomly_cut(env):
        actions = {int(who.predict(observation, deterministic=True)[0]) for who in (here, there, run.model)}
        assert len(actions) == 1 and observation["action_mask"][actions.pop()]


def test_the_command_plays_a_saved_policy(run, tmp_path, capsys):
    out = tmp_path / "episodes.csv"
    assert main(["evaluate", str(run.folder.best), "--episodes", "2", "--out", str(out)]) == 0
    assert len(out.read_text().splitlines()) == 3
    capsys.readouterr()


def test_a_run_may_begin_with_the_weights_of_another(run, tmp_path):
    trainer = Trainer(small_config(network=FLAT), tmp_path / "run", start=run.folder.last)
    assert is_same(trainer.model.policy, run.model.policy) and trainer.n_steps == 0


# Mistakes ---------------------------------------------------------------------------------------------------------


def numbers_of(env):
    """Return how many numbers a flat network reads of an environment's observations, and how many actions there are."""
    return sum(env.observation_space[part].shape[0] * (*env.observation_space[part].shape, 1)[1] for part in FLAT_PARTS)


def test_a_mesh_of_another_size_is_refused_in_one_line(run, env, tmp_path, capsys):
    other = ResectEnv(small_scene(cells=(3, 2, 2)))
    with pytest.raises(CheckpointError) as caught:
        load_policy(run.folder.best, other.observation_space, other.action_space)
    assert str(caught.value) == (
        f"{run.folder.best} cannot be used here: a flat network is made for one size of mesh, "
        f"{numbers_of(env)} numbers to see and {env.action_space.n} actions; "
        f"this one has {numbers_of(other)} numbers to see and {other.action_space.n} actions"
    )
    config = tmp_path / "flat.yaml"
    config.write_text(yaml.safe_dump(SMALL | {"network": FLAT, "scene": "box-108"}))
    start = ["train", config, "--start-from", run.folder.best, "--out", tmp_path / "run"]
    for command in (["evaluate", run.folder.best, "--scene", "box-108", "--episodes", 1], start):
        assert main([str(argument) for argument in command]) == 1
        error = capsys.readouterr().err
        assert error.startswith(f"error: {run.folder.best} cannot be used here: a flat network") and error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_flat_network_cannot_be_cloned():
    with pytest.raises(ConfigError, match="has 1 mistake:\n  warm_start: .* of kind 'candidates' only; leave warm_start out"):
        small_config(network=FLAT, warm_start={})
