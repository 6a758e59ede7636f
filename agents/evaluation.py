"""Playing a policy on held-out scenes, and what the episodes come to."""

import csv
import io
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np

from agents.trials import n_simulated

Array = np.ndarray[Any, Any]


class Policy(Protocol):
    """Anything with stable-baselines3's `predict`."""

    def predict(
        self,
        observation: dict[str, Array],
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
        action_masks: Array | None = None,
    ) -> tuple[Any, Any]:
        """Return an action and the next state."""
        ...


class Episode(NamedTuple):
    """One episode, played to its end."""

    policy: str
    """Name of the policy."""
    scene: str
    """Name of the scene."""
    scene_seed: int
    """Seed of the scene."""
    total_return: float
    """Sum of the rewards; the optimum is 1."""
    is_success: bool
    """Whether the target came free and nothing collapsed."""
    reason: str
    """Why the episode ended."""
    cost_ratio: float
    """Cost over the least cost J*."""
    n_steps: int
    """Actions taken."""
    n_simulated: int
    """Steps of the simulator that the policy spent on thinking, those of the episode itself left out."""
    seconds: float
    """Wall time of choosing and acting [s], the reset left out."""


class Estimate(NamedTuple):
    """A mean over episodes."""

    mean: float
    """Mean, NaN where there is nothing to average."""
    error: float
    """Standard error of the mean."""
    spread: float
    """Standard deviation over the episodes."""

    def __str__(self) -> str:
        """Return mean, standard error and spread, or a dash."""
        if np.isnan(self.mean):
            return "-"
        digits = 0 if abs(self.mean) >= 100 else 2
        return f"{self.mean:.{digits}f} ± {self.error:.{digits}f} (sd {self.spread:.{digits}f})"


class Summary(NamedTuple):
    """What the episodes of one policy come to."""

    policy: str
    n_episodes: int
    total_return: Estimate
    success: Estimate
    cost_ratio: Estimate
    """Over the successful episodes only: a body that collapses at the first cut has cost little."""
    n_simulated: Estimate
    """Steps of the simulator spent on thinking, per episode."""
    steps_per_second: Estimate
    reasons: dict[str, int]
    """How often each reason ended an episode, the most frequent first."""


def play_episode(policy: Policy, env: gym.Env[Any, Any], name: str, seed: int, index: int) -> Episode:
    """Play one scene of the environment's list to the end, every choice deterministic."""
    observation, _ = env.reset(seed=seed, options={"index": index})
    state, total, n_steps, has_ended = None, 0.0, 0, False
    info: dict[str, Any] = {}
    n_before, start = n_simulated(policy), time.perf_counter()
    while not has_ended:
        first = np.array([n_steps == 0])
        action, state = policy.predict(observation, state, episode_start=first, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(int(action))
        total += float(reward)
        n_steps += 1
        has_ended = terminated or truncated
    seconds = time.perf_counter() - start
    return Episode(
        name, info["scene"], info["scene_seed"], total, info["is_success"], info["reason"], info["cost_ratio"],
        n_steps, n_simulated(policy) - n_before, seconds,
    )  # fmt: skip


def evaluate(
    policy: Policy,
    env: gym.Env[Any, Any],
    n_episodes: int | None = None,
    *,
    name: str = "policy",
    seed: int = 0,
    on_episode: Callable[[Episode], None] = lambda episode: None,
) -> list[Episode]:
    """Play the scenes of an environment in order, each once unless told otherwise.

    Args:
        policy: who plays; scripted ones must be bound to the environment.
        env: a Resect-v0, wrapped or not.
        n_episodes: how many; more than there are scenes plays some again.
        name: what to call the policy in the result.
        seed: of the first episode; the others count up from it.
        on_episode: called after every episode, to show progress.
    """
    n_scenes = len(env.unwrapped.scenes)  # type: ignore[attr-defined]
    episodes = []
    for number in range(n_scenes if n_episodes is None else n_episodes):
        episodes.append(play_episode(policy, env, name, seed + number, number % n_scenes))
        on_episode(episodes[-1])
    return episodes


def summarise(episodes: Sequence[Episode]) -> Summary:
    """Return means, standard errors and spreads over the episodes of one policy."""
    return Summary(
        policy=episodes[0].policy,
        n_episodes=len(episodes),
        total_return=estimate(episode.total_return for episode in episodes),
        success=estimate(float(episode.is_success) for episode in episodes),
        cost_ratio=estimate(episode.cost_ratio for episode in episodes if episode.is_success),
        n_simulated=estimate(episode.n_simulated for episode in episodes),
        steps_per_second=estimate(episode.n_steps / episode.seconds for episode in episodes),
        reasons=dict(Counter(episode.reason for episode in episodes).most_common()),
    )


def estimate(values: Iterable[float]) -> Estimate:
    """Return the mean of some values, its standard error and their standard deviation (n - 1)."""
    array = np.array(list(values))
    if len(array) == 0:
        return Estimate(np.nan, np.nan, np.nan)
    spread = float(array.std(ddof=1)) if len(array) > 1 else 0.0
    return Estimate(float(array.mean()), spread / np.sqrt(len(array)), spread)


def episodes_as_csv(episodes: Iterable[Episode]) -> str:
    """Return a row per episode under a header."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(Episode._fields)
    writer.writerows(episodes)
    return stream.getvalue()
