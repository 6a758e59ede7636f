"""The command line as a whole: help, errors and exit codes of every command; and the commands about bodies."""

import csv
import json
import os
import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from agents.command_line import _parser, main
from agents.commands import COMMANDS
from gmapspring import Mesh, measure, meshes, read_mesh, write_mesh


def run(arguments, capsys):
    """Return (exit code, standard output, standard error) of a command."""
    code = main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture
def box(tmp_path):
    """Write a box of 3 x 2 x 2 cells with a region and return its file."""
    mesh = meshes.box((3, 2, 2), spacing=0.01)
    core = np.zeros(mesh.n_tetrahedra, bool)
    core[[7, 20]] = True
    write_mesh(tmp_path / "box.vtu", Mesh(mesh.points, mesh.tetrahedra, {"core": core}, {"foot": mesh.points[:, 2] == 0.0}))
    return tmp_path / "box.vtu"


# Help, errors, exit codes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", COMMANDS)
def test_the_examples_in_a_command_s_help_are_commands_that_it_takes(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    assert stopped.value.code == 0
    printed = capsys.readouterr().out.split("example", 1)[1]
    shown = re.findall(r"^  gmapspring (.*)$", printed, flags=re.MULTILINE)
    assert shown == COMMANDS[name].examples.splitlines()
    for example in shown:
        assert example.startswith(name)
        assert _parser().parse_args(shlex.split(example)).run is COMMANDS[name].run


def test_the_help_of_the_whole_has_a_line_and_an_example_for_every_command(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["--help"])
    printed = capsys.readouterr().out
    assert stopped.value.code == 0
    assert all(re.search(rf"^    {name} ", printed, flags=re.MULTILINE) for name in COMMANDS)
    assert all(f"  gmapspring {command.examples.splitlines()[0]}\n" in printed for command in COMMANDS.values())


def test_the_entry_point_is_the_command_line(tmp_path):
    script = os.path.join(os.path.dirname(sys.executable), "gmapspring")
    done = subprocess.run([script, "mesh", "info", "nothing.msh"], capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("error: cannot read nothing.msh") and done.stderr.count("\n") == 1


def test_a_reader_that_has_read_enough_is_no_error():
    command = f"{shlex.quote(sys.executable)} -m agents mesh info liver --json | head -c 1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.stdout == "{0\n" and done.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["mesh", "info", "missing.msh"], ["cannot read missing.msh"]),
        (["mesh", "info", "liver", "--density", "0"], ["--density is 0"]),
        (["mesh", "convert", "liver", "liver.stl"], ["cannot write liver.stl", ".vtu, .msh, .mesh"]),
        (["mesh", "convert", "liver", "/dev/null/x.msh"], ["cannot write /dev/null/x.msh"]),
        (["simulate", "liver", "--cut", "tumuor"], ["'tumuor' names no tetrahedra", "did you mean 'tumour'"]),
        (["simulate", "liver", "--cut", "z<-5"], ["'z<-5' holds no tetrahedra", "they lie between"]),
        (["simulate", "liver", "--cut", "z<.-"], ["z<.- has no number behind <"]),
        (["simulate", "liver", "--remove", "5,9999"], ["no 9999 among 1854 tetrahedra"]),
        (["simulate", "liver", "--cut", "tumour@3"], ["--cut tumour@3 is at 3 s, but --seconds is 1"]),
        (["simulate", "liver", "--cut", "tumour@-1"], ["tumour@-1", "not a number from 0 up"]),
        (["simulate", "liver", "--pin", "ancor"], ["'ancor' names no points", "did you mean 'anchor'"]),
        (["simulate", "liver", "--integrator", "rk5"], ["no integrator 'rk5'", "did you mean 'rk4'"]),
        (["simulate", "liver", "--out", "run.vtk"], ["cannot write run.vtk", "ends in .vtu"]),
        (["simulate", "liver", "--cut", "0-1853", "--frames", "1"], ["0", "1853"]),
        (["bench", "--seconds", "0"], ["--seconds is 0"]),
    ],
    ids=lambda part: " ".join(map(str, part)),
)
def test_an_error_is_one_line_and_exit_code_1(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, error = run(arguments, capsys)
    assert code == 1
    assert error.startswith("error: ") and error.count("\n") == 1
    assert all(word in error for word in words)
    assert not list(tmp_path.rglob("*.pvd"))


@pytest.mark.parametrize(
    "arguments",
    [["mesh"], ["mesh", "inform", "liver"], ["simulate"], ["simulate", "liver", "--seconds", "-1"],
     ["simulate", "liver", "--gravity", "1", "2"], ["simulate", "liver", "--frames", "0"], ["bench", "--seconds", "x"],
     ["certify", "box-48", "--jobs", "0"]],
    ids=" ".join,
)  # fmt: skip
def test_wrong_arguments_exit_with_code_2(arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2


def test_certify_hands_on_its_errors(capsys):
    code, _, error = run(["certify", "box-49", "--seed", 0], capsys)
    assert code == 1 and "did you mean 'box-48'" in error


def test_evaluate_gives_a_script_its_numbers(capsys):
    code, printed, _ = run(["evaluate", "certificate", "random", "--scene", "box-48", "--episodes", 2, "--json"], capsys)
    found = json.loads(printed)
    assert code == 0 and [summary["policy"] for summary in found] == ["certificate", "random"]
    assert found[0]["total_return"]["mean"] == pytest.approx(1.0)
    assert found[1]["cost_ratio"]["mean"] is None  # no success, no mean


def test_bench_measures_every_row(capsys):
    code, printed, _ = run(["bench", "--seconds", "0.01", "--json"], capsys)
    found = json.loads(printed)
    assert code == 0 and found["machine"]["processor"]
    assert len(found["results"]) >= 6
    assert all(0.0 < row["low"] <= row["median"] <= row["high"] for row in found["results"])


# Meshes -----------------------------------------------------------------------------------------------------------


def test_mesh_info_tells_what_is_in_a_file(box, capsys):
    code, printed, _ = run(["mesh", "info", box, "--json"], capsys)
    found = json.loads(printed)
    assert code == 0
    assert (found["n_points"], found["n_tetrahedra"]) == (36, 72)
    # A ball has V - E + F - T = 1.
    assert found["n_points"] - found["n_edges"] + found["n_faces"] - found["n_tetrahedra"] == 1
    assert found["regions"] == {"core": 2, "foot": 12}
    assert found["volume"] == pytest.approx(12e-6)
    assert found["stable_steps"]["backward_euler"] is None  # any
    assert sum(found["quality_histogram"]) == 72


def test_mesh_info_is_a_table_for_people(capsys):
    code, printed, _ = run(["mesh", "info", "liver"], capsys)
    assert code == 0
    assert "563, 2852, 4144, 1854" in printed and "(a sphere)" in printed and "backward_euler any" in printed


@pytest.mark.parametrize("ending", ["vtu", "msh", "mesh"])
def test_a_converted_mesh_is_the_same_mesh(ending, box, tmp_path, capsys):
    if ending == "mesh":
        pytest.importorskip("meshio")
    out = tmp_path / f"out.{ending}"
    code, _, warned = run(["mesh", "convert", box, out], capsys)
    before, after = read_mesh(box), read_mesh(out)
    assert code == 0
    assert np.array_equal(before.points, after.points)
    order, other = (np.lexsort(np.sort(mesh.tetrahedra, axis=1).T) for mesh in (before, after))
    assert np.array_equal(np.sort(before.tetrahedra[order], axis=1), np.sort(after.tetrahedra[other], axis=1))
    name = "ref_1" if ending == "mesh" else "core"
    assert np.array_equal(before.cell_regions["core"][order], after.cell_regions[name][other])
    assert ("warning: " in warned) == (ending == "mesh")
    if ending != "mesh":
        assert np.array_equal(before.point_regions["foot"], after.point_regions["foot"])


def test_what_a_format_cannot_hold_is_told(tmp_path, capsys):
    mesh = meshes.box((2, 1, 1))
    regions = {"all": np.ones(mesh.n_tetrahedra, bool), "one": np.arange(mesh.n_tetrahedra) == 3}
    write_mesh(tmp_path / "in.vtu", Mesh(mesh.points, mesh.tetrahedra, regions))
    code, _, warned = run(["mesh", "convert", tmp_path / "in.vtu", tmp_path / "out.msh"], capsys)
    assert code == 0 and "keeps the first of 1 more" in warned and warned.count("\n") == 1
    assert list(read_mesh(tmp_path / "out.msh").cell_regions) == ["all"]


# Simulations ------------------------------------------------------------------------------------------------------


def test_a_simulation_writes_a_series_that_shows_the_cut(box, tmp_path, capsys):
    out = tmp_path / "new" / "run.vtu"
    arguments = ["simulate", box, "--pin", "foot", "--cut", "core@0.02", "--remove", "x>0.02@0.03", "--seconds", 0.04]
    code, printed, _ = run([*arguments, "--frames", 4, "--out", out], capsys)
    assert code == 0 and "--cut core@0.02" in printed and str(out.with_suffix(".pvd")) in printed
    sets = ElementTree.parse(out.with_suffix(".pvd")).getroot().findall("Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in sets] == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04])
    frames = [read_mesh(out.parent / entry.get("file")) for entry in sets]
    assert [frame.n_tetrahedra for frame in frames] == [72, 72, 72, frames[3].n_tetrahedra, frames[3].n_tetrahedra]
    assert frames[3].n_tetrahedra < 72
    rows = list(csv.DictReader(out.with_suffix(".csv").open()))
    assert [int(row["n_pieces"]) for row in rows[:3]] == [1, 1, int(rows[2]["n_pieces"])]
    assert int(rows[2]["n_pieces"]) > 1 and int(rows[2]["n_nodes"]) > int(rows[1]["n_nodes"])


def test_the_numbers_of_a_simulation_are_those_of_the_body(box, tmp_path, capsys):
    arguments = ["simulate", box, "--pin", "z<0.001", "--seconds", 0, "--frames", 1, "--out", tmp_path / "run.vtu", "--json"]
    code, printed, _ = run(arguments, capsys)
    found = json.loads(printed)
    assert code == 0 and found["n_tetrahedra"] == 72 and found["kinetic_energy"] == 0.0
    # Weight times the height of the middle, 12 cm^3 of 1000 kg/m^3 at 1 cm.
    assert found["gravitational_energy"] == pytest.approx(12e-3 * 9.81 * 0.01)


def test_one_face_can_be_cut(box, tmp_path, capsys):
    mesh = read_mesh(box)
    from gmapspring import Material, Simulation

    body = Simulation(mesh, Material(5e3, 1000.0)).body
    one = int(np.argmax(body.gmap.image[:, 0] // 24 != np.arange(mesh.n_tetrahedra)))
    other = int(body.gmap.image[one, 0] // 24)
    arguments = ["simulate", box, "--cut", f"{one}-{other}", "--seconds", 0.001, "--frames", 1, "--out", tmp_path / "run.vtu"]
    code, printed, _ = run(arguments, capsys)
    assert code == 0 and f"--cut {one}-{other}: " in printed
    assert measure.components(body).max() == 0
