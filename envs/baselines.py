"""Rules that choose the next cut without learning: what levels are measured with, and policies are compared with.

Each is a function of a task as it stands, the ids of its legal actions, ascending, and a source of chance.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from envs.optimum import minimum_cut
from envs.task import Resection

Array = np.ndarray[Any, Any]
Rule = Callable[[Resection, Array, np.random.Generator], int]


def random_cut(task: Resection, legal: Array, rng: np.random.Generator) -> int:
    """Choose any legal action."""
    return int(rng.choice(legal))


def rim_first(task: Resection, legal: Array, rng: np.random.Generator) -> int:
    """Cut the face between target and healthy tissue that lies farthest from the middle of all such faces."""
    table = task.table
    is_interface = np.diff(task.scene.target[table.face_tetrahedra], axis=1)[:, 0]
    faces = np.intersect1d(np.flatnonzero(is_interface), legal)
    if len(faces) == 0:
        return random_cut(task, legal, rng)
    middle = table.face_centroid[is_interface].mean(axis=0)
    distance = np.linalg.norm(table.face_centroid[faces] - middle, axis=1)
    return int(faces[np.argmax(distance)])


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


BASELINES: dict[str, Rule] = {"random": random_cut, "rim-first": rim_first, "min-cut-index": minimum_cut_by_index}
"""Rules by name."""
