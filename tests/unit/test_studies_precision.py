"""The studies of error against cost: their scenes and references, their measures, and the rules they make of rows."""

import math

import numpy as np
import pytest

import gmapspring as gs
from tests.benchmarks.studies import choice, work_precision
from tests.benchmarks.studies.precision_drift import drift
from tests.benchmarks.studies.precision_figure import draw
from tests.benchmarks.studies.precision_reference import Motion, motion_of, naive_system, refer
from tests.benchmarks.studies.precision_rows import (
    Budget,
    Contestant,
    Row,
    as_dicts,
    fastest,
    is_explicit,
    ladder,
    read_rows,
)
from tests.benchmarks.studies.precision_rules import MARGIN, UNITS, Rule, by_damping, judge, propose
from tests.benchmarks.studies.precision_scenes import (
    Facts,
    Scene,
    damped_scenes,
    facts_of,
    free_scene,
    layered_scenes,
)
from tests.benchmarks.study import Plan, as_csv, as_markdown
from tests.naive_mechanics import acceleration
from tests.unit.test_forces import body_force

SCENES = [*damped_scenes(True), *layered_scenes(True), free_scene(True)]
each_scene = pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
NAN = math.nan


def row(scene="a", scheme="rk4", precision="float64", step=1e-3, share=1.0, error=1e-3, cpu=1.0, note=""):
    """Return a row with equal errors of position and strain."""
    return Row(scene, scheme, precision, step, share, 10, error, error, cpu, note)


def facts(scene="a", frequency=1000.0, median=1000.0, damping_ratio=0.5):
    """Return facts of a made-up body."""
    return Facts(scene, "made up", 1.0, 27, 1.0, frequency, median, damping_ratio)


def first_order_rows(scene, constant, scheme="symplectic_euler", bound=4e-3):
    """Return runs with error = constant * step and cost = 1 / step."""
    steps = bound / 2.0 ** np.arange(10)
    return [row(scene, scheme, "float64", step, step / bound, constant * step, 1.0 / step) for step in steps.tolist()]


# Scenes and references ----------------------------------------------------------------------------------------------------


def test_scenes_have_names_of_their_own():
    assert len({scene.name for scene in SCENES}) == len(SCENES)


@each_scene
def test_a_scene_begins_alike_for_every_scheme_and_precision(scene):
    first, second = scene.build("rk4", np.float64), scene.build("symplectic_euler", np.float32)
    assert scene.seconds > 0.0 and facts_of(scene).tetrahedra == first.body.n_tetrahedra
    np.testing.assert_array_equal(first.body.vertex_of, second.body.vertex_of)
    np.testing.assert_array_equal(first.body.edge_of, second.body.edge_of)
    np.testing.assert_array_equal(first.body.nodes.state.astype(np.float32), second.body.nodes.state)


@each_scene
def test_the_naive_right_hand_side_agrees_with_the_kernels_to_round_off(scene):
    body, rng = scene.build("rk4", np.float64).body, np.random.default_rng(0)
    nodes, system = body.nodes, naive_system(body)
    nodes.position[:] += 1e-3 * rng.standard_normal(nodes.position.shape)
    nodes.velocity[:] = rng.standard_normal(nodes.velocity.shape)
    expected = system["mass"][:, None] * acceleration(system, nodes.position, nodes.velocity)
    force = np.where(nodes.is_pinned[:, None], 0.0, body_force(body))
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_cut_scene_has_more_nodes_than_points():
    for name in ("liver", "resection"):
        body = next(scene for scene in SCENES if scene.name == name).build("rk4", np.float64).body
        assert body.n_nodes > len(np.unique(body.nodes.point))


def test_errors_are_relative_to_the_size_and_the_worst_of_all_springs():
    still = Motion(np.zeros((4, 3)), np.array([0.1, 0.0]), size=2.0)
    moved = Motion(np.array([(0.3, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0)]), np.array([0.1, -0.2]), size=2.0)
    # sqrt(0.3^2 / 4) / 2 = 0.075
    assert moved.errors(still) == pytest.approx((0.075, 0.2))
    assert moved.errors(still).worst == pytest.approx(0.2)


def test_the_strain_of_other_positions_is_that_of_a_body_which_has_them():
    body = SCENES[0].build("rk4", np.float64).body
    position = 1.1 * body.nodes.position
    motion = motion_of(body, position)
    body.nodes.position[:] = position
    np.testing.assert_allclose(motion.strain, motion_of(body).strain, rtol=1e-12)
    np.testing.assert_allclose(motion.strain, 0.1, rtol=1e-12)


def small_scene(viscosity=1.0):
    """Return a small body that falls for a short time."""
    mesh, material = gs.meshes.box((2, 1, 1), 0.05), gs.Material(5e3, 1e3, damping=1e-3 * (viscosity > 0), viscosity=viscosity)
    pinned = mesh.points[:, 0] < 1e-9

    def build(scheme, dtype):
        return gs.Simulation(mesh, material, pinned=pinned, gravity=(0, 0, -9.81), integrator=scheme, dtype=dtype)

    return Scene("small", "a small body", 0.1, build)


def test_rk4_comes_to_the_reference_with_its_order_and_scipy_agrees():
    scene = small_scene()
    reference = refer(scene)
    assert reference.change <= 1e-10 and reference.checked <= 1e-9 and reference.travel > 1e-2
    rows = list(ladder(Contestant(scene, "rk4", np.float64), reference.end, Budget(5.0, 5.0, 1e-8)))
    assert [each.share for each in rows] == pytest.approx([0.5**i for i in range(len(rows))])
    assert rows[-1].error <= 1e-8 < rows[-2].error
    # Half a step, a sixteenth of the error; a step is cut so that the time is a whole number of them.
    assert rows[-1].error == pytest.approx(rows[-2].error / 16, rel=0.5)


def test_a_scheme_without_a_stable_step_or_beyond_the_budget_gets_a_row_that_says_so():
    scene = small_scene(viscosity=0.0)
    end = motion_of(scene.build("rk4", np.float64).body)
    budget = Budget(0.0, 0.0, 0.0)
    (never,) = ladder(Contestant(scene, "explicit_euler", np.float64), end, budget)
    assert math.isnan(never.error) and "no stable step" in never.note
    (dear,) = ladder(Contestant(scene, "rk4", np.float64), end, budget)
    assert math.isnan(dear.error) and "would take about" in dear.note


def test_a_free_body_keeps_what_it_must():
    changes = drift(free_scene(True).build("rk4", np.float64), 0.25, 0.01)
    assert changes["momentum"] < 1e-12 and changes["angular momentum"] < 1e-6 and changes["energy"] < 1e-3
    assert changes["angular momentum"] > 0.0


# Rows ---------------------------------------------------------------------------------------------------------------------


def test_the_fastest_run_is_the_cheapest_within_the_tolerance_and_never_one_without_a_result():
    rows = [row(error=NAN, cpu=0.1), row(error=1e-1, cpu=0.2), row(error=1e-2, cpu=0.5), row(error=1e-3, cpu=0.7)]
    assert fastest(rows, 1e-1).cpu == 0.2
    assert fastest(rows, 5e-2).cpu == 0.5
    assert fastest(rows, 1e-4) is None


def test_a_run_that_is_good_by_chance_is_not_the_fastest():
    rows = [row(step=4e-3, error=1e-2, cpu=1.0), row(step=2e-3, error=3e-2, cpu=2.0), row(step=1e-3, error=1e-3, cpu=4.0)]
    assert fastest(rows, 1e-2).cpu == 4.0
    # Another scheme's luck is no concern, nor is round-off.
    assert fastest([rows[0], rows[1]._replace(scheme="other"), rows[2]], 1e-2).cpu == 1.0
    assert fastest([rows[0], rows[1]._replace(position_error=0.0, strain_error=1.9e-2), rows[2]], 1e-2).cpu == 1.0


def test_rows_come_back_from_their_file(tmp_path):
    rows = [row(note="one, two", error=1 / 3), row(scheme="backward_euler")]
    (tmp_path / "rows.csv").write_text(as_csv(as_dicts(rows)))
    assert read_rows(tmp_path / "rows.csv", Row) == rows


def test_only_backward_euler_has_no_longest_step():
    assert not is_explicit("backward_euler")
    assert is_explicit("explicit_euler") and is_explicit("rk4")


def test_the_implicit_scheme_wins_from_the_ratio_on_from_which_it_never_loses():
    measured = work_precision.Measured([], [], [])
    for ratio, explicit_cost in ((1.0, 5.0), (10.0, 0.5), (100.0, 4.0)):
        name = f"layer {ratio:g}"
        measured.facts.append(facts(name))
        measured.rows.extend([row(name, "rk4", error=1e-3, cpu=explicit_cost), row(name, "backward_euler", error=5e-2, cpu=1.0)])
    rows = work_precision.crossover_rows(measured)
    assert [each["0.1"] for each in rows] == [5.0, 0.5, 4.0]
    assert all(math.isnan(each["0.01"]) for each in rows)
    text = work_precision.crossover_text(rows, measured.rows)
    assert "within 0.1 from a ratio of 100 on" in text and "within 0.01 at no ratio" in text


def test_a_diagram_has_a_panel_for_each_scene_and_leaves_out_what_has_no_result():
    rows = [*first_order_rows("a", 1.0), *first_order_rows("b", 1.0), row("b", "rk4", step=NAN, error=NAN, cpu=NAN, note="why")]
    figure = draw(rows, ["a", "b"], "strain_error", "error")
    assert [panel.get_title() for panel in figure.axes] == ["a", "b", "", ""]
    assert sum(len(line.get_xdata()) for line in figure.axes[1].get_lines()) == 10 + 1


# Rules --------------------------------------------------------------------------------------------------------------------

OWN_STEP = UNITS[0]


def test_a_rule_takes_the_longest_step_at_which_no_body_misses_the_tolerance_by_its_margin():
    bodies = [facts("a"), facts("b"), facts("c")]
    rows = [*first_order_rows("a", 1.0), *first_order_rows("b", 8.0), *first_order_rows("c", 2.0)]
    verdict = judge(Rule("symplectic_euler", "float64", OWN_STEP), bodies, rows, 1e-2)
    # b allows 8 h <= 0.005, h = 6.25e-4 and less: the run with 4e-3 / 8 is the longest.
    assert verdict.multiple == pytest.approx(1 / 8)
    assert verdict.worst_error == pytest.approx(8.0 * 5e-4 / 1e-2) and verdict.worst_error <= MARGIN
    # Without b, c decides: h = 2e-3, the default step, at which b has an error of 0.016.
    assert verdict.left_out_error == pytest.approx(1.6)
    # a could take 4e-3, with an error of 0.004; it takes 5e-4 and pays eight times as much.
    assert max(verdict.costs) == pytest.approx(8.0)


def test_a_rule_gives_no_explicit_scheme_more_than_its_default_step():
    verdict = judge(Rule("symplectic_euler", "float64", OWN_STEP), [facts("a")], first_order_rows("a", 1.0), 10.0)
    assert verdict.multiple == pytest.approx(0.5)


def test_a_rule_is_none_where_a_body_has_no_runs_or_none_within_the_tolerance():
    rule = Rule("symplectic_euler", "float64", OWN_STEP)
    assert judge(rule, [facts("a"), facts("b")], first_order_rows("a", 1.0), 1e-2) is None
    assert judge(rule, [facts("a")], first_order_rows("a", 1.0), 1e-6) is None
    diverged = [row("a", "symplectic_euler", step=4e-3, error=NAN, cpu=NAN, note="diverged")]
    assert judge(rule, [facts("a")], diverged, 1e-2) is None


def test_bodies_are_parted_by_their_damping():
    bodies = [facts("a", damping_ratio=0.8), facts("b", damping_ratio=0.01), facts("c", damping_ratio=0.5)]
    light, damped = by_damping(bodies).values()
    assert [body.scene for body in light] == ["b"] and {body.scene for body in damped} == {"a", "c"}


def test_uneven_bodies_get_a_rule_of_their_own_where_it_pays():
    names, rows = ("a", "b", "c", "d"), []
    bodies = [facts("light", damping_ratio=1e-3)]
    rows += first_order_rows("light", 1.0)
    for name in names:
        is_uneven = name in "cd"
        bodies.append(facts(name, frequency=1e5 if is_uneven else 1e3))
        rows += first_order_rows(name, 1.0, bound=4e-5 if is_uneven else 4e-3)
        rows += [row(name, "backward_euler", "float64", 0.2, 10.0, 1e-3, 2000.0)]
    _, even, uneven = propose(bodies, rows, 1e-2)
    assert even.verdict.rule.scheme == "symplectic_euler" and uneven.verdict.rule.scheme == "backward_euler"
    assert "spread up to 10" in even.sort and "spread above 10" in uneven.sort


def test_choice_reads_the_rows_that_were_measured_and_tabulates_the_fastest(tmp_path, monkeypatch):
    bodies = [facts("a", damping_ratio=0.01), facts("b"), facts("c")]
    rows = [each for body in bodies for each in first_order_rows(body.scene, 1.0)]
    rows += [row("a", "rk4", "float32", 2e-3, 0.5, 1e-5, 400.0), row("a", "rk4", note="dear", step=NAN, error=NAN, cpu=NAN)]
    monkeypatch.setattr(work_precision, "measure_scenes", None)  # must not be called
    (tmp_path / "work-precision").mkdir()
    for name, table in (("rows", rows), ("scenes", bodies)):
        (tmp_path / "work-precision" / f"{name}.csv").write_text(as_csv(as_dicts(table)))
    study = choice.run(Plan(True, lambda _: None, tmp_path))
    best = next(each for each in study.tables[0].rows if (each["scene"], each["tolerance"]) == ("a", 1e-3))
    # Symplectic Euler needs h <= 1e-3 and costs 1000; RK4 costs 400.
    assert best["fastest"] == "rk4 float32" and best["step"] == 0.5
    assert best["next best"] == "symplectic_euler float64" and best["costs"] == pytest.approx(2.5)
    assert "0.001" in study.text and all(as_markdown(table.rows) for table in study.tables)
