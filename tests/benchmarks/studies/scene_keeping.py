"""A body that keeps what has come loose: the task drops it, so this is what the dropping is measured against."""

import copy
import time
from typing import Any

import numpy as np

from envs.collapse import Tissue, collapse_reason
from envs.task import Resection, settle_step
from gmapspring.measure import tetrahedron_strains, volume_ratios
from gmapspring.simulation import Simulation

Array = np.ndarray[Any, Any]

REPEATS = 5
"""Times that a settling is timed; the shortest counts."""


class Keeper:
    """A copy of a task's body that takes the same cuts and loads, and goes on moving the pieces that come loose."""

    def __init__(self, task: Resection) -> None:
        """Begin where the task stands."""
        self.task = task
        self.simulation: Simulation = copy.deepcopy(task.simulation)

    def apply(self, action: int) -> None:
        """Carry an action out in the task, which drops what comes loose, and in the copy, which does not."""
        self.task.apply(action)
        table = self.task.table
        if action < table.n_faces:
            self.simulation.split_face(*(table.face_slots[action] // 4).tolist())
        else:
            self.simulation.remove_tetrahedron(action - table.n_faces)
        # What is attached bears the load, in the copy too.
        self.simulation.set_corner_loads(self.task.simulation.body.matter.tetrahedra.load)

    def settle(self) -> None:
        """Let both move for the scene's time after a cut."""
        self.task.settle()
        self.simulation.advance(self.task.scene.physics.settle_seconds, settle_step(self.simulation))

    @property
    def tissue(self) -> Tissue:
        """Return what the task measures, with strain and volume ratio as they are in the copy."""
        healthy = self.task.is_attached & ~self.task.scene.target
        body = self.simulation.body
        strain, ratio = (measure(body)[healthy] for measure in (tetrahedron_strains, volume_ratios))
        return self.task.tissue._replace(
            healthy_strain=float(strain.max(initial=0.0)), lowest_volume_ratio=float(ratio.min(initial=1.0))
        )

    @property
    def reason(self) -> str | None:
        """Return why the copy has collapsed, None where it stands."""
        return collapse_reason(self.tissue, self.task.healthy_share, self.task.scene.limits)

    def farthest(self) -> float:
        """Return the largest distance between a corner of attached tissue in the task and in the copy [m]."""
        attached = self.task.is_attached
        return float(np.abs(corners_of(self.task.simulation)[attached] - corners_of(self.simulation)[attached]).max(initial=0.0))


def corners_of(simulation: Simulation) -> Array:
    """Return where the corners of all tetrahedra are [m], (n_tetrahedra, 4, 3); what is removed has arbitrary ones."""
    body = simulation.body
    return np.asarray(body.nodes.position[body.vertex_of], dtype=np.float64)


def settling_time(simulation: Simulation, seconds: float) -> float:
    """Return the processor time of a settling [s]; the body is afterwards as it was."""
    state, times = simulation.save_state(), []
    for _ in range(REPEATS):
        begin = time.thread_time()
        simulation.advance(seconds, settle_step(simulation))
        times.append(time.thread_time() - begin)
        simulation.load_state(state)
    return min(times)


def outer_faces(task: Resection, share: float) -> list[int]:
    """Return the faces between the given share of all tetrahedra that are farthest from any pinned point, and the rest."""
    mesh = task.scene.mesh
    centroids, pinned = mesh.points[mesh.tetrahedra].mean(axis=1), mesh.points[task.scene.pinned]
    distance = np.linalg.norm(centroids[:, None] - pinned, axis=2).min(axis=1)
    is_outer = distance > np.quantile(distance, 1.0 - share)
    sides = is_outer[task.table.face_slots // 4]
    return np.flatnonzero(sides[:, 0] != sides[:, 1]).tolist()
