"""Meshes survive a round trip through files; foreign files are met half-way."""

import os
import sys
import warnings
from base64 import b64encode

import numpy as np
import pytest

from gmapspring import meshes
from gmapspring.errors import MeshError
from gmapspring.mesh_files import MeshWarning, read_mesh, write_mesh, write_vtu
from tests.mesh_texts import GMSH_2, marked_box, quietly, refusal, saved

CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]


@pytest.fixture
def marked():
    """Return a box with regions."""
    return marked_box()


def assert_same(first, second):
    """Assert that two meshes agree to the last bit, regions included."""
    assert np.array_equal(first.points, second.points) and np.array_equal(first.tetrahedra, second.tetrahedra)
    for name in ("cell_regions", "point_regions"):
        ours, theirs = getattr(first, name), getattr(second, name)
        assert ours.keys() == theirs.keys()
        assert all(np.array_equal(ours[region], theirs[region]) for region in ours)


def test_a_mesh_comes_back_from_its_file_to_the_last_bit(marked, tmp_path):
    write_mesh(tmp_path / "mesh.vtu", marked)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_same(read_mesh(str(tmp_path / "mesh.vtu")), marked)


def test_a_written_mesh_and_its_fields_are_read_by_others(tmp_path):
    """meshio stands for ParaView here: both follow VTK's format."""
    meshio = pytest.importorskip("meshio")
    mesh = meshes.box((2, 2, 1), 0.1)
    velocity, load = np.random.default_rng(0).normal(size=(18, 3)), np.arange(18, dtype=np.int16)
    on_cells = {"strain": np.arange(24, dtype=np.float32), "alive": np.arange(24) > 5, "id": np.arange(24, dtype=np.uint64)}
    write_mesh(tmp_path / "mesh.vtu", mesh, {"velocity": velocity, "load": load}, on_cells)
    theirs = meshio.read(tmp_path / "mesh.vtu")
    assert np.array_equal(theirs.points, mesh.points)
    assert [block.type for block in theirs.cells] == ["tetra"]
    assert np.array_equal(theirs.cells[0].data, mesh.tetrahedra)
    assert np.array_equal(theirs.point_data["velocity"], velocity)
    assert np.array_equal(theirs.point_data["load"], load)
    assert theirs.cell_data["strain"][0].dtype == np.float32
    for name, values in on_cells.items():
        assert np.array_equal(theirs.cell_data[name][0], values)


def test_a_body_with_no_tetrahedra_left_can_be_written(tmp_path):
    write_vtu(tmp_path / "bare.vtu", np.zeros((2, 3)), np.zeros((0, 4), dtype=int), {"mass": [1.0, 2.0]}, {"strain": []})
    assert "no linear tetrahedra" in refusal(tmp_path / "bare.vtu")


def test_a_cut_body_with_split_nodes_can_be_written(tmp_path):
    points = np.array([*CORNERS, *CORNERS[1:4]], dtype=float)
    write_vtu(tmp_path / "cut.vtu", points, [(0, 1, 2, 3), (5, 6, 7, 4)], {"mass": np.ones(8)}, {"volume": [1, 2]})
    assert read_mesh(tmp_path / "cut.vtu").n_points == 8


def test_a_failed_write_leaves_the_old_file_and_nothing_else(marked, tmp_path, monkeypatch):
    write_mesh(tmp_path / "mesh.vtu", marked)

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(MeshError, match="No space left"):
        write_mesh(tmp_path / "mesh.vtu", meshes.single())
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.vtu"]
    assert_same(read_mesh(tmp_path / "mesh.vtu"), marked)


@pytest.mark.parametrize(
    ("name", "fields", "reason"),
    [
        ("mesh.vtk", {}, "ends in .vtu"),
        ("no/such/folder/mesh.vtu", {}, "there is no folder .*/no/such/folder$"),
        ("mesh.vtu", {"point_data": {"mass": np.ones(3)}}, r"point_data\['mass'\] has dtype float64 and shape \(3,\)"),
        ("mesh.vtu", {"cell_data": {"strain": np.ones((4, 1))}}, r"cell_data\['strain'\]"),
        ("mesh.vtu", {"cell_data": {"name": ["lump"]}}, "give numbers"),
        ("mesh.vtu", {"cell_data": {"stress": np.ones((1, 3, 3))}}, "give numbers"),
        ("mesh.vtu", {"cell_data": {"mass": 1.0}}, "give numbers"),
        ("mesh.vtu", {"cell_data": {"": [1.0]}}, "non-empty"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, name, fields, reason):
    with pytest.raises(MeshError, match=reason):
        write_mesh(tmp_path / name, meshes.single(), **fields)
    assert not list(tmp_path.iterdir())


def test_a_field_must_not_hide_a_region(marked, tmp_path):
    with pytest.raises(MeshError, match="rename the field"):
        write_mesh(tmp_path / "mesh.vtu", marked, cell_data={"region:none": np.ones(24)})


def test_gmsh_format_1_is_read_and_repaired(tmp_path):
    with pytest.warns(MeshWarning) as caught:
        mesh = read_mesh(saved(tmp_path, "gmsh 1"))
    message = str(caught[0].message)
    assert "dropped 1 points" in message and "turned 1 tetrahedra" in message
    assert caught[0].filename == __file__
    assert np.array_equal(mesh.points, CORNERS)
    assert mesh.tetrahedra.tolist() == [[0, 1, 2, 3], [2, 1, 4, 3]]
    assert mesh.volumes == pytest.approx([1 / 6, 2 / 6])
    assert {name: mask.tolist() for name, mask in mesh.cell_regions.items()} == {"physical_7": [True, False]}


@pytest.mark.parametrize("kind", ["gmsh 2", "gmsh 4"])
def test_physical_groups_of_gmsh_become_regions(tmp_path, kind):
    mesh = read_mesh(saved(tmp_path, kind))
    assert np.array_equal(mesh.points, CORNERS)
    assert mesh.tetrahedra.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
    regions = {name: mask.tolist() for name, mask in mesh.cell_regions.items()}
    assert regions == {"whole organ": [True, True], "tumour": [False, True]}
    assert {name: mask.tolist() for name, mask in mesh.point_regions.items()} == {"wall": [True] * 3 + [False] * 2}


def test_a_legacy_vtk_file_is_read_with_its_regions(tmp_path):
    mesh = read_mesh(saved(tmp_path, "vtk"))
    assert np.array_equal(mesh.points, CORNERS)
    assert mesh.tetrahedra.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
    assert mesh.cell_regions["tumour"].tolist() == [False, True]
    assert mesh.point_regions["top"].tolist() == [False] * 3 + [True] * 2


def test_a_medit_file_is_read_with_its_references(tmp_path):
    pytest.importorskip("meshio")
    mesh = read_mesh(saved(tmp_path, "medit"))
    assert mesh.tetrahedra.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
    assert {name: mask.tolist() for name, mask in mesh.cell_regions.items()} == {"ref_6": [False, True]}


@pytest.mark.parametrize(
    ("ending", "file_format", "options"),
    [
        (".msh", "gmsh22", {"binary": True}),
        (".msh", "gmsh22", {"binary": False}),
        (".msh", "gmsh", {"binary": True}),
        (".msh", "gmsh", {"binary": False}),
        (".vtk", "vtk42", {"binary": True}),
        (".vtk", "vtk42", {"binary": False}),
        (".vtk", "vtk51", {"binary": True}),
        (".vtk", "vtk51", {"binary": False}),
        (".vtu", "vtu", {"compression": None}),
        (".vtu", "vtu", {"compression": "zlib"}),
        (".vtu", "vtu", {"compression": "lzma"}),
        (".vtu", "vtu", {"binary": False}),
        (".mesh", "medit", {}),
    ],
)
def test_what_meshio_writes_is_read(marked, tmp_path, ending, file_format, options):
    meshio = pytest.importorskip("meshio")
    cells = [("triangle", marked.tetrahedra[:5, :3]), ("tetra", marked.tetrahedra)]
    # meshio writes gmsh 4.1 files of one kind of cell only.
    theirs = meshio.Mesh(marked.points, cells[1:] if file_format == "gmsh" else cells)
    if ending in (".vtk", ".vtu"):
        lump = marked.cell_regions["lump & <rest>"]
        theirs.cell_data = {"region:lump": [np.ones(5, np.int32), lump.astype(np.int32)], "strain": [np.ones(5), np.ones(24)]}
        theirs.point_data = {"region:top": marked.point_regions["höhe"].astype(float), "velocity": np.ones((18, 3))}
    meshio.write(tmp_path / f"mesh{ending}", theirs, file_format=file_format, **options)
    mesh = read_mesh(tmp_path / f"mesh{ending}")
    # In text, meshio writes 12 digits.
    assert mesh.points == pytest.approx(marked.points, abs=1e-12)
    assert np.array_equal(mesh.tetrahedra, marked.tetrahedra)
    if theirs.cell_data and ending in (".vtk", ".vtu"):
        assert np.array_equal(mesh.cell_regions["lump"], lump)
        assert np.array_equal(mesh.point_regions["top"], marked.point_regions["höhe"])


@pytest.mark.parametrize("is_raw", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_appended_vtu_data_are_read(tmp_path, is_raw, order):
    """ParaView's own choice: all arrays after the tree, as raw bytes or base64."""
    arrays = [np.array(CORNERS, f"{order}f4"), np.array([0, 1, 2, 3, 1, 2, 3, 4], f"{order}i8"),
              np.array([4, 8], f"{order}i8"), np.array([10, 10], "u1"), np.array([0, 1], "u1")]  # fmt: skip
    stored, offsets = b"", []
    for array in arrays:
        offsets.append(len(stored))
        content = np.array(array.nbytes, f"{order}u4").tobytes() + array.tobytes()
        stored += content if is_raw else b64encode(content)

    def element(name, kind, place, width=1):
        size = f'NumberOfComponents="{width}" format="appended" offset="{offsets[place]}"'
        return f'<DataArray type="{kind}" Name="{name}" {size}/>'

    head = f"""<VTKFile type="UnstructuredGrid" byte_order="{"LittleEndian" if order == "<" else "BigEndian"}">
        <UnstructuredGrid><Piece NumberOfPoints="5" NumberOfCells="2"><Points>{element("Points", "Float32", 0, 3)}</Points>
        <Cells>{element("connectivity", "Int64", 1)}{element("offsets", "Int64", 2)}{element("types", "UInt8", 3)}</Cells>
        <CellData>{element("region:lump", "UInt8", 4)}</CellData></Piece></UnstructuredGrid>
        <AppendedData encoding="{"raw" if is_raw else "base64"}">\n_"""
    (tmp_path / "mesh.vtu").write_bytes(head.encode() + stored + b"\n</AppendedData></VTKFile>")
    mesh = read_mesh(tmp_path / "mesh.vtu")
    assert np.array_equal(mesh.points, CORNERS) and mesh.tetrahedra.tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
    assert mesh.cell_regions["lump"].tolist() == [False, True]


def test_other_solids_are_ignored_aloud(tmp_path):
    text = GMSH_2.replace("5 15 0 1\n", "5 7 0 1 2 30 4 5\n")
    (tmp_path / "mesh.msh").write_text(text)
    with pytest.warns(MeshWarning, match="not linear tetrahedra: 1 pyramids"):
        assert read_mesh(tmp_path / "mesh.msh").n_tetrahedra == 2


@pytest.mark.parametrize("kind", ["gmsh 1", "gmsh 2", "gmsh 4", "vtk"])
def test_all_other_formats_need_no_meshio(tmp_path, monkeypatch, kind):
    monkeypatch.setitem(sys.modules, "meshio", None)
    assert quietly(saved(tmp_path, kind)).n_tetrahedra == 2
    assert meshes.liver().n_tetrahedra > 1800
