"""The task without Gymnasium: cut the target free, at a cost, before healthy tissue gives way.

Certificates are made, and episodes are played, by exactly this class.
"""

from typing import Any, NamedTuple

import numpy as np

from envs.actions import MASKS, action_table, surroundings
from envs.attachment import find_attached
from envs.collapse import Tissue, collapse_reason, measure_tissue
from envs.costs import CostParts, face_costs, loss_costs, tetrahedron_costs
from envs.scene import Scene
from gmapspring.body import Material
from gmapspring.errors import DivergenceError, TopologyError
from gmapspring.simulation import Simulation

Array = np.ndarray[Any, Any]

SEPARATED = "separated"
"""Outcome of a target that hangs on nothing any more; the others are the reasons of a collapse."""


class ResectionState(NamedTuple):
    """Everything that `Resection.load_state` needs to go on from here."""

    simulation: Any
    """State of the body, topology included."""

    loaded: Array
    """Target tetrahedra that share the load, bool (n_tetrahedra,)."""

    cost: float
    """Cost so far."""

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
        self.simulation = Simulation(
            mesh,
            Material(scene.young_modulus, physics.density, physics.damping, physics.viscosity),
            pinned=scene.pinned,
            gravity=physics.gravity,
            integrator=physics.integrator,
            dtype=np.dtype(physics.dtype).type,
        )
        self.strain = np.zeros(mesh.n_tetrahedra)
        """Largest edge strain of each tetrahedron, 0 where it is not attached."""
        self.volume_ratio = np.zeros(mesh.n_tetrahedra)
        """Volume over rest volume of each tetrahedron, 0 where it is not attached."""
        self.is_attached = np.zeros(mesh.n_tetrahedra, dtype=bool)
        """Tetrahedra that hang on an anchor; after each action these are all there are."""
        self.label_of = np.zeros(mesh.n_tetrahedra, dtype=np.int32)
        """Component of each tetrahedron in the order of its lowest one, -1 where it is gone."""
        self.n_components = 0
        self.outcome: str | None = None
        """None, "separated" or the reason of a collapse, as judged when the body last settled."""
        self._is_target = np.array(scene.target)
        self._queue = np.zeros(mesh.n_tetrahedra, dtype=np.int32)
        self._loaded = np.zeros(mesh.n_tetrahedra, dtype=bool)
        self._corner_loads = np.zeros((mesh.n_tetrahedra, 4, 3))
        self._face_costs = face_costs(self.table.face_area, scene.spacing)
        self._tetrahedron_costs = tetrahedron_costs(self.table.volume, scene.spacing)
        self._loss_costs = loss_costs(self.table.volume, ~scene.target, scene.spacing)
        self._connect()
        self._drop_loose()
        self._rest = self.simulation.save_state()
        self.set_load(scene.load)

    def set_load(self, load: Array) -> None:
        """Start again under another total force on the target [N], shape (3,)."""
        self.load = np.array(load, dtype=np.float64)
        self.simulation.load_state(self._rest)
        self.cost = 0.0
        self._loaded[:] = False
        self._connect()
        self._spread_load()
        self._settle_for(self.scene.physics.initial_settle_seconds)
        self.start_tissue = self.tissue
        self._judge()
        self._start = self.save_state()

    def reset(self) -> None:
        """Go back to the settled, uncut body."""
        self.load_state(self._start)

    def action_mask(self, mode: str = "all") -> Array:
        """Return which actions a mask mode allows now, int8 (n_actions,)."""
        mask = np.empty(self.table.n_actions, dtype=np.int8)
        gmap = self.simulation.body.gmap
        MASKS[mode](self.table, self.around, gmap.image, gmap.edge_of, self.is_attached, mask)
        return mask

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
        self._check(action)
        table = self.table
        face, tetrahedron = 0.0, 0.0
        if action < table.n_faces:
            first, second = table.face_slots[action] // 4
            self.simulation.split_face(int(first), int(second))
            face = float(self._face_costs[action])
        else:
            self.simulation.remove_tetrahedron(int(action) - table.n_faces)
            tetrahedron = float(self._tetrahedron_costs[action - table.n_faces])
        self._connect()
        parts = CostParts(face, tetrahedron, self._drop_loose())
        self._spread_load()
        self.cost += parts.total
        return parts

    def settle(self) -> None:
        """Let the body move for the scene's time after a cut, and set `outcome`: None, "separated" or a collapse."""
        self._settle_for(self.scene.physics.settle_seconds)
        self._judge()

    @property
    def healthy_share(self) -> float:
        """Return the volume of attached healthy tissue over that at the start."""
        return self.tissue.healthy_volume / self.start_tissue.healthy_volume

    @property
    def target_share(self) -> float:
        """Return the volume of the attached target over that at the start."""
        return self.tissue.target_volume / self.start_tissue.target_volume

    def save_state(self) -> ResectionState:
        """Return a snapshot of the body and the bookkeeping."""
        return ResectionState(self.simulation.save_state(), self._loaded.copy(), self.cost, self.outcome)

    def load_state(self, state: ResectionState) -> None:
        """Go back to a snapshot of the same scene under the same load."""
        self.simulation.load_state(state.simulation)
        self._loaded[:] = state.loaded
        self.cost, self.outcome = state.cost, state.outcome
        self._connect()
        self._measure()

    def _check(self, action: int) -> None:
        """Raise where an action does not exist or does nothing to the body."""
        table, around = self.table, self.around
        if not 0 <= action < table.n_actions:
            raise TopologyError(f"action {action} is out of range 0..{table.n_actions - 1}")
        if action >= table.n_faces:
            tet = action - table.n_faces
            if not self.is_attached[tet]:
                raise TopologyError(f"action {action} removes tetrahedron {tet}, which is no longer attached")
            if around.is_anchor[tet]:
                raise TopologyError(
                    f"action {action} removes tetrahedron {tet}, which is pinned: anchors stay"
                )
            return
        slot = int(table.face_slots[action, 0])
        is_free = self.simulation.body.gmap.image[slot // 4, slot % 4] // 6 == slot
        if is_free or not self.is_attached[slot // 4]:
            raise TopologyError(f"action {action} cuts face {action}, which is cut or no longer attached")

    def _connect(self) -> None:
        """Find what is attached, from the map."""
        gmap = self.simulation.body.gmap
        self.n_components, self._n_loose = find_attached(
            gmap.image, gmap.component_of, self.around.is_anchor, self._queue, self.label_of, self.is_attached
        )

    def _drop_loose(self) -> float:
        """Take pieces that hang on no anchor off the body; return the cost of the healthy tissue among them."""
        if self._n_loose == 0:
            return 0.0
        loose = np.flatnonzero((self.label_of >= 0) & ~self.is_attached)
        self.simulation.cut(tetrahedra=loose)
        self._connect()
        return float(self._loss_costs[loose].sum())

    def _spread_load(self) -> None:
        """Share the total force among the attached target by volume: shaving the target sheds no load."""
        loaded = self._is_target & self.is_attached
        if np.array_equal(loaded, self._loaded):
            return
        self._loaded[:] = loaded
        volume = np.where(loaded, self.table.volume, 0.0)
        # With no target left the sum is 0, and so is every share.
        share = volume / max(float(volume.sum()), np.finfo(np.float64).tiny)
        self._corner_loads[:] = (0.25 * share)[:, None, None] * self.load
        self.simulation.set_corner_loads(self._corner_loads)

    def _settle_for(self, seconds: float) -> None:
        """Let time pass and measure; a state that stops being finite is a collapse, not an error."""
        self._diverged = False
        try:
            # At the bound itself, without the usual margin: motion is damped, and certificates are checked in this very physics.
            self.simulation.advance(seconds, step=self.simulation.stable_step)
        except DivergenceError:
            self._diverged = True
        self._measure()

    def _measure(self) -> None:
        """Measure the attached tissue."""
        body = self.simulation.body
        self.tissue = Tissue(
            *measure_tissue(
                body.gmap,
                body.node_rows.state,
                body.spring_rows.rest_length,
                self.table.volume,
                self._is_target,
                self.is_attached,
                self.strain,
                self.volume_ratio,
            )
        )

    def _judge(self) -> None:
        """Set the outcome; a collapse counts even where the target has come free."""
        tissue = self.tissue._replace(is_finite=self.tissue.is_finite and not self._diverged)
        self.outcome = collapse_reason(tissue, self.healthy_share, self.scene.limits)
        if self.outcome is None and not tissue.target_volume:
            self.outcome = SEPARATED
