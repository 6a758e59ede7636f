"""BodyBatch: many bodies, each with a mesh, a map and cuts of its own, advanced by one call of a kernel.

    batch = BodyBatch([simulation_0, simulation_1, ...])
    batch.advance(0.1)                       # each in its own stable substeps
    split_face(batch.bodies[1], 3, 7)        # cut a row as any body
    batch.state[0, : batch.n_nodes[0]]       # rows [x y z 0 u v w 0]

A row gives, bit for bit, what a Simulation of its own gives.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gmapspring.arena import COUNTS, PER_NODE, PER_SPRING, SCRATCH, SHARED, WHOLE, Arena
from gmapspring.body import Body, BodyArrays, Material
from gmapspring.errors import CapacityError
from gmapspring.matter import Matter, Nodes, Springs, Tetrahedra, empty_matter, empty_nodes, empty_springs, no_matter
from gmapspring.mesh import Mesh
from gmapspring.simulation import Simulation, check_tolerance, substeps_for
from gmapspring.stability import check_step
from gmapspring.threads import Threads
from gmapspring.topology.build import empty_gmap
from gmapspring.topology.gmap import N_EDGES, N_VERTICES, GMap
from gmapspring.topology.room import empty_room

BODY_EXTENTS: Any = BodyArrays(
    Matter(
        Nodes(
            state=PER_NODE, force=SCRATCH, external=PER_NODE, mass=PER_NODE, inverse_mass=PER_NODE, viscosity=PER_NODE,
            is_pinned=PER_NODE, point=PER_NODE,
        ),
        Springs(endpoints=PER_SPRING, rest_length=PER_SPRING, stiffness=PER_SPRING, damping=PER_SPRING, coefficient=SCRATCH),
        Tetrahedra(volume=SHARED, mass=SHARED, modulus=SHARED, damping_modulus=SHARED, viscosity=SHARED, load=WHOLE),
        gravity=SHARED, work=SCRATCH, counts=COUNTS,
    ),
    GMap(
        image=WHOLE, vertex_of=WHOLE, edge_of=WHOLE, component_of=WHOLE, vertex_dart=PER_NODE, edge_dart=PER_SPRING,
        link=PER_NODE, counts=COUNTS, mark=SCRATCH, queue=SCRATCH,
    ),
    room=SCRATCH,
)  # fmt: skip
"""What each array of a body is to a batch; see arena.py."""


class Advance(NamedTuple):
    """What one call of BodyBatch.advance did."""

    n_substeps: np.ndarray
    """Substeps taken, 0 where the row has diverged, int64 (n_rows,)."""
    has_diverged: np.ndarray
    """Rows whose state stopped being finite: they are as they were before, bool (n_rows,)."""


class RowBody(Body):
    """The body of a row of a table: it is found through that table, whatever becomes of its arrays."""

    def __init__(self, mesh: Mesh, material: Material, arrays: BodyArrays, row: np.ndarray):
        """Make the body of some arrays; row: the row of the table, (1, n_columns), whose first entries they are."""
        self._row = row
        super().__init__(mesh, material, arrays.gmap, arrays.matter)
        self.room = arrays.room
        self.matter = arrays.matter

    @property
    def matter(self) -> Matter:
        """All mechanics."""
        return self._matter

    @matter.setter
    def matter(self, matter: Matter) -> None:
        Body.matter.fset(self, matter)  # type: ignore[attr-defined]
        self._row[0, : self.table.shape[1]] = self.table
        self.table = self._row


class BodyBatch:
    """Bodies side by side, each a row: different meshes and cuts, one precision and one integrator."""

    def __init__(self, simulations: Sequence[Simulation], n_tetrahedra: int | None = None, n_threads: int = 1):
        """Copy simulations as they stand; what they do later is theirs.

        n_tetrahedra: how large a body each row has room for, by default the largest of these; n_threads: over how many
        threads the rows are spread.
        """
        if not simulations:
            raise ValueError("a batch needs at least one simulation")
        first = simulations[0]
        largest = max(simulations, key=lambda simulation: simulation.body.mesh.n_tetrahedra).body
        self.integrator = first.integrator
        self.real = first.body.real
        """A number of the precision of all rows."""
        self.n_tetrahedra = n_tetrahedra or largest.mesh.n_tetrahedra
        """Tetrahedra that a row has room for."""
        example = room_for(self.n_tetrahedra, type(self.real), self.integrator.n_work)
        self.arena = Arena(example, BODY_EXTENTS, len(simulations))
        self.stable_steps = np.zeros(len(simulations))
        """The largest substep [s] of each row whose small motions are proven stable, (n_rows,)."""
        self.default_steps = np.zeros(len(simulations))
        """The substep [s] of each row that is taken where none is asked for, (n_rows,)."""
        self._threads = Threads(n_threads)
        self.bodies = [self._placed(row, simulation) for row, simulation in enumerate(simulations)]
        """The bodies, to be cut and measured; `put` makes a new one."""

    @property
    def table(self) -> np.ndarray:
        """Where kernels find the rows, int64 (n_rows, n_columns)."""
        return self.arena.table

    @property
    def arrays(self) -> BodyArrays:
        """All that rows can change, (n_rows, capacity, ...); a term that a row does not name has idle numbers there."""
        return self.arena.arrays

    @property
    def state(self) -> np.ndarray:
        """Rows [x y z 0 u v w 0] of all nodes, (n_rows, capacity, 8); of row i the first n_nodes[i] are live."""
        return self.arrays.matter.nodes.state

    @property
    def n_nodes(self) -> np.ndarray:
        """Live nodes of each row, int64 (n_rows,)."""
        return self.arrays.matter.counts[:, N_VERTICES]

    @property
    def n_springs(self) -> np.ndarray:
        """Live springs of each row, int64 (n_rows,)."""
        return self.arrays.matter.counts[:, N_EDGES]

    def put(self, row: int, simulation: Simulation) -> None:
        """Let a row go on from a copy of a simulation as it stands."""
        if not 0 <= row < len(self.bodies):
            raise ValueError(f"there is no row {row}: the batch has rows 0 to {len(self.bodies) - 1}")
        self.bodies[row] = self._placed(row, simulation)

    def advance(self, seconds: float | np.ndarray, step: float | np.ndarray | None = None,
                rest_tolerance: float | None = None) -> Advance:  # fmt: skip
        """Simulate all rows; see Simulation.advance. Each number may be one for each row, (n_rows,). Ctrl-C is heard at its end.

        A row whose state stops being finite stays as it was, and is reported; no other row notices.
        Raises StabilityError for a step above the stable one of its row.
        """
        n_rows = len(self.bodies)
        seconds = np.broadcast_to(np.asarray(seconds, np.float64), (n_rows,))
        longest = np.broadcast_to(self.default_steps if step is None else step, (n_rows,))
        self._check(seconds, longest)
        check_tolerance(rest_tolerance)
        n_substeps = substeps_for(seconds, longest).astype(np.int64)
        steps = seconds / np.maximum(n_substeps, 1)
        tolerances = np.full(n_rows, -1.0 if rest_tolerance is None else rest_tolerance)
        taken = np.zeros(n_rows, np.int64)

        def advance(rows: np.ndarray) -> None:
            done = np.zeros(len(rows), np.int64)
            self.integrator.advance(self.table, rows, self.real, steps[rows], n_substeps[rows], tolerances[rows], done)
            taken[rows] = done

        self._threads.run(advance, np.flatnonzero(n_substeps))
        return Advance(np.maximum(taken, 0), taken < 0)

    def _check(self, seconds: np.ndarray, longest: np.ndarray) -> None:
        """Raise for times that cannot be, and for steps that are not stable."""
        for row in np.flatnonzero(~(np.isfinite(seconds) & (seconds >= 0.0))):
            raise ValueError(f"row {row}: seconds must be finite and not negative, not {seconds[row]}")
        for row in np.flatnonzero(~((longest > 0.0) & (longest <= self.stable_steps))):
            check_step(longest[row], self.stable_steps[row], self.integrator.name, f"row {row}: ")

    def _placed(self, row: int, simulation: Simulation) -> RowBody:
        """Copy a body into a row; raise where it is of another kind, or might outgrow the row."""
        body = simulation.body
        if simulation.integrator is not self.integrator or type(body.real) is not type(self.real):
            raise ValueError(
                f"row {row}: the rows of a batch share one integrator and one precision, {self.integrator.name} in "
                f"{type(self.real).__name__}; this body has {simulation.integrator.name} in {type(body.real).__name__}"
            )
        check_capacity(self.n_tetrahedra, body.mesh.n_tetrahedra, f"row {row}")
        self.arena.put(row, self.arena.tenancy(body.table[0], body), body.table, 0)
        # A smaller body may have begun its stamps anew, and has left alone the marks of a larger one before it.
        self.arrays.gmap.mark[row] = 0
        self.stable_steps[row], self.default_steps[row] = simulation.stable_step, simulation.default_step
        arrays = self.arena.view(row, BodyArrays(body.matter, body.gmap, body.room))
        return RowBody(body.mesh, body.material, arrays, self.table[row: row + 1])


def check_capacity(capacity: int, n_tetrahedra: int, where: str) -> None:
    """Raise CapacityError where a body may come to need more than a row has room for.

    Cut to pieces, T tetrahedra have 4T nodes and 6T springs, and never more: below that no cut can fail for want of room.
    """
    if n_tetrahedra > capacity:
        raise CapacityError(
            f"{where} has room for {capacity} tetrahedra, 4T = {4 * capacity} nodes and 6T = {6 * capacity} springs; a body of "
            f"{n_tetrahedra} may come to need 4T = {4 * n_tetrahedra} and 6T = {6 * n_tetrahedra}: make the batch with "
            f"n_tetrahedra={n_tetrahedra} or more"
        )


def room_for(n_tetrahedra: int, dtype: type, n_work: int) -> BodyArrays:
    """Return arrays with room for a body of so many tetrahedra, however it is cut, with every term."""
    gmap = empty_gmap(n_tetrahedra)
    tetrahedra = no_matter(dtype).tetrahedra._replace(load=np.zeros((n_tetrahedra, 4, 3)))
    nodes, springs = empty_nodes(4 * n_tetrahedra, dtype, True, True), empty_springs(6 * n_tetrahedra, dtype, True)
    matter = empty_matter(nodes, springs, tetrahedra, n_work)
    return BodyArrays(matter, gmap, empty_room())
