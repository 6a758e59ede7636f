"""Behaviour cloning: before it plays, a policy learns to do what the certificates do (Pomerleau, 1989)."""

from collections.abc import Callable, Iterator

import numpy as np
import torch

from agents.candidate_policy import CandidatePolicy
from agents.demonstrations import Demonstrations
from agents.features import join
from agents.training_config import WarmStart


def clone(
    policy: CandidatePolicy,
    shown: Demonstrations,
    settings: WarmStart,
    rng: np.random.Generator,
    say: Callable[[float, float], None],
) -> None:
    """Raise the log-probability of what was shown, by Adam with a rate that falls to 0.

    Args:
        policy: what learns; its own optimizer is left alone.
        shown: what to do in which states.
        settings: how long and how fast.
        rng: of the order of the states.
        say: told now and then which share is done, and the mean of -log-probability since.
    """
    optimizer = torch.optim.Adam(policy.parameters(), fused=True)
    batches = list(_batches(len(shown.actions), settings, rng))
    losses: list[float] = []
    for number, batch in enumerate(batches):
        optimizer.param_groups[0]["lr"] = settings.learning_rate * (1.0 - number / len(batches))
        seen = join([shown.states[state] for state in batch])
        _, log_probability, _ = policy.evaluate_actions(seen, torch.from_numpy(shown.actions[batch]))
        loss = -log_probability.mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
        if len(losses) == 32 or number == len(batches) - 1:
            say((number + 1) / len(batches), float(np.mean(losses)))
            losses.clear()


def _batches(n_states: int, settings: WarmStart, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield the states of each batch; every epoch has all of them, in an order of its own."""
    for _ in range(settings.epochs):
        order = rng.permutation(n_states)
        yield from (order[first : first + settings.batch_size] for first in range(0, n_states, settings.batch_size))
