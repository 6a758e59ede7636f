"""The registered schemes, at the substeps that a scene can be played with."""

import math
from typing import NamedTuple

from envs.scene import Scene
from gmapspring.integrators import INTEGRATORS
from gmapspring.stability import stable_step
from tests.benchmarks.studies.scene_replay import SHIPPED, Variant, task_of

SHARES_OF_STABLE, SHARES_OF_SHIPPED = (1.0, 0.5), (4.0, 1.0, 0.25)
"""Substeps tried of a scheme: over its stable one; or, where it is stable at any, over that of the scene's own scheme."""
MOST_SUBSTEPS = 1000
"""A scheme that needs more of them for one settling is left out."""


class Schemes(NamedTuple):
    """What there is to try of the registered schemes."""

    variants: list[Variant]
    cheap: list[Variant]
    """Those quick enough for every shipped scene."""
    skipped: dict[str, str]
    """Why a scheme is left out, by name."""


def schemes_for(scene: Scene) -> Schemes:
    """Return the registered schemes at the substeps that they allow."""
    body, result = task_of(scene, SHIPPED).simulation.body, Schemes([], [], {})
    for name, integrator in INTEGRATORS.items():
        stable = stable_step(body, integrator)
        if not stable * MOST_SUBSTEPS > scene.physics.settle_seconds:
            result.skipped[name] = f"its stable step is {stable:.1e} s"
            continue
        is_own, is_bounded = name == scene.physics.integrator, math.isfinite(stable)
        shares = [share for share in (SHARES_OF_STABLE if is_bounded else SHARES_OF_SHIPPED) if not (is_own and share == 1.0)]
        variants = [Variant(f"{name}, step x {share:g}", physics={"integrator": name}, step=share) for share in shares]
        result.variants.extend(variants)
        result.cheap.extend(variants[:1] if is_bounded else [])
    return result
