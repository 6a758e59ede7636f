"""Simulation: the one stateful shell. It checks what comes in, raises, and counts time; the work is done by free functions."""

import math
import pathlib
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from gmapspring import cut as cutting
from gmapspring import stability, state_file
from gmapspring.body import Body, Material, build_body, own_matter
from gmapspring.choice import Choice, choose
from gmapspring.cut import CutReport
from gmapspring.embedding import embed_all, sum_external
from gmapspring.errors import DivergenceError, StabilityError, StateFileError
from gmapspring.integrators import INTEGRATORS
from gmapspring.layout import renumber
from gmapspring.mesh import Mesh
from gmapspring.snapshot import Snapshot, load_arrays, name_loads, save_arrays
from gmapspring.topology import gmap as topology
from gmapspring.validity import check_body

ONE_ROW, NEVER = np.zeros(1, np.int64), np.full(1, -1.0)
"""The only row of a body's own table; a tolerance at which nothing ends early."""
PORTION = 2**28
"""Springs times sweeps of one call of a kernel, about a second: in between, Ctrl-C is heard."""
MOST_SUBSTEPS = 1e9
"""More of them in one call are a mistake: so many take an organ of 2,000 tetrahedra half a day."""


class SimulationState(NamedTuple):
    """All that a Simulation can change, as copies."""

    body: Snapshot
    time: float
    n_substeps: int
    mesh: Mesh
    """That of the body, not copied: it never changes."""


class Simulation:
    """A body that is stepped through time and cut.

    mesh: the body at rest. material: what it is made of. pinned: nodes held in place, bool (n_points,). gravity [m/s^2], (3,).
    loads: constant forces on points [N], (n_points, 3). integrator: a name of gmapspring.integrators.INTEGRATORS ("rk4").
    dtype: np.float64 (if none is given) or np.float32. tolerance: in place of both, the error to allow, which chooses scheme,
    precision and step; see choice.choose. keep_manifold: refuse cuts that would pinch the body.
    """

    def __init__(self, mesh: Mesh, material: Material, *, pinned: np.ndarray | None = None, gravity=(0.0, 0.0, 0.0),
                 loads: np.ndarray | None = None, integrator: str | None = None, dtype: type | None = None,
                 tolerance: float | None = None, keep_manifold: bool = False):  # fmt: skip
        if tolerance is not None and (integrator is not None or dtype is not None):
            raise ValueError("a tolerance chooses integrator and dtype: leave them out, or leave out the tolerance")
        choice = Choice(integrator or "rk4", dtype or np.float64, None)
        if tolerance is not None:
            choice = choose(stability.element_limits(mesh, own_matter(mesh, material)), tolerance)
        integrator, dtype = choice.integrator, choice.dtype
        if integrator not in INTEGRATORS:
            raise ValueError(f"integrator {integrator!r} is unknown; there are {', '.join(sorted(INTEGRATORS))}")
        if np.dtype(dtype) not in (np.dtype(np.float64), np.dtype(np.float32)):
            raise ValueError(f"dtype must be numpy.float64 or numpy.float32, not {dtype}")
        self.integrator = INTEGRATORS[integrator]
        self.tolerance = tolerance
        self.keep_manifold = keep_manifold
        self.time = 0.0
        """Simulated time [s]."""
        self.n_substeps = 0
        """Substeps taken so far."""
        self.body: Body = build_body(mesh, material, _pinned_mask(pinned, mesh), _vector(gravity, "gravity"),
                                     np.dtype(dtype).type, self.integrator.n_work)
        embed_all(self.body.table, 0, self.body.real)
        if loads is not None:
            self.set_loads(loads)
        limits = stability.element_limits(mesh, self.body.tetrahedra)
        self.stable_step = self.integrator.stable_step(limits)
        """The largest substep [s] whose small motions are proven stable, for this body and every body cut from it."""
        self.default_step = self.integrator.default_step(limits) if choice.step is None else choice.step
        """The substep [s] that `advance` takes where none is asked for; see Integrator.default_step, choice.choose."""

    def advance(self, seconds: float, step: float | None = None, rest_tolerance: float | None = None) -> int:
        """Simulate for some seconds in equal substeps, none longer than step; return how many were taken.

        Without a step, it is default_step: what the tolerance asks for, or one that suits violent motion too. With a
        rest_tolerance [m] the rest of the time is skipped once no node can move any further than that in it.
        Raises StabilityError for a step above the stable one, and DivergenceError where the state stops being finite: the
        body then holds its last finite state. Without a rest_tolerance Ctrl-C ends it within seconds; body and clock then stand
        at the last substep taken.
        """
        if not (math.isfinite(seconds) and seconds >= 0.0):
            raise ValueError(f"seconds must be finite and not negative, not {seconds}")
        longest = self.default_step if step is None else step
        stability.check_step(longest, self.stable_step, self.integrator.name)
        check_tolerance(rest_tolerance)
        n_substeps = int(substeps_for(seconds, longest))
        tolerance = NEVER if rest_tolerance is None else np.array([rest_tolerance])
        return self._take_substeps(seconds / n_substeps, n_substeps, tolerance) if n_substeps else 0

    def _take_substeps(self, step: float, n_substeps: int, tolerance: np.ndarray = NEVER) -> int:
        """Take substeps and return their number; on divergence find the last finite state."""
        start, before = self.time, self.n_substeps
        portion = max(1, PORTION // (self.integrator.n_sweeps * max(1, self.body.n_springs)))
        if tolerance[0] >= 0.0:
            # Whether a body will move no further depends on all the time that is left: one call then sees it all.
            portion = n_substeps
        for first in range(0, n_substeps, portion):
            stop = min(first + portion, n_substeps)
            if self._advance_kernel(step, stop - first, tolerance, start + stop * step) < 0:
                self._find_divergence(step, self.n_substeps - before, n_substeps)
        return self.n_substeps - before

    def _find_divergence(self, step: float, n_taken: int, n_substeps: int) -> None:
        """Take one substep after another up to the last finite state, then raise; n_taken of n_substeps have been taken."""
        while self._advance_kernel(step, 1, NEVER, self.time + step) == 1:
            n_taken += 1
        raise DivergenceError(
            f"the state stopped being finite in substep {n_taken + 1} of {n_substeps}, of {step:.6g} s each, at time "
            f"{self.time:.6g} s; the body holds its last finite state. Look for loads or velocities beyond all bounds"
        )

    def _advance_kernel(self, step: float, n_substeps: int, tolerance: np.ndarray, time: float) -> int:
        """Call the integrator's kernel, count and return the substeps it took; -1, with nothing counted, on divergence.

        time: when it will be done [s].
        """
        body, taken = self.body, np.zeros(1, np.int64)
        try:
            self.integrator.advance(body.table, ONE_ROW, body.real, np.array([step]), np.array([n_substeps]), tolerance, taken)
        finally:
            # Ctrl-C in a kernel is heard when it has returned: what it has done counts.
            if taken[0] > 0:
                self.time = time
                self.n_substeps += int(taken[0])
        return int(taken[0])

    def split_face(self, tet_a: int, tet_b: int) -> CutReport:
        """Cut the face between two tetrahedra; see cut.split_face."""
        return cutting.split_face(self.body, tet_a, tet_b, self.keep_manifold)

    def remove_tetrahedron(self, tetrahedron: int) -> CutReport:
        """Isolate and delete a tetrahedron; see cut.remove_tetrahedron."""
        return cutting.remove_tetrahedron(self.body, tetrahedron, self.keep_manifold)

    def sew_face(self, tet_a: int, tet_b: int) -> CutReport:
        """Sew a face that was cut; see cut.sew_face."""
        return cutting.sew_face(self.body, tet_a, tet_b, self.keep_manifold)

    def cut(self, faces: Iterable = (), tetrahedra: Iterable = ()) -> CutReport:
        """Cut faces, (k, 2) pairs of tetrahedra, and remove tetrahedra, all at once; see cut.cut."""
        return cutting.cut(self.body, faces, tetrahedra, self.keep_manifold)

    def renumber(self) -> CutReport:
        """Number nodes and springs anew, for large bodies that have been cut in many places; see layout.renumber."""
        return renumber(self.body)

    def set_loads(self, loads: np.ndarray | None) -> None:
        """Set the constant force on each mesh point [N], (n_points, 3), shared by mass among its nodes; None for none."""
        if loads is None:
            return self._put_loads(np.zeros((0, 4, 3)))
        loads = _forces(loads, (self.body.mesh.n_points, 3), "loads")
        corners, alive = self.body.mesh.tetrahedra, self.body.is_alive
        mass = np.where(alive, self.body.tetrahedra.mass, 0.0)
        total = np.bincount(corners.ravel(), np.repeat(mass, 4), self.body.mesh.n_points)
        gone = np.flatnonzero((total == 0.0) & loads.any(axis=1))
        if len(gone):
            raise ValueError(f"the load on point {gone[0]} has nothing to act on: all tetrahedra there are removed")
        share = mass[:, None] / np.where(total > 0.0, total, 1.0)[corners]
        return self._put_loads(share[:, :, None] * loads[corners])

    def set_corner_loads(self, loads: np.ndarray) -> None:
        """Set the constant force on each corner of each tetrahedron [N], (n_tets, 4, 3); those of removed ones are idle."""
        self._put_loads(_forces(loads, (self.body.mesh.n_tetrahedra, 4, 3), "corner loads"))

    def _put_loads(self, load: np.ndarray) -> None:
        """Store corner loads and sum them to nodes; no rows where neither loads nor gravity are named."""
        body = self.body
        has_external = len(load) > 0 or bool(body.matter.gravity.any())
        name_loads(body, load, has_external)
        if has_external:
            sum_external(body.table, 0, body.real)

    def components(self) -> np.ndarray:
        """Label the components 0, 1, ... in the order of their lowest tetrahedron, -1 where removed, (n_tets,)."""
        return topology.components(self.body.gmap)

    def check_validity(self) -> None:
        """Raise TopologyError, naming the culprit, unless map and mechanics are consistent throughout."""
        check_body(self.body)

    def save_state(self) -> SimulationState:
        """Copy all that can change, topology included."""
        return SimulationState(save_arrays(self.body), self.time, self.n_substeps, self.body.mesh)

    def load_state(self, state: SimulationState) -> None:
        """Go back to a saved state; it stays valid and can be loaded again. Raises StateFileError for one of another body."""
        mine, its = self.body.mesh, state.mesh
        if its is not mine and not (np.array_equal(its.points, mine.points) and np.array_equal(its.tetrahedra, mine.tetrahedra)):
            raise StateFileError("the state belongs to a body on another mesh; build the same body first")
        load_arrays(self.body, state.body)
        self.time, self.n_substeps = state.time, state.n_substeps

    def save(self, path: str | pathlib.Path) -> None:
        """Write everything to a file (.npz), atomically."""
        state_file.write(pathlib.Path(path), self)

    @classmethod
    def load(cls, path: str | pathlib.Path) -> "Simulation":
        """Read a simulation from a file; raise StateFileError for a foreign, truncated or outdated one."""
        return state_file.read(pathlib.Path(path), cls)


def substeps_for(seconds, longest):
    """Return how many equal substeps, none longer than the longest [s], some seconds take, one number or an array, as floats.

    Raises StabilityError for more than MOST_SUBSTEPS.
    """
    # A whole number of steps up to round-off must not become one more; where any step will do, one is taken.
    n_substeps = np.maximum(np.ceil(seconds / longest * (1.0 - 1e-12)), np.greater(seconds, 0.0))
    if not (n_substeps <= MOST_SUBSTEPS).all():
        raise StabilityError(
            f"{np.max(seconds):g} s in steps of {np.min(longest):g} s would take {np.max(n_substeps):.3g} substeps, above "
            f"{MOST_SUBSTEPS:g}; simulate less time at once, or a body that is less stiff, less damped or heavier"
        )
    return n_substeps


def check_tolerance(rest_tolerance: float | None) -> None:
    """Raise ValueError for a rest tolerance that is none."""
    if rest_tolerance is not None and not rest_tolerance >= 0.0:
        raise ValueError(f"rest_tolerance must not be negative, not {rest_tolerance}")


def _pinned_mask(pinned: np.ndarray | None, mesh: Mesh) -> np.ndarray:
    """Return a mask of pinned points; refuse numbers, which a mask would misread."""
    if pinned is None:
        return np.zeros(mesh.n_points, dtype=bool)
    mask = np.asarray(pinned)
    if mask.shape != (mesh.n_points,) or mask.dtype != np.bool_:
        raise ValueError(f"pinned must be a mask, bool ({mesh.n_points},), not {mask.dtype} {mask.shape}")
    return mask


def _vector(value, name: str) -> np.ndarray:
    """Return a finite vector of three numbers."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} must be three finite numbers, not {value}")
    return vector


def _forces(value, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Return finite forces of the expected shape."""
    forces = np.array(value, dtype=np.float64)
    if forces.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, not {forces.shape}")
    if not np.isfinite(forces).all():
        raise ValueError(f"{name} must be finite; entry {tuple(np.argwhere(~np.isfinite(forces))[0].tolist())} is not")
    return forces
