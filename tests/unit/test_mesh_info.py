"""What `mesh info` tells: quality, boundary and pieces, against shapes for which they are known."""

import numpy as np
import pytest

from gmapspring import Material, Mesh, Simulation, meshes
from gmapspring.mesh_info import describe, mean_ratios
from tests import zoo

TISSUE = Material(5e3, 1000.0)


def test_the_mean_ratio_is_1_for_a_regular_tetrahedron_and_falls_with_its_height():
    regular = np.array([[1.0, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
    assert mean_ratios(Mesh(regular, [[0, 1, 2, 3]])) == pytest.approx(1.0)
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    # V = 1/6, and the squared edges sum to 3 + 6.
    assert mean_ratios(Mesh(corner, [[0, 1, 2, 3]])) == pytest.approx(12.0 * 0.5 ** (2.0 / 3.0) / 9.0)
    flat = [mean_ratios(Mesh(corner * (1.0, 1.0, height), [[0, 1, 2, 3]]))[0] for height in (1.0, 0.1, 0.01)]
    assert flat[0] > flat[1] > flat[2] > 0.0


@pytest.mark.parametrize(
    ("name", "euler", "pieces", "pinched", "singular"),
    [("box", 2, 1, 0, 0), ("ball", 2, 1, 0, 0), ("fan", 2, 1, 0, 0), ("liver", 2, 1, 0, 0), ("torus", 0, 1, 0, 0),
     ("hollow_box", 4, 1, 0, 0), ("cubes_sharing_a_vertex", 4, 2, 1, 0), ("cubes_sharing_an_edge", 4, 2, 2, 0),
     ("pinched_block", 2, 1, 0, 1)],
)  # fmt: skip
def test_boundary_pieces_and_pinches_are_those_of_the_shape(name, euler, pieces, pinched, singular):
    info = describe(zoo.build(name), TISSUE, [])
    found = info.boundary_euler, info.n_components, info.n_pinched_points, info.n_singular_nodes
    assert found == (euler, pieces, pinched, singular)


@pytest.mark.parametrize("name", [name for name in zoo.MANIFOLD if not name.startswith("cubes")])
def test_the_boundary_of_a_manifold_has_twice_its_characteristic(name):
    info = describe(zoo.build(name), TISSUE, [])
    assert info.boundary_euler == 2 * (info.n_points - info.n_edges + info.n_faces - info.n_tetrahedra)


def test_a_crack_is_told_by_the_points_that_lie_on_both_of_its_sides():
    box = meshes.box((2, 1, 1))
    is_right = box.points[box.tetrahedra].mean(axis=1)[:, 0] > 1.0
    points, tetrahedra = box.points, box.tetrahedra.copy()
    # The right half takes points of its own.
    new = np.unique(tetrahedra[is_right])
    tetrahedra[is_right] = np.searchsorted(new, tetrahedra[is_right]) + len(points)
    used, back = np.unique(tetrahedra, return_inverse=True)
    cracked = Mesh(np.concatenate([points, points[new]])[used], back.reshape(-1, 4))
    whole, torn = (describe(mesh, TISSUE, []) for mesh in (box, cracked))
    assert (whole.n_coincident_points, whole.n_components) == (0, 1)
    # Four points of the middle, on either side.
    assert (torn.n_coincident_points, torn.n_components) == (8, 2)


def test_area_volume_memory_and_steps_are_those_of_the_body():
    mesh = meshes.box((2, 3, 1), spacing=0.5)
    info = describe(mesh, TISSUE, ["rk4", "symplectic_euler"])
    assert info.extent == pytest.approx((1.0, 1.5, 0.5)) and info.volume == pytest.approx(0.75)
    assert info.boundary_area == pytest.approx(2.0 * (1.0 * 1.5 + 1.0 * 0.5 + 1.5 * 0.5))
    assert info.stable_steps["rk4"] == Simulation(mesh, TISSUE).stable_step
    assert info.stable_steps["symplectic_euler"] < info.stable_steps["rk4"]
    assert sum(info.quality_histogram) == mesh.n_tetrahedra
    # The map alone holds an image, of four bytes at least, for each face.
    assert info.n_bytes > 4 * 4 * mesh.n_tetrahedra
