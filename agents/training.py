"""Training a policy by PPO: update, validate, keep the best; stop on time, and lose nothing when stopped.

A run is a row of segments, each of the updates between two validations. A segment begins with fresh episodes and with
generators seeded by the run's seed and the step reached, so that a run resumed at one of them goes on bit for bit as
the one that was never stopped.
"""

import copy
import pathlib
import time
from typing import Any, NamedTuple

import numpy as np
import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv

from agents.averaging import WeightAverage
from agents.candidate_policy import CandidatePolicy
from agents.checkpoint import SCENE_JOINT, Page, observation_columns, restore_model, save_checkpoint, start_from
from agents.cloning import clone
from agents.demonstrations import demonstrate, demonstrate_recorded, together
from agents.evaluation import Summary, evaluate, summarise
from agents.flat import FlatPolicy
from agents.interruption import Interruption
from agents.learner import CandidatePPO
from agents.memory import keep_freed_memory
from agents.progress import ProgressReport
from agents.run_folder import RunFolder
from agents.training_config import FlatSettings, TrainingConfig
from agents.training_view import make_environments
from envs.resect import ResectEnv
from gmapspring.errors import GmapspringError

LOGGED = ("approx_kl", "clip_fraction", "entropy_loss", "explained_variance", "policy_gradient_loss", "value_loss")
"""What PPO reports of an update and progress.csv keeps."""


NEVER = 2**62
"""Interval at which SB3 is to write its own log."""


class TrainingError(GmapspringError, RuntimeError):
    """Training that cannot go on."""


class TrainingResult(NamedTuple):
    """How a run ended."""

    n_steps: int
    """Environment steps, those before a resumption included."""
    cpu_seconds: float
    """CPU time, likewise [s]."""
    best_return: float | None
    """Best validation return, None where none was measured."""
    signal: int | None
    """What interrupted the run, None where it ran to its end."""


def make_model(config: TrainingConfig, environments: VecEnv) -> MaskablePPO:
    """Return an untrained model."""
    learner: type[MaskablePPO] = CandidatePPO
    policy: type[MaskableActorCriticPolicy] = CandidatePolicy
    if isinstance(config.network, FlatSettings):
        learner, policy = MaskablePPO, FlatPolicy
    settings = config.ppo
    return learner(
        policy,
        environments,
        n_steps=settings.n_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.n_epochs,
        learning_rate=settings.learning_rate,
        clip_range=settings.clip_range,
        ent_coef=settings.entropy,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        policy_kwargs={"network": config.network},
        seed=config.seed,
        device="cpu",
    )


class Trainer:
    """One run: the model, its environments, its folder."""

    def __init__(
        self,
        config: TrainingConfig,
        folder: pathlib.Path,
        *,
        start: pathlib.Path | None = None,
        resume: bool = False,
        cpu_start: float = 0.0,
    ):
        """Open the folder and make everything, as new or as the last checkpoint left it.

        Args:
            config: what to train.
            folder: where everything goes; see `agents.run_folder`.
            start: a saved policy to begin with.
            resume: go on with the run in the folder; what it began with is in there.
            cpu_start: CPU time of the process that is not the run's [s].
        """
        # A forward pass took 0.13 ms with one thread and 4.8 ms with two on a busy machine.
        torch.set_num_threads(1)
        keep_freed_memory()
        self.config = config
        self.folder = RunFolder(folder)
        self._environments = make_environments(config)
        self._validation = [ResectEnv(scene, "validation", config.mask) for scene in config.scenes]
        self.model = make_model(config, self._environments)
        if start and not resume:
            start_from(start, self.model)
        self._average = WeightAverage(self.model.policy, config.ppo.averaged_updates)
        self.folder.open(config, resume)
        self.model.set_logger(Logger(None, [TensorBoardOutputFormat(str(self.folder.tensorboard))]))
        self._cpu_start, self._best = cpu_start, None
        self._update_cost = self._validation_cost = 0.0
        if resume:
            page = restore_model(self.folder.last, self.model, self._average)
            self._cpu_start -= page.cpu_seconds
            self._best = page.best_return
            self.folder.forget_progress_after(page.n_steps)

    @property
    def cpu_seconds(self) -> float:
        """Return the CPU time of the run so far [s]."""
        return time.process_time() - self._cpu_start

    @property
    def n_steps(self) -> int:
        """Return the environment steps so far."""
        return int(self.model.num_timesteps)

    def run(self, report: ProgressReport) -> TrainingResult:
        """Train until the rule for stopping, or a signal, says so."""
        report.begin_at(self._fraction())
        if self._is_over() and not self.n_steps:
            raise TrainingError("the rule for stopping leaves no time for a single update; raise stop in the configuration")
        with Interruption() as interruption:
            try:
                self._warm_up(report, interruption)
                self._begin_segment()
                while not self._is_over() and interruption.signal is None:
                    self._update(report)
            except KeyboardInterrupt:
                # Half an update is worth less than the last checkpoint.
                if self.folder.last.exists():
                    return TrainingResult(self.n_steps, self.cpu_seconds, self._best, interruption.signal)
            self._save(is_best=self._best is None)
        return TrainingResult(self.n_steps, self.cpu_seconds, self._best, interruption.signal)

    def _warm_up(self, report: ProgressReport, interruption: Interruption) -> None:
        """Clone the certificates where the configuration says so and the run has not begun; keep what comes of it, or nothing."""
        settings = self.config.warm_start
        if settings is None or self.n_steps or self._best is not None:
            return
        set_random_seed(self.config.seed)
        shown = together([demonstrate(scene, "train", self.config.mask) for scene in self.config.scenes])
        if settings.recordings:
            shown = together([shown, demonstrate_recorded(self.config.scenes, settings.recordings, self.config.mask)])
        stop, policy = self.config.stop.cpu_seconds or np.inf, self.model.policy
        assert isinstance(policy, CandidatePolicy), "the configuration is checked"
        start = copy.deepcopy(policy.state_dict())

        def say(share: float, loss: float) -> None:
            report.update(self._fraction(), f"cloning {len(shown.actions)} cuts: {share:4.0%}  -log p {loss:.2f}")
            if interruption.signal is not None:
                raise KeyboardInterrupt
            if self.cpu_seconds > stop:
                raise TrainingError(
                    f"stop.cpu_seconds = {stop:g} is over before warm_start is; raise it or lower warm_start.epochs"
                )

        try:
            clone(policy, shown, settings, np.random.default_rng(self.config.seed), say)
            self._average.begin()
            summary = self._validate()
        except KeyboardInterrupt:
            # What is half cloned is no start: a resumed run clones again, from the same weights.
            policy.load_state_dict(start)
            self._average.begin()
            self._best = None
            raise
        self._note_cloning(summary)
        measures = f"validation return {summary.total_return}, success {summary.success.mean:.2f}"
        report.note(f"cloned in {self.cpu_seconds:.0f} CPU seconds: {measures}")

    def _note_cloning(self, summary: Summary) -> None:
        """Write a line of progress.csv for the policy that was cloned and has not played yet."""
        unknown = ("steps_per_second", "return", "success", "episode_steps", *LOGGED)
        row = {"steps": self.n_steps, "cpu_seconds": round(self.cpu_seconds, 3)} | dict.fromkeys(unknown, "")
        self.folder.write_progress(row | _validation_cells(summary))

    def _begin_segment(self) -> None:
        """Start fresh episodes and generators, as a function of the run's seed and the step reached."""
        state = np.random.SeedSequence([self.config.seed, self.n_steps]).generate_state(1)
        set_random_seed(int(state[0]))
        self._environments.seed(int(state[0]))
        # Without a last observation the model resets the environments itself.
        self.model._last_obs = None

    def _update(self, report: ProgressReport) -> None:
        """Play, learn, and validate where it is time to."""
        before, wall = self.cpu_seconds, time.perf_counter()
        settings = self.config.ppo
        size = settings.n_envs * settings.n_steps
        self.model.learning_rate = settings.learning_rate * 0.5 ** (self.n_steps / settings.learning_rate_half_life)
        self.model._setup_lr_schedule()
        # The policy takes the mask from the observation; SB3 need not ask for it again.
        self.model.learn(size, log_interval=NEVER, reset_num_timesteps=False, use_masking=False)
        if not all(bool(torch.isfinite(tensor).all()) for tensor in self.model.policy.parameters()):
            raise TrainingError(f"the weights stopped being finite at step {self.n_steps}; lower ppo.learning_rate")
        self._average.follow(self._n_updates())
        wall = time.perf_counter() - wall
        self._update_cost = self.cpu_seconds - before
        row = self._measures(wall)
        is_due = self._n_updates() % self.config.validation.every_updates == 0
        summary = self._validate() if is_due or self._is_over() else None
        self._log(row, summary)
        report.update(self._fraction(), _text(row))
        if summary:
            report.note(f"step {self.n_steps}: validation return {summary.total_return}, success {summary.success.mean:.2f}")
            self._begin_segment()

    def _validate(self) -> Summary:
        """Play the validation scenes, and keep the policy, as the best where it is."""
        before = self.cpu_seconds
        n_episodes = self.config.validation.episodes
        with self._average.playing():
            # To play a scene again would find nothing new.
            counts = [min(n_episodes, len(env.scenes)) for env in self._validation]
            played = [evaluate(self.model, env, count) for env, count in zip(self._validation, counts, strict=True)]
            summary = summarise([episode for episodes in played for episode in episodes])
        mean = summary.total_return.mean
        is_best = self._best is None or mean >= self._best
        if is_best:
            self._best = mean
        self._save(is_best, self.folder.checkpoint(self.n_steps))
        self.folder.prune(self.config.validation.keep_checkpoints)
        self._validation_cost = self.cpu_seconds - before
        return summary

    def _save(self, is_best: bool, *paths: pathlib.Path) -> None:
        """Write the last checkpoint, and the same as the best and elsewhere where asked."""
        page = Page(
            scene=SCENE_JOINT.join(self.config.scenes),
            mask=self.config.mask,
            network=self.config.network.model_dump(mode="json"),
            n_steps=self.n_steps,
            cpu_seconds=self.cpu_seconds,
            best_return=self._best,
            columns=observation_columns(),
        )
        best = [self.folder.best] if is_best else []
        with self._average.playing() as learnt:
            save_checkpoint([*paths, *best, self.folder.last], self.model, learnt, page)

    def _measures(self, wall: float) -> dict[str, Any]:
        """Return what is known after an update."""
        settings, logged = self.config.ppo, self.model.logger.name_to_value
        episodes = self.model.ep_info_buffer or [{"r": np.nan, "l": np.nan}]
        return {
            "steps": self.n_steps,
            "cpu_seconds": round(self.cpu_seconds, 3),
            "steps_per_second": round(settings.n_envs * settings.n_steps / wall, 1),
            "return": float(np.mean([episode["r"] for episode in episodes])),
            "success": float(np.mean(self.model.ep_success_buffer or np.nan)),
            "episode_steps": float(np.mean([episode["l"] for episode in episodes])),
            **{name: float(logged[f"train/{name}"]) for name in LOGGED},
        }

    def _log(self, row: dict[str, Any], summary: Summary | None) -> None:
        """Write a line of progress.csv and a point of every curve."""
        self.folder.write_progress(row | _validation_cells(summary))
        logger = self.model.logger
        for name in ("cpu_seconds", "steps_per_second", "return", "success", "episode_steps"):
            logger.record(f"run/{name}", row[name])
        if summary:
            logger.record("validation/return", summary.total_return.mean)
            logger.record("validation/success", summary.success.mean)
        logger.dump(self.n_steps)

    def _n_updates(self) -> int:
        return self.n_steps // (self.config.ppo.n_envs * self.config.ppo.n_steps)

    def _fraction(self) -> float:
        """Return how much of the run is done, from 0 to 1."""
        stop = self.config.stop
        by_steps = self.n_steps / stop.steps if stop.steps else 0.0
        by_time = self.cpu_seconds / stop.cpu_seconds if stop.cpu_seconds else 0.0
        return min(max(by_steps, by_time), 1.0)

    def _is_over(self) -> bool:
        """Return whether another update, and the validation after it, would overrun the rule for stopping."""
        stop, settings = self.config.stop, self.config.ppo
        if stop.steps is not None and self.n_steps + settings.n_envs * settings.n_steps > stop.steps:
            return True
        cost = 1.1 * self._update_cost + self._validation_cost
        return stop.cpu_seconds is not None and self.cpu_seconds + cost > stop.cpu_seconds


def _validation_cells(summary: Summary | None) -> dict[str, Any]:
    """Return the last columns of a line of progress.csv, empty without a validation."""
    return {
        "validation_return": summary.total_return.mean if summary else "",
        "validation_success": summary.success.mean if summary else "",
    }


def _text(row: dict[str, Any]) -> str:
    """Return the measures of an update as they stand beside the bar."""
    return (
        f"{row['steps']} steps  {row['steps_per_second']:.0f} steps/s  return {row['return']:.2f}  success {row['success']:.2f}"
    )
