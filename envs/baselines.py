"""Rules that choose the next cut without learning: what levels are measured with, and policies are compared with.

Each is a function of a task as it stands, the ids of its legal actions, ascending, and a source of chance.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from envs.optimum import minimum_cut
from envs.task import Resection
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]
Rule = Callable[[Resection, Array, np.random.Generator], int]


def random_cut(task: Resection, legal: Array, rng: np.random.Generator) -> int:
    """Choose any legal action."""
    return int(rng.choice(legal))


def rim_first(task: Resection, legal: Array, rng: np.random.Generator) -> int:
    """Cut the face between target and healthy tissue that lies farthest from the middle of all such faces."""
    faces = interface(task, legal)
    if len(faces) == 0:
        return random_cut(task, legal, rng)
    centroid = task.table.face_centroid
    middle = centroid[interface(task, np.arange(task.table.n_faces))].mean(axis=0)
    return int(faces[np.argmax(np.linalg.norm(centroid[faces] - middle, axis=1))])


def lever_first(task: Resection, legal: Array, rng: np.random.Generator) -> int:
    """Cut the face between target and healthy tissue that lies farthest from the line along which the load pulls on the target.

    Both are taken as the body hangs now, so that a stalk is left behind the load, where it is pulled and not bent.
    """
    faces = interface(task, legal)
    return int(faces[np.argmax(levers(task, faces))]) if len(faces) else random_cut(task, legal, rng)


def interface(task: Resection, legal: Array) -> Array:
    """Return those legal actions that cut a face between target and healthy tissue, ascending."""
    faces: Array = legal[legal < task.table.n_faces]
    return faces[np.diff(task.scene.target[task.table.face_tetrahedra[faces]], axis=1)[:, 0]]


def levers(task: Resection, actions: Array) -> Array:
    """Return how far actions are from the line along which the load pulls, as the body hangs now [m], shape (n,).

    Where there are several target regions, each is pulled along a line of its own: an action that touches one is held against
    that, any other against the nearest.
    """
    table, region_of = task.table, task.rules.region_of
    target, centroid = task.scene.target, places(task, table.n_faces + np.arange(table.n_tetrahedra))
    is_left = target & task.is_attached
    regions = np.unique(region_of[is_left])
    parts = [is_left & (region_of == region) for region in regions]
    middles = np.array([np.average(centroid[part], axis=0, weights=table.volume[part]) for part in parts])
    away = places(task, actions)[:, None] - middles
    strength = np.linalg.norm(task.load)
    if strength > 0.0:
        away -= (away @ task.load)[..., None] * task.load / strength**2
    distance = np.linalg.norm(away, axis=2)
    own = np.arange(table.n_tetrahedra)[:, None].repeat(2, axis=1)
    sides = np.concatenate([table.face_tetrahedra, own])[actions, :, None]
    touches = (target[sides] & (region_of[sides] == regions)).any(axis=1)
    distance[~touches & touches.any(axis=1, keepdims=True)] = np.inf
    return np.asarray(distance.min(axis=1))


def places(task: Resection, actions: Array) -> Array:
    """Return where the middles of faces and tetrahedra are, as the body hangs now [m], shape (n, 3)."""
    body, table = task.simulation.body, task.table
    corners = body.nodes.position[body.vertex_of].astype(np.float64)
    is_face, found = actions < table.n_faces, np.empty((len(actions), 3))
    slots = table.face_slots[actions[is_face], :1]
    found[is_face] = corners[slots // 4, OUTWARD_FACE_CORNERS[slots[:, 0] % 4]].mean(axis=1)
    found[~is_face] = corners[actions[~is_face] - table.n_faces].mean(axis=1)
    return found


def minimum_cut_by_index(task: Resection, legal: Array, rng: np.random.Generator) -> int:
    """Work out the cheapest plan anew and do its action of lowest id; physics plays no part."""
    return int(legal_plan(task, legal)[0])


def legal_plan(task: Resection, legal: Array) -> Array:
    """Return the legal actions of the cheapest plan from here, ascending; all legal ones where none of it is legal."""
    allowed = np.intersect1d(cheapest_plan(task), legal)
    return allowed if len(allowed) else legal


def cheapest_plan(task: Resection) -> Array:
    """Return the actions of the cheapest plan from where the body stands, ascending."""
    is_sewn = task.action_mask("all")[: task.table.n_faces].astype(bool)
    return minimum_cut(task.scene, task.table, task.is_attached, is_sewn).actions


BASELINES: dict[str, Rule] = {
    "random": random_cut,
    "rim-first": rim_first,
    "lever-first": lever_first,
    "min-cut-index": minimum_cut_by_index,
}
"""Rules by name."""
