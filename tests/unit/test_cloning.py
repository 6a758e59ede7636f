"""Cloning: what certificates show is learnt before play begins, once, and from the same start after any interruption."""

import csv
import os
import signal
import time
from collections import Counter

import numpy as np
import pytest
import yaml

torch = pytest.importorskip("torch")

from agents import demonstrations  # noqa: E402
from agents.candidate_policy import CandidatePolicy, read_candidates  # noqa: E402
from agents.checkpoint import CheckpointError  # noqa: E402
from agents.cloning import clone  # noqa: E402
from agents.command_line import main  # noqa: E402
from agents.demonstrations import DemonstrationError, demonstrate  # noqa: E402
from agents.features import join  # noqa: E402
from agents.training import Trainer, TrainingError  # noqa: E402
from agents.training_config import NetworkSettings, WarmStart  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from gmapspring.errors import ConfigError  # noqa: E402
from tests.small_run import SMALL, UPDATE, Quiet, few_scenes, is_same, optimizer_tensors, small_config, trained  # noqa: E402
from tests.small_scene import fake_certificate, side_by_side, small_scene, with_certificate  # noqa: E402


@pytest.fixture(scope="module")
def scenes():
    """Return scenes of one mesh whose certificates have different lengths."""
    corner = np.zeros(48, dtype=bool)
    corner[-1] = True
    targets = [{}, {"target": corner}, {}, {}, {"target": corner}]
    found = [small_scene(seed=seed, load=0.02, **target) for seed, target in enumerate(targets)]
    assert len({len(scene.certificate.order) for scene in found}) > 1
    return found


@pytest.fixture(scope="module")
def shown(scenes):
    """Return what the scenes' certificates show."""
    return demonstrate(scenes, "train", "all")


# Demonstrations ---------------------------------------------------------------------------------------------------


def slowly_shown(scene):
    """Return what one environment shows along a certificate, to be compared bit for bit."""
    env = ResectEnv(scene)
    observation, _ = env.reset(seed=0)
    found, has_ended = [], False
    for action in scene.certificate.order:
        assert not has_ended
        found.append(as_bytes(read_candidates(side_by_side([observation])), action))
        observation, _, terminated, truncated, info = env.step(action)
        has_ended = terminated or truncated
    assert info["is_success"]
    return found


def as_bytes(state, action):
    """Return a state and what to do in it as something to count."""
    return (int(action), *(part.tobytes() for part in state))


@pytest.mark.parametrize("n_rows", [1, 2, 5, 7])
def test_every_certificate_is_shown_once_as_a_single_environment_plays_it(scenes, n_rows, monkeypatch):
    monkeypatch.setattr(demonstrations, "N_ROWS", n_rows)
    found = demonstrate(scenes, "train", "all")
    expected = Counter(step for scene in scenes for step in slowly_shown(scene))
    assert Counter(map(as_bytes, found.states, found.actions)) == expected
    assert len(found.states) == len(found.actions) == sum(len(scene.certificate.order) for scene in scenes)


def test_a_certificate_that_the_mask_forbids_is_not_shown(scenes):
    scene = scenes[1]
    legal = [ResectEnv(scene, mask=mask).reset(seed=0)[0]["action_mask"] for mask in ("all", "focus")]
    far = int(np.flatnonzero(legal[0] > legal[1])[0])
    other = with_certificate(scene, fake_certificate(scene.certificate.optimum, (far, *scene.certificate.order)))
    assert demonstrate(other, "train", "all").actions[0] == far
    with pytest.raises(DemonstrationError, match=r"'small', seed 1, makes a cut that the mask 'focus' forbids"):
        demonstrate(other, "train", "focus")


def test_a_certificate_with_more_or_fewer_cuts_than_it_takes_is_not_shown(scenes):
    order = scenes[0].certificate.order
    loose = set(np.flatnonzero(ResectEnv(scenes[0]).reset(seed=0)[0]["action_mask"]).tolist()) - set(order)
    longer = with_certificate(scenes[0], fake_certificate(scenes[0].certificate.optimum, (*order, min(loose))))
    shorter = with_certificate(scenes[0], fake_certificate(scenes[0].certificate.optimum, order[:-1]))
    for other, n_cuts in ((longer, len(order) + 1), (shorter, len(order) - 1)):
        with pytest.raises(DemonstrationError, match=f"is not freed by the {n_cuts} cuts of its certificate, or by fewer"):
            demonstrate([scenes[1], other], "train", "all")


@pytest.mark.parametrize("certificate", [None, fake_certificate(1.0)])
def test_a_scene_without_a_certificate_has_nothing_to_show(scenes, certificate):
    with pytest.raises(DemonstrationError, match="seed 0, has no certificate"):
        demonstrate([scenes[1], with_certificate(scenes[0], certificate)], "train", "all")


# Cloning ----------------------------------------------------------------------------------------------------------


def cloned(scene, shown, settings, seed=0):
    """Return a cloned policy, the same before, and what was said meanwhile."""
    env, said = ResectEnv(scene), []
    spaces = env.observation_space, env.action_space
    policy, before = (CandidatePolicy(*spaces, lambda _: 1e-3, network=NetworkSettings(hidden=8)) for _ in range(2))
    before.load_state_dict(policy.state_dict())
    clone(policy, shown, settings, np.random.default_rng(seed), lambda *each: said.append(each))
    return policy, before, said


def mean_loss(policy, shown):
    """Return the mean of -log-probability of what was shown."""
    with torch.no_grad():
        return -float(policy.evaluate_actions(join(shown.states), torch.from_numpy(shown.actions))[1].mean())


def test_cloning_makes_what_was_shown_likely_and_leaves_the_policy_s_own_optimizer_alone(scenes, shown):
    torch.manual_seed(0)
    policy, before, said = cloned(scenes[0], shown, WarmStart(epochs=25, batch_size=8, learning_rate=1e-2))
    # An untrained policy likes all legal actions about equally.
    n_legal = [len(state.action) for state in shown.states]
    assert mean_loss(before, shown) == pytest.approx(np.log(n_legal).mean(), abs=0.3)
    assert mean_loss(policy, shown) < 1.0
    shares, losses = zip(*said, strict=True)
    assert list(shares) == sorted(shares) and shares[-1] == 1.0
    assert losses[-1] < losses[0]
    assert policy.optimizer.state_dict()["state"] == {}
    assert policy.optimizer.param_groups[0]["lr"] == 1e-3


def test_cloning_is_repeated_by_its_seed(scenes, shown):
    found = []
    for seed in (1, 1, 2):
        torch.manual_seed(0)
        found.append(cloned(scenes[0], shown, WarmStart(epochs=1, batch_size=4), seed)[0])
    assert is_same(found[0], found[1]) and not is_same(found[0], found[2])


def test_cloning_takes_the_steps_of_adam_at_a_rate_that_falls_in_a_straight_line(scenes, shown):
    torch.manual_seed(0)
    n_states, settings = len(shown.actions), WarmStart(epochs=3, batch_size=1000, learning_rate=1e-2)
    policy, slow, _ = cloned(scenes[0], shown, settings)
    assert n_states < settings.batch_size
    optimizer = torch.optim.Adam(slow.parameters(), lr=1e-2)
    for rate in (1e-2, 1e-2 * 2 / 3, 1e-2 / 3):
        optimizer.param_groups[0]["lr"] = rate
        optimizer.zero_grad()
        states = zip(shown.states, torch.from_numpy(shown.actions)[:, None], strict=True)
        loss = -sum(slow.evaluate_actions(state, action)[1][0] for state, action in states) / n_states
        loss.backward()
        optimizer.step()
    for name, weights in slow.state_dict().items():
        # The bias of what a softmax is taken of has no slope: there the first steps of Adam have the sign of round-off.
        if name not in ("network.logit.bias", "network.weight.bias"):
            torch.testing.assert_close(policy.state_dict()[name], weights, atol=1e-4, rtol=0.0, msg=name)


def test_every_epoch_has_every_state_once(scenes, shown, monkeypatch):
    met = []
    evaluate = CandidatePolicy.evaluate_actions
    monkeypatch.setattr(
        CandidatePolicy, "evaluate_actions", lambda self, seen, actions: (met.append(seen), evaluate(self, seen, actions))[1]
    )
    cloned(scenes[0], shown, WarmStart(epochs=2, batch_size=4))
    states = [state.features.tobytes() for batch in met for state in batch.split()]
    expected = Counter(state.features.tobytes() for state in shown.states)
    half = len(states) // 2
    assert Counter(states[:half]) == Counter(states[half:]) == expected
    assert states[:half] != states[half:]


# Warm starts ------------------------------------------------------------------------------------------------------

WARM = {"epochs": 3, "batch_size": 1}
"""Some 50 batches, of which the first 32 are told of in the midst."""


def warm_run(folder, scene, n_updates, on_text=lambda text: None, **arguments):
    """Train from a warm start and return (trainer, result, texts)."""
    texts = []

    def hear(text):
        texts.append(text)
        on_text(text)

    settings = {"scene": scene, "warm_start": WARM, "validation": SMALL["validation"] | {"every_updates": 1}}
    return *trained(folder, n_updates, on_text=hear, **settings | arguments), texts


def stop_at(word):
    """Return what presses Ctrl-C at the first text that begins with a word."""
    heard = []

    def stop(text):
        if text.startswith(word) and not heard:
            heard.append(text)
            os.kill(os.getpid(), signal.SIGINT)

    return stop


@pytest.fixture(scope="module")
def few(tmp_path_factory):
    """Return a scene file with a few scenes."""
    return few_scenes(tmp_path_factory.mktemp("few"))


@pytest.fixture(scope="module")
def warm(few, tmp_path_factory):
    """Return a run from a warm start that was never stopped, and what it said."""
    trainer, result, texts = warm_run(tmp_path_factory.mktemp("warm") / "run", few, n_updates=2)
    assert result.n_steps == 2 * UPDATE
    return trainer, texts


def is_as_good(trainer, other):
    """Tell whether two runs have the same weights and the same optimizer, bit for bit."""
    tensors = optimizer_tensors(trainer), optimizer_tensors(other)
    same = len(tensors[0]) == len(tensors[1]) > 0 and all(map(torch.equal, *tensors))
    return same and is_same(trainer.model.policy, other.model.policy)


def test_certificates_are_cloned_before_the_first_update_and_never_after(warm, few, tmp_path):
    kinds = [text.split()[0] for text in warm[1]]
    n_cloned = kinds.index("cloned")
    assert n_cloned >= 2 and set(kinds[:n_cloned]) == {"cloning"}
    assert not {"cloning", "cloned"} & set(kinds[n_cloned + 1 :])
    _, first, _ = warm_run(tmp_path / "run", few, n_updates=1)
    resumed, result, texts = warm_run(tmp_path / "run", few, n_updates=2, resume=True)
    assert (first.n_steps, result.n_steps) == (UPDATE, 2 * UPDATE)
    assert not [text for text in texts if text.startswith("clon")]
    assert is_as_good(resumed, warm[0])
    with (tmp_path / "run" / "progress.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["steps"] for row in rows] == ["0", str(UPDATE), str(2 * UPDATE)]
    assert all(row["validation_return"] for row in rows) and not rows[0]["return"]


def test_a_run_that_was_stopped_while_cloning_clones_again_from_the_same_start(warm, few, tmp_path):
    fresh = Trainer(small_config(scene=few), tmp_path / "fresh")
    stopped, result, texts = warm_run(tmp_path / "run", few, 2, stop_at("cloning"))
    assert (result.signal, result.n_steps, result.best_return) == (signal.SIGINT, 0, None)
    assert len(texts) == 1, "it was stopped at once"
    assert is_same(stopped.model.policy, fresh.model.policy)
    resumed, _, texts = warm_run(tmp_path / "run", few, 2, resume=True)
    clonings = [[text for text in each if text.startswith("cloning")] for each in (texts, warm[1])]
    assert clonings[0] == clonings[1]
    assert is_as_good(resumed, warm[0])


def test_a_run_that_was_stopped_after_cloning_goes_on_bit_for_bit(warm, few, tmp_path):
    _, result, _ = warm_run(tmp_path / "run", few, 2, stop_at("cloned"))
    assert (result.signal, result.n_steps) == (signal.SIGINT, 0)
    assert result.best_return is not None
    resumed, _, texts = warm_run(tmp_path / "run", few, 2, resume=True)
    assert not [text for text in texts if text.startswith("clon")]
    assert is_as_good(resumed, warm[0])


def test_time_that_is_over_before_cloning_is_told_in_one_line(few, tmp_path):
    trainer = Trainer(small_config(scene=few, warm_start=WARM, stop={"cpu_seconds": 0.05}), tmp_path / "run")
    trainer._cpu_start = time.process_time()
    with pytest.raises(TrainingError, match="lower warm_start.epochs") as caught:
        trainer.run(Quiet())
    assert "\n" not in str(caught.value)


def test_the_command_line_adds_and_takes_away_a_warm_start():
    plain, warmed = small_config(), small_config(warm_start=WARM)
    assert plain.replaced(None, None, "bc").warm_start == WarmStart()
    assert warmed.replaced(None, None, "bc").warm_start == warmed.replaced(None, None).warm_start == WarmStart(**WARM)
    assert warmed.replaced(None, None, "none").warm_start is None
    with pytest.raises(ConfigError, match="1 mistake:\n  warm_start: certificates are cloned by"):
        small_config(network={"kind": "flat"}).replaced(None, None, "bc")


# Starting from a saved policy -------------------------------------------------------------------------------------


def test_a_run_may_begin_with_the_weights_of_another(warm, few, tmp_path):
    best = warm[0].folder.best
    trainer = Trainer(small_config(scene=few, seed=9), tmp_path / "run", start=best)
    unlike = Trainer(small_config(scene=few, seed=9), tmp_path / "other")
    saved = Trainer(small_config(scene=few), tmp_path / "saved")
    assert not is_same(trainer.model.policy, unlike.model.policy)
    # as stable-baselines3 reads it
    saved.model.set_parameters(str(best), device="cpu")
    assert is_same(trainer.model.policy, saved.model.policy)
    assert trainer.n_steps == 0 and not optimizer_tensors(trainer)


def test_a_run_begun_with_another_s_weights_is_resumed_with_its_own(warm, few, tmp_path):
    settings = {"scene": few, "seed": 9, "validation": SMALL["validation"] | {"every_updates": 1}}
    start = warm[0].folder.best
    whole, _ = trained(tmp_path / "whole", 2, start=start, **settings)
    trained(tmp_path / "run", 1, start=start, **settings)
    resumed, result = trained(tmp_path / "run", 2, start=start, resume=True, **settings)
    assert result.n_steps == 2 * UPDATE
    assert is_as_good(resumed, whole)


@pytest.mark.parametrize(
    ("network", "words"),
    [
        ({"hidden": 9, "rounds": 1}, "hidden is 8 there, 9 here"),
        ({"hidden": 8, "rounds": 1, "heads": 3}, "heads is 2 there, 3 here"),
        ({"hidden": 8, "rounds": 1, "is_blind_to_strain": True}, "is_blind_to_strain is False there, True here"),
        ({"kind": "flat"}, "kind is candidates there, flat here"),
    ],
    ids=str,
)
def test_a_policy_of_another_network_is_no_start(warm, network, words, tmp_path, capsys):
    config = tmp_path / "small.yaml"
    config.write_text(yaml.safe_dump(SMALL | {"network": network}))
    best = warm[0].folder.best
    with pytest.raises(CheckpointError, match=words):
        Trainer(small_config(network=network), tmp_path / "run", start=best)
    assert main(["train", str(config), "--start-from", str(best), "--out", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {best} has another network than this run: ") and error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_start_that_is_not_there_is_told_in_one_line(tmp_path, capsys):
    config = tmp_path / "small.yaml"
    config.write_text(yaml.safe_dump(SMALL))
    assert main(["train", str(config), "--start-from", str(tmp_path / "no.zip"), "--out", str(tmp_path / "run")]) == 1
    assert capsys.readouterr().err == f"error: cannot read {tmp_path / 'no.zip'}: No such file or directory\n"
    assert not (tmp_path / "run").exists()
