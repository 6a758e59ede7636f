"""What certification finds for one seed, in words: the cheapest cuts, the order that survives, and its margins."""

from collections.abc import Iterator

from envs.action_table import ActionTable, action_table
from envs.calibrate import MAX_ROUNDS, MAX_SCALINGS
from envs.library import Record
from envs.optimum import minimum_cut
from envs.order import BEAM_WIDTH, EXACT_LENGTH
from envs.scene import Certificate, build_scene
from envs.scene_config import Limits, SceneConfig


def describe(config: SceneConfig, found: Record) -> Iterator[str]:
    """Yield lines about the scene of one seed."""
    scene = build_scene(config, found.seed)
    table = action_table(scene.mesh)
    cut = minimum_cut(scene, table)
    yield f"{config.name}, seed {found.seed}: {table.n_tetrahedra} tetrahedra, {int(scene.target.sum())} of them target"
    if not len(cut.actions):
        yield "no cuts free the target and spare the vessel"
    else:
        bound = "J*, the least cost" if cut.is_exact else "an upper bound of the least cost, which is not proven,"
        yield f"{bound} is {cut.cost:.6g} by {len(cut.actions)} cuts, with {int(cut.lost.sum())} healthy tetrahedra lost:"
        yield f"  {named(table, cut.actions.tolist())}"
    if found.certificate:
        yield from margins(table, config.limits, found.certificate)
    else:
        yield f"no certificate: {found.reason}"
        yield (
            f"searched: up to {MAX_ROUNDS} rounds of a beam of {BEAM_WIDTH}, all orders of at most {EXACT_LENGTH} cuts once, "
            f"and up to {MAX_SCALINGS} loads for each order"
        )


def margins(table: ActionTable, limits: Limits, certificate: Certificate) -> Iterator[str]:
    """Yield lines about a certificate: its order, and how far it stays from what healthy tissue bears."""
    strain, ratio = certificate.peak_strain, certificate.lowest_volume_ratio
    yield f"an order that survives, under {certificate.load_factor:.6g} times the configured load:"
    yield f"  {named(table, certificate.order)}"
    yield f"peak strain {strain:.4f}, limit {limits.strain:g}: margin {limits.strain - strain:.4f}"
    yield f"lowest volume ratio {ratio:.4f}, limit {limits.volume_ratio:g}: margin {ratio - limits.volume_ratio:.4f}"


def named(table: ActionTable, actions: "list[int] | tuple[int, ...]") -> str:
    """Return actions in words: what each of them does."""
    return ", ".join(f"cut face {a}" if a < table.n_faces else f"remove tetrahedron {a - table.n_faces}" for a in actions)
