"""The page of training runs: it stands alone, tells what is there, and says what is not."""

import json
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest
import yaml

from agents.html import Facts, Figure, Folded, Heading, Strip, Text, as_markdown_page, as_page
from agents.report_tables import Table
from agents.run_episodes import Played, best_and_worst, film, play
from agents.run_plots import learning_curves
from agents.run_record import RunRecordError, is_run, read_runs
from agents.run_report import contents, groups_of, write_run_report
from tests.small_run import SMALL, few_scenes, trained
from tests.unit.test_report import episode

HEADER = "steps,cpu_seconds,steps_per_second,return,success,episode_steps,approx_kl,entropy_loss,explained_variance," \
         "validation_return,validation_success"  # fmt: skip


class Reader(HTMLParser):
    """Collects what a page leads to, its text, and whether every element is closed."""

    def __init__(self, page):
        super().__init__()
        self.targets, self.text, self.open, self.ids = [], [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        names = dict(attrs)
        self.targets += [value for name, value in attrs if name in ("src", "href", "xlink:href", "srcset", "data", "action")]
        self.targets += re.findall(r"url\(([^)]*)\)", " ".join(value or "" for value in names.values()))
        self.ids += [names["id"]] if "id" in names else []
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        assert tag not in ("script", "link", "iframe", "object", "embed")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return the folders of two small runs that differ in their seeds alone."""
    folder = tmp_path_factory.mktemp("runs")
    scene = few_scenes(folder)
    for seed in (0, 1):
        trained(folder / "small" / f"seed-{seed}", seed=seed, scene=scene)
    return [folder / "small" / f"seed-{seed}" for seed in (0, 1)]


@pytest.fixture(scope="module")
def page(runs):
    """Return the page of both, in the folder in which they lie."""
    return write_run_report(runs, n_episodes=2)


def made_run(folder, rows=(), seed=0, **changes):
    """Write the folder of a run that never was: rows are (steps, validation return, validation success), None for none."""
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(SMALL | {"seed": seed, "stop": {"steps": 128}} | changes))
    lines = [HEADER]
    for steps, total, success in rows:
        validation = ["" if each is None else each for each in (total, success)]
        cells = [steps, steps / 100, 50, -0.5, 0.25, 7, 0.01, -3, 0.1, *validation]
        lines.append(",".join(map(str, cells)))
    (folder / "progress.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_a_page_needs_no_other_file_and_no_network(page):
    page = page.read_text(encoding="utf-8")
    reader = Reader(page)
    assert reader.open == []
    assert "@import" not in page
    outside = [target for target in reader.targets if not target.startswith(("#", "data:image/png;base64,"))]
    assert outside == []
    assert sum(target.startswith("data:") for target in reader.targets) >= 4
    assert {target[1:] for target in reader.targets if target.startswith("#")} <= set(reader.ids)
    assert len(reader.ids) == len(set(reader.ids))
    assert page.count("<svg") == 3
    assert len(page) < 1_500_000


def test_a_page_tells_of_runs_and_their_episodes_in_html_as_in_markdown(runs, page):
    text = " ".join(Reader(page.read_text(encoding="utf-8")).text)
    markdown = page.with_suffix(".md").read_text(encoding="utf-8")
    versions = json.loads((runs[0] / "versions.json").read_text())
    wanted = ("2 training runs", "seed-1", "all of small", "test scenes", "ppo.learning_rate", versions["numpy"], "first 2 of 3")
    for words in wanted:
        assert words in text, words
        assert words in markdown, words
    assert "not at its end" not in text


def test_the_page_of_one_run_lies_in_its_folder_where_it_gets_the_same_bytes_each_time(runs, tmp_path):
    first, second = (write_run_report(runs[:1], out, n_episodes=1) for out in (None, tmp_path / "again" / "page.html"))
    assert first == runs[0].resolve() / "report.html"
    assert first.read_bytes() == second.read_bytes()


def test_the_page_of_several_runs_lies_in_the_folder_of_all(runs, page):
    assert page == runs[0].resolve().parent / "report.html"


def test_all_scenes_are_played_where_that_is_asked(runs):
    (run,) = read_runs(runs[:1])
    assert len(play(run, None).episodes) == play(run, 1).n_scenes == 3


def test_a_filmed_episode_ends_as_it_did_when_it_was_played(runs):
    played = play(read_runs(runs[:1])[0], 2)
    frames = film(played, 1, n_frames=3)
    assert 2 <= len(frames) <= 3
    assert frames[0][1] == "before the first cut"
    assert frames[-1][1].endswith(f"after cut {played.episodes[1].n_steps}, the end: {played.episodes[1].reason}")
    assert all(png.startswith(b"\x89PNG") for png, _ in frames)


def test_the_best_and_the_worst_episode_are_found_among_all_runs():
    first = Played("a", [episode(0.5), episode(1.0)], [], [], "all", 2)
    second = Played("b", [episode(1.0), episode(-1.0, reason="tear")], [], [], "all", 2)
    assert best_and_worst([first, second]) == ((first, 1), (second, 1))
    assert best_and_worst([]) is None


def test_an_interrupted_run_without_a_policy_gets_a_page_that_says_so(tmp_path):
    folder = made_run(tmp_path / "run", [(32, None, None)])
    text = " ".join(write_run_report([folder]).read_text(encoding="utf-8").split())
    for words in ("25% of what its rule for stopping allows", "No validation has been made yet", "no <code>best.zip</code> yet"):
        assert words in text


def test_a_damaged_policy_and_a_lost_scene_are_told_in_the_page(runs, tmp_path):
    damaged = tmp_path / "damaged"
    shutil.copytree(runs[0], damaged)
    (damaged / "best.zip").write_bytes(b"no zip")
    assert "not a policy saved by" in write_run_report([damaged]).read_text(encoding="utf-8")
    lost = made_run(tmp_path / "lost", scene="gone.yaml")
    (lost / "best.zip").write_bytes(b"")
    assert "cannot read gone.yaml" in write_run_report([lost]).read_text(encoding="utf-8")


def test_a_line_that_is_cut_off_is_left_out_and_told(tmp_path):
    folder = made_run(tmp_path / "run", [(32, 0.5, 0.5), (64, 0.6, 0.5)])
    path = folder / "progress.csv"
    path.write_text(path.read_text()[:-12])
    (run,) = read_runs([folder])
    assert run.progress["steps"].tolist() == [32]
    assert any("cut off" in remark for remark in run.remarks)


def test_a_run_is_at_its_end_once_no_update_would_fit_in(tmp_path):
    for steps, is_over in ((96, False), (128, True)):
        (run,) = read_runs([made_run(tmp_path / str(steps), [(steps, 0.5, 0.5)])])
        assert any("not at its end" in remark for remark in run.remarks) != is_over


def test_folders_without_a_run_and_damaged_files_are_errors_with_the_culprit(tmp_path):
    (tmp_path / "empty").mkdir()
    broken = made_run(tmp_path / "broken", [(32, "half", 0.5)])
    short = made_run(tmp_path / "short")
    (short / "progress.csv").write_text("steps,cpu_seconds\n1,2\n")
    for folder, words in (("empty", "no config.yaml"), ("broken", "line 2.*half"), ("short", "no column 'return'")):
        with pytest.raises(RunRecordError, match=words):
            read_runs([tmp_path / folder])
    assert [is_run(folder) for folder in (tmp_path / "empty", broken)] == [False, True]
    with pytest.raises(RunRecordError, match="ends in .html"):
        write_run_report([made_run(tmp_path / "run")], tmp_path / "page.pdf")


def test_runs_are_called_by_what_tells_them_apart_and_grouped_by_all_but_their_seeds(tmp_path):
    folders = [made_run(tmp_path / group / f"seed-{seed}", seed=seed, mask=mask)
               for group, mask in (("wide", "all"), ("narrow", "focus")) for seed in (0, 1)]  # fmt: skip
    runs = read_runs([*folders, folders[0]])
    assert [run.label for run in runs] == ["wide/seed-0", "wide/seed-1", "narrow/seed-0", "narrow/seed-1"]
    assert [(group.label, len(group.runs)) for group in groups_of(runs)] == [("wide", 2), ("narrow", 2)]
    assert [run.label for run in read_runs(folders[:2])] == ["seed-0", "seed-1"]
    _, blocks = contents(runs, [play(run) for run in runs])
    (differing,) = [block for block in blocks if isinstance(block, Table) and block.headers[0] == "setting"]
    assert [row[0] for row in differing.rows] == ["mask", "seed"]


def test_curves_are_drawn_as_often_as_there_are_runs_and_medians(tmp_path):
    rows = [(32 * i, 0.1 * i, 0.5) for i in range(1, 5)]
    runs = read_runs([made_run(tmp_path / "some" / f"seed-{seed}", rows, seed) for seed in (0, 1, 2)])
    svg = learning_curves(groups_of(runs))
    assert svg.count("stroke-opacity: 0.65") == 3 * 4
    assert "median of 3 seeds" in svg
    assert "http" not in svg.replace("http://www.w3.org", "")


@pytest.mark.parametrize("words", ["<script>alert(1)</script>", "a & b | c", 'quote " end'])
def test_every_kind_of_block_escapes_its_text(words):
    blocks = [Heading(words), Text(words), Text(f"`{words}`", True), Facts([(words, words)]), Table((words,), [(words,)]),
              Folded(words, Table((words,), [(words,)])), Figure("<svg></svg>", words), Strip([(b"", words)], words)]  # fmt: skip
    reader = Reader(as_page(words, blocks))
    assert reader.open == []
    assert sum(words in text for text in reader.text) == 15
    markdown = as_markdown_page(words, blocks)
    assert "<script" not in markdown
    assert all(line.count("|") - line.count("\\|") in (0, 2) for line in markdown.splitlines())


def test_columns_of_numbers_are_set_to_the_right():
    page = as_page("t", [Table(("name", "value"), [("a", "1.5"), ("b", "–"), ("c", "12.0%")])])
    assert page.count('<td class="number">') == 3
    assert np.all([f"<td>{name}</td>" in page for name in "abc"])
