"""Parts of a mesh in a few letters: what they hold, and what is said of those that hold nothing."""

import numpy as np
import pytest

from gmapspring import ConfigError, Mesh, meshes
from gmapspring.selecting import select_points, select_tetrahedra


@pytest.fixture
def mesh():
    """Return a box of 2 x 1 x 1 m with a region of each kind."""
    box = meshes.box((2, 1, 1))
    return Mesh(box.points, box.tetrahedra, {"left": np.arange(box.n_tetrahedra) < 4}, {"foot": box.points[:, 2] == 0.0})


def test_a_region_a_half_space_and_numbers_are_parts(mesh):
    assert np.array_equal(select_tetrahedra(mesh, "left"), mesh.cell_regions["left"])
    assert np.flatnonzero(select_tetrahedra(mesh, "3,8")).tolist() == [3, 8]
    centroid = mesh.points[mesh.tetrahedra].mean(axis=1)
    assert np.array_equal(select_tetrahedra(mesh, "x>1"), centroid[:, 0] > 1.0)
    assert np.array_equal(select_points(mesh, "z<1e-3"), mesh.point_regions["foot"])
    assert np.array_equal(select_points(mesh, "foot"), mesh.point_regions["foot"])
    assert select_points(mesh, "y>-0.5").all()


@pytest.mark.parametrize(
    ("text", "words"),
    [("lfet", "did you mean 'left'"), ("foot", "names no tetrahedra"), ("z<-1", "holds no tetrahedra"),
     ("x<e", "no number behind <"), ("w<1", "names no tetrahedra"), ("999", "no 999 among 12 tetrahedra"),
     ("", "names no tetrahedra")],
)  # fmt: skip
def test_what_is_no_part_is_an_error_that_names_the_way_out(mesh, text, words):
    with pytest.raises(ConfigError, match=words):
        select_tetrahedra(mesh, text)


def test_what_is_selected_can_be_changed_without_changing_the_mesh(mesh):
    select_tetrahedra(mesh, "left")[:] = True
    assert mesh.cell_regions["left"].sum() == 4
