"""What certificates show: every state along them, as the policy sees it, and the cut that comes next."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.candidate_policy import read_candidates
from agents.features import Candidates
from envs.scene import Scene
from envs.vector import ResectVectorEnv
from gmapspring.errors import GmapspringError

N_ROWS = 32
"""Scenes played side by side."""


class DemonstrationError(GmapspringError, ValueError):
    """A certificate that cannot be followed."""


class Demonstrations(NamedTuple):
    """States, and what to do in each."""

    states: list[Candidates]
    actions: np.ndarray
    """Action ids, int64, shape (n_states,)."""


def together(parts: Sequence[Demonstrations]) -> Demonstrations:
    """Return what several scenes show, one after the other."""
    return Demonstrations([state for part in parts for state in part.states], np.concatenate([part.actions for part in parts]))


def demonstrate(scene: str | Sequence[Scene], split: str, mask: str) -> Demonstrations:
    """Play the certificate of every scene of a split once.

    Raises:
        DemonstrationError: a certificate is missing, makes a cut that the mask forbids, or does not free the
            target with just its last cut.
    """
    envs = ResectVectorEnv(N_ROWS, scene, split, mask, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=0)
    states: list[Candidates] = []
    actions: list[int] = []
    for first in range(0, len(envs.scenes), N_ROWS):
        observation, shown = _begin(envs, range(first, min(first + N_ROWS, len(envs.scenes))))
        orders = [_order(scene) for scene in shown]
        for place in range(max(map(len, orders))):
            rows = [row for row, order in enumerate(orders) if place < len(order)]
            chosen = observation["action_mask"].argmax(axis=1)
            chosen[rows] = [orders[row][place] for row in rows]
            for row in rows:
                if not observation["action_mask"][row, chosen[row]]:
                    raise DemonstrationError(
                        f"the certificate of {_name(shown[row])} makes a cut that the mask {mask!r} forbids: "
                        "there is nothing to clone; choose another mask, or no warm_start"
                    )
            seen = read_candidates(observation).split()
            states += [seen[row] for row in rows]
            actions += chosen[rows].tolist()
            observation, _, terminated, truncated, info = envs.step(chosen)
            has_ended = terminated | truncated
            for row in rows:
                is_last = place + 1 == len(orders[row])
                # What a row shows after its end is another scene.
                if has_ended[row] != is_last or (is_last and not info["final_info"]["is_success"][row]):
                    raise DemonstrationError(
                        f"{_name(shown[row])} is not freed by the {len(orders[row])} cuts of its certificate, or by fewer: "
                        "there is nothing to clone; certify the scenes again"
                    )
    return Demonstrations(states, np.array(actions))


def _begin(envs: ResectVectorEnv, indices: range) -> tuple[dict[str, np.ndarray], list[Scene]]:
    """Let a row begin each of some scenes; return what is seen, and the scenes."""
    for row, index in enumerate(indices):
        mask = np.arange(envs.num_envs) == row
        observation, _ = envs.reset(options={"index": index, "reset_mask": mask})
    return observation, [envs.scene_of(row) for row in range(len(indices))]


def _order(scene: Scene) -> tuple[int, ...]:
    """Return the cuts of a scene's certificate."""
    if scene.certificate is None or not scene.certificate.order:
        raise DemonstrationError(f"{_name(scene)} has no certificate: there is nothing to clone")
    return scene.certificate.order


def _name(scene: Scene) -> str:
    return f"scene {scene.name!r}, seed {scene.seed},"
