"""Files that are no meshes, or damaged or faulty ones, are refused with the reason, and nothing else ever comes of them."""

import sys

import numpy as np
import pytest

from gmapspring.errors import MeshError
from gmapspring.mesh_files import write_mesh
from tests.mesh_texts import GMSH_2, MEDIT, TEXTS, marked_box, quietly, refusal, saved


@pytest.fixture
def marked():
    """Return a box with regions."""
    return marked_box()


def test_a_mesh_with_no_tetrahedra_is_refused_with_what_it_has(tmp_path):
    path = tmp_path / "surface.msh"
    text = GMSH_2.replace("2 4 2 7 1 1 2 30 4", "2 2 2 7 1 1 2 30")
    path.write_text(text.replace("\n3 4 3", "\n3 3 3").replace("\n4 4", "\n4 3"))
    assert "no linear tetrahedra in it (no solid cells)" in refusal(path)


@pytest.mark.parametrize("ending", [".msh", ".vtk", ".vtu", ".mesh"])
def test_files_that_are_no_meshes_are_refused(tmp_path, ending):
    path = tmp_path / f"mesh{ending}"
    assert "No such file" in refusal(path)
    path.mkdir()
    assert "Is a directory" in refusal(path)
    path.rmdir()
    path.write_bytes(b"")
    assert "empty" in refusal(path)
    for content in (b"\n", b"hello\n", np.random.default_rng(1).bytes(5000), b"\x00" * 100, "é".encode("latin-1")):
        path.write_bytes(content)
        refusal(path)


@pytest.mark.parametrize("name", ["mesh.stl", "mesh", "mesh.vtu.gz"])
def test_other_endings_are_refused(tmp_path, name):
    (tmp_path / name).write_text(MEDIT)
    assert ".msh, .vtu, .vtk, .mesh" in refusal(tmp_path / name)


@pytest.mark.parametrize("kind", [*TEXTS, "vtu"])
def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path, marked, kind):
    """Cut after the last number that counts, it may still be read, but then as the whole mesh."""
    if kind == "medit":
        pytest.importorskip("meshio")
    if kind == "vtu":
        path = tmp_path / "mesh.vtu"
        write_mesh(path, marked)
    else:
        path = saved(tmp_path, kind)
    whole, content = quietly(path), path.read_bytes()
    n_refused = 0
    ends = range(0, len(content), 1 + len(content) // 300)
    for end in ends:
        path.write_bytes(content[:end])
        try:
            mesh = quietly(path)
        except MeshError:
            n_refused += 1
        else:
            assert np.array_equal(mesh.tetrahedra, whole.tetrahedra)
    # A legacy VTK file names no end: cut before its fields, it is a smaller but sound file.
    assert n_refused > (0.6 if kind == "vtk" else 0.95) * len(ends)


@pytest.mark.parametrize("kind", [*TEXTS, "gmsh 2 binary", "gmsh 4 binary", "vtk binary", "vtu"])
def test_a_damaged_file_never_raises_anything_else(tmp_path, marked, kind):
    """Whatever bytes are changed, the outcome is a mesh or a `MeshError`."""
    rng = np.random.default_rng(7)
    if "binary" in kind or kind == "medit":
        meshio = pytest.importorskip("meshio")
    if "binary" in kind:
        file_format = {"gmsh 2 binary": "gmsh22", "gmsh 4 binary": "gmsh", "vtk binary": "vtk42"}[kind]
        path = tmp_path / ("mesh.vtk" if "vtk" in kind else "mesh.msh")
        meshio.write(path, meshio.Mesh(marked.points, [("tetra", marked.tetrahedra)]), file_format=file_format, binary=True)
    elif kind == "vtu":
        path = tmp_path / "mesh.vtu"
        write_mesh(path, marked)
    else:
        path = saved(tmp_path, kind)
    content = np.frombuffer(path.read_bytes(), np.uint8)
    for _ in range(60):
        damaged = content.copy()
        damaged[rng.integers(len(content), size=rng.integers(1, 4))] = rng.integers(256)
        path.write_bytes(damaged.tobytes())
        try:
            quietly(path)
        except MeshError as error:
            assert str(path) in str(error)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("\n30 0 1 0", "\n2 0 1 0", "two nodes have the number 2"),
        ("1 2 30 4\n3", "1 2 31 4\n3", "refers to node 31"),
        ("1 2 30 4\n3", "1 2 30\n3", "has 3 nodes; it needs 4"),
        ("2 4 2 7", "2 99 2 7", "kind 99"),
        ("$Elements\n5", "$Elements\n6", "announces 6 elements and has 5"),
        ("$Nodes\n5", "$Nodes\n6", "ends too early"),
        ("2.2 0 8", "4.0 0 8", "format 4.0 is not supported"),
        ("30 0 1 0", "30 0 nan 0", "point 2 is not finite"),
        ("30 0 1 0", "30 0 1 0 0", "not `number x y z`"),
        ("30 0 1 0", "30.5 0 1 0", "not `number x y z`"),
        ("$Nodes\n5", "$Nodes\n5.5", "must be whole"),
        ("4 4 2 8 1 2 30 4 5", "4 4 2 7 1 2 30 4 5", "on the same nodes"),
        ("5 1 1 1", "5 1 0 0", "tetrahedron 1 (corners [1, 2, 3, 4]) is flat"),
    ],
)
def test_a_faulty_gmsh_file_is_refused_with_its_fault(tmp_path, old, new, reason):
    assert old in GMSH_2
    path = tmp_path / "mesh.msh"
    path.write_text(GMSH_2.replace(old, new, 1))
    assert reason in refusal(path)


def test_a_medit_file_without_meshio_names_the_way_out(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    assert "pip install gmapspring[mesh]" in refusal(saved(tmp_path, "medit"))


def test_meshio_cannot_end_the_process(tmp_path, monkeypatch):
    meshio = pytest.importorskip("meshio")

    def end(*_, **__):
        print("Error: no such thing", file=sys.stderr)
        sys.exit(1)

    monkeypatch.setattr(meshio, "read", end)
    assert "Error: no such thing" in refusal(saved(tmp_path, "medit"))
