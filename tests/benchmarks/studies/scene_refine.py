"""A box scene on a finer mesh: the same geometry, stiffness, target, load, pins and cuts, each cube made of eight."""

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np

from envs.action_table import action_table
from envs.library import load_scenes
from envs.scene import Scene, build_mesh
from envs.scene_config import SceneConfig
from envs.scene_kinds import BoxMesh
from envs.task import Resection
from gmapspring.mesh import Mesh
from tests.benchmarks.studies.scene_replay import (
    SHIPPED,
    Order,
    carried_out,
    compare,
    orders_of,
    percent_of_labels,
    play,
    sample,
    share,
    task_of,
)

Array = np.ndarray[Any, Any]

SAME_POINT = 1e-6
"""Points are one that are nearer than this, in units of length h."""


@dataclasses.dataclass(frozen=True, eq=False)
class Refined:
    """A scene and how it follows from a coarse one."""

    scene: Scene
    parent: Array
    """The coarse tetrahedron that each fine one lies in, (n_fine,)."""
    coarse: Scene

    def cuts(self, order: Order) -> Order:
        """Return cuts of the coarse scene as cuts along the same surfaces: all parts of a face, or of a tetrahedron, at once."""
        coarse, fine = action_table(self.coarse.mesh), action_table(self.scene.mesh)
        sides = np.sort(self.parent[fine.face_slots // 4], axis=1)
        cuts = []
        for cut in order:
            parts: list[int] = []
            for action in cut:
                if action < coarse.n_faces:
                    lies_in = (sides == np.sort(coarse.face_slots[action] // 4)).all(axis=1)
                    parts += np.flatnonzero(lies_in).tolist()
                else:
                    parts += (fine.n_faces + np.flatnonzero(self.parent == action - coarse.n_faces)).tolist()
            cuts.append(parts)
        return cuts

    def gauge_strain(self, task: Resection) -> float:
        """Return the largest healthy strain of the fine body in play, measured along the edges of the coarse mesh.

        Near the end of a cut strain has no limit as meshes get finer; over a fixed length it has one.
        """
        body, rest = task.simulation.body, self.coarse.mesh.points[self.coarse.mesh.tetrahedra]
        child, column = self._corner_children
        stands = task.is_attached[child].all(axis=1) & ~self.coarse.target
        corners = body.nodes.position.astype(np.float64)[body.vertex_of[child, column]][stands]
        return float((_edge_lengths(corners) / _edge_lengths(rest[stands])).max(initial=1.0) - 1.0)

    @cached_property
    def _corner_children(self) -> tuple[Array, Array]:
        """Return, for each corner of each coarse tetrahedron, the fine one that lies there, and which of its corners it is."""
        fine, coarse = self.scene.mesh, self.coarse.mesh
        corners, around = fine.points[fine.tetrahedra], coarse.points[coarse.tetrahedra[self.parent]]
        distance = np.linalg.norm(corners[:, :, None] - around[:, None], axis=3)
        lies_there, its_corner, corner = np.nonzero(distance < SAME_POINT * self.coarse.spacing)
        child, column = np.empty((2, coarse.n_tetrahedra, 4), dtype=np.int64)
        child[self.parent[lies_there], corner] = lies_there
        column[self.parent[lies_there], corner] = its_corner
        return child, column


def _edge_lengths(corners: Array) -> Array:
    """Return the lengths of the six edges of tetrahedra, given their corners (n, 4, 3), shape (n, 6)."""
    start, end = np.triu_indices(4, 1)
    return np.asarray(np.linalg.norm(corners[:, end] - corners[:, start], axis=2))


def refine(scene: Scene, config: SceneConfig, factor: int) -> Refined:
    """Return a box scene on cubes of an edge that many times shorter.

    Cubes cut alike round their diagonals stay so when they are divided (Freudenthal, 1942): each fine tetrahedron lies in a
    single coarse one, and each coarse face is made of whole fine ones.
    """
    assert isinstance(config.mesh, BoxMesh)
    n_x, n_y, n_z = config.mesh.cells
    fine = BoxMesh(kind="box", cells=(factor * n_x, factor * n_y, factor * n_z), spacing=config.mesh.spacing / factor)
    mesh = build_mesh(fine)
    parent = containing(scene.mesh, config.mesh, mesh.points[mesh.tetrahedra].mean(axis=1))
    changed = dataclasses.replace(
        scene,
        mesh=mesh,
        target=scene.target[parent],
        pinned=config.pinned.points(mesh),
        young_modulus=scene.young_modulus[parent],
        certificate=None,
    )
    return Refined(changed, parent, scene)


def containing(mesh: Mesh, box: BoxMesh, points: Array) -> Array:
    """Return the tetrahedron of a box that each point lies in, (n_points,)."""
    cube = np.ravel_multi_index(tuple((points / box.spacing).astype(int).T), box.cells)
    candidates = 6 * cube[:, None] + np.arange(6)
    corners = mesh.points[mesh.tetrahedra[candidates]]
    edges = np.swapaxes(corners[:, :, 1:] - corners[:, :, :1], 2, 3)
    weights = np.linalg.solve(edges, (points[:, None] - corners[:, :, 0])[..., None])[..., 0]
    # A point lies inside where all four weights are positive.
    inside = np.minimum(weights.min(axis=2), 1.0 - weights.sum(axis=2))
    return np.asarray(candidates[np.arange(len(points)), inside.argmax(axis=1)])


def refined_row(family: str, factor: int, n_scenes: int, n_random: int) -> dict[str, Any]:
    """Return strains and labels on one finer mesh against those on the scene's own."""
    config = load_scenes(family, "train").config
    moves, uncut, peaks, gauges = [], [], [], []
    for scene in sample(family, "train", n_scenes):
        refined, task = refine(scene, config, factor), task_of(scene, SHIPPED)
        fine = task_of(refined.scene, SHIPPED)
        for number, order in enumerate(orders_of(scene, n_random)):
            trace, reference = play(fine, refined.cuts(order)), play(task, order)
            moves.append(compare(trace, reference))
            if number == 0:
                gauge = max(refined.gauge_strain(fine) for _ in carried_out(fine, refined.cuts(order)))
                uncut.append(trace.strain[0] / reference.strain[0])
                peaks.append(trace.strain.max() / reference.strain.max())
                gauges.append(gauge / reference.strain.max())
    certificates = moves[:: n_random + 1]
    return {
        "family": family,
        "mesh": f"h/{factor}",
        "scenes": len(peaks),
        "uncut strain over own": float(np.median(uncut)),
        "certificate's peak over own": float(np.median(peaks)),
        "95th percentile": float(np.percentile(peaks, 95.0)),
        "the same along the own mesh's edges": float(np.median(gauges)),
        "labels that differ, all orders [%]": percent_of_labels(moves),
        "certificates that end otherwise [%]": share(move.ends_otherwise for move in certificates),
    }
