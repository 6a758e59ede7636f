"""The margin that certificates keep from every limit, so that what ends an episode is no matter of the scheme's last digits."""

from typing import NamedTuple

from envs.order import INVERSION_MARGIN
from envs.scene_config import Limits, SceneConfig
from tests.benchmarks.studies.scene_replay import Trace


class Margin(NamedTuple):
    """How far a body stays from each of its limits."""

    strain: float
    """Below the largest strain."""
    volume_ratio: float
    """Above the smallest volume ratio."""
    healthy_share: float
    """Above the smallest share of healthy tissue."""

    def holds(self, room: "Margin") -> bool:
        """Tell whether a body with so much room keeps this margin."""
        return all(has >= needs for has, needs in zip(room, self, strict=True))


ROOM_KEPT = 0.8
"""Share of the room that a certificate keeps below the limit of the strain, of all that its kappa leaves."""


def stated_margin(config: SceneConfig) -> Margin:
    """Return what every certificate of a scene keeps; the study of labels shows which moves it covers.

    Attached volume is the same under all physics that cut alike, so its share needs no margin.
    """
    return Margin(ROOM_KEPT * (1.0 - config.kappa) * config.limits.strain, INVERSION_MARGIN, healthy_share=0.0)


def room_left(trace: Trace, limits: Limits) -> Margin:
    """Return how far a body stayed from its limits, from the settled start to the last cut."""
    return Margin(
        float(limits.strain - trace.strain.max()),
        float(trace.volume_ratio.min() - limits.volume_ratio),
        float(trace.healthy_share.min() - limits.healthy_share),
    )
