"""What is measured of a level: its certificates as they ship, the orders that spare its bodies, and what rules earn there."""

from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from envs.action_table import action_table
from envs.baselines import BASELINES, Rule
from envs.library import certificate_path, load_scene_config, load_scenes, read_certificates
from envs.order import EXACT_LENGTH, replay
from envs.orders import agreement, all_orders, feasible_share, gentlest_order, random_orders
from envs.resect import ResectEnv
from envs.scene import Certificate, Scene, build_mesh
from envs.scene_config import SceneConfig
from envs.task import Resection

Row = dict[str, Any]
SEED = 0
"""Of the choice of scenes, of random orders and of random cuts."""


class Effort(NamedTuple):
    """How much is played."""

    n_scenes: int
    """Test scenes of a level."""
    n_orders: int
    """Random orders of a scene whose orders are not counted."""
    n_replays: int
    """Random orders of a scene whose orders are counted, to compare with."""


def effort_for(n_tetrahedra: int) -> Effort:
    """Return how much of a level is played: the larger its bodies, the less."""
    return Effort(*np.clip([15_000 // n_tetrahedra, 60_000 // n_tetrahedra, 20], [6, 30, 0], [32, 300, 20]).tolist())


def sampled_scenes(name: str, count: int) -> list[Scene]:
    """Return some test scenes of a level, chosen at random once and for all."""
    scenes = load_scenes(name, "test")
    chosen = np.random.default_rng(SEED).permutation(len(scenes))[:count]
    return [scenes[int(index)] for index in np.sort(chosen)]


# As they ship -----------------------------------------------------------------------------------------------------


def level_row(name: str) -> Row:
    """Return what a level is, and how many of its seeds were rejected for what."""
    config, records = load_scene_config(name), read_certificates(certificate_path(name)).records
    table = action_table(build_mesh(config.mesh))
    reasons = Counter(record.reason for record in records if not record.certificate)
    counts = Counter(record.split for record in records if record.certificate)
    return {
        "scene": name,
        "tetrahedra": table.n_tetrahedra,
        "actions": table.n_actions,
        "κ": config.kappa,
        "settle [s]": config.physics.settle_seconds,
        "scenes": ", ".join(f"{counts[split]} {split}" for split in config.splits),
        "seeds examined": len(records),
        "rejected [%]": 100.0 * reasons.total() / len(records),
        "for": "; ".join(f"{count} x {reason}" for reason, count in reasons.most_common()) or "-",
    }


def certificate_row(name: str) -> Row:
    """Return plan lengths, costs, loads and margins of all certificates of a level."""
    config, records = load_scene_config(name), read_certificates(certificate_path(name)).records
    return {"scene": name} | certificate_figures(config, [each.certificate for each in records if each.certificate])


def certificate_figures(config: SceneConfig, certificates: Sequence[Certificate]) -> Row:
    """Return the spread of each number of some certificates."""
    loads = np.array([each.load_factor for each in certificates])
    return {
        "cuts: min, median, max": quantiles([len(each.order) for each in certificates], 0, 50, 100),
        "J\\*: min, median, max": quantiles([each.optimum for each in certificates], 0, 50, 100),
        "load factor: 5 %, median, 95 %": quantiles(loads, 5, 50, 95),
        "room below the limit of the strain: min, 5 %, median": quantiles(
            [config.limits.strain - each.peak_strain for each in certificates], 0, 5, 50
        ),
        "lowest volume ratio: min, 5 %, median": quantiles([each.lowest_volume_ratio for each in certificates], 0, 5, 50),
    }


def quantiles(values: Sequence[float] | np.ndarray, *percents: float) -> str:
    """Return some percentiles of values as a table shows them."""
    return ", ".join(f"{value:.3g}" for value in np.percentile(values, percents))


# Orders -----------------------------------------------------------------------------------------------------------


class SceneOrders(NamedTuple):
    """What the orders of one scene's cheapest cuts come to."""

    share: float
    """Feasible orders over all, or over those tried."""
    over_least: float = np.nan
    """Peak strain of the certificate over the least of all orders by the table; NaN where orders are not counted."""
    over_gentlest: float = np.nan
    """The same over that of the order that is gentlest by the table, when it is carried out."""
    moves: Sequence[float] = ()
    """How far strains of replays differ from those of the table."""
    n_labels: int = 0
    n_differing: int = 0
    """Cuts of replays compared with the table, and those after which the body stands in one alone."""

    @property
    def is_counted(self) -> bool:
        """Tell whether all orders were counted."""
        return self.n_labels > 0


def is_countable(scene: Scene) -> bool:
    """Tell whether the cuts are few enough to look at all their sets, and what is legal depends on these alone."""
    return scene.tool_radius is None and scene.certificate is not None and len(scene.certificate.order) <= EXACT_LENGTH


def scene_orders(scene: Scene, effort: Effort) -> SceneOrders:
    """Count the orders of a certified scene that its body stands, or try some."""
    assert scene.certificate is not None
    task, plan, rng = Resection(scene), scene.certificate.plan, np.random.default_rng(scene.seed)
    if not is_countable(scene):
        return SceneOrders(feasible_share(task, random_orders(plan, effort.n_orders, rng)))
    table = all_orders(task, plan)
    compared = agreement(task, plan, table, random_orders(plan, effort.n_replays, rng))
    peak, gentlest = scene.certificate.peak_strain, replay(task, gentlest_order(table, plan))
    # An order that comes near to turning tissue inside out is none that a certificate may take.
    over_gentlest = peak / gentlest.peak_strain if gentlest.survives and not gentlest.inverts else np.nan
    return SceneOrders(table.feasible_share, peak / float(table.peak[-1]), over_gentlest, *compared)


def order_row(name: str, scenes: Sequence[Scene], effort: Effort) -> Row:
    """Return the share of feasible orders of a level."""
    found = [scene_orders(scene, effort) for scene in scenes]
    shares = np.array([each.share for each in found])
    counted = [each for each in found if each.is_counted]
    return {
        "scene": name,
        "scenes": len(found),
        "counted": len(counted),
        "orders tried of each other": effort.n_orders if len(counted) < len(found) else "-",
        "feasible orders [%]": mean_of(100.0 * shares, 1),
        "least, median, most [%]": quantiles(100.0 * shares, 0, 50, 100),
        **counted_figures(counted),
    }


def counted_figures(counted: Sequence[SceneOrders]) -> Row:
    """Return how gentle certificates are among all orders, and how true the counting is; dashes where there is none."""
    moves = [move for each in counted for move in each.moves]
    n_labels, n_differing = (sum(getattr(each, key) for each in counted) for key in ("n_labels", "n_differing"))
    gentlest = [each.over_gentlest for each in counted if np.isfinite(each.over_gentlest)]
    return {
        "certificate's peak over the least, worst": max(each.over_least for each in counted) if counted else "-",
        "over the gentlest order's own, worst": max(gentlest) if gentlest else "-",
        "strain of replays off by: median, 95 %, most": quantiles(moves, 50, 95, 100) if moves else "-",
        "labels off [%]": 100.0 * n_differing / n_labels if counted else "-",
    }


# Rules ------------------------------------------------------------------------------------------------------------


def baseline_row(name: str, scenes: Sequence[Scene]) -> Row:
    """Return what simple rules earn on some scenes of a level."""
    env = ResectEnv(scenes)
    earned = {title: mean_of(returns(env, rule), 2) for title, rule in BASELINES.items()}
    return {"scene": name, "scenes": len(scenes)} | earned


def returns(env: ResectEnv, rule: Rule) -> list[float]:
    """Return what a rule earns on each scene of an environment."""
    rng, earned = np.random.default_rng(SEED), []
    for index in range(len(env.scenes)):
        env.reset(seed=SEED, options={"index": index})
        total, has_ended = 0.0, False
        while not has_ended:
            _, reward, terminated, truncated, _ = env.step(rule(env.task, np.flatnonzero(env.action_masks()), rng))
            total += reward
            has_ended = terminated or truncated
        earned.append(total)
    return earned


def mean_of(values: Sequence[float] | np.ndarray, digits: int) -> str:
    """Return a mean over scenes and its standard error; what chance adds within scenes is part of the spread over them."""
    mean = f"{np.mean(values):.{digits}f}"
    if len(values) == 1:
        return mean
    return f"{mean} ± {np.std(values, ddof=1) / np.sqrt(len(values)):.{digits}f}"
