"""The load of a scene: scaled until the gentlest order of cuts strains healthy tissue to the share wanted.

Order and load depend on each other, so they are found by turns.
"""

from collections.abc import Sequence

from envs.order import EXACT_LENGTH, Replay, beam_order, exact_order, replay
from envs.scene_config import SceneConfig
from envs.task import Resection

LOAD_TOLERANCE = 0.02
"""How near the peak strain comes to kappa times the limit, relative."""
MAX_ROUNDS = 6
"""Times that the order is searched anew, since a larger load may ask for another."""
MAX_SCALINGS = 12
"""Loads tried for one order."""
GENTLER = 0.998
"""Another order is worth a new calibration if its peak is below this share of the old one."""


class Rejected(Exception):
    """Tell why a seed gives no certificate."""


def calibrated(task: Resection, config: SceneConfig, plan: tuple[int, ...]) -> tuple[tuple[int, ...], float]:
    """Return the gentlest order, and the factor on the load at which its peak strain is the one wanted."""
    order, factor, is_exact = plan, 1.0, len(plan) > EXACT_LENGTH
    factor, now = _scale_load(task, config, order, factor)
    for _ in range(MAX_ROUNDS):
        better = beam_order(task, plan)
        if not _is_gentler(task, better, now):
            if is_exact:
                break
            is_exact = True
            better = exact_order(task, plan, GENTLER * now.peak_danger)
            if not better or not _is_gentler(task, better, now):
                break
        order = better
        factor, now = _scale_load(task, config, order, factor)
    if now.inverts:
        raise Rejected("tissue turns inside out before it is strained enough")
    if not is_calibrated(config, now):
        raise Rejected("load cannot be calibrated")
    return order, factor


def _is_gentler(task: Resection, order: Sequence[int], now: Replay) -> bool:
    """Return whether an order is clearly gentler than one that has been carried out under the same load."""
    return replay(task, order).peak_danger < GENTLER * now.peak_danger


def is_calibrated(config: SceneConfig, now: Replay) -> bool:
    """Return whether the peak strain is near enough to the one wanted."""
    return abs(now.peak_strain / (config.kappa * config.limits.strain) - 1.0) <= LOAD_TOLERANCE


def _scale_load(task: Resection, config: SceneConfig, order: Sequence[int], factor: float) -> tuple[float, Replay]:
    """Set the load at which the order's peak strain is the one wanted; return its factor and the replay under it."""
    unit = task.scene.load
    for trial in range(MAX_SCALINGS):
        task.set_load(unit * factor)
        now = replay(task, order)
        ratio = config.kappa * config.limits.strain / now.peak_strain
        # An order that turns tissue inside out is no measure of a larger load: let a better one be found first.
        if is_calibrated(config, now) or (now.inverts and ratio > 1.0) or trial == MAX_SCALINGS - 1:
            break
        # Strain grows somewhat faster than the load; a little less than proportional steps do not overshoot.
        factor *= min(max(ratio, 0.3), 3.0) ** 0.9
    return factor, now
