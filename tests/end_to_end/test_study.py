"""A study from its file to its page: interrupted, gone on with, failed in part, and told as it is."""

import csv
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml

pytest.importorskip("torch")

from agents import study  # noqa: E402
from agents.command_line import main  # noqa: E402
from agents.report import write_report  # noqa: E402
from agents.results import read_episodes, read_results  # noqa: E402
from agents.study_config import load_study  # noqa: E402
from agents.study_jobs import DONE, FAILED, MISSING, UNFINISHED  # noqa: E402
from envs.library import certificate_path, load_scenes, read_certificates, write_certificates  # noqa: E402
from envs.scene_config import SPLITS  # noqa: E402
from gmapspring.paths import configs_folder  # noqa: E402
from tests.end_to_end.test_train import SMALL, UPDATE  # noqa: E402

UNREACHABLE = 1.0


def write_yaml(path, data):
    """Write plain data and return the path as text."""
    path.write_text(yaml.safe_dump(data))
    return str(path)


def few_scenes(folder):
    """Write a scene file that has the first four scenes of each split of box-48, and return its path as text."""
    file = read_certificates(certificate_path("box-48"))
    records = [record for split in SPLITS for record in [r for r in file.records if r.split == split and r.certificate][:4]]
    path = folder / "few.yaml"
    path.write_bytes((configs_folder() / "scenes" / "box-48.yaml").read_bytes())
    write_certificates(certificate_path(path), file._replace(records=records))
    return str(path)


def run_whole(folder, *arguments):
    """Run the study of a folder in this process, and return the exit code."""
    with pytest.MonkeyPatch.context() as patch:
        # The study that was interrupted has compiled them already.
        patch.setattr(study, "compile_kernels", lambda scene: None)
        return main(["study", str(folder / "tiny.yaml"), "--out", str(folder / "out"), "--jobs", "2", *arguments])


def states(folder):
    """Return how each job stands, by name."""
    results = read_results(load_study(str(folder / "tiny.yaml")), folder / "out")
    return {job.name: outcome for job, outcome, _ in results.states}


def steps_of(path):
    """Return the steps in a progress.csv."""
    with path.open() as stream:
        return [int(row["steps"]) for row in csv.DictReader(stream)]


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """Return the folder of a study that was interrupted while its first two runs were at work; one of the two cannot work."""
    folder = tmp_path_factory.mktemp("study")
    endless = write_yaml(folder / "endless.yaml", SMALL | {"stop": {"steps": 10**9}})
    wrong = write_yaml(folder / "wrong.yaml", SMALL | {"stop": {"steps": 1}})
    few = few_scenes(folder)
    aims = [{"aim": "whatever it does", "scene": few, "return": -9.0, "success": UNREACHABLE, "in_every_seed": True}]
    write_yaml(folder / "tiny.yaml", {
        "name": "tiny", "title": "A tiny study", "seeds": [0],
        "rows": [{"name": "base", "train": endless, "evaluate": [{"scene": few}], "reach": aims},
                 {"name": "less", "train": wrong, "ablates": "base"}],
        "scripts": [{"scene": few, "policies": ["certificate"]}],
    })  # fmt: skip
    out = folder / "out"
    command = [sys.executable, "-m", "agents", "study", str(folder / "tiny.yaml"), "--out", str(out), "--jobs", "2"]
    process = subprocess.Popen([*command, "--only", "base"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    progress = out / "base" / "seed-0" / "progress.csv"
    deadline = time.monotonic() + 300.0
    while not (progress.exists() and steps_of(progress)) and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGINT)
    assert process.wait(timeout=120) == 128 + signal.SIGINT
    return folder


@pytest.fixture(scope="module")
def finished(interrupted):
    """Return the folder after the interrupted run was given an end that is near, and the study was run again in full."""
    run = interrupted / "out" / "base" / "seed-0"
    before = steps_of(run / "progress.csv")
    page = write_report(interrupted / "out").read_text()
    stood = states(interrupted)
    write_yaml(interrupted / "endless.yaml", SMALL | {"stop": {"steps": before[-1] + 2 * UPDATE}})
    code = run_whole(interrupted)
    return interrupted, before, stood, page, code


def test_what_was_interrupted_is_kept_and_told_to_be_unfinished(finished):
    _, _, stood, page, _ = finished
    assert stood == {
        "base/seed-0": UNFINISHED, "base/seed-0/few-test": MISSING,
        "less/seed-0": MISSING, "less/seed-0/few-test": MISSING,
        "scripts/certificate/few-test": MISSING,
    }  # fmt: skip
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("|")]
    assert ["base", UNFINISHED, "1", ""] in cells and ["less", MISSING, "2", ""] in cells
    assert [row[-1] for row in cells if row[0] == "base" and row[1] == "whatever it does"] == ["**not measured**"] * 2


def test_an_interrupted_run_goes_on_where_it_stopped(finished):
    folder, before, _, _, _ = finished
    after = steps_of(folder / "out" / "base" / "seed-0" / "progress.csv")
    assert after[: len(before)] == before and len(after) == len(before) + 2
    assert np.all(np.diff(after) == UPDATE)


def test_a_failed_run_is_told_and_the_others_go_on(finished):
    folder, _, _, _, code = finished
    assert code == 1
    stood = states(folder)
    assert stood["less/seed-0"] == FAILED and stood["less/seed-0/few-test"] == MISSING
    others = [outcome for name, outcome in stood.items() if not name.startswith("less")]
    assert others == [DONE] * 3
    page = write_report(folder / "out").read_text()
    line = next(line for line in page.splitlines() if line.startswith("| less ") and f" {FAILED} " in line)
    assert "no time for a single update" in line


def test_the_page_says_what_the_episodes_say(finished):
    folder = finished[0]
    page = write_report(folder / "out").read_text()
    episodes = read_episodes(folder / "out" / "base" / "seed-0" / "evaluation" / "few-test.csv")
    assert [episode.scene_seed for episode in episodes] == load_scenes(str(folder / "few.yaml"), "test").seeds
    mean_return = np.mean([episode.total_return for episode in episodes])
    success = np.mean([episode.is_success for episode in episodes])
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("|")]
    base = next(row for row in rows if row[0] == "**base**")
    assert base[1] == f"1 x {len(episodes)}" and base[3] == f"{mean_return:.3f}" and base[4].startswith(f"{success:.3f} [")
    certificate = next(row for row in rows if row[0] == "certificate")
    assert certificate[2] == "1.000 [1.000, 1.000]" and certificate[5] == "0.000" and certificate[-1] == "–"
    aims = [row for row in rows if row[0] == "base" and row[1] == "whatever it does"]
    assert [row[-1] for row in aims] == ["reached", "reached" if success >= UNREACHABLE else "**not reached**"]
    picture = folder / "out" / "tiny-curves-base.png"
    assert f"]({picture.name})" in page and 5_000 < picture.stat().st_size < 300_000


def test_nothing_that_is_done_is_done_again(finished):
    folder = finished[0]
    files = [path for path in (folder / "out").rglob("*") if path.suffix in (".csv", ".zip")]
    before = {path: path.stat().st_mtime_ns for path in files}
    assert files and run_whole(folder, "--only", "base", "scripts") == 0
    assert {path: path.stat().st_mtime_ns for path in files} == before


def test_publishing_leaves_no_old_picture_behind(finished, tmp_path):
    folder = finished[0]
    (tmp_path / "tiny-old.png").write_bytes(b"old")
    (tmp_path / "other.png").write_bytes(b"other")
    write_report(folder / "out", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.png", "tiny-curves-base.png", "tiny.md"]
    assert (tmp_path / "tiny.md").read_text() == (folder / "out" / "tiny.md").read_text()


def test_a_folder_without_a_study_is_refused(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 1
    assert "holds no study" in capsys.readouterr().err


def test_a_mistake_in_a_study_is_one_message(tmp_path, capsys):
    path = write_yaml(tmp_path / "bad.yaml", {"name": "bad", "title": "Bad", "seeds": [0], "rows": [{"nmae": "a"}]})
    assert main(["study", path, "--out", str(tmp_path / "out")]) == 1
    assert "rows.0.nmae: unknown key; did you mean 'name'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
