"""One body twice, fast and naive, driven by the same operations, and what it means that they agree."""

import numpy as np

import gmapspring as gs
from gmapspring.topology import gmap as maps
from tests import naive_links, naive_mechanics
from tests.naive import EDGES, NaiveBody, same_partition


def varied_material(n_tets, rng, has_all_terms=True):
    """Return a material in which every tetrahedron differs in every property; with or without damping and drag."""
    return gs.Material(
        young_modulus=rng.uniform(4e3, 8e3, n_tets),
        density=rng.uniform(900.0, 1100.0, n_tets),
        damping=rng.uniform(0.5e-3, 1e-3, n_tets) * has_all_terms,
        viscosity=rng.uniform(0.05, 0.1, n_tets) * has_all_terms,
    )


class Twins:
    """A simulation and its naive double: the same mesh, material, pins, weight, and stretched moving state."""

    def __init__(self, mesh, seed=0, pinned_share=0.1, has_all_terms=True, **options):
        rng = np.random.default_rng(seed)
        self.mesh = mesh
        self.material = varied_material(mesh.n_tetrahedra, rng, has_all_terms)
        pinned = rng.uniform(size=mesh.n_points) < pinned_share
        loads = rng.uniform(-1.0, 1.0, (mesh.n_tetrahedra, 4, 3)) * has_all_terms
        gravity = np.array([0.3, -0.2, -9.81]) * has_all_terms
        self.sim = gs.Simulation(mesh, self.material, pinned=pinned, gravity=gravity, **options)
        if has_all_terms:
            self.sim.set_corner_loads(loads)
        self.naive = NaiveBody(mesh, self.material, pinned, gravity, loads)
        self.stir(rng)

    def stir(self, rng):
        """Stretch and throw the body: random displacements and velocities, one for each node."""
        nodes = self.sim.body.nodes
        nodes.position[:] += 0.05 * mean_edge_length(self.mesh) * rng.uniform(-1.0, 1.0, nodes.position.shape)
        nodes.velocity[:] = np.where(nodes.is_pinned[:, None], 0.0, rng.uniform(-1.0, 1.0, nodes.velocity.shape))
        self.copy_state()

    def copy_state(self):
        """Give the naive body the positions and velocities of the fast one."""
        body = self.sim.body
        for corner, node in np.ndenumerate(body.vertex_of):
            if node >= 0:
                self.naive.position[corner] = body.nodes.position[node].astype(float)
                self.naive.velocity[corner] = body.nodes.velocity[node].astype(float)

    def split_face(self, tet, other):
        """Split a face of both bodies and return the report of the fast one."""
        return self._do("split_face", tet, other)

    def remove_tetrahedron(self, tet):
        """Remove a tetrahedron of both bodies and return the report of the fast one."""
        return self._do("remove_tetrahedron", tet)

    def sew_face(self, tet, other):
        """Sew a face of both bodies and return the report of the fast one."""
        return self._do("sew_face", tet, other)

    def cut(self, faces=(), tetrahedra=()):
        """Cut a batch out of both bodies and return the report of the fast one."""
        return self._do("cut", faces, tetrahedra)

    def _do(self, operation, *arguments):
        before, boundary = Before(self.sim), self.naive.boundary_faces()
        report = getattr(self.sim, operation)(*arguments)
        getattr(self.naive, operation)(*arguments)
        opened = self.naive.boundary_faces() - boundary
        assert sorted(map(tuple, report.boundary_faces.tolist())) == sorted(opened)
        before.assert_report_leads_to(self.sim, report)
        return report

    def set_loads(self, rng):
        """Put other loads on the corners of both bodies."""
        loads = rng.uniform(-1.0, 1.0, (self.mesh.n_tetrahedra, 4, 3))
        self.sim.set_corner_loads(loads)
        self.naive.load = {corner: loads[corner].copy() for corner in np.ndindex(loads.shape[:2])}

    def advance(self, n_steps):
        """Advance both by some steps of a fifth of the stable step, or of what symplectic Euler could take."""
        step = 0.2 * self.sim.stable_step
        if np.isinf(step):
            step = 0.2 * gs.stability.stable_step(self.sim.body, gs.simulation.INTEGRATORS["symplectic_euler"])
        before = self.sim.n_substeps
        self.sim.advance(n_steps * step, step=step)
        assert self.sim.n_substeps - before == n_steps
        naive_mechanics.advance(self.naive, self.sim.integrator.name, step, n_steps)

    def random_operation(self, rng, kinds=("split", "split", "remove", "sew", "batch")):
        """Do one operation of a kind drawn at random; return its name, or None where nothing of that kind is left."""
        kind = str(rng.choice(kinds))
        sewn, cut, alive = self.naive.sewn_faces(), self.naive.open_faces(), sorted(self.naive.alive)
        if kind == "split" and sewn:
            self.split_face(*sewn[rng.integers(len(sewn))])
        elif kind == "remove" and len(alive) > 1:
            self.remove_tetrahedron(alive[rng.integers(len(alive))])
        elif kind == "sew" and cut:
            self.sew_face(*cut[rng.integers(len(cut))])
        elif kind == "batch" and sewn and len(alive) > 2:
            faces = rng.permutation(sewn)[: rng.integers(1, 6)].tolist()
            self.cut(faces, rng.permutation(alive)[: rng.integers(0, min(4, len(alive) - 1))].tolist())
        else:
            return None
        return kind

    def assert_agreement(self, precision=1e-12):
        """Check that both bodies have the same cells and the same mechanics, and that the fast one finds itself valid."""
        self.sim.check_validity()
        assert_same_topology(self.sim, self.naive)
        assert_same_mechanics(self.sim, self.naive, precision)


class Before:
    """What numbers a body had, to see that a report tells truly what became of them."""

    def __init__(self, sim):
        body = sim.body
        self.rows = {"nodes": body.n_nodes, "springs": body.n_springs}
        self.cells = {"nodes": body.vertex_of.copy(), "springs": body.edge_of.copy()}
        self.labels = set(body.gmap.component_of[body.is_alive].tolist())
        self.is_alive = body.is_alive.copy()

    def assert_report_leads_to(self, sim, report):
        """Check a report as its user would: arrays of one's own that follow it stay with their nodes and springs."""
        body = sim.body
        now = {"nodes": (body.n_nodes, body.vertex_of), "springs": (body.n_springs, body.edge_of)}
        for kind, (n_rows, cells) in now.items():
            new, moved, n_gone = (getattr(report, name.format(kind)) for name in ("new_{}", "moved_{}", "n_removed_{}"))
            assert n_rows == self.rows[kind] + len(new) - n_gone
            own = np.full(max(n_rows, self.rows[kind]), -1)
            own[: self.rows[kind]] = np.arange(self.rows[kind])
            for origin, target in moved.tolist():
                own[target] = own[origin]
            for kept, made in new.tolist():
                own[made] = own[kept]
            self._assert_follows(own, self.cells[kind][body.is_alive], cells[body.is_alive])
        gone = np.flatnonzero(self.is_alive & ~body.is_alive)
        np.testing.assert_array_equal(report.removed_tetrahedra, gone)
        labels = set(body.gmap.component_of[body.is_alive].tolist())
        assert set(report.new_components.tolist()) == labels - self.labels

    @staticmethod
    def _assert_follows(own, old, new):
        """Check that each row holds the old number of its cell; where cells were merged, that of one of them."""
        is_same = own[new] == old
        for cell in np.unique(new[~is_same]).tolist():
            assert own[cell] in old[new == cell], f"row {cell} holds what belonged to row {own[cell]}"


def mean_edge_length(mesh):
    """Return the mean length [m] of the edges 01 of a mesh."""
    corners = mesh.points[mesh.tetrahedra]
    return float(np.mean(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))


def at_corners(body, rows):
    """Spread node rows over tetrahedron corners (n, 4, ...), NaN where removed."""
    spread = np.asarray(rows, dtype=float)[body.vertex_of]
    spread[body.vertex_of < 0] = np.nan
    return spread


def at_edges(body, rows):
    """Spread spring rows over tetrahedron edges (n, 6, ...), NaN where removed."""
    spread = np.asarray(rows, dtype=float)[body.edge_of]
    spread[body.edge_of < 0] = np.nan
    return spread


def assert_rows_are_compact(cell_of, n_rows):
    """Check that the rows in use are exactly 0 to n_rows - 1."""
    np.testing.assert_array_equal(np.unique(cell_of[cell_of >= 0]), np.arange(n_rows))


def assert_same_topology(sim, naive):
    """Check cells of every dimension, the boundary and the vertex links."""
    body = sim.body
    assert same_partition(body.vertex_of, naive.vertex_labels())
    assert same_partition(body.edge_of, naive.edge_labels())
    assert same_partition(sim.components(), naive.component_labels())
    np.testing.assert_array_equal(body.face_of, naive.face_labels())
    assert_rows_are_compact(body.vertex_of, body.n_nodes)
    assert_rows_are_compact(body.edge_of, body.n_springs)
    assert {tuple(side) for side in maps.boundary_faces(body.gmap).tolist()} == naive.boundary_faces()
    link = body.gmap.link[body.vertex_of]
    link[body.vertex_of < 0] = -1
    np.testing.assert_array_equal(link, naive_links.link_counts(naive))
    singular = naive_links.singular_nodes(naive)
    assert set(maps.singular_vertices(body.gmap).tolist()) == {int(body.vertex_of[c]) for c in singular}


def or_zeros(rows, n):
    """Return rows, or zeros where a term that nothing names has no rows."""
    return rows if len(rows) else np.zeros((n, *rows.shape[1:]))


def assert_same_mechanics(sim, naive, precision=1e-12):
    """Check masses, stiffness and all else that tetrahedra share out, the state, and where each spring ends."""
    body, nodes, springs = sim.body, sim.body.nodes, sim.body.springs
    pairs = {
        "mass": (at_corners(body, nodes.mass), naive_mechanics.node_mass(naive)),
        "viscosity": (at_corners(body, or_zeros(nodes.viscosity, body.n_nodes)), naive_mechanics.node_viscosity(naive)),
        "stiffness": (at_edges(body, springs.stiffness), naive_mechanics.spring_stiffness(naive)),
        "damping": (at_edges(body, or_zeros(springs.damping, body.n_springs)), naive_mechanics.spring_damping(naive)),
        "rest length": (at_edges(body, springs.rest_length), naive_mechanics.rest_length(naive)),
    }
    for name, (found, expected) in pairs.items():
        np.testing.assert_allclose(found, expected, rtol=precision, atol=0.0, err_msg=name)
    external = at_corners(body, or_zeros(nodes.external, body.n_nodes)[:, :3])
    # What has a sign is compared on the scale of its largest entry.
    vectors = {
        "external": (external, naive_mechanics.node_load(naive)),
        "position": (at_corners(body, nodes.position), naive_mechanics.corner_array(naive, naive.position)),
        "velocity": (at_corners(body, nodes.velocity), naive_mechanics.corner_array(naive, naive.velocity)),
    }
    for name, (found, expected) in vectors.items():
        scale = np.nanmax(np.abs(expected), initial=0.0)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=precision * scale, err_msg=name)
    pinned = naive_mechanics.corner_array(naive, naive.is_pinned)
    np.testing.assert_array_equal(at_corners(body, nodes.is_pinned), pinned)
    points = np.where(body.vertex_of < 0, np.nan, np.array(naive.tetrahedra))
    np.testing.assert_array_equal(at_corners(body, nodes.point), points)
    assert_springs_end_at_their_edges(body)


def assert_springs_end_at_their_edges(body):
    """Check the two nodes of the spring at every tetrahedron edge."""
    edges = np.array(EDGES)
    found = np.sort(body.springs.endpoints[body.edge_of[body.is_alive]], axis=-1)
    np.testing.assert_array_equal(found, np.sort(body.vertex_of[body.is_alive][:, edges], axis=-1))
