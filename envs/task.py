"""The task without Gymnasium: cut the target free, at a cost, before healthy tissue gives way.

Certificates are made, and episodes are played, by exactly this class; what it does is done by kernels over rows of a table,
of which it has one (see arrays.py) and a batch of environments many (see rows.py).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from envs.acting import BEGIN, act
from envs.action_table import action_table, surroundings
from envs.actions import MASKS
from envs.arrays import (
    COST,
    FACE,
    HEALTHY_STRAIN,
    HEALTHY_VOLUME,
    IS_FINITE,
    IS_TOUCHED,
    LAYOUTS,
    N_COMPONENTS,
    TARGET_VOLUME,
    TaskArrays,
    empty_play,
    rules_of,
)
from envs.collapse import SEPARATED, Tissue, collapse_reason
from envs.compiling import compiling_beside
from envs.costs import CostParts
from envs.measuring import measure
from envs.scene import Scene
from envs.sight import seen_load
from gmapspring.addresses import address_row
from gmapspring.arena import SavedRow, copy_live
from gmapspring.body import BodyArrays, Material
from gmapspring.errors import DivergenceError, StateFileError, TopologyError
from gmapspring.simulation import ONE_ROW, Simulation

Array = np.ndarray[Any, Any]


class ResectionState(NamedTuple):
    """Everything that `Resection.load_state` needs to go on from here."""

    row: SavedRow
    """Body and episode, topology included."""

    kind: tuple[int, int, str, bool, bool]
    """Tetrahedra, actions and precision of the task that it was taken from."""

    time: float
    """Simulated time [s]."""

    n_substeps: int
    """Substeps taken."""

    outcome: str | None
    """What the last settling ended with."""


class Resection:
    """Play one scene: cut, let the body settle, judge it.

    Pieces that hang on no anchor are no longer part of the task: they are taken off the body at once, so that only what
    still stands is simulated.
    """

    def __init__(self, scene: Scene) -> None:
        """Build the body of a scene and let it settle under its load."""
        mesh, physics = scene.mesh, scene.physics
        self.scene = scene
        self.table = action_table(mesh)
        self.around = surroundings(mesh, self.table, scene.target, scene.anchor)
        with compiling_beside(physics.dtype, physics.integrator):
            self.simulation = Simulation(
                mesh,
                Material(scene.young_modulus, physics.density, physics.damping, physics.viscosity),
                pinned=scene.pinned,
                gravity=physics.gravity,
                integrator=physics.integrator,
                dtype=np.dtype(physics.dtype).type,
            )
        # Names the load, so that there is room for it from the start.
        self.simulation.set_corner_loads(np.zeros((mesh.n_tetrahedra, 4, 3)))
        self.play = empty_play(mesh.n_tetrahedra, self.table.n_actions)
        self.rules = rules_of(scene, self.table, self.around)
        self.rest_tolerance = None if physics.rest_tolerance is None else physics.rest_tolerance * scene.spacing
        """What ends a settling early [m], or None."""
        self.outcome: str | None = None
        """None, "separated" or the reason of a collapse, as judged when the body last settled."""
        self._kind = (mesh.n_tetrahedra, self.table.n_actions, physics.dtype, physics.viscosity > 0, physics.damping > 0)
        self._known_table: Any = None
        self._act(int(BEGIN))
        self._rest = self.save_state()
        self.set_load(scene.load)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy is made from: addresses hold for this task alone."""
        return self.__dict__ | {"_known_table": None, "_row": None}

    def set_load(self, load: Array) -> None:
        """Start again under another total force on the target [N], shape (3,)."""
        self.rules.load[:] = load
        self.rules.sight.load[:] = seen_load(self.scene, self.load)
        self.load_state(self._rest)
        self._act(int(BEGIN))
        self._settle_for(self.scene.physics.initial_settle_seconds)
        self.start_tissue = self.tissue
        self.rules.start[:] = self.tissue.healthy_volume, self.tissue.target_volume
        self._judge()
        self._start = self.save_state()

    def reset(self) -> None:
        """Go back to the settled, uncut body."""
        self.load_state(self._start)

    def action_mask(self, mode: str = "all") -> Array:
        """Return which actions a mask mode allows now, int8 (n_actions,)."""
        MASKS[mode](self.row, ONE_ROW, self.simulation.body.real)
        return self.play.mask.copy()

    def step(self, action: int) -> CostParts:
        """Cut, then let the body settle and judge it; see `apply` and `settle`."""
        parts = self.apply(action)
        self.settle()
        return parts

    def apply(self, action: int) -> CostParts:
        """Cut without letting time pass; return what it cost.

        Raises:
            TopologyError: the action is illegal; nothing has changed.
        """
        if not 0 <= action < self.table.n_actions:
            raise TopologyError(f"action {action} is out of range 0..{self.table.n_actions - 1}")
        if not self._act(action):
            raise self._refusal(int(action))
        return CostParts(*self.play.numbers[FACE : FACE + 3].tolist())

    def settle(self, seconds: float | None = None) -> None:
        """Let the body move for the scene's time after a cut, or so many seconds of it, and judge it.

        Sets `outcome`: None, "separated" or a collapse.
        """
        self._settle_for(self.scene.physics.settle_seconds if seconds is None else seconds, self.rest_tolerance)
        self._judge()

    @property
    def row(self) -> Array:
        """Return where kernels find body, episode and rules, (1, n)."""
        body = self.simulation.body
        if self._known_table is not body.table:
            # The body has got other arrays, or this is a copy of another task.
            self._known_table = body.table
            self._row = address_row(self.arrays)[None]
        return self._row

    @property
    def arrays(self) -> TaskArrays:
        """Return body, episode and rules."""
        body = self.simulation.body
        return TaskArrays(BodyArrays(body.matter, body.gmap, body.room), self.play, self.rules)

    @property
    def start(self) -> ResectionState:
        """Return the settled, uncut body."""
        return self._start

    @property
    def load(self) -> Array:
        """Return the total force on the target [N], shape (3,)."""
        return self.rules.load

    @property
    def strain(self) -> Array:
        """Return the largest edge strain of each tetrahedron, 0 where it is not attached."""
        return self.play.strain

    @property
    def volume_ratio(self) -> Array:
        """Return volume over rest volume of each tetrahedron, 0 where it is not attached."""
        return self.play.volume_ratio

    @property
    def is_attached(self) -> Array:
        """Return the tetrahedra that hang on an anchor; after each action these are all there are."""
        return self.play.is_attached

    @property
    def label_of(self) -> Array:
        """Return the component of each tetrahedron in the order of its lowest one, -1 where it is gone."""
        return self.play.label_of

    @property
    def n_components(self) -> int:
        """Return the number of pieces."""
        return int(self.play.whole[N_COMPONENTS])

    @property
    def cost(self) -> float:
        """Return the cost so far."""
        return float(self.play.numbers[COST])

    @property
    def tissue(self) -> Tissue:
        """Return what was measured when the body last settled."""
        numbers, whole = self.play.numbers[HEALTHY_STRAIN : TARGET_VOLUME + 1].tolist(), self.play.whole
        return Tissue._make((*numbers, bool(whole[IS_FINITE]), bool(whole[IS_TOUCHED])))

    @property
    def healthy_share(self) -> float:
        """Return the volume of attached healthy tissue over that at the start."""
        return float(self.play.numbers[HEALTHY_VOLUME]) / self.start_tissue.healthy_volume

    @property
    def target_share(self) -> float:
        """Return the volume of the attached target over that at the start."""
        return float(self.play.numbers[TARGET_VOLUME]) / self.start_tissue.target_volume

    def save_state(self) -> ResectionState:
        """Return a snapshot of the body and the bookkeeping."""
        simulation = self.simulation
        saved = SavedRow(LAYOUTS[type(simulation.body.real)], self.row, 0, simulation.body.gmap.counts)
        return ResectionState(saved, self._kind, simulation.time, simulation.n_substeps, self.outcome)

    def load_state(self, state: ResectionState) -> None:
        """Go back to a snapshot of the same scene under the same load."""
        if state.kind != self._kind:
            kinds = f"{state.kind}, not of {self._kind} (tetrahedra, actions, precision, viscosity, damping)"
            raise StateFileError(f"the state belongs to a task of {kinds}")
        simulation = self.simulation
        layout = LAYOUTS[type(simulation.body.real)]
        copy_live(state.row.table, 0, self.row, 0, *layout, layout.counts)
        simulation.time, simulation.n_substeps, self.outcome = state.time, state.n_substeps, state.outcome

    def _act(self, action: int) -> bool:
        """Carry out an action; return False where it is illegal."""
        is_done = np.empty(1, bool)
        act(self.row, ONE_ROW, self.simulation.body.real, np.array([action], np.int64), is_done)
        return bool(is_done[0])

    def _refusal(self, action: int) -> TopologyError:
        """Return why an action does nothing to the body."""
        if action < self.table.n_faces:
            return TopologyError(f"action {action} cuts face {action}, which is cut or no longer attached")
        tet = action - self.table.n_faces
        if not self.is_attached[tet]:
            return TopologyError(f"action {action} removes tetrahedron {tet}, which is no longer attached")
        return TopologyError(f"action {action} removes tetrahedron {tet}, which is pinned: anchors stay")

    def _settle_for(self, seconds: float, rest_tolerance: float | None = None) -> None:
        """Let time pass and measure; a state that stops being finite is a collapse, not an error."""
        self._diverged = False
        try:
            self.simulation.advance(seconds, settle_step(self.simulation), rest_tolerance)
        except DivergenceError:
            self._diverged = True
        self._measure()

    def _measure(self) -> None:
        """Measure the attached tissue."""
        measure(self.row, ONE_ROW, self.simulation.body.real)

    def _judge(self) -> None:
        """Set the outcome; a collapse counts even where the target has come free."""
        tissue = self.tissue
        tissue = tissue._replace(is_finite=tissue.is_finite and not self._diverged)
        self.outcome = collapse_reason(tissue, self.healthy_share, self.scene.limits)
        if self.outcome is None and not tissue.target_volume:
            self.outcome = SEPARATED


def settle_step(simulation: Simulation) -> float:
    """Return the substep [s] in which a body settles.

    It is the stable step itself, without the usual margin: motion is damped, and certificates are checked in this very physics.
    Where every step is stable, it is the default one.
    """
    return simulation.stable_step if math.isfinite(simulation.stable_step) else simulation.default_step
