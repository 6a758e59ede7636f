"""The load of a scene: scaled until the gentlest order of cuts strains healthy tissue to the share wanted.

Order and load depend on each other, so they are found by turns.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from envs.optimum import MinimumCut, minimum_cut
from envs.order import EXACT_LENGTH, Replay, beam_order, exact_order, replay
from envs.scene import Certificate, Scene
from envs.task import Resection
from gmapspring.errors import ConfigError

LOAD_TOLERANCE = 0.02
"""How near the peak strain comes to the one wanted, relative."""
MAX_ROUNDS = 6
"""Times that the order is searched anew, since a larger load may ask for another."""
MAX_SCALINGS = 12
"""Loads tried for one order."""
GENTLER = 0.998
"""Another order is worth a new calibration if its peak is below this share of the old one."""


class Rejected(Exception):
    """Tell why a seed gives no certificate."""


def proven_plan(cut: MinimumCut) -> tuple[int, ...]:
    """Return the actions of a cheapest cut, or raise `Rejected` where it is not one for certain."""
    if not cut.is_exact:
        raise Rejected("optimum not proven")
    if np.isinf(cut.cost):
        raise Rejected("no cuts free the target and spare the vessel")
    return tuple(int(action) for action in cut.actions)


def calibrated(task: Resection, wanted: float, plan: tuple[int, ...]) -> tuple[tuple[int, ...], float]:
    """Return the gentlest order, and the factor on the load at which its peak strain is the one wanted."""
    order, factor = plan, 1.0
    factor, now = _scale_load(task, wanted, order, factor)
    for _ in range(MAX_ROUNDS):
        better = beam_order(task, plan)
        if not _is_gentler(task, better, now):
            if len(plan) > EXACT_LENGTH:
                break
            better = exact_order(task, plan, GENTLER * now.peak_danger if now.is_in_reach else np.inf)
            if not _is_gentler(task, better, now):
                break
        order = better
        factor, now = _scale_load(task, wanted, order, factor)
    _check(now, wanted)
    return order, factor


def recalibrated(scene: Scene, kappa: float) -> Scene:
    """Return a scene under the load at which its gentlest known order strains healthy tissue to kappa times the limit.

    That order is its certificate's, else what is found for the cheapest cuts; the new certificate is proven by carrying it out.

    Raises:
        ConfigError: there is no such load.
    """
    task, wanted, old = Resection(scene), kappa * scene.limits.strain, scene.certificate
    try:
        if not scene.load.any():
            raise Rejected("a load of zero has no direction")
        if old and old.order:
            optimum, order = old.optimum, old.order
            factor, now = _scale_load(task, wanted, order, 1.0)
            _check(now, wanted)
        else:
            cut = minimum_cut(scene, task.table)
            optimum = cut.cost
            order, factor = calibrated(task, wanted, proven_plan(cut))
        load = scene.load * factor
        load.flags.writeable = False
        scaled = dataclasses.replace(scene, load=load)
        proof = replay(Resection(scaled), order)
        if not proof.survives:
            raise Rejected("no order survives")
    except Rejected as reason:
        raise ConfigError(f"scene {scene.name!r}, seed {scene.seed}: no load gives kappa = {kappa:g}: {reason}") from None
    total = factor * (old.load_factor if old else 1.0)
    certificate = Certificate(optimum, order, total, proof.peak_strain, proof.lowest_volume_ratio)
    return dataclasses.replace(scaled, certificate=certificate)


def _check(now: Replay, wanted: float) -> None:
    """Raise `Rejected` where a replay under the last load tried is not what was wanted."""
    if not now.is_in_reach:
        raise Rejected("no order of the cuts was found that the tool can follow")
    if now.inverts:
        raise Rejected("tissue turns inside out before it is strained enough")
    if not is_calibrated(wanted, now):
        raise Rejected("load cannot be calibrated")


def _is_gentler(task: Resection, order: Sequence[int], now: Replay) -> bool:
    """Return whether an order is clearly gentler than one done under the same load, or the first that a tool can follow."""
    other = replay(task, order)
    return bool(order) and other.is_in_reach and (not now.is_in_reach or other.peak_danger < GENTLER * now.peak_danger)


def is_calibrated(wanted: float, now: Replay) -> bool:
    """Return whether the peak strain is near enough to the one wanted."""
    return abs(now.peak_strain / wanted - 1.0) <= LOAD_TOLERANCE


def _scale_load(task: Resection, wanted: float, order: Sequence[int], factor: float) -> tuple[float, Replay]:
    """Set the load at which the order's peak strain is the one wanted; return its factor and the replay under it."""
    unit = task.scene.load
    for trial in range(MAX_SCALINGS):
        task.set_load(unit * factor)
        now = replay(task, order)
        ratio = wanted / now.peak_strain
        # An order that turns tissue inside out is no measure of a larger load: let a better one be found first.
        if is_calibrated(wanted, now) or (now.inverts and ratio > 1.0) or trial == MAX_SCALINGS - 1:
            break
        # Strain grows somewhat faster than the load; a little less than proportional steps do not overshoot.
        factor *= min(max(ratio, 0.3), 3.0) ** 0.9
    return factor, now
