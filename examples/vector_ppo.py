"""Train on many environments side by side with MaskablePPO of sb3-contrib, for a few steps only.

`ResectVecEnv` is the batch as stable-baselines3 sees it; `action_masks()` tells the learner what is legal.

Prints:
    4 environments, 120 actions
    128 steps, and every action was legal
"""

import numpy as np
from sb3_contrib import MaskablePPO

from agents.vector_face import ResectVecEnv


class Watched(ResectVecEnv):
    """The same, which counts the actions that were refused."""

    n_illegal = 0

    def step_async(self, actions: np.ndarray) -> None:
        """Look before they are done."""
        legal = np.stack(self.env_method("action_masks"))
        self.n_illegal += int((~legal[np.arange(self.num_envs), actions]).sum())
        super().step_async(actions)


environments = Watched(4, scene="box-48", split="train")
print(f"{environments.num_envs} environments, {environments.action_space.n} actions")
model = MaskablePPO("MultiInputPolicy", environments, n_steps=16, batch_size=32, n_epochs=1, seed=0, device="cpu")
model.learn(total_timesteps=128)
print(f"{model.num_timesteps} steps, and", "every action was legal" if not environments.n_illegal else "some were refused")
