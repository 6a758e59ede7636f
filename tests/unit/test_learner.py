"""PPO on ragged candidates: it plays and learns exactly what MaskablePPO would, step for step."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from sb3_contrib import MaskablePPO  # noqa: E402
from stable_baselines3.common.utils import set_random_seed  # noqa: E402

from agents.candidate_policy import CandidatePolicy, read_candidates  # noqa: E402
from agents.learner import CandidatePPO  # noqa: E402
from agents.training_config import NetworkSettings, Shaping  # noqa: E402
from agents.training_view import TrainingView  # noqa: E402
from agents.vector_face import ResectVecEnv  # noqa: E402
from tests.small_scene import small_scene  # noqa: E402

N_ENVS, N_STEPS = 3, 20
NETWORK = NetworkSettings(hidden=16, rounds=2)


def learnt(learner, **changes):
    """Return a model after one update, whose environments ended some episodes on the way."""
    scene = small_scene(seed=2, load=0.02)
    view = TrainingView(ResectVecEnv(N_ENVS, scene=scene), Shaping(weight=1.0), 0.9)
    settings = {"n_steps": N_STEPS, "batch_size": N_ENVS * N_STEPS, "n_epochs": 1, "ent_coef": 0.02, "gamma": 0.9}
    model = learner(CandidatePolicy, view, policy_kwargs={"network": NETWORK}, device="cpu", seed=3, **settings | changes)
    # Plain descent: the first step of Adam has the size of the learning rate wherever a slope is not exactly 0.
    model.policy.optimizer = torch.optim.SGD(model.policy.parameters(), lr=1.0)
    torch.nn.init.normal_(model.policy.network.logit.weight)
    set_random_seed(5)
    view.seed(5)
    # Without masks of its own MaskablePPO would weigh illegal actions in its loss, whatever the policy knows of them.
    model.learn(N_ENVS * N_STEPS, log_interval=None, use_masking=learner is MaskablePPO)
    return model


def test_an_update_is_the_one_that_maskable_ppo_takes():
    # The rate is large enough that the step is well above round-off: 1.0 times slopes whose norm is held to 0.5.
    own, other = (learnt(learner, learning_rate=1.0) for learner in (CandidatePPO, MaskablePPO))
    states = own.policy.state_dict(), other.policy.state_dict()
    for name in states[0]:
        torch.testing.assert_close(states[0][name], states[1][name], atol=1e-4, rtol=0.0, msg=name)
    for name, value in other.logger.name_to_value.items():
        if name.startswith("train/"):
            assert own.logger.name_to_value[name] == pytest.approx(value, abs=1e-3), name


def test_a_rollout_is_the_one_that_maskable_ppo_remembers():
    own, other = (learnt(learner, learning_rate=1e-3).rollout_buffer for learner in (CandidatePPO, MaskablePPO))
    for name in ("rewards", "values", "log_probs", "episode_starts", "advantages", "returns"):
        # MaskablePPO's buffer lies environment by environment once it has been read.
        theirs = np.asarray(getattr(other, name))
        theirs = theirs if theirs.shape == (N_STEPS, N_ENVS) else theirs.reshape(N_ENVS, N_STEPS).T
        np.testing.assert_allclose(getattr(own, name), theirs, atol=1e-4, err_msg=name)
    assert own.episode_starts[1:].any()


def test_a_buffer_holds_the_candidates_of_every_state():
    whole, ragged = (learnt(learner).rollout_buffer for learner in (MaskablePPO, CandidatePPO))
    for step in (0, 7, N_STEPS - 1):
        for env in range(N_ENVS):
            # MaskablePPO's buffer lies environment by environment once it has been read.
            row = env * N_STEPS + step
            found = ragged.states[step * N_ENVS + env]
            expected = read_candidates({name: part[row : row + 1] for name, part in whole.observations.items()})
            assert found.action[found.action == whole.actions[row, 0]].size == 1
            for own, other in zip(found, expected, strict=True):
                np.testing.assert_array_equal(own, other)


def test_the_samples_of_an_epoch_are_all_states_each_once_and_whole():
    buffer = learnt(CandidatePPO).rollout_buffer
    samples = list(buffer.get(batch_size=N_ENVS * N_STEPS // 4))
    assert len(samples) == 4
    assert sorted(np.concatenate([sample.returns for sample in samples])) == sorted(buffer.returns.ravel())
    for sample in samples:
        for number, state in enumerate(sample.observations.split()):
            number_of = int(np.flatnonzero(buffer.log_probs.ravel() == sample.old_log_prob[number].item())[0])
            np.testing.assert_array_equal(state.features, buffer.states[number_of].features)
            assert sample.actions[number] == buffer.actions.ravel()[number_of]


def test_another_buffer_is_refused():
    with pytest.raises(TypeError, match="rollout_buffer_class"):
        learnt(CandidatePPO, rollout_buffer_class=None)
