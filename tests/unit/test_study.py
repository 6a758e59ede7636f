"""A study's file is checked at once; its jobs run some at a time, survive failures, and stop without loss."""

import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

import pytest
import yaml

pytest.importorskip("torch")

from rich.console import Console  # noqa: E402

from agents import study as running  # noqa: E402
from agents.progress import ProgressReport  # noqa: E402
from agents.study import Choice, StudyError, Work, run_study  # noqa: E402
from agents.study_config import StudyConfig, load_study  # noqa: E402
from agents.study_jobs import DONE, FAILED, MISSING, OUTDATED, UNFINISHED, Job, jobs_of, state_of  # noqa: E402
from envs.library import certificate_path, load_scenes  # noqa: E402
from envs.scene_config import SPLITS  # noqa: E402
from gmapspring.config import check_config  # noqa: E402
from gmapspring.errors import ConfigError  # noqa: E402
from gmapspring.paths import configs_folder  # noqa: E402

BASE = {"name": "base", "train": "box-108", "evaluate": [{"scene": "box-48"}]}
SMALL = {"name": "small", "title": "Small", "seeds": [0, 1], "rows": [BASE]}


def study_of(*rows, **changes):
    """Return a checked study of the base row and others."""
    return check_config(SMALL | {"rows": [BASE, *rows]} | changes, StudyConfig)


# The file ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(path.stem for path in (configs_folder() / "studies").glob("*.yaml")))
def test_all_that_a_shipped_study_names_exists(name):
    study = load_study(name)
    assert study.name == name
    assert jobs_of(study, pathlib.Path("nowhere"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rows": [BASE | {"trian": "box-108"}]}, ["rows.0.trian", "did you mean 'train'"]),
        ({"rows": [BASE | {"train": "bx-108"}]}, ["rows.0.train", "bx-108", "did you mean 'box-108'"]),
        ({"rows": [BASE | {"evaluate": [{"scene": "box-49"}]}]}, ["rows.0.evaluate.0", "did you mean 'box-48'"]),
        ({"rows": [BASE | {"evaluate": [{"scene": "box-48", "mask": "focsu"}]}]}, ["evaluate.0.mask", "'focus'"]),
        ({"rows": [BASE | {"evaluate": []}]}, ["base", "evaluated on nothing"]),
        ({"rows": [BASE, BASE]}, ["base", "name is taken"]),
        ({"rows": [BASE | {"reach": [{"aim": "a", "scene": "box-48"}]}]}, ["rows.0.reach.0", "give return, success, gap"]),
        ({"rows": [BASE | {"reach": [{"aim": "a", "scene": "box-108", "return": 0.5}]}]}, ["'box-108'", "'test'"]),
        ({"rows": [BASE | {"reach": [{"aim": "a", "scene": "box-48", "gap": 0.5}]}]}, ["'box-48'", "'train'"]),
        ({"rows": [BASE | {"reach": [{"aim": "a", "scene": "box-48", "retrun": 0.5}]}]}, ["retrun", "did you mean 'return'"]),
        ({"rows": [BASE, {"name": "less", "train": "box-108", "ablates": "bsae"}]}, ["less", "ablates", "'base'"]),
        ({"rows": [BASE, BASE | {"name": "less", "ablates": "base"}]}, ["less", "leave out evaluate"]),
        ({"rows": [BASE | {"start_from": "later"}, BASE | {"name": "later"}]}, ["start_from", "no earlier row"]),
        ({"rows": [BASE, BASE | {"name": "on", "start_from": "base", "seeds": [0, 7]}]}, ["on", "lacks", "[7]"]),
        ({"seeds": [0, 0]}, ["seeds", "twice"]),
        ({"scripts": [{"scene": "box-48", "policies": ["lookahaed"]}]}, ["scripts.0.policies.0", "'lookahead'"]),
        ({"scripts": [{"scene": "box-48", "policies": ["old.zip"]}]}, ["scripts.0.policies.0", "no scripted policy"]),
        ({"scripts": [{"scene": "box-48", "policies": ["random", "random"]}]}, ["plays the same scenes twice"]),
    ],
    ids=lambda part: "",
)
def test_mistakes_in_a_study_are_named(changes, words):
    with pytest.raises(ConfigError) as caught:
        check_config(SMALL | changes, StudyConfig)
    assert all(word in str(caught.value) for word in words), caught.value


def test_a_training_file_that_cannot_be_read_is_a_mistake_of_the_study(tmp_path):
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(ConfigError, match=r"rows\.1\.train"):
        study_of(BASE | {"name": "more", "train": str(tmp_path / "empty.yaml")})


def test_where_the_files_of_a_scene_lie_does_not_matter(tmp_path):
    study = check_config(SMALL | {"rows": [BASE | {"evaluate": [{"scene": "liver"}]}]}, StudyConfig)
    (job,) = [job for job in jobs_of(study, tmp_path) if job.played and job.seed == 0]
    assert "path" not in job.facts["config"]["mesh"]
    assert [path.name for path in job.files[:2]] == ["liver.jsonl", "liver.vtu"]


def test_all_mistakes_of_a_study_are_listed_at_once():
    with pytest.raises(ConfigError, match="3 mistakes"):
        check_config(SMALL | {"titel": "Small", "rows": [BASE | {"train": "bx-108"}], "seeds": [-1]}, StudyConfig)


def test_an_unknown_study_or_row_is_named():
    with pytest.raises(ConfigError, match="did you mean 'results'"):
        load_study("reslts")
    with pytest.raises(ConfigError, match="did you mean 'base'"):
        study_of().needed_by(["bsae"])


def test_rows_bring_along_what_they_start_from():
    study = study_of(BASE | {"name": "on", "start_from": "base"}, BASE | {"name": "further", "start_from": "on"})
    assert study.needed_by(["further"]) == {"further", "on", "base"}
    assert study.needed_by(["base", "scripts"]) == {"base", "scripts"}


# The jobs ---------------------------------------------------------------------------------------------------------


def test_jobs_come_in_the_order_of_the_file_and_know_what_they_need(tmp_path):
    started = BASE | {"name": "on", "start_from": "base", "seeds": [1], "evaluate": [{"scene": "box-48", "mask": "focus"}]}
    study = study_of(started, scripts=[{"scene": "box-48", "policies": ["random"]}])
    jobs = {job.name: job for job in jobs_of(study, tmp_path)}
    assert list(jobs) == ["base/seed-0", "base/seed-0/box-48-test", "base/seed-1", "base/seed-1/box-48-test",
                          "on/seed-1", "on/seed-1/box-48-test", "scripts/random/box-48-test"]  # fmt: skip
    training, judging = jobs["on/seed-1"], jobs["on/seed-1/box-48-test"]
    best = tmp_path / "base" / "seed-1" / "best.zip"
    assert training.arguments[-2:] == ("--start-from", str(best))
    assert training.files == (certificate_path("box-108"), best) and training.needs == "base/seed-1"
    assert training.facts["config"]["network"]["hidden"] and training.facts["scenes"][0]["kappa"]
    assert judging.needs == "on/seed-1" and judging.arguments[1] == str(training.output)
    assert judging.arguments[-2:] == ("--mask", "focus")


@pytest.mark.parametrize(("wrapper", "file"), [("shield", "box-48-test-shield"), ("foresight:30", "box-48-test-foresight-30")])
def test_an_evaluation_in_a_wrapper_is_one_of_its_own(tmp_path, wrapper, file):
    scene = {"scene": "box-48"}
    study = check_config(SMALL | {"rows": [BASE | {"evaluate": [scene, scene | {"wrapper": wrapper}]}]}, StudyConfig)
    plain, wrapped = jobs_of(study, tmp_path)[1:3]
    assert [job.name for job in (plain, wrapped)] == ["base/seed-0/box-48-test", f"base/seed-0/{file}"]
    assert wrapped.arguments[1] == f"{wrapper}:{plain.arguments[1]}" and wrapped.output != plain.output
    assert study.wrappers == [wrapper]
    # an aim is held against the policy alone
    lonely = {"evaluate": [scene | {"wrapper": wrapper}], "reach": [scene | {"aim": "a", "return": 0.5}]}
    with pytest.raises(ConfigError, match="not evaluated on split 'test'"):
        check_config(SMALL | {"rows": [BASE | lonely]}, StudyConfig)


@pytest.mark.parametrize(
    ("wrapper", "words"),
    [("sheild", "give 'shield' or 'foresight:BUDGET'"), ("search:30", "wraps no policy"), ("foresight:ten", "not 'ten'")],
)
def test_a_wrapper_that_means_nothing_is_refused(wrapper, words):
    with pytest.raises(ConfigError, match=words):
        check_config(SMALL | {"rows": [BASE | {"evaluate": [{"scene": "box-48", "wrapper": wrapper}]}]}, StudyConfig)


def test_an_ablation_is_evaluated_as_the_row_that_it_ablates(tmp_path):
    study = study_of({"name": "less", "train": "box-192", "ablates": "base"}, seeds=[0])
    assert [job.name for job in jobs_of(study, tmp_path)][2:] == ["less/seed-0", "less/seed-0/box-48-test"]


def test_other_splits_are_played_as_often_as_the_test_scenes(tmp_path):
    study = check_config(
        SMALL | {"rows": [BASE | {"evaluate": [{"scene": "box-48", "split": split} for split in SPLITS]}]}, StudyConfig
    )
    counts = {job.played.split: job.facts["episodes"] for job in jobs_of(study, tmp_path) if job.played}
    there = {split: len(load_scenes("box-48", split)) for split in SPLITS}
    assert there["train"] > there["test"]
    assert counts == {split: min(there[split], there["test"]) for split in SPLITS}


# Doing them: jobs that are a few lines of Python --------------------------------------------------------------------

ACTS = """
import os, pathlib, signal, sys, time
act, output = sys.argv[1], pathlib.Path(sys.argv[2])
diary = output.parent / "diary"
def note(word):
    with diary.open("a") as stream:
        stream.write(f"{word} {output.name}\\n")
note("begin")
if act == "hang":
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        note("saved")
        sys.exit(130)
time.sleep(0.3)
if act == "fail":
    print("there is\\nno such thing")
    sys.exit(3)
if act == "die":
    os.kill(os.getpid(), signal.SIGKILL)
output.write_text("made")
note("end")
"""


HOLD = """
import fcntl, sys, time
with open(sys.argv[1], "w") as stream:
    fcntl.flock(stream, fcntl.LOCK_EX)
    print("held", flush=True)
    time.sleep(60)
"""


class Quiet(ProgressReport):
    """A report that shows nothing."""

    def __init__(self):
        super().__init__(Console(quiet=True), "test")


@pytest.fixture(autouse=True)
def acts(monkeypatch):
    """Let jobs be acts instead of commands of the package."""
    monkeypatch.setattr(running, "COMMAND", (sys.executable, "-c", ACTS))
    monkeypatch.setattr(running, "LOOK_INTERVAL", 0.02)


def act(folder, name, kind="make", needs=None, files=()):
    """Return a job named name/seed-0/box-48-test."""
    played = study_of().rows[0].evaluate[0]
    output = folder / name
    return Job(name, 0, played, (kind, str(output)), output, output, {}, tuple(files), full(needs))


def full(name):
    """Return the whole name of an act."""
    return name and f"{name}/seed-0/box-48-test"


def do(folder, *jobs, n_at_once=2):
    """Do some jobs; return (what failed, the signal that interrupted)."""
    with (folder / "lock").open("w") as lock:
        work = Work(jobs, n_at_once, lock.fileno(), Quiet())
        number = work.run()
    return work.failed, number


def diary(folder):
    """Return what the acts wrote down, in order."""
    path = folder / "diary"
    return path.read_text().splitlines() if path.exists() else []


def test_as_many_jobs_run_at_once_as_are_asked_for(tmp_path):
    do(tmp_path, *(act(tmp_path, name) for name in "abcd"), n_at_once=2)
    running_now, most = 0, 0
    for line in diary(tmp_path):
        running_now += 1 if line.startswith("begin") else -1
        most = max(most, running_now)
    assert most == 2 and running_now == 0


def test_one_at_a_time_they_run_in_order_and_none_twice(tmp_path):
    jobs = [act(tmp_path, name) for name in "abc"]
    assert do(tmp_path, *jobs, n_at_once=1) == ({}, None)
    assert do(tmp_path, *jobs, n_at_once=1) == ({}, None)
    assert diary(tmp_path) == [f"{word} {name}" for name in "abc" for word in ("begin", "end")]


def test_a_job_waits_for_what_it_needs(tmp_path):
    do(tmp_path, act(tmp_path, "a"), act(tmp_path, "b", needs="a"), n_at_once=2)
    assert diary(tmp_path) == ["begin a", "end a", "begin b", "end b"]


@pytest.mark.parametrize(("kind", "words"), [("fail", "exit code 3: no such thing"), ("die", "exit code -9")])
def test_a_failure_is_written_down_and_stops_only_what_needs_it(tmp_path, kind, words):
    jobs = [act(tmp_path, "a", kind), act(tmp_path, "b", needs="a"), act(tmp_path, "c")]
    failed, _ = do(tmp_path, *jobs)
    assert list(failed) == [full("a"), full("b")] and words in failed[full("a")]
    assert [state_of(job)[0] for job in jobs] == [FAILED, MISSING, DONE]
    assert words in state_of(jobs[0])[1]
    # Tried again, with what was wrong set right.
    assert do(tmp_path, act(tmp_path, "a"), *jobs[1:]) == ({}, None)
    assert [state_of(job)[0] for job in jobs] == [DONE, DONE, DONE]


def test_a_result_counts_only_while_what_it_was_made_of_is_the_same(tmp_path):
    source = tmp_path / "source"
    source.write_text("one")
    job = act(tmp_path, "a", files=[source])
    do(tmp_path, job)
    assert state_of(job)[0] == DONE
    source.write_text("two")
    assert state_of(job)[0] == OUTDATED
    do(tmp_path, job)
    assert state_of(job)[0] == DONE and diary(tmp_path).count("end a") == 2
    assert state_of(job._replace(facts={"mask": "focus"}))[0] == OUTDATED
    job.output.unlink()
    assert state_of(job)[0] == MISSING


def test_an_interruption_lets_jobs_save_and_starts_no_more(tmp_path):
    def interrupt():
        while len(diary(tmp_path)) < 2:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    jobs = [act(tmp_path, name, "hang") for name in "abc"]
    failed, number = do(tmp_path, *jobs)
    assert (failed, number) == ({}, signal.SIGINT)
    assert sorted(diary(tmp_path)) == ["begin a", "begin b", "saved a", "saved b"]
    assert [state_of(job)[0] for job in jobs] == [UNFINISHED, UNFINISHED, MISSING]


def test_a_training_whose_start_has_changed_is_not_gone_on_with(tmp_path):
    start, place = tmp_path / "start.zip", tmp_path / "run"
    start.write_text("one")
    job = Job("on", 0, None, ("fail", str(place)), place / "best.zip", place, {}, (start,))
    do(tmp_path, job)
    place.mkdir()
    (place / "last.zip").write_text("learnt from one")
    start.write_text("two")
    failed, _ = do(tmp_path, job)
    assert "has changed since it began" in failed["on/seed-0"]
    assert (place / "last.zip").read_text() == "learnt from one"


def test_two_studies_cannot_be_at_work_in_one_folder(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path / ".lock")], stdout=subprocess.PIPE)
    try:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(StudyError, match="at work in"):
            run_study(study_of(), tmp_path, Choice([], []), 1, Console(quiet=True))
    finally:
        holder.kill()
        holder.communicate()
    assert not (tmp_path / "study.yaml").exists()


def test_a_seed_that_no_row_has_is_refused(tmp_path):
    with pytest.raises(StudyError, match=r"has the seeds \[7\]"):
        run_study(study_of(), tmp_path / "out", Choice([], [1, 7]), 1, Console(quiet=True))
    assert not (tmp_path / "out").exists()


def test_the_study_is_written_as_it_can_be_read_again(tmp_path):
    study = study_of(rows=[BASE | {"reach": [{"aim": "any", "scene": "box-48", "return": 0.5}]}], seeds=[3])
    code = run_study(study, tmp_path, Choice(["scripts"], []), 1, Console(quiet=True))
    assert code == 0
    assert check_config(yaml.safe_load((tmp_path / "study.yaml").read_text()), StudyConfig) == study
