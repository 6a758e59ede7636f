"""Many episodes side by side, each a row: what Resection does with one, done with all in a few calls of kernels.

Rows play scenes of their own, on meshes of one size. A row does, bit for bit, what a Resection of its own would.
"""

import weakref
from typing import Any, NamedTuple

import numpy as np

from envs.acting import act
from envs.actions import MASKS
from envs.arrays import (
    FACE,
    HEALTHY_STRAIN,
    IS_FINITE,
    IS_TOUCHED,
    TARGET_VOLUME,
    TASK_EXTENTS,
    TaskArrays,
    task_room,
)
from envs.collapse import SEPARATED, Tissue, collapse_reasons
from envs.measuring import measure
from envs.observation_kernel import Observation, observe
from envs.scene import Scene
from envs.stage import Stage
from envs.task import settle_step
from gmapspring.arena import Arena, SavedRow, Tenancy, shared_part
from gmapspring.batch import RowBody
from gmapspring.body import Material
from gmapspring.errors import ConfigError
from gmapspring.integrators import INTEGRATORS
from gmapspring.simulation import substeps_for
from gmapspring.threads import Threads

Array = np.ndarray[Any, Any]

NEVER = -1.0
"""Tolerance at which no settling ends early."""


class Start(NamedTuple):
    """A scene settled and ready to be played in any row: its constants, shared by all rows, and the state they begin in."""

    scene: Scene
    optimum: float
    """Least total cost J* that frees the target."""
    material: Material
    arrays: TaskArrays
    """The constants; None for all that rows have of their own."""
    entries: Array
    """Where kernels find the constants, and how long each array is, (n_columns,)."""
    state: SavedRow
    """The settled, uncut body."""
    numbers: Array
    """What RowSettings holds of it, in its order."""


class RowSettings(NamedTuple):
    """Numbers of the scenes that rows play, (n_rows,) each."""

    step: Array
    """Substep [s]."""
    n_substeps: Array
    """Substeps after each action; whole, as float."""
    tolerance: Array
    """What ends a settling early [m], negative: nothing."""
    optimum: Array
    budget: Array
    """Cost past which an episode is cut short."""
    strain: Array
    """Limits, as in `scene_config.Limits`."""
    volume_ratio: Array
    healthy_share: Array
    healthy_volume: Array
    """Of the settled, uncut body [m^3]."""


def start_of(stage: Stage) -> Start:
    """Return what rows need of a stage; the stage itself is not needed any longer."""
    task, scene = stage.task, stage.task.scene
    seconds, longest = scene.physics.settle_seconds, settle_step(task.simulation)
    n_substeps = float(substeps_for(seconds, longest))
    tolerance = NEVER if task.rest_tolerance is None else task.rest_tolerance
    limits = scene.limits
    numbers = np.array([
        seconds / n_substeps, n_substeps, tolerance, stage.optimum, scene.budget * stage.optimum,
        limits.strain, limits.volume_ratio, limits.healthy_share, task.start_tissue.healthy_volume,
    ])  # fmt: skip
    return Start(
        scene, stage.optimum, task.simulation.body.material, shared_part(task.arrays, TASK_EXTENTS), task.row[0].copy(),
        task.start.row, numbers,
    )  # fmt: skip


class TaskRows:
    """Rows of episodes; `table` finds them for kernels, `play` has their arrays, (n_rows, ...)."""

    def __init__(self, first: Start, n_rows: int, mask: str, n_threads: int):
        """Let all rows stand at the start of one scene; others that fit may follow."""
        physics, mesh = first.scene.physics, first.scene.mesh
        self.integrator = INTEGRATORS[physics.integrator]
        self.real = np.dtype(physics.dtype).type(0)
        self.n_faces = len(first.arrays.rules.face_slots)
        room = task_room(mesh.n_tetrahedra, self.n_faces + mesh.n_tetrahedra, type(self.real), self.integrator.n_work)
        self.arena = Arena(room, TASK_EXTENTS, n_rows)
        self.play = self.arena.arrays.play
        self.masks = self.play.mask[:, : self.n_faces + mesh.n_tetrahedra]
        """Legal actions, int8 (n_rows, n_actions)."""
        self.starts = [first] * n_rows
        """What each row plays."""
        self._settings = np.zeros((n_rows, len(RowSettings._fields)))
        self.settings = RowSettings(*self._settings.T)
        self._tenancies: weakref.WeakKeyDictionary[SavedRow, Tenancy] = weakref.WeakKeyDictionary()
        self._numbers = np.arange(n_rows)
        self.has_diverged = np.zeros(n_rows, bool)
        """Rows whose state stopped being finite when they last settled: they hold their last finite state."""
        self._fill_mask = MASKS[mask]
        self._threads = Threads(n_threads)
        for row in range(n_rows):
            self.put(row, first)

    def put(self, row: int, start: Start) -> None:
        """Let a row begin a scene, its mask included; raise ConfigError where it does not fit."""
        if start is not self.starts[row]:
            self._check_fit(start)
        self.starts[row] = start
        tenancy = self._tenancies.get(start.state)
        if tenancy is None:
            tenancy = self._tenancies[start.state] = self.arena.tenancy(start.entries, start.arrays)
        self.arena.put(row, tenancy, start.state.table, 0)
        self._settings[row] = start.numbers
        self._fill_mask(self.arena.table, self._numbers[row : row + 1], self.real)

    def step(self, rows: Array, actions: Array, out: Observation) -> None:
        """Do legal actions in some rows, ascending (k,): cut, settle, measure. Then observe all rows."""

        def step_some(some: Array) -> None:
            first, stop = np.searchsorted(rows, (some[0], some[-1] + 1))
            self._play(rows[first:stop], actions[first:stop])
            observe(self.arena.table, some, self.real, some, out)

        self._threads.run(step_some, self._numbers)

    def observe(self, rows: Array, out: Observation) -> None:
        """Write what there is to see of some rows to their places in out."""
        observe(self.arena.table, rows, self.real, rows, out)

    def judge(self) -> Array:
        """Return what each row has come to since it settled: None, "separated" or a collapse, object (n_rows,)."""
        numbers = self.play.numbers[:, HEALTHY_STRAIN : TARGET_VOLUME + 1].T
        is_finite, is_touched = self.play.whole[:, [IS_FINITE, IS_TOUCHED]].T != 0
        tissue = Tissue._make((*numbers, is_finite & ~self.has_diverged, is_touched))
        outcomes = collapse_reasons(tissue, tissue.healthy_volume / self.settings.healthy_volume, self.settings)
        outcomes[(tissue.target_volume == 0.0) & (outcomes == None)] = SEPARATED  # noqa: E711, each element is compared
        return outcomes

    def costs(self) -> Array:
        """Return what the last action of each row cost, (n_rows,)."""
        face, tetrahedron, loss = self.play.numbers[:, FACE : FACE + 3].T
        return face + tetrahedron + loss

    def body(self, row: int) -> RowBody:
        """Return the body of a row, as it stands."""
        start = self.starts[row]
        arrays = self.arena.view(row, start.arrays).body
        return RowBody(start.scene.mesh, start.material, arrays, self.arena.table[row : row + 1])

    def _play(self, rows: Array, actions: Array) -> None:
        """Cut, settle, measure and mask some rows."""
        if not len(rows):
            return
        table, settings = self.arena.table, self.settings
        act(table, rows, self.real, actions, np.empty(len(rows), bool))
        n_substeps, taken = settings.n_substeps[rows].astype(np.int64), np.empty(len(rows), np.int64)
        self.integrator.advance(table, rows, self.real, settings.step[rows], n_substeps, settings.tolerance[rows], taken)
        self.has_diverged[rows] = taken < 0
        for row in rows[taken < 0]:
            self._find_last_finite(row)
        measure(table, rows, self.real)
        self._fill_mask(table, rows, self.real)

    def _find_last_finite(self, row: int) -> None:
        """Let a row that diverges as a whole settle for as long as its state is finite."""
        rows, taken = np.array([row]), np.ones(1, np.int64)
        while taken[0] > 0:
            self.integrator.advance(
                self.arena.table, rows, self.real, self.settings.step[rows], np.ones(1, np.int64), np.full(1, NEVER), taken
            )

    def _check_fit(self, start: Start) -> None:
        """Raise ConfigError where a scene is of another size or another kind of physics."""
        scene, rules, mine = start.scene, start.arrays.rules, self.starts[0].scene
        sizes = len(rules.face_slots), len(rules.volume)
        if sizes != (self.n_faces, mine.mesh.n_tetrahedra):
            raise ConfigError(
                f"scene {scene.name!r} has {sizes[0]} interior faces and {sizes[1]} tetrahedra, but this environment was "
                f"made for {self.n_faces} and {mine.mesh.n_tetrahedra}; make another one for it"
            )
        if (scene.physics.integrator, scene.physics.dtype) != (mine.physics.integrator, mine.physics.dtype):
            raise ConfigError(
                f"scene {scene.name!r} asks for {scene.physics.integrator} in {scene.physics.dtype}, but this environment was "
                f"made for {mine.physics.integrator} in {mine.physics.dtype}; make another one for it"
            )
