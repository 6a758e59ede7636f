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
from gmapspring.jit import kernel
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
        return with_depth(picture, depth, camera)


def with_depth(picture: Array, depth: Array, camera: Camera) -> Array:
    """Return a picture with a fourth channel for depths [m], (height, width, 4).

    It holds 255 at half the camera's distance, evenly down to 1 at 1.5 of it, and 0 where depths are infinite.
    """
    joined = np.empty((*depth.shape, 4), np.uint8)
    _join(picture, depth.astype(np.float32, copy=False), np.float32(254.0 / camera.distance), joined)
    return joined


@kernel
def _join(picture, depth, steps_per_meter, out):
    """Write the four channels of each pixel."""
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            far = depth[row, column]
            step = np.rint(np.float32(382.0) - far * steps_per_meter)
            for channel in range(3):
                out[row, column, channel] = picture[row, column, channel]
            out[row, column, 3] = np.uint8(min(np.float32(255.0), max(np.float32(1.0), step))) if far < np.inf else np.uint8(0)
