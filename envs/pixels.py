"""Observations as pictures, for agents that learn from pixels."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

from envs.frames import camera_of
from envs.scene import Scene
from envs.task import Resection
from gmapspring.config import known_name
from gmapspring.errors import ConfigError
from gmapspring.render import draw, draw_with_depth
from gmapspring.rendering.camera import Camera
from gmapspring.rendering.skin import body_surface
from gmapspring.rendering.style import Style

Array = np.ndarray[Any, Any]

CHANNELS = {"rgb": 3, "rgbd": 4}
"""Channels of each mode."""

LOOK = Style(wire=0.0, occlusion=0.0)
"""Mesh lines and contact shadows are lost on so few pixels, and cost as much as all the rest."""

SMALLEST, LARGEST = 36, 1024
"""Sides of a picture [pixels]: convolutions as stable-baselines3 has them need 36."""


class PixelObservation(gym.ObservationWrapper[Array, Any, dict[str, Array]], RecordConstructorArgs):
    """Show the body as one picture, uint8 (size, size, channels), seen from the scene's own camera.

    Mode "rgb" has three channels. Mode "rgbd" has a fourth, depth: 0 where there is nothing, else 255 at half of the camera's
    distance down to 1 at one and a half of it; equal steps are equal lengths [m]. All in one array of bytes, so that the usual
    networks for pictures take either (`CnnPolicy`), and that memories of past play stay small; depths in metres are what
    `gmapspring.render.see_faces` gives.

    A picture tells what can be seen and no more: of tetrahedra inside, of stiffness and of forces, nothing. Which actions
    are legal comes by `action_masks()`, as for every other form of the environment.
    """

    def __init__(self, env: gym.Env[dict[str, Array], Any], mode: str = "rgb", size: int = 84) -> None:
        """Wrap a Resect-v0.

        Args:
            env: wrapped or not; it needs no render mode.
            mode: "rgb" or "rgbd".
            size: side of the picture [pixels].
        """
        known_name("pixel mode", mode, CHANNELS)
        if isinstance(size, bool) or not isinstance(size, int) or not SMALLEST <= size <= LARGEST:
            raise ConfigError(f"size must be a whole number from {SMALLEST} to {LARGEST}, not {size!r}")
        RecordConstructorArgs.__init__(self, mode=mode, size=size)
        gym.ObservationWrapper.__init__(self, env)
        self.mode, self.size = mode, (size, size)
        self.observation_space = spaces.Box(0, 255, (size, size, CHANNELS[mode]), np.uint8)

    def action_masks(self) -> Array:
        """Return the legal actions, bool (n_actions,), as MaskablePPO asks for them."""
        masks: Array = self.env.get_wrapper_attr("action_masks")()
        return masks

    def observation(self, observation: dict[str, Array]) -> Array:
        """Return the picture of the body as it is now."""
        task: Resection = self.unwrapped.task  # type: ignore[attr-defined]
        scene: Scene = task.scene
        camera = camera_of(scene, self.size)
        surface = body_surface(task.simulation.body, scene.target, style=LOOK)
        if self.mode == "rgb":
            return draw(surface, camera, self.size, LOOK)
        picture, depth = draw_with_depth(surface, camera, self.size, LOOK)
        return np.concatenate([picture, depth_bytes(depth, camera)[..., None]], axis=2)


def depth_bytes(depth: Array, camera: Camera) -> Array:
    """Return depths [m] as bytes: 255 at half the camera's distance, evenly down to 1 at 1.5 of it, 0 where infinite."""
    nearness = 382.0 - depth * np.float32(254.0 / camera.distance)
    return np.where(np.isfinite(depth), np.clip(np.rint(nearness), 1.0, 255.0), 0.0).astype(np.uint8)
