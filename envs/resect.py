"""Resect-v0: free the target by cutting, at the least cost, and let nothing collapse on the way."""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from envs.actions import MASKS
from envs.arrays import N_STEPS
from envs.collapse import SEPARATED
from envs.costs import NOTHING
from envs.frames import Frames
from envs.library import play_list
from envs.observation import Observer, observation_space, one_of
from envs.observation_kernel import observe
from envs.rewards import Transition, reward, reward_weights
from envs.scene import Scene
from envs.selection import select
from envs.stage import BUDGET, Stage, StageCache, build_stage, step_limit
from envs.task import Resection, ResectionState
from envs.window import Window
from gmapspring.config import known_name
from gmapspring.errors import ConfigError, StateFileError
from gmapspring.simulation import ONE_ROW

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """Everything that `ResectEnv.load_state` needs to go on from here."""

    scene: Scene
    """What is played."""

    task: ResectionState
    """Body and bookkeeping."""

    mask: Array
    """The legal actions, int8 (n_actions,)."""

    has_ended: bool
    """Whether the episode is over."""


class ResectEnv(gym.Env[dict[str, Any], Any]):
    """Cut faces and remove tetrahedra until nothing joins the target to an anchor.

    `make("envs:Resect-v0", ...)` takes the arguments of the constructor. An action outside the mask changes nothing but
    the count of actions and the reward, and `info["is_illegal"]` says so.

    `info` of a step holds is_success, reason (why the episode ended, else None), cost, cost_ratio (over the optimum),
    reward_terms (name -> raw and weighted; the weighted ones sum to the reward), is_illegal, scene and scene_seed.

    `reset(seed=...)` fixes the whole sequence of scenes; `reset(options=...)` may choose the next one by `index`,
    `scene_seed` or `scene`, and change it by `load_factor`, `load`, `target`, `young_modulus`, `mesh` or `kappa`.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 5}

    def __init__(
        self,
        scene: str | Scene | Sequence[Scene] = "box-108",
        split: str = "train",
        mask: str = "all",
        reward: Mapping[str, float] | None = None,
        render_mode: str | None = None,
        render_style: str = "tissue",
    ) -> None:
        """Check everything and find the scenes; bodies are built when they are first played.

        Args:
            scene: name of a shipped scene, a scene file, or scenes of one's own, all on the same mesh.
            split: which of the scene's seeds to play: train, validation or test.
            mask: what counts as legal, a name of `envs.actions.MASKS`.
            reward: weights of reward terms that differ from their defaults.
            render_mode: None, "rgb_array" for frames by `render()`, or "human" for a window, where there is a display.
            render_style: "tissue" or "strain", a heat map; see `envs.frames.STYLES`.
        """
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigError(f"there is no render mode {render_mode!r}; give None, 'rgb_array' or 'human'")
        self.mask_mode, self.render_mode = known_name("mask", mask, MASKS), render_mode
        self._frames = Frames(render_style)
        self._window = Window("Resect-v0", float(self.metadata["render_fps"])) if render_mode == "human" else None
        self.reward_weights = reward_weights(reward)
        self.scenes = play_list(scene, split)
        self._stages: StageCache[Stage] = StageCache()
        self._stage = build_stage(self.scenes[0])
        self._stages.keep(0, self._stage, self._stage.task.table.n_tetrahedra)
        table = self.task.table
        self.action_space = spaces.Discrete(table.n_actions)
        self.observation_space = space = observation_space(table.n_faces, table.n_tetrahedra)
        self.step_limit = step_limit(table.n_actions)
        self._observer = Observer(space)
        self._has_ended = True
        self._mask = self.task.action_mask(self.mask_mode)

    @property
    def task(self) -> Resection:
        """Return the body and rules of the episode, for policies that look ahead; before a reset, of the first scene."""
        return self._stage.task

    @property
    def scene(self) -> Scene:
        """Return the scene of the episode; before a reset, the first one."""
        return self._stage.task.scene

    @property
    def optimum(self) -> float:
        """Return the least total cost J* of the episode's scene."""
        return self._stage.optimum

    @property
    def n_steps(self) -> int:
        """Return the number of actions so far."""
        return int(self.task.play.whole[N_STEPS])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode on the settled, uncut body of a scene."""
        super().reset(seed=seed)
        # Drawn whatever the options say, so that they do not shift the scenes that follow.
        drawn = int(self.np_random.integers(len(self.scenes)))
        selection = select(self.scenes, drawn, options)
        self._stage = (
            self._stage_of(selection.place) if selection.scene is None else self._stage_for(selection.scene)
        )
        self.task.reset()
        self._has_ended = False
        self._mask = self.task.action_mask(self.mask_mode)
        self._frames.forget()
        self._show()
        return self._observe(), {"scene": self.scene.name, "scene_seed": self.scene.seed}

    def step(self, action: int) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Cut, let the body settle, judge it."""
        if self._has_ended:
            raise gym.error.ResetNeeded("the episode has ended, or none has begun; call reset() first")
        action = operator.index(action)
        if not 0 <= action < len(self._mask):
            raise ValueError(f"action {action} is out of range 0..{len(self._mask) - 1}")
        task, scene = self.task, self.scene
        is_illegal = not self._mask[action]
        if self.render_mode is not None:
            self._frames.note(task.simulation.body, action - task.table.n_faces)
        parts = NOTHING if is_illegal else task.step(action)
        task.play.whole[N_STEPS] += 1
        if not is_illegal:
            self._mask = task.action_mask(self.mask_mode)
        outcome = None if is_illegal else task.outcome
        total, terms = reward(Transition(parts.total, self.optimum, outcome, is_illegal), self.reward_weights)
        terminated = outcome is not None
        is_spent = task.cost > scene.budget * self.optimum or self.n_steps >= self.step_limit
        truncated = is_spent and not terminated
        self._has_ended = terminated or truncated
        info = {
            "is_success": outcome == SEPARATED,
            "reason": BUDGET if truncated else outcome,
            "cost": task.cost,
            "cost_ratio": task.cost / self.optimum,
            "reward_terms": terms,
            "is_illegal": is_illegal,
            "scene": scene.name,
            "scene_seed": scene.seed,
        }
        self._show()
        return self._observe(), total, terminated, truncated, info

    def save_state(self) -> EpisodeState:
        """Return a snapshot of the episode; it stays valid as long as the environment, and can be loaded again."""
        return EpisodeState(self.scene, self.task.save_state(), self._mask.copy(), self._has_ended)

    def load_state(self, state: EpisodeState) -> dict[str, Array]:
        """Go back to a snapshot of the episode's scene, and return what there is to see: what follows, follows bit for bit.

        Raises:
            StateFileError: the snapshot is of another scene.
        """
        if state.scene is not self.scene:
            raise StateFileError(f"the state is of scene {state.scene.name!r}, seed {state.scene.seed}, which is not played now")
        self.task.load_state(state.task)
        self._mask, self._has_ended = state.mask.copy(), state.has_ended
        self._frames.forget()
        self._show()
        return self._observe()

    def action_masks(self) -> Array:
        """Return the legal actions, bool (n_actions,), as MaskablePPO asks for them; before a reset, of the first scene."""
        return self._mask.astype(bool)

    def render(self) -> Array | None:
        """Return a frame, uint8 (480, 480, 3), or show it in a window in mode "human"; None without a render mode."""
        if self.render_mode == "rgb_array":
            return self._frame()
        self._show()
        return None

    def close(self) -> None:
        """Shut the window, if there is one."""
        if self._window is not None:
            self._window.close()

    def _frame(self) -> Array:
        """Return a frame of the body as it is now."""
        return self._frames.draw(self.scene, self.task.simulation.body, self.task.strain)

    def _show(self) -> None:
        """Show a frame where there is a window."""
        if self._window is not None:
            self._window.show(self._frame())

    def _observe(self) -> dict[str, Array]:
        """Return what there is to see now."""
        room = self._observer.room_for(1)
        # Policies that look ahead may have asked for another mask since.
        self.task.play.mask[:] = self._mask
        observe(self.task.row, ONE_ROW, self.task.simulation.body.real, ONE_ROW, room)
        return one_of(room, 0)

    def _stage_of(self, index: int) -> Stage:
        """Return a scene of the list, ready to be played."""
        stage = self._stages.get(index)
        if stage is None:
            stage = self._fitting(build_stage(self.scenes[index]))
            self._stages.keep(index, stage, stage.task.table.n_tetrahedra)
        return stage

    def _stage_for(self, scene: Scene) -> Stage:
        """Return a scene from outside the list, ready to be played, or raise where it does not fit the spaces."""
        if scene is self.scene:
            return self._stage
        return self._fitting(build_stage(scene))

    def _fitting(self, stage: Stage) -> Stage:
        """Return a stage, or raise where it does not fit the spaces, which are those of the first one."""
        mine, other = self._stage.task.table, stage.task.table
        if (mine.n_faces, mine.n_tetrahedra) != (other.n_faces, other.n_tetrahedra):
            raise ConfigError(
                f"scene {stage.task.scene.name!r} has {other.n_faces} interior faces and {other.n_tetrahedra} tetrahedra, but "
                f"this environment was made for {mine.n_faces} and {mine.n_tetrahedra}; make another one for it"
            )
        return stage
