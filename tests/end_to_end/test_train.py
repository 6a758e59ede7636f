"""Training: what is learnt is kept, and a run that was stopped goes on as if it never had been."""

import csv
import json
import os
import signal
import time
import zipfile

import pytest
import yaml

torch = pytest.importorskip("torch")

from sb3_contrib import MaskablePPO  # noqa: E402

from agents import run_folder  # noqa: E402
from agents.checkpoint import CheckpointError, load_policy, read_page  # noqa: E402
from agents.command_line import main  # noqa: E402
from agents.progress import ProgressReport  # noqa: E402
from agents.run_folder import RunFolderError  # noqa: E402
from agents.training import Trainer, TrainingError  # noqa: E402
from agents.training_config import TrainingConfig  # noqa: E402
from envs.resect import ResectEnv  # noqa: E402
from gmapspring.config import check_config, load_config  # noqa: E402
from gmapspring.errors import ConfigError  # noqa: E402
from gmapspring.paths import configs_folder  # noqa: E402
from tests.small_run import SMALL, UPDATE, Quiet, is_same, optimizer_tensors, small_config, trained  # noqa: E402
from tests.small_scene import small_scene  # noqa: E402


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory):
    """Return the folder and the trainer of a run that was never stopped."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    trainer, _ = trained(folder)
    return folder, trainer


def test_a_resumed_run_goes_on_bit_for_bit(whole_run, tmp_path):
    trained(tmp_path / "run", n_updates=2)
    resumed, result = trained(tmp_path / "run", n_updates=4, resume=True)
    whole = whole_run[1]
    assert result.n_steps == whole.n_steps == 4 * UPDATE
    assert is_same(resumed.model.policy, whole.model.policy)
    assert all(map(torch.equal, optimizer_tensors(resumed), optimizer_tensors(whole)))


def test_a_resumed_run_adds_up_its_cpu_time(whole_run, tmp_path):
    _, first = trained(tmp_path / "run", n_updates=1)
    before = Trainer(small_config(), tmp_path / "run", resume=True, cpu_start=0.0).cpu_seconds
    assert before == pytest.approx(time.process_time() + first.cpu_seconds, abs=5.0)


def test_a_run_resumed_with_other_versions_names_both(tmp_path, monkeypatch):
    trained(tmp_path / "run", n_updates=1)
    path = tmp_path / "run" / "versions.json"
    first = json.loads(path.read_text())
    Trainer(small_config(), tmp_path / "run", resume=True)
    assert json.loads(path.read_text()) == first
    for revision in ("other", "third"):
        monkeypatch.setattr(run_folder, "versions", lambda revision=revision: first | {"revision": revision})
        Trainer(small_config(), tmp_path / "run", resume=True)
    other = first | {"revision": "other", "before": first}
    assert json.loads(path.read_text()) == first | {"revision": "third", "before": other}
    path.write_text("{")
    with pytest.raises(RunFolderError, match="delete it"):
        Trainer(small_config(), tmp_path / "run", resume=True)


def test_a_run_folder_holds_all_that_a_result_depends_on(whole_run):
    folder, _ = whole_run
    assert yaml.safe_load((folder / "config.yaml").read_text())["seed"] == SMALL["seed"]
    versions = json.loads((folder / "versions.json").read_text())
    assert versions["torch"] and versions["machine"]["cores"] >= 1 and "revision" in versions
    assert any((folder / "tensorboard").glob("events.out.tfevents.*"))
    with (folder / "progress.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["steps"]) for row in rows] == [UPDATE, 2 * UPDATE, 3 * UPDATE, 4 * UPDATE]
    assert [bool(row["validation_return"]) for row in rows] == [False, True, False, True]


def test_old_checkpoints_are_pruned_and_no_half_written_file_is_left(whole_run):
    folder, _ = whole_run
    assert [path.name for path in (folder / "checkpoints").iterdir()] == [f"step-{4 * UPDATE:010d}.zip"]
    assert not list(folder.rglob("*.unfinished"))


def test_the_best_policy_is_the_one_with_the_highest_validation_return(whole_run):
    folder, _ = whole_run
    with (folder / "progress.csv").open() as stream:
        found = {int(row["steps"]): row["validation_return"] for row in csv.DictReader(stream)}
    returns = {steps: float(value) for steps, value in found.items() if value}
    page = read_page(folder / "best.zip")
    assert page.best_return == max(returns.values()) == returns[page.n_steps]


def test_a_failed_write_leaves_the_old_checkpoint_whole(tmp_path, monkeypatch):
    trainer, _ = trained(tmp_path / "run", n_updates=1)
    before = (tmp_path / "run" / "last.zip").read_bytes()

    def fail(source, target):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        trainer._save(is_best=False)
    assert (tmp_path / "run" / "last.zip").read_bytes() == before
    assert not list((tmp_path / "run").rglob("*.unfinished"))


def test_a_saved_policy_plays_the_same_here_and_in_stable_baselines3(whole_run):
    folder, trainer = whole_run
    env = ResectEnv("box-48", "test")
    observation, _ = env.reset(seed=0)
    here = load_policy(folder / "last.zip", env.observation_space, env.action_space)
    there = MaskablePPO.load(folder / "last.zip")
    actions = {int(who.predict(observation, deterministic=True)[0]) for who in (here, there, trainer.model)}
    assert len(actions) == 1


def test_a_saved_policy_plays_a_mesh_of_another_size(whole_run):
    env = ResectEnv(small_scene(cells=(3, 2, 2)))
    policy = load_policy(whole_run[0] / "last.zip", env.observation_space, env.action_space)
    observation, _ = env.reset(seed=0)
    assert observation["action_mask"][policy.predict(observation, deterministic=True)[0]]


# Stopping ---------------------------------------------------------------------------------------------------------


def test_ctrl_c_keeps_what_was_learnt(tmp_path):
    before = signal.getsignal(signal.SIGINT)
    _, result = trained(tmp_path / "run", on_text=lambda text: os.kill(os.getpid(), signal.SIGINT))
    assert (result.signal, result.n_steps) == (signal.SIGINT, UPDATE)
    assert read_page(tmp_path / "run" / "last.zip").n_steps == UPDATE
    assert read_page(tmp_path / "run" / "best.zip").n_steps == UPDATE
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_ends_the_command_with_code_130_and_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ProgressReport, "update", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    config = tmp_path / "small.yaml"
    config.write_text(yaml.safe_dump(SMALL))
    assert main(["train", str(config), "--out", str(tmp_path / "run")]) == 130
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "--resume" in error


@pytest.mark.parametrize("stop", [{"cpu_seconds": 1e-3}, {"steps": UPDATE - 1}])
def test_a_run_without_room_for_an_update_says_so_in_one_line(stop, tmp_path):
    trainer = Trainer(small_config(stop=stop), tmp_path / "run", cpu_start=time.process_time())
    with pytest.raises(TrainingError, match="no time for a single update; raise stop") as caught:
        trainer.run(Quiet())
    assert "\n" not in str(caught.value) and not (tmp_path / "run" / "best.zip").exists()


def test_a_second_request_to_stop_leaves_the_last_checkpoint_as_it_is(tmp_path, monkeypatch):
    trainer, _ = trained(tmp_path / "run", 2)
    saved = (tmp_path / "run" / "last.zip").read_bytes()
    again = Trainer(small_config(), tmp_path / "run", resume=True)

    def cut_short(*arguments, **values):
        again.model.num_timesteps += UPDATE // 2
        raise KeyboardInterrupt

    monkeypatch.setattr(again.model, "learn", cut_short)
    again.run(Quiet())
    assert (tmp_path / "run" / "last.zip").read_bytes() == saved


# Mistakes ---------------------------------------------------------------------------------------------------------


def test_a_folder_with_a_run_is_not_overwritten(whole_run):
    with pytest.raises(RunFolderError, match="--resume"):
        Trainer(small_config(), whole_run[0])


def test_a_run_is_not_resumed_under_another_configuration(whole_run):
    changed = small_config(ppo=SMALL["ppo"] | {"learning_rate": 1e-3})
    with pytest.raises(RunFolderError, match=r"ppo\.learning_rate was 0\.01, now 0\.001"):
        Trainer(changed, whole_run[0], resume=True)


def test_there_must_be_something_to_resume(tmp_path):
    with pytest.raises(RunFolderError, match="no run to resume"):
        Trainer(small_config(), tmp_path / "run", resume=True)


def test_a_folder_whose_run_kept_nothing_is_not_said_to_be_resumable(tmp_path):
    Trainer(small_config(), tmp_path / "run")
    for resume in (False, True):
        with pytest.raises(RunFolderError, match="choose another --out") as caught:
            Trainer(small_config(), tmp_path / "run", resume=resume)
        assert "--resume" not in str(caught.value)


def damaged(path, how):
    """Write a file that is not quite a policy and return it."""
    whole = path.read_bytes()
    contents = {
        "truncated": whole[: len(whole) // 2],
        "empty": b"",
        "foreign": b"PK\x05\x06" + bytes(18),
        "text": b"hello",
        "flipped": whole[:2000] + bytes([whole[2000] ^ 255]) + whole[2001:],
    }
    target = path.parent / f"{how}.zip"
    target.write_bytes(contents[how])
    return target


@pytest.mark.parametrize("how", ["truncated", "empty", "foreign", "text", "flipped"])
def test_a_damaged_policy_is_refused_in_one_line(whole_run, how, capsys):
    target = damaged(whole_run[0] / "last.zip", how)
    with pytest.raises(CheckpointError, match=how):
        read_page(target)
    assert main(["evaluate", str(target), "--episodes", "1"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1
    target.unlink()


def test_a_policy_for_another_observation_is_refused(whole_run, monkeypatch):
    import agents.checkpoint

    columns = agents.checkpoint.observation_columns()
    monkeypatch.setattr(agents.checkpoint, "observation_columns", lambda: columns | {"globals": ["load"]})
    with pytest.raises(CheckpointError, match="another observation: its table 'globals'"):
        read_page(whole_run[0] / "last.zip")


def test_a_policy_with_another_network_is_refused_in_one_line(whole_run, tmp_path, monkeypatch):
    trainer = whole_run[1]
    monkeypatch.setattr(trainer, "config", small_config(network={"hidden": 9, "rounds": 1}))
    monkeypatch.setattr(trainer.folder, "last", tmp_path / "other.zip")
    trainer._save(is_best=False)
    env = ResectEnv("box-48", "test")
    with pytest.raises(CheckpointError, match="does not fit the network") as caught:
        load_policy(tmp_path / "other.zip", env.observation_space, env.action_space)
    assert "\n" not in str(caught.value)


def with_page(path, target, **changes):
    """Write a policy whose page says something else, and return its file."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as copy:
        for name in source.namelist():
            content = source.read(name)
            if name == "gmapspring.json":
                content = json.dumps(json.loads(content) | changes)
            copy.writestr(name, content)
    return target


def test_a_policy_of_an_older_format_is_refused_in_one_line(whole_run, tmp_path, capsys):
    assert read_page(with_page(whole_run[0] / "best.zip", tmp_path / "same.zip")) == read_page(whole_run[0] / "best.zip")
    # Format 1 had no network on its page, but how wide it was among other settings.
    old = with_page(whole_run[0] / "best.zip", tmp_path / "old.zip", format=1, network=None, hidden=8)
    config = tmp_path / "small.yaml"
    config.write_text(yaml.safe_dump(SMALL))
    for command in (["evaluate", old], ["train", config, "--start-from", old, "--out", tmp_path / "run"]):
        assert main([str(argument) for argument in command]) == 1
        assert capsys.readouterr().err == f"error: {old} is of format 1; this version reads 3: train again\n"
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("network", "words"),
    [
        ({"kind": "candidates", "hidden": 0}, "network.hidden"),
        ({"kind": "round"}, "'round' is not one of"),
        ({"hiden": 8}, "did you mean 'hidden'"),
        (8, "should be an object"),
    ],
)
def test_a_policy_whose_page_names_an_impossible_network_is_refused(whole_run, network, words, tmp_path):
    target = with_page(whole_run[0] / "best.zip", tmp_path / "odd.zip", network=network)
    env = ResectEnv("box-48", "test")
    with pytest.raises(ConfigError, match=words) as caught:
        load_policy(target, env.observation_space, env.action_space)
    assert str(target) in str(caught.value)


@pytest.mark.parametrize("path", sorted((configs_folder() / "train").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_training_configurations_are_valid(path):
    assert load_config(path, TrainingConfig).stop.cpu_seconds


def test_all_mistakes_of_a_configuration_are_listed():
    wrong = SMALL | {"ppo": SMALL["ppo"] | {"n_epoch": 3, "gamma": 2.0}, "mask": "focsu", "stop": {}}
    with pytest.raises(ConfigError) as caught:
        check_config(wrong, TrainingConfig)
    for part in ("ppo.n_epoch", "'n_epochs'", "ppo.gamma", "'focus'", "stop"):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "path", "hint"),
    [
        ({"network": {"hiden": 8}}, "network.hiden", "did you mean 'hidden'"),
        ({"network": {"kind": "flat", "hidden": 8}}, "network.hidden", "known are kind, layers"),
        ({"network": {"kind": "flatt"}}, "network", "did you mean 'flat'"),
        ({"network": {"kind": "flat", "layers": []}}, "network.layers", "at least 1 item"),
        ({"network": {"rounds": -1}}, "network.rounds", "greater than or equal to 0"),
        ({"network": 8}, "network", "should be an object"),
        ({"shaping": {"weigt": 1.0}}, "shaping.weigt", "did you mean 'weight'"),
        ({"shaping": {"potential": "intrface", "weight": 1.0}}, "shaping.potential", "did you mean 'interface'"),
        ({"shaping": 1.0}, "shaping", "should be an object"),
        ({"warm_start": {"epoch": 8}}, "warm_start.epoch", "did you mean 'epochs'"),
        ({"warm_start": "bc"}, "warm_start", "should be an object"),
        ({"ppo": SMALL["ppo"] | {"hidden": 8}}, "ppo.hidden", "unknown key"),
        ({"ppo": SMALL["ppo"] | {"shaping": 1.0}}, "ppo.shaping", "unknown key"),
    ],
    ids=str,
)
def test_a_mistake_in_what_is_learnt_is_told_with_its_place_and_the_way_out(changes, path, hint):
    with pytest.raises(ConfigError, match="1 mistake") as caught:
        small_config(**changes)
    assert f"  {path}: " in str(caught.value) and hint in str(caught.value)


def test_the_command_trains_from_a_file(tmp_path, capsys):
    config = tmp_path / "small.yaml"
    config.write_text(yaml.safe_dump(SMALL | {"stop": {"steps": UPDATE}}))
    assert main(["train", str(config), "--seed", "9", "--out", str(tmp_path / "run")]) == 0
    assert "best.zip" in capsys.readouterr().out
    assert yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["seed"] == 9
    assert (tmp_path / "run" / "best.zip").exists()
