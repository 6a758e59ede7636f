"""Scenes made ready to be played, and kept so: a reset restores a settled body instead of building one."""

import math
from collections import OrderedDict
from typing import Any, Generic, NamedTuple, TypeVar

from envs.optimum import minimum_cut
from envs.scene import Scene
from envs.task import Resection
from gmapspring.errors import ConfigError

KEPT_TETRAHEDRA = 40_000
"""Size of all bodies that an environment keeps settled, together; about 100 MB."""

BUDGET = "budget"
"""Reason of an episode that is cut short, by its cost or by its number of actions."""

Kept = TypeVar("Kept")


class Stage(NamedTuple):
    """One scene ready to be played."""

    task: Resection
    """Body and rules."""

    optimum: float
    """Least total cost J* that frees the target."""


def build_stage(scene: Scene) -> Stage:
    """Build and settle the body of a scene; without a certificate the optimum is worked out here."""
    task = Resection(scene)
    optimum = scene.certificate.optimum if scene.certificate else minimum_cut(scene, task.table).cost
    if math.isinf(optimum):
        raise ConfigError(f"scene {scene.name!r}, seed {scene.seed}: no cuts free the target and spare the vessel")
    return Stage(task, optimum)


def step_limit(n_actions: int) -> int:
    """Return after how many actions an episode is cut short: from the mesh alone, so that it tells nothing of the optimum."""
    return 10 + n_actions // 8


class StageCache(Generic[Kept]):
    """Keep the stages of a list of scenes, the least recently played leaving first."""

    def __init__(self, n_tetrahedra: int = KEPT_TETRAHEDRA) -> None:
        """Start empty; n_tetrahedra: size of all that is kept, together."""
        self._room = n_tetrahedra
        self._stages: OrderedDict[int, tuple[Kept, int]] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        """Return an empty cache: what it held can be built again wherever a copy goes."""
        return {"_room": self._room, "_stages": OrderedDict()}

    def get(self, index: int) -> Kept | None:
        """Return a stage if it is kept."""
        found = self._stages.get(index)
        if found is None:
            return None
        self._stages.move_to_end(index)
        return found[0]

    def keep(self, index: int, stage: Kept, n_tetrahedra: int) -> None:
        """Keep a stage of some size, and let others go where there is no room for all; the newest always stays."""
        self._stages[index] = stage, n_tetrahedra
        total = sum(size for _, size in self._stages.values())
        while total > self._room and len(self._stages) > 1:
            total -= self._stages.popitem(last=False)[1][1]
