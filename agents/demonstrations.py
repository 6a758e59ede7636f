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


def demonstrate(scene: str | Sequence[Scene], split: str, mask: str) -> Demonstrations:
    """Play the certificate of every scene of a split once.

    Raises:
        DemonstrationError: a certificate makes a cut that the mask forbids.
    """
    envs = ResectVectorEnv(N_ROWS, scene, split, mask, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=0)
    states: list[Candidates] = []
    actions: list[int] = []
    for first in range(0, len(envs.scenes), N_ROWS):
        observation, orders = _begin(envs, range(first, min(first + N_ROWS, len(envs.scenes))))
        for place in range(max(map(len, orders))):
            rows = [row for row, order in enumerate(orders) if place < len(order)]
            chosen = observation["action_mask"].argmax(axis=1)
            chosen[rows] = [orders[row][place] for row in rows]
            for row in rows:
                if not observation["action_mask"][row, chosen[row]]:
                    shown = envs.scene_of(row)
                    raise DemonstrationError(
                        f"the certificate of {shown.name}, seed {shown.seed}, makes a cut that the mask {mask!r} forbids: "
                        "there is nothing to clone; choose another mask, or no warm_start"
                    )
            seen = read_candidates(observation).split()
            states += [seen[row] for row in rows]
            actions += chosen[rows].tolist()
            observation = envs.step(chosen)[0]
    return Demonstrations(states, np.array(actions))


def _begin(envs: ResectVectorEnv, indices: range) -> tuple[dict[str, np.ndarray], list[tuple[int, ...]]]:
    """Let a row begin each of some scenes; return what is seen, and their certificates' orders."""
    for row, index in enumerate(indices):
        mask = np.arange(envs.num_envs) == row
        observation, _ = envs.reset(options={"index": index, "reset_mask": mask})
    certificates = [envs.scene_of(row).certificate for row in range(len(indices))]
    return observation, [certificate.order if certificate else () for certificate in certificates]
