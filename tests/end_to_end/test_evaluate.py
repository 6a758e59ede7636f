"""The command line: tables and files that can be trusted, errors in one line, and no torch where none is needed."""

import csv
import io
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from agents.command_line import main
from agents.demo_cut import amounts, choose_cuts, conservation_rows, cut_liver, own_share
from agents.scripted import POLICIES
from agents.video import SIDE
from gmapspring import Material, Simulation, meshes


def run(arguments, capsys):
    """Return (exit code, standard output, standard error) of a command."""
    code = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_evaluate_prints_a_table_and_writes_a_line_per_episode(tmp_path, capsys):
    out = tmp_path / "new" / "folder" / "episodes.csv"
    arguments = ["evaluate", "certificate", "random", "--scene", "box-48", "--episodes", 2, "--out", out]
    code, printed, _ = run(arguments, capsys)
    assert code == 0
    with out.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["policy"] for row in rows] == ["certificate", "certificate", "random", "random"]
    assert [float(row["total_return"]) for row in rows[:2]] == pytest.approx([1.0, 1.0])
    lines = [line for line in printed.splitlines() if line.startswith("| certificate")]
    assert len(lines) == 1 and "1.00 ± 0.00" in lines[0]
    assert not list(out.parent.glob("*.unfinished"))


def test_names_with_colons_are_printed_as_they_are(capsys):
    code, printed, _ = run(["evaluate", "foresight:100:rim-first", "--scene", "box-48", "--episodes", 1], capsys)
    assert code == 0
    assert "| foresight:100:rim-first |" in printed


def test_evaluate_tells_how_many_simulator_steps_thinking_took(tmp_path, capsys):
    arguments = ["evaluate", "rim-first", "shield:rim-first", "search:30", "--scene", "box-48", "--episodes", 2]
    code, printed, _ = run([*arguments, "--out", tmp_path / "episodes.csv"], capsys)
    assert code == 0
    assert "simulated steps" in printed
    rows = list(csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines()))
    plain, shielded, searched = ([int(row["n_simulated"]) for row in rows[start : start + 2]] for start in (0, 2, 4))
    assert plain == [0, 0]
    assert all(spent >= int(row["n_steps"]) for spent, row in zip(shielded, rows[2:4], strict=True))
    assert all(0 < spent <= 30 for spent in searched)


def test_policies_are_filmed_side_by_side(tmp_path, capsys):
    film = tmp_path / "new" / "two.gif"
    arguments = ["evaluate", "certificate", "rim-first", "--scene", "box-48", "--episodes", 1, "--video", film]
    code, printed, _ = run(arguments, capsys)
    assert code == 0 and f"the film is {film}" in printed
    with Image.open(film) as opened:
        assert opened.n_frames > 20 and opened.width == 2 * SIDE


def test_the_same_seed_gives_the_same_episodes(tmp_path, capsys):
    found = []
    for name in ("first.csv", "second.csv"):
        run(["evaluate", "random", "--scene", "box-48", "--episodes", 2, "--seed", 3, "--out", tmp_path / name], capsys)
        rows = csv.DictReader(io.StringIO((tmp_path / name).read_text()))
        found.append([{key: value for key, value in row.items() if key != "seconds"} for row in rows])
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["evaluate", "lookahaed"], ["lookahaed", "did you mean 'lookahead'"]),
        (["evaluate", "missing.zip"], ["cannot read missing.zip"]),
        (["evaluate", "random", "--scene", "box-49"], ["box-49", "did you mean 'box-48'"]),
        (["evaluate", "random", "--split", "tset"], ["tset", "did you mean 'test'"]),
        (["evaluate", "random", "--mask", "focsu"], ["focsu", "did you mean 'focus'"]),
        (["evaluate", "random", "--scene", "box-48", "--episodes", 1, "--out", "/dev/null/x.csv"], ["/dev/null"]),
        (["evaluate", "random", "--out", "."], ["--out .", "is a folder"]),
        (["evaluate", *list(POLICIES)[:5], "--video", "x.gif"], ["1 to 4", "not 5"]),
        (["evaluate", "random", "--video", "film.gfi"], ["film.gfi", "did you mean '.gif'"]),
    ],
    ids=lambda part: " ".join(map(str, part)),
)
def test_an_error_is_one_line_and_exit_code_1(arguments, words, capsys):
    code, _, error = run(arguments, capsys)
    assert code == 1
    assert error.startswith("error: ") and error.count("\n") == 1
    assert all(word in error for word in words)


def test_an_error_has_a_traceback_only_where_it_is_asked_for():
    with pytest.raises(ValueError, match="there is no policy 'nobody'"):
        main(["evaluate", "nobody", "--debug"])
    with pytest.raises(ValueError, match="there is no policy 'nobody'"):
        main(["--debug", "evaluate", "nobody"])


@pytest.mark.parametrize(
    "arguments",
    [
        ["evaluate", "random", "--episodes", "-1"],
        ["evaluate", "random", "--episodes", "0"],
        ["evaluate"],
        ["dance"],
        ["train"],
        [],
    ],
)
def test_wrong_arguments_exit_with_code_2(arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2


def test_scripted_policies_are_evaluated_without_torch():
    block = "import sys; sys.modules.update(dict.fromkeys(('torch', 'stable_baselines3', 'sb3_contrib')))"
    scripted = "main('evaluate min-cut-index --scene box-48 --episodes 1'.split())"
    learned = "main('train box-108'.split())"
    command = f"{block}; from agents.command_line import main; print([{scripted}, {learned}])"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[0, 1]", done.stderr
    assert "pip install" in done.stderr and done.stderr.count("\n") == 1


# The demo ---------------------------------------------------------------------------------------------------------


def test_the_demo_cuts_the_liver_and_writes_it_down(tmp_path):
    stream = io.StringIO()
    cut_liver(tmp_path, Console(file=stream, width=120))
    assert {"liver.vtu", "liver.png"} <= {path.name for path in tmp_path.iterdir()}
    assert "elastic energy" in stream.getvalue()


def test_the_demo_s_errors_are_round_off():
    mesh = meshes.box((3, 3, 3), spacing=0.01)
    tumour = np.zeros(mesh.n_tetrahedra, dtype=bool)
    tumour[80:100] = True
    mesh = type(mesh)(mesh.points, mesh.tetrahedra, {"tumour": tumour})
    sim = Simulation(mesh, Material(5e3, 1000.0), pinned=mesh.points[:, 2] < 1e-9, gravity=(0.0, 0.0, -9.81))
    sim.advance(0.02)
    faces, removed = choose_cuts(mesh)
    start = amounts(sim.body)
    sim.cut(faces=faces)
    slit, share = amounts(sim.body), own_share(sim.body, removed)
    sim.cut(tetrahedra=removed)
    assert len(faces) and len(removed)
    for row in conservation_rows(start, slit, share, amounts(sim.body)):
        # A cut changes nothing and a removal takes its own share, to the round-off of sums over the body.
        assert float(row[3]) < 1e-12 and float(row[5]) < 1e-12
