"""The slow, obvious oracle: a body as dictionaries, every cell found anew by union-find over the sewn faces.

Nothing here is shared with the package. State is kept per tetrahedron corner, so a split copies nothing and moves
nothing: corners simply stop being joined. Whatever the body answers is an array over tetrahedron corners (n, 4) or
tetrahedron edges (n, 6), so that it can be compared with any other numbering of nodes and springs.
"""

import copy
import itertools
from collections import defaultdict

import numpy as np

EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


class Forest:
    """Union-find over any hashable things."""

    def __init__(self, things):
        self.parent = {thing: thing for thing in things}

    def find(self, thing):
        """Return the root of a thing, shortening the way there."""
        while self.parent[thing] != thing:
            self.parent[thing] = self.parent[self.parent[thing]]
            thing = self.parent[thing]
        return thing

    def join(self, one, other):
        """Put two things into the same set; the lower root stays root."""
        low, high = sorted((self.find(one), self.find(other)))
        self.parent[high] = low


def same_partition(one, other):
    """Tell whether two integer labelings (-1: absent) group the same entries, up to renumbering."""
    one, other = np.ravel(one).tolist(), np.ravel(other).tolist()
    if len(one) != len(other) or any((a < 0) != (b < 0) for a, b in zip(one, other, strict=True)):
        return False
    pairs = {(a, b) for a, b in zip(one, other, strict=True) if a >= 0}
    return len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})


def values_per_tetrahedron(value, n):
    """Spread a scalar over all tetrahedra, or copy what is already one value for each."""
    return np.array(np.broadcast_to(np.asarray(value, dtype=float), (n,)))


def weighted_mean(one, other, weights):
    """Return the weighted mean of two vectors; entries that are equal keep their bits."""
    mean = (weights[0] * one + weights[1] * other) / (weights[0] + weights[1])
    return np.where(one == other, one, mean)


class NaiveBody:
    """A mass/spring body on tetrahedra of which some faces are sewn."""

    def __init__(self, mesh, material, pinned=None, gravity=(0.0, 0.0, 0.0), corner_loads=None):
        self.points = np.array(mesh.points, dtype=float)
        self.tetrahedra = [tuple(int(p) for p in row) for row in mesh.tetrahedra]
        self.n = len(self.tetrahedra)
        self.gravity = np.array(gravity, dtype=float)
        self._set_material(material)
        self.partner = self._match_faces()
        self.interior_faces = sorted((a, b) for a, b in self.partner.items() if a < b)
        self.gluings = self._match_corners()
        self.alive = set(range(self.n))
        self.sewn = set(self.partner)
        corners = list(itertools.product(range(self.n), range(4)))
        pinned = np.zeros(len(self.points), dtype=bool) if pinned is None else np.asarray(pinned)
        loads = np.zeros((self.n, 4, 3)) if corner_loads is None else np.asarray(corner_loads, dtype=float)
        self.position = {(t, i): self.points[self.tetrahedra[t][i]].copy() for t, i in corners}
        self.velocity = {corner: np.zeros(3) for corner in corners}
        self.is_pinned = {(t, i): bool(pinned[self.tetrahedra[t][i]]) for t, i in corners}
        self.load = {(t, i): loads[t, i].copy() for t, i in corners}

    def _set_material(self, material):
        modulus = values_per_tetrahedron(material.young_modulus, self.n)
        density = values_per_tetrahedron(material.density, self.n)
        volume = np.array([self._volume(t) for t in range(self.n)])
        self.mesh_lengths = np.array([[self._length(t, *edge) for edge in EDGES] for t in range(self.n)])
        self.mass = density * volume
        self.modulus = modulus * volume
        self.damping = values_per_tetrahedron(material.damping, self.n) * self.modulus
        self.viscosity = values_per_tetrahedron(material.viscosity, self.n) * self.mass

    def _volume(self, tet):
        a, b, c, d = (self.points[p] for p in self.tetrahedra[tet])
        return float(np.dot(np.cross(b - a, c - a), d - a)) / 6.0

    def _length(self, tet, i, j):
        difference = self.points[self.tetrahedra[tet][j]] - self.points[self.tetrahedra[tet][i]]
        return float(np.sqrt(np.sum(difference**2)))

    def _match_faces(self):
        """Pair every two faces on the same three mesh points."""
        sides = defaultdict(list)
        for t, f in itertools.product(range(self.n), range(4)):
            sides[frozenset(self.tetrahedra[t]) - {self.tetrahedra[t][f]}].append((t, f))
        pairs = [pair for pair in sides.values() if len(pair) == 2]
        return {a: b for pair in pairs for a, b in (pair, pair[::-1])}

    def _match_corners(self):
        """List every interior face as (side, neighbour, its corners, the neighbour's corners on the same points)."""
        gluings = []
        for (tet, face), (other, _) in self.interior_faces:
            corners = [i for i in range(4) if i != face]
            gluings.append(((tet, face), other, corners, [self._corner_at(other, self.tetrahedra[tet][i]) for i in corners]))
        return gluings

    # ------------------------------------------------------------------ cuts

    def sewn_faces(self):
        """Return the tetrahedra (low, high) at every sewn face."""
        return sorted((a[0], b[0]) for a, b in self.interior_faces if a in self.sewn)

    def open_faces(self):
        """Return the tetrahedra (low, high), both alive, at every original face that is cut now."""
        pairs = [(a[0], b[0]) for a, b in self.interior_faces if a not in self.sewn]
        return [pair for pair in pairs if self.alive.issuperset(pair)]

    def _side_towards(self, tet, other):
        for side in itertools.product((tet,), range(4)):
            if self.partner.get(side, (None,))[0] == other and {tet, other} <= self.alive:
                return side
        raise ValueError(f"tetrahedra {tet} and {other} share no face")

    def split_face(self, tet, other):
        """Cut the sewn face between two tetrahedra."""
        side = self._side_towards(tet, other)
        self.sewn.remove(side)
        self.sewn.remove(self.partner[side])

    def remove_tetrahedron(self, tet):
        """Cut all faces of a tetrahedron and take it away for good."""
        self.alive.remove(tet)
        for face in range(4):
            if (tet, face) in self.sewn:
                self.sewn -= {(tet, face), self.partner[tet, face]}

    def cut(self, faces=(), tetrahedra=()):
        """Cut faces, then remove tetrahedra; repeated or already implied cuts do nothing."""
        for tet, other in faces:
            if self._side_towards(tet, other) in self.sewn:
                self.split_face(tet, other)
        for tet in set(tetrahedra):
            self.remove_tetrahedron(tet)

    def sew_face(self, tet, other):
        """Sew a cut face again; nodes that become one take the weighted mean of their state."""
        side = self._side_towards(tet, other)
        if side in self.sewn:
            raise ValueError("already sewn")
        cells = self.vertex_cells()
        merging = [(i, self._corner_at(other, self.tetrahedra[tet][i])) for i in range(4) if i != side[1]]
        for i, j in merging:
            one, opposite = cells[tet, i], cells[other, j]
            if one is not opposite:
                self._merge_state(sorted((one, opposite)))
        self.sewn |= {side, self.partner[side]}

    def _merge_state(self, cells):
        """Give two vertex cells one state: the pinned one's place, else the mass-weighted mean (momentum is kept)."""
        a, b = cells[0][0], cells[1][0]
        pinned = [corner for corner in (a, b) if self.is_pinned[corner]]
        if pinned:
            position, velocity = self.position[pinned[0]].copy(), np.zeros(3)
        else:
            weights = [sum(self.mass[tet] / 4 for tet, _ in cell) for cell in cells]
            position = weighted_mean(self.position[a], self.position[b], weights)
            velocity = weighted_mean(self.velocity[a], self.velocity[b], weights)
        for corner in cells[0] + cells[1]:
            self.position[corner], self.velocity[corner] = position.copy(), velocity.copy()
            self.is_pinned[corner] = bool(pinned)

    def _corner_at(self, tet, point):
        return self.tetrahedra[tet].index(point)

    def snapshot(self):
        """Return a copy of everything that changes."""
        changing = ("alive", "sewn", "position", "velocity", "is_pinned", "load")
        return copy.deepcopy({name: getattr(self, name) for name in changing})

    def restore(self, state):
        """Take back a snapshot."""
        for name, value in copy.deepcopy(state).items():
            setattr(self, name, value)

    # ------------------------------------------------------------------ cells

    def _sewn_sides(self):
        """Return the sewn faces, each once: ((tet, face), neighbour, corners, matching corners of the neighbour)."""
        return [gluing for gluing in self.gluings if gluing[0] in self.sewn]

    def vertex_forest(self):
        """Join the corners of living tetrahedra that meet in a sewn face."""
        forest = Forest(itertools.product(sorted(self.alive), range(4)))
        for (t, _), u, mine, theirs in self._sewn_sides():
            for i, j in zip(mine, theirs, strict=True):
                forest.join((t, i), (u, j))
        return forest

    def edge_forest(self):
        """Join the edges of living tetrahedra that meet in a sewn face."""
        forest = Forest(itertools.product(sorted(self.alive), range(6)))
        for (t, _), u, mine, theirs in self._sewn_sides():
            for a, b in itertools.combinations(range(3), 2):
                one, other = sorted((mine[a], mine[b])), sorted((theirs[a], theirs[b]))
                forest.join((t, EDGES.index(tuple(one))), (u, EDGES.index(tuple(other))))
        return forest

    def _labels(self, forest, width):
        labels = np.full((self.n, width), -1)
        for item in forest.parent:
            tet, local = forest.find(item)
            labels[item] = width * tet + local
        return labels

    def vertex_labels(self):
        """Label the vertex cell of every corner (n, 4), -1 where removed."""
        return self._labels(self.vertex_forest(), 4)

    def edge_labels(self):
        """Label the edge cell of every tetrahedron edge (n, 6), -1 where removed."""
        return self._labels(self.edge_forest(), 6)

    def face_labels(self):
        """Label the face cell of every tetrahedron face (n, 4): its lower side; -1 where removed."""
        labels = np.full((self.n, 4), -1)
        for tet, face in itertools.product(self.alive, range(4)):
            side = (tet, face)
            low = min(side, self.partner[side]) if side in self.sewn else side
            labels[side] = 4 * low[0] + low[1]
        return labels

    def component_labels(self):
        """Label the component of every tetrahedron (n,), -1 where removed."""
        forest = Forest(sorted(self.alive))
        for (t, _), u, _, _ in self._sewn_sides():
            forest.join(t, u)
        return np.array([forest.find(t) if t in self.alive else -1 for t in range(self.n)])

    def vertex_cells(self):
        """Map every corner to the list, in ascending order, of the corners of its vertex cell."""
        return self._cells(self.vertex_forest())

    def edge_cells(self):
        """Map every tetrahedron edge to the list, in ascending order, of the edges of its edge cell."""
        return self._cells(self.edge_forest())

    @staticmethod
    def _cells(forest):
        lists = defaultdict(list)
        for item in sorted(forest.parent):
            lists[forest.find(item)].append(item)
        return {item: lists[forest.find(item)] for item in forest.parent}

    def boundary_faces(self):
        """Return the free sides (tet, face) of living tetrahedra."""
        return {side for side in itertools.product(self.alive, range(4)) if side not in self.sewn}
