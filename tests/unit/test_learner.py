"""PPO on ragged candidates: it plays and learns exactly what MaskablePPO would, step for step."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from sb3_contrib import MaskablePPO  # noqa: E402
from stable_baselines3.common.utils import set_random_seed  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv  # noqa: E402

from agents.candidate_policy import CandidatePolicy  # noqa: E402
from agents.features import Observed, gather_candidates  # noqa: E402
from agents.learner import CandidatePPO  # noqa: E402
from agents.training_view import TrainingView  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from tests.small_scene import small_scene  # noqa: E402

N_ENVS, N_STEPS = 3, 20


def learnt(learner, **changes):
    """Return a model after one update, whose environments ended some episodes on the way."""
    scene = small_scene(seed=2, load=0.02)
    view = TrainingView(DummyVecEnv([lambda: ResectEnv(scene) for _ in range(N_ENVS)]), 1.0, 0.9)
    settings = {"n_steps": N_STEPS, "batch_size": N_ENVS * N_STEPS, "n_epochs": 1, "ent_coef": 0.02, "gamma": 0.9}
    model = learner(CandidatePolicy, view, policy_kwargs={"hidden": 16}, device="cpu", seed=3, **settings | changes)
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


def test_a_buffer_holds_the_features_of_every_state_one_after_the_other():
    model = learnt(MaskablePPO), learnt(CandidatePPO)
    whole, ragged = model[0].rollout_buffer.observations, model[1].rollout_buffer.ragged()
    for step in (0, 7, N_STEPS - 1):
        for env in range(N_ENVS):
            row = env * N_STEPS + step
            observed = Observed(*(whole[name][row][None] for name in Observed._fields))
            expected = gather_candidates(observed, whole["action_mask"][row][None])
            state = step * N_ENVS + env
            found = ragged.features[ragged.offset[state] : ragged.offset[state + 1]]
            np.testing.assert_array_equal(found, expected.features)
            np.testing.assert_array_equal(ragged.of_state[state], whole["globals"][row])


def test_settings_that_it_has_no_part_for_are_refused():
    with pytest.raises(TypeError, match="no setting 'target_kl'"):
        learnt(CandidatePPO, target_kl=0.1)
