"""The batched twin of Resect-v0: many episodes in one process, stepped by a few calls of kernels."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from envs.actions import MASKS
from envs.arrays import COST, N_STEPS
from envs.collapse import SEPARATED
from envs.frames import Frames
from envs.library import play_list
from envs.observation import Observer, observation_space, one_of
from envs.observation_kernel import Observation
from envs.rewards import Transition, reward, reward_weights
from envs.rows import Start, TaskRows, start_of
from envs.scene import Scene
from envs.selection import CHOICES, Selection, select
from envs.stage import BUDGET, StageCache, build_stage, step_limit
from envs.vector_info import joined, picked
from gmapspring.config import known_name
from gmapspring.errors import ConfigError

Array = np.ndarray[Any, Any]

KEPT_TETRAHEDRA = 200_000
"""Size of all bodies whose starts are kept, together: without a body of their own they take a fifth of what stages take."""
MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


class ResectVectorEnv(VectorEnv[dict[str, Array], Array, Array]):
    """Play many episodes of Resect-v0 side by side.

    `make_vec("envs:Resect-v0", num_envs=..., vectorization_mode="vector_entry_point", ...)` takes the arguments of the
    constructor. Seeded alike and told the same actions, row i gives, bit for bit, what a `ResectEnv` gives with seed + i: the
    same observations, rewards, flags, infos and scenes. A row that diverges ends its own episode; no other row notices.

    Options of `reset` are those of `ResectEnv.reset`, for all rows alike, and `reset_mask`, bool (num_envs,): rows to reset.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 5, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        scene: str | Scene | Sequence[Scene] = "box-108",
        split: str = "train",
        mask: str = "all",
        reward: Mapping[str, float] | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        n_threads: int | None = None,
        render_style: str = "tissue",
    ) -> None:
        """Check everything and find the scenes; bodies are built when they are first played.

        Args:
            num_envs: number of rows.
            scene: as for `ResectEnv`; split, mask, reward and render_style likewise.
            render_mode: None or "rgb_array": there is no window for many episodes at once.
            autoreset_mode: when a row whose episode has ended begins the next one, NEXT_STEP or SAME_STEP.
            n_threads: threads that the rows are spread over; None for none but the caller's.
        """
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise ConfigError(f"num_envs must be a whole number above 0, not {num_envs!r}")
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigError(f"there is no render mode {render_mode!r}; give None or 'rgb_array'")
        self.num_envs, self.mask_mode, self.render_mode = int(num_envs), known_name("mask", mask, MASKS), render_mode
        self._frames = [Frames(render_style) for _ in range(self.num_envs)]
        self.autoreset_mode = _checked_mode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.reward_weights = reward_weights(reward)
        self.scenes = play_list(scene, split)
        self._starts: StageCache[Start] = StageCache(KEPT_TETRAHEDRA)
        self._rows = TaskRows(self._start_of(0), self.num_envs, mask, 1 if n_threads is None else n_threads)
        n_tetrahedra = self.scenes[0].mesh.n_tetrahedra
        self.single_observation_space = observation_space(self._rows.n_faces, n_tetrahedra)
        self.n_actions = self._rows.n_faces + n_tetrahedra
        self.single_action_space = gym.spaces.Discrete(self.n_actions)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.step_limit = step_limit(self.n_actions)
        self._observer = Observer(self.single_observation_space)
        self._all = np.arange(self.num_envs)
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._has_ended = np.ones(self.num_envs, bool)
        self._has_begun = np.zeros(self.num_envs, bool)
        self._scene_names = np.full(self.num_envs, None, dtype=object)
        self._scene_seeds = np.zeros(self.num_envs, np.int64)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode in every row, or in those that options["reset_mask"] names."""
        seeds = [seed + row for row in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        seeds = [None] * self.num_envs if seeds is None else list(seeds)
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds were given for {self.num_envs} rows")
        rows, options = self._rows_to_reset(dict(options or {}))
        for row in rows.tolist():
            if seeds[row] is not None:
                self._generators[row] = seeding.np_random(seeds[row])[0]
        self._begin(rows, options)
        out = self._observer.room_for(self.num_envs)
        self._rows.observe(self._all, out)
        return out._asdict(), picked(self._scene_info(), self._mask_of(rows))

    def step(self, actions: Array) -> tuple[dict[str, Array], Array, Array, Array, dict[str, Any]]:
        """Cut, let the bodies settle, judge them; begin the next episode where the mode says so."""
        if not self._has_begun.all():
            raise gym.error.ResetNeeded("no episode has begun; call reset() first")
        # In mode SAME_STEP no row is ever left ended.
        begins = self._has_ended
        plays = ~begins
        actions = self._checked(actions, plays)
        if begins.any():
            self._begin(np.flatnonzero(begins), {})
        is_legal = plays & (self._rows.masks[self._all, actions] != 0)
        self._rows.play.whole[plays, N_STEPS] += 1
        out = self._observer.room_for(self.num_envs)
        rows = np.flatnonzero(is_legal)
        if self.render_mode is not None:
            self._note(actions, plays)
        self._rows.step(rows, actions[rows], out)
        rewards, terminated, truncated, info = self._judged(is_legal, plays & ~is_legal, begins)
        self._has_ended = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._has_ended.any():
            info = self._begin_ended(out, info)
        else:
            info = joined(picked(info, plays), picked(self._scene_info(), begins))
        return out._asdict(), rewards, terminated, truncated, info

    def action_masks(self) -> Array:
        """Return the legal actions of every row, bool (num_envs, n_actions)."""
        return self._rows.masks.astype(bool)

    def render(self) -> tuple[Array, ...] | None:
        """Return a frame of each row, uint8 (480, 480, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        strain = self._rows.play.strain
        return tuple(
            frames.draw(self.scene_of(row), self._rows.body(row), strain[row]) for row, frames in enumerate(self._frames)
        )

    def scene_of(self, row: int) -> Scene:
        """Return the scene that a row plays."""
        return self._rows.starts[row].scene

    def _judged(self, is_legal: Array, is_illegal: Array, begins: Array) -> tuple[Array, Array, Array, dict[str, Any]]:
        """Return rewards, flags and the info of a step, given the rows that cut, those that may not, and those that began."""
        costs, outcomes = np.where(is_legal, self._rows.costs(), 0.0), self._rows.judge()
        outcomes[~is_legal] = None
        settings, play = self._rows.settings, self._rows.play
        rewards, terms = reward(Transition(costs, settings.optimum, outcomes, is_illegal), self.reward_weights)
        total = play.numbers[:, COST].copy()
        terminated = outcomes != None  # noqa: E711, each element is compared
        is_spent = (total > settings.budget) | (play.whole[:, N_STEPS] >= self.step_limit)
        truncated = is_spent & ~terminated & ~begins
        reasons = outcomes.copy()
        reasons[truncated] = BUDGET
        rewards[begins] = 0.0
        info = {
            "is_success": outcomes == SEPARATED, "reason": reasons, "cost": total, "cost_ratio": total / settings.optimum,
            "reward_terms": terms, "is_illegal": is_illegal,
        } | self._scene_info()  # fmt: skip
        return rewards, terminated, truncated, info

    def _note(self, actions: Array, plays: Array) -> None:
        """Tell the frames what there is before a cut, so that they can show what it frees."""
        for row in np.flatnonzero(plays).tolist():
            self._frames[row].note(self._rows.body(row), int(actions[row]) - self._rows.n_faces)

    def _begin_ended(self, out: Observation, info: dict[str, Any]) -> dict[str, Any]:
        """Begin the next episode in rows that have just ended: their last observation and info go to final_obs and final_info."""
        ended = np.flatnonzero(self._has_ended)
        final = np.full(self.num_envs, None, dtype=object)
        last = Observation(*(array[ended] for array in out))
        for place, row in enumerate(ended.tolist()):
            final[row] = one_of(last, place)
        is_ended = self._has_ended
        parting = {"final_obs": final, "_final_obs": is_ended.copy()} | picked({"final_info": info}, is_ended)
        stays = picked(info, ~is_ended)
        self._begin(ended, {})
        self._rows.observe(ended, out)
        return joined(stays, picked(self._scene_info(), is_ended)) | parting

    def _begin(self, rows: Array, options: Mapping[str, Any]) -> None:
        """Begin an episode in some rows."""
        built: dict[int, Start] = {}
        # Rows that play the same scene share what is made of it.
        selected: dict[int, Selection] = {}
        is_drawn = not any(name in options for name in CHOICES)
        for row in rows.tolist():
            generator = self._generators[row] = self._generators[row] or seeding.np_random(None)[0]
            # Drawn whatever the options say, so that they do not shift the scenes that follow.
            drawn = int(generator.integers(len(self.scenes)))
            key = drawn if is_drawn else 0
            selection = selected[key] = selected.get(key) or select(self.scenes, drawn, options)
            scene = selection.scene
            if scene is None:
                start = self._start_of(selection.place)
            elif id(scene) in built:
                start = built[id(scene)]
            else:
                start = self._rows.starts[row] if scene is self.scene_of(row) else start_of(build_stage(scene))
                built[id(scene)] = start
            self._rows.put(row, start)
            self._frames[row].forget()
            self._scene_names[row], self._scene_seeds[row] = start.scene.name, start.scene.seed
        # New arrays, since the old ones may have been handed out.
        self._has_ended = self._has_ended & ~self._mask_of(rows)
        self._has_begun[rows] = True

    def _start_of(self, index: int) -> Start:
        """Return the start of a scene of the list."""
        start = self._starts.get(index)
        if start is None:
            start = start_of(build_stage(self.scenes[index]))
            self._starts.keep(index, start, start.scene.mesh.n_tetrahedra)
        return start

    def _rows_to_reset(self, options: dict[str, Any]) -> tuple[Array, dict[str, Any]]:
        """Return the rows that a reset is for, and the options that are left."""
        if "reset_mask" not in options:
            return self._all, options
        mask = np.asarray(options.pop("reset_mask"))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ConfigError(f"options.reset_mask must be bool ({self.num_envs},) with at least one True")
        return np.flatnonzero(mask), options

    def _checked(self, actions: Array, plays: Array) -> Array:
        """Return actions as whole numbers; those of rows that do not play do not matter."""
        given = np.asarray(actions)
        if given.shape != (self.num_envs,) or given.dtype.kind not in "iu":
            what = f"whole numbers, one for each of {self.num_envs} rows"
            raise ValueError(f"actions must be {what}, not {given.dtype} {given.shape}")
        given = np.where(plays, given, 0).astype(np.int64)
        for row in np.flatnonzero((given < 0) | (given >= self.n_actions)):
            raise ValueError(f"row {row}: action {given[row]} is out of range 0..{self.n_actions - 1}")
        return given

    def _scene_info(self) -> dict[str, Any]:
        """Return which scene each row plays, as copies."""
        return {"scene": self._scene_names.copy(), "scene_seed": self._scene_seeds.copy()}

    def _mask_of(self, rows: Array) -> Array:
        """Return rows as a mask."""
        mask = np.zeros(self.num_envs, bool)
        mask[rows] = True
        return mask


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return a mode of starting anew, or raise."""
    for known in MODES:
        if mode in (known, known.name, known.value):
            return known
    raise ConfigError(f"there is no autoreset mode {mode!r} here; give AutoresetMode.NEXT_STEP or AutoresetMode.SAME_STEP")
