"""The figures of a study's page, from episodes made by hand: each is told as it is, and gaps in them too."""

import pathlib

import numpy as np
import pytest

from agents.evaluation import Episode, episodes_as_csv
from agents.report import page
from agents.report_plots import median_curve, pictures
from agents.report_tables import ablations, aims, efficiency, ends, gaps, policies, thinking, worst_seeds
from agents.results import Curve, Group, Results, found_for, read_episodes
from agents.study_config import StudyConfig
from agents.study_jobs import MISSING, jobs_of
from gmapspring.config import check_config

WRAPPERS = ["shield", "foresight:30"]
SCENE = {"scene": "box-48"}
EVALUATE = [SCENE, SCENE | {"split": "train"}, *(SCENE | {"wrapper": name} for name in WRAPPERS)]
REACH = SCENE | {"aim": "to be good"}


def study_of(reach):
    """Return a study with a row of two seeds, its ablation, and one aim."""
    rows = [{"name": "base", "train": "box-108", "evaluate": EVALUATE, "reach": [REACH | reach]},
            {"name": "less", "train": "box-108", "ablates": "base"}]  # fmt: skip
    return check_config({"name": "s", "title": "S", "seeds": [0, 1], "rows": rows}, StudyConfig)


def episode(total, scene_seed=0, reason="separated", n_simulated=0, cost_ratio=1.0):
    """Return an episode."""
    return Episode(
        "p", "box-48", scene_seed, total, reason == "separated", reason, cost_ratio,
        n_steps=4, n_simulated=n_simulated, seconds=0.5,
    )  # fmt: skip


def group_of(name, *returns, split="test", **values):
    """Return a group with a row of returns for each seed; those below 0 tore."""
    by_seed = {
        seed: [episode(total, scene, "separated" if total >= 0 else "tear", **values) for scene, total in enumerate(row)]
        for seed, row in enumerate(returns)
    }
    return Group(name, "box-48", split, by_seed, True)


def results_of(*groups, reach=None, curves=None):
    """Return results that hold some groups."""
    return Results(study_of(reach or {"return": 0.5}), [], list(groups), curves or {}, [])


@pytest.mark.parametrize(
    ("reach", "figure", "verdict"),
    [
        ({"return": 0.69}, 0.7, "reached"),
        ({"return": 0.71}, 0.7, "not reached"),
        ({"return": 0.59, "in_every_seed": True}, 0.6, "reached"),
        ({"return": 0.65, "in_every_seed": True}, 0.6, "not reached"),
        ({"success": 1.0}, 1.0, "reached"),
        ({"gap": 0.2}, 0.15, "reached"),
        ({"gap": 0.1}, 0.15, "not reached"),
        ({"gap": 0.2, "in_every_seed": True}, 0.3, "not reached"),
    ],
)
def test_an_aim_is_held_against_the_mean_or_the_worst_seed(reach, figure, verdict):
    test = group_of("base", [0.5, 0.7], [0.7, 0.9])
    train = group_of("base", [0.8, 1.0], [0.7, 0.9], split="train")
    results = results_of(test, train, reach=reach)
    row = results.study.rows[0]
    (found,) = found_for(results, row, row.reach[0])
    assert found.figure == pytest.approx(figure)
    assert found.verdict == verdict


def test_missing_seeds_leave_an_aim_open_unless_one_has_failed_it():
    half = group_of("base", [0.5, 0.7])
    for reach, verdict in (
        ({"return": 0.5}, "seeds missing"),
        ({"return": 0.9}, "seeds missing"),
        ({"return": 0.9, "in_every_seed": True}, "not reached"),
    ):
        results = results_of(half, reach=reach)
        row = results.study.rows[0]
        assert found_for(results, row, row.reach[0])[0].verdict == verdict
    assert aims(results_of()).rows[0][-1] == "**not measured**"
    assert "missing: 1" in aims(results_of(half)).rows[0][-4]


def test_what_the_simulator_adds_stands_beside_the_figure_and_reaches_no_aim():
    groups = group_of("base", [0.5, 0.7], [0.7, 0.9]), group_of("shield:base", [0.9, 1.0], [0.8, 1.0])
    for reach, shielded in (({"return": 0.9}, "0.925"), ({"return": 0.9, "in_every_seed": True}, "0.900")):
        found = aims(results_of(*groups, reach=reach))
        assert found.headers[-3:] == ("with shield", "with foresight:30", "")
        assert found.rows[0][-3:] == (shielded, "–", "**not reached**")
    assert aims(results_of(groups[0], reach={"return": 0.9})).rows[0][-3:] == ("–", "–", "**not reached**")


def test_how_many_aims_the_simulator_would_reach_is_told():
    groups = group_of("base", [0.5, 0.7], [0.7, 0.9]), group_of("foresight:30:base", [0.9, 1.0], [0.9, 0.9])
    text = page(results_of(*groups, reach={"return": 0.9}), [])
    assert "0 of 1 figures aimed at are reached" in text
    assert "with shield it would be 0 of the 0 that were measured so" in text
    assert "with foresight:30 it would be 1 of the 1 that were measured so." in text
    half = group_of("base", [0.5, 0.7], [0.7, 0.9]), group_of("foresight:30:base", [0.9, 1.0])
    assert "with foresight:30 it would be 0 of the 0" in page(results_of(*half, reach={"return": 0.9}), [])


def test_a_policy_in_a_wrapper_has_a_line_of_its_own_with_the_training_of_its_row():
    curve, names = Curve(*np.ones((4, 1)), 100, 33.0), ["base", "shield:base", "foresight:30:base"]
    groups = [group_of(name, [0.1 * number]) for number, name in enumerate(names)]
    found = policies(results_of(*groups, curves={"base": {0: curve}}), "box-48")
    assert [(row[0], row[-1]) for row in found.rows] == [(f"**{name}**", "33") for name in reversed(names)]


def test_a_policy_is_held_against_scripts_that_neither_simulate_nor_know_the_answer():
    scripts = [
        group_of("certificate", [1.0, 1.0, 1.0])._replace(is_learned=False),
        group_of("shield:rim-first", [1.0, 1.0, 1.0], n_simulated=9)._replace(is_learned=False),
        group_of("random", [-1.0, -1.0, 1.0])._replace(is_learned=False),
        group_of("rim-first", [-1.0, 1.0, 1.0])._replace(is_learned=False),
    ]
    ours = group_of("base", [1.0, 1.0, 1.0], [-1.0, -1.0, 1.0])
    for reach, verdict in (({}, "reached"), ({"in_every_seed": True}, "not reached")):
        results = results_of(ours, *scripts, reach={"is_above_scripts": True} | reach)
        row = results.study.rows[0]
        (found,) = found_for(results, row, row.reach[0])
        assert list(found.by_seed.values()) == pytest.approx([1 / 3, -1 / 3])
        assert found.verdict == verdict
    plain = {"name": "base", "train": "box-108", "evaluate": EVALUATE}
    scripted = {
        "name": "s",
        "title": "S",
        "seeds": [0],
        "rows": [plain],
        "scripts": [{"scene": "box-48", "policies": ["random"]}],
    }
    job = jobs_of(check_config(scripted, StudyConfig), pathlib.Path("nowhere"))[-1]
    waiting = results._replace(states=[(job, MISSING, "")])
    assert found_for(waiting, row, row.reach[0])[0].verdict == "not measured", "the script that has yet to play may be the best"
    lonely = results_of(ours, scripts[0], scripts[1], reach={"is_above_scripts": True})
    assert found_for(lonely, lonely.study.rows[0], lonely.study.rows[0].reach[0])[0].verdict == "not measured"


def test_remarks_stand_on_the_page_only_where_an_aim_is_missed():
    groups = group_of("base", [0.5, 0.7], [0.7, 0.9]), group_of("less", [0.5, 0.7], [0.7, 0.9])
    for asked, stands in ((0.9, True), (0.6, False)):
        text = page(results_of(*groups, reach={"return": asked, "remarks": "Too little time."}), [])
        assert ("**base**, to be good (return): Too little time." in text) == stands


def test_ends_are_shares_of_all_episodes_with_what_lies_in_the_tissue_together():
    reasons = ["separated"] * 4 + ["tear"] * 2 + ["inverted"] + ["numerical"] + ["budget"] * 2
    text = ends([episode(0.0, reason=reason) for reason in reasons])
    assert text == "structural 30.0% (tear 20.0%, inverted 10.0%), budget 20.0%, numerical 10.0%"
    assert ends([episode(1.0)]) == "–"


def test_the_table_of_policies_tells_set_and_order_apart_and_puts_the_best_first():
    good, bad = group_of("base", [1.0, 0.9], cost_ratio=1.2), group_of("less", [1.0, -1.0], cost_ratio=1.5)
    table = policies(results_of(bad, good), "box-48")
    rows = [dict(zip(table.headers, row, strict=True)) for row in table.rows]
    assert [row["policy"] for row in rows] == ["**base**", "**less**"]
    assert [row["set regret"] for row in rows] == ["0.200", "0.500"]
    assert [row["order regret"] for row in rows] == ["0.000", "0.500"]
    assert [row["steps/s"] for row in rows] == ["8", "8"]


def test_the_gap_is_the_mean_over_seeds_that_played_both():
    train = group_of("base", [0.9, 0.9], split="train")
    (row,) = gaps(results_of(group_of("base", [0.5, 0.7], [0.0, 0.0]), train)).rows
    assert row == ("base", "box-48", "0.900", "0.600", "+0.300", "0: +0.300")


def test_an_ablation_is_compared_with_its_row():
    base, less = group_of("base", [0.5, 0.7], [0.5, 0.7]), group_of("less", [0.3, 0.5], [0.3, 0.5])
    (row,) = ablations(results_of(base, less)).rows
    assert row[:4] == ("less", "base", "box-48", "2 / 2") and row[4] == "-0.200 [-0.200, -0.200]"
    assert not ablations(results_of(less)).rows


def test_only_policies_that_simulate_are_asked_what_thinking_buys():
    slow, fast = group_of("base", [1.0, 1.0], n_simulated=900), group_of("less", [1.0, -1.0], n_simulated=20)
    assert [row[1:3] for row in thinking(results_of(slow, fast)).rows] == [("less", "20"), ("base", "900")]
    assert not thinking(results_of(group_of("base", [1.0]))).rows
    assert "thinking" in pictures(results_of(slow, fast)) and "thinking" not in pictures(results_of())


def test_the_worst_seed_and_the_hardest_scenes_are_shown():
    (row,) = worst_seeds(results_of(group_of("base", [1.0, -1.0, 1.0], [-1.0, -1.0, 1.0]))).rows
    assert row[2] == "1" and row[3] == "-0.333" and row[-1] == "1 (2 of 2), 0 (1 of 2)"


def curve(success):
    """Return a learning curve with a validation every 10 steps and 2 seconds."""
    n = len(success)
    numbers, success = np.arange(1, n + 1), np.array(success)
    return Curve(10.0 * numbers, 2.0 * numbers, success - 0.1, success, 10 * n, 2.0 * n)


def test_sample_efficiency_is_the_median_of_first_times_and_tells_how_many_got_there():
    curves = {"base": {0: curve([0.2, 0.5, 0.4, 0.9]), 1: curve([0.6, 0.7, 0.85, 0.7])}}
    (row,) = efficiency(results_of(curves=curves)).rows
    assert row[:6] == ("base", "2", "15 steps, 3 s (2 of 2 seeds)", "35 steps, 7 s (2 of 2 seeds)",
                       "40 steps, 8 s (1 of 2 seeds)", "in no seed")  # fmt: skip


def test_the_median_curve_ends_where_the_first_seed_ends():
    lines = [(np.array([1.0, 3.0]), np.array([0.0, 1.0])), (np.array([0.0, 2.0]), np.array([0.0, 1.0]))]
    grid, median = median_curve(lines)
    assert (grid[0], grid[-1]) == (1.0, 2.0)
    # Means of two lines: (x - 1) / 2 and x / 2.
    assert median == pytest.approx(grid / 2.0 - 0.25)
    assert len(median_curve([])[0]) == 0


def test_episodes_are_read_as_they_were_written(tmp_path):
    episodes = [episode(0.1 + 0.2), episode(-1.0, 7, "tear", 12)]
    (tmp_path / "e.csv").write_text(episodes_as_csv(episodes))
    assert read_episodes(tmp_path / "e.csv") == episodes


def test_a_page_of_nothing_says_so():
    text = page(results_of(), [])
    assert "0 of 1 figures aimed at are reached" in text and "**0 of 2**" in text
