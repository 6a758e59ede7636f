"""The map against Regina, a topology package that nobody here wrote: cells, boundary and links after every operation."""

import itertools

import numpy as np
import pytest

from gmapspring.topology import gmap as maps
from tests import zoo
from tests.naive import EDGES, same_partition
from tests.twins import Twins

regina = pytest.importorskip("regina", reason="regina is not installed (extra dev); it is the outside oracle")

N_OPERATIONS = {"liver": 4, "ball": 6, "hollow_box": 8}
"""Fewer on large meshes, to save time; elsewhere 20."""


class Triangulation:
    """Regina's view of the same tetrahedra and gluings, as labelings over tetrahedron corners, edges and so on."""

    def __init__(self, tetrahedra, alive, glued_sides):
        self.n, self.alive = len(tetrahedra), sorted(alive)
        self.oracle = regina.Triangulation3()
        self.simplices = {tet: self.oracle.newTetrahedron() for tet in self.alive}
        for (tet, face), (other, opposite) in glued_sides:
            at = {point: corner for corner, point in enumerate(tetrahedra[other])}
            images = [opposite if i == face else at[tetrahedra[tet][i]] for i in range(4)]
            self.simplices[tet].join(face, self.simplices[other], regina.Perm4(*images))

    def labels(self, width, cell_at):
        """Lay out the index of the cell at every local place, -1 where removed."""
        labels = np.full((self.n, width), -1)
        for tet, simplex in self.simplices.items():
            labels[tet] = [cell_at(simplex, local).index() for local in range(width)]
        return labels

    def vertex_labels(self):
        """Return the vertex of every corner (n, 4)."""
        return self.labels(4, lambda simplex, corner: simplex.vertex(corner))

    def edge_labels(self):
        """Return the edge of every tetrahedron edge (n, 6)."""
        return self.labels(6, lambda simplex, edge: simplex.edge(*EDGES[edge]))

    def face_labels(self):
        """Return the triangle of every tetrahedron face (n, 4)."""
        return self.labels(4, lambda simplex, face: simplex.triangle(face))

    def component_labels(self):
        """Return the component of every tetrahedron (n,)."""
        return self.labels(1, lambda simplex, _: simplex.component())[:, 0]

    def vertex_facts(self):
        """Return, per vertex: is it on the boundary, chi of its link, is the link neither a sphere nor a disc."""
        plain = (regina.Vertex3.SPHERE, regina.Vertex3.DISC)
        return [
            (vertex.isBoundary(), vertex.linkEulerChar(), vertex.linkType() not in plain)
            for vertex in self.oracle.vertices()
        ]


def regina_view(naive):
    """Build Regina's triangulation from nothing but the mesh and the faces that are glued."""
    sides = [(a, b) for a, b in naive.interior_faces if a in naive.sewn]
    return Triangulation(naive.tetrahedra, naive.alive, sides)


def assert_agreement(sim, view):
    """Check every count and every cell of the fast body against Regina."""
    body, oracle = sim.body, view.oracle
    assert body.n_nodes == oracle.countVertices()
    assert body.n_springs == oracle.countEdges()
    assert len(np.unique(body.face_of[body.face_of >= 0])) == oracle.countTriangles()
    assert len(np.unique(sim.components()[body.is_alive])) == oracle.countComponents()
    assert len(maps.boundary_faces(body.gmap)) == oracle.countBoundaryTriangles()
    assert same_partition(body.vertex_of, view.vertex_labels())
    assert same_partition(body.edge_of, view.edge_labels())
    assert same_partition(body.face_of, view.face_labels())
    assert same_partition(sim.components(), view.component_labels())
    assert_boundary_and_links_agree(body, view)


def assert_boundary_and_links_agree(body, view):
    """Check which vertices and edges lie on the boundary, and the link of every vertex."""
    vertices, edges = view.vertex_labels(), view.edge_labels()
    facts = view.vertex_facts()
    boundary = set(maps.boundary_vertices(body.gmap).tolist())
    singular = set(maps.singular_vertices(body.gmap).tolist())
    chi = maps.link_characteristic(body.gmap)
    for place in itertools.product(view.alive, range(4)):
        node = int(body.vertex_of[place])
        assert facts[vertices[place]] == (node in boundary or node in singular, chi[node], node in singular)
    boundary_edges = set(maps.boundary_edges(body.gmap).tolist())
    for place in itertools.product(view.alive, range(6)):
        assert view.oracle.edge(int(edges[place])).isBoundary() == (int(body.edge_of[place]) in boundary_edges)


@pytest.mark.parametrize("name", zoo.ALL)
def test_the_map_equals_regina_after_every_operation(name):
    twins, rng = Twins(zoo.build(name), seed=1), np.random.default_rng(2)
    assert_agreement(twins.sim, regina_view(twins.naive))
    for _ in range(N_OPERATIONS.get(name, 20)):
        if twins.random_operation(rng):
            assert_agreement(twins.sim, regina_view(twins.naive))


def test_the_comparison_with_regina_can_fail():
    twins = Twins(zoo.build("two"))
    twins.naive.split_face(0, 1)
    with pytest.raises(AssertionError):
        assert_agreement(twins.sim, regina_view(twins.naive))
