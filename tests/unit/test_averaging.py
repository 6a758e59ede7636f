"""The mean of weights: what is played and saved lags behind what is learnt, by as much as was asked, and learning goes on."""

import io
import zipfile

import pytest

torch = pytest.importorskip("torch")

from agents.averaging import GROWTH, WeightAverage  # noqa: E402
from agents.checkpoint import load_policy  # noqa: E402
from tests.small_run import SMALL, trained  # noqa: E402


def is_same(one, other):
    """Tell whether two sets of weights are the same, bit for bit."""
    return one.keys() == other.keys() and all(map(torch.equal, one.values(), other.values()))


def followed(numbers, reach):
    """Return the mean after a module's only weight took on some numbers, one an update."""
    module = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.zeros_(module.weight)
    average = WeightAverage(module, reach)
    for update, number in enumerate(numbers, 1):
        torch.nn.init.constant_(module.weight, number)
        average.follow(update)
    return float(average.weights["weight"]), module, average


def test_a_mean_over_one_update_is_the_weight_itself():
    assert followed([3.0, 5.0, 8.0] * 9, reach=1)[0] == 8.0


def test_the_mean_reaches_back_over_a_part_of_the_run_and_no_further_than_asked():
    numbers = [float(number % 7) for number in range(40)]
    expected = 0.0
    for update, number in enumerate(numbers, 1):
        reach = min(4, max(1, update / GROWTH))
        expected = (1 - 1 / reach) * expected + number / reach
    assert followed(numbers, reach=4)[0] == pytest.approx(expected, rel=1e-5)
    assert followed([1.0] * GROWTH + [9.0], reach=100)[0] > 5.0, "what is early is soon forgotten"


def test_what_is_learnt_comes_back_after_the_mean_has_played_even_if_that_fails():
    mean, module, average = followed([1.0, 2.0, 6.0] * 5, reach=3)
    with pytest.raises(ValueError), average.playing() as learnt:
        assert module.weight.item() == mean != 6.0 == learnt["weight"].item()
        raise ValueError
    assert module.weight.item() == 6.0
    average.begin()
    assert float(average.weights["weight"]) == 6.0


def test_a_run_saves_the_mean_to_be_played_and_resumes_with_both(tmp_path):
    changes = {"ppo": SMALL["ppo"] | {"averaged_updates": 3}}
    whole, _ = trained(tmp_path / "whole", 16, **changes)
    mean, learnt = whole._average.weights, whole.model.policy.state_dict()
    assert not is_same(mean, learnt)
    with zipfile.ZipFile(tmp_path / "whole" / "last.zip") as archive:
        saved = [torch.load(io.BytesIO(archive.read(name)), weights_only=True) for name in ("policy.pth", "learnt.pt")]
    assert is_same(saved[0], mean) and is_same(saved[1], learnt)
    env = whole._validation[0]
    assert is_same(load_policy(tmp_path / "whole" / "last.zip", env.observation_space, env.action_space).state_dict(), mean)
    trained(tmp_path / "parts", 14, **changes)
    parts, _ = trained(tmp_path / "parts", 16, resume=True, **changes)
    assert is_same(parts._average.weights, mean) and is_same(parts.model.policy.state_dict(), learnt)
