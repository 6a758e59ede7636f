"""Play the environment with a policy of a few lines: of the faces between target and healthy tissue, cut the least strained.

The loop is gymnasium's; the observation is a dictionary of arrays, with the legal actions in `action_mask`.

Prints:
    episode 0: tear after 5 cuts, return -1.417
    episode 1: separated after 6 cuts, return 1.000
"""

import gymnasium as gym
import numpy as np

from envs.observation import COLUMNS

NAMES = [column.name for column in COLUMNS["tetrahedra"]]
STRAIN, TARGET = NAMES.index("strain"), NAMES.index("target")


def choose(observation: dict[str, np.ndarray], env: gym.Env) -> int:
    """Return a legal face round the target, or else any legal face: the one whose two tetrahedra are strained least."""
    beside = observation["tetrahedra"][env.unwrapped.task.table.face_tetrahedra]
    is_legal = observation["action_mask"][: len(beside)].astype(bool)
    is_round = is_legal & (beside[:, 0, TARGET] != beside[:, 1, TARGET])
    strain = beside[:, :, STRAIN].max(axis=1)
    return int(np.where(is_round if is_round.any() else is_legal, strain, np.inf).argmin())


env = gym.make("envs:Resect-v0", scene="box-48", split="test", mask="focus")
for episode in range(2):
    observation, info = env.reset(seed=episode)
    total, is_over = 0.0, False
    while not is_over:
        observation, reward, terminated, truncated, info = env.step(choose(observation, env))
        total += reward
        is_over = terminated or truncated
    print(f"episode {episode}: {info['reason']} after {env.unwrapped.n_steps} cuts, return {total:.3f}")
