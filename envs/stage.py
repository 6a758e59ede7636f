"""Scenes made ready to be played, and kept so: a reset restores a settled body instead of building one."""

from collections import OrderedDict
from typing import Any, NamedTuple

from envs.observation import constants_of
from envs.observation_kernel import Constants
from envs.optimum import minimum_cut
from envs.scene import Scene
from envs.task import Resection

KEPT_TETRAHEDRA = 40_000
"""Size of all bodies that an environment keeps settled, together; about 100 MB."""


class Stage(NamedTuple):
    """One scene ready to be played."""

    task: Resection
    """Body and rules."""

    constants: Constants
    """What observations of it need."""

    optimum: float
    """Least total cost J* that frees the target."""


def build_stage(scene: Scene) -> Stage:
    """Build and settle the body of a scene; without a certificate the optimum is worked out here."""
    task = Resection(scene)
    optimum = scene.certificate.optimum if scene.certificate else minimum_cut(scene, task.table).cost
    return Stage(task, constants_of(task), optimum)


class StageCache:
    """Keep the stages of a list of scenes, the least recently played leaving first."""

    def __init__(self) -> None:
        """Start empty."""
        self._stages: OrderedDict[int, Stage] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        """Return an empty cache: what it held can be built again wherever a copy goes."""
        return {"_stages": OrderedDict()}

    def get(self, index: int) -> Stage | None:
        """Return a stage if it is kept."""
        stage = self._stages.get(index)
        if stage is not None:
            self._stages.move_to_end(index)
        return stage

    def keep(self, index: int, stage: Stage) -> None:
        """Keep a stage, and let others go where there is no room for all; the newest always stays."""
        self._stages[index] = stage
        total = sum(kept.task.table.n_tetrahedra for kept in self._stages.values())
        while total > KEPT_TETRAHEDRA and len(self._stages) > 1:
            total -= self._stages.popitem(last=False)[1].task.table.n_tetrahedra
