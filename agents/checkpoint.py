"""Saved policies: stable-baselines3's zip file with a page about itself, written in one go and read without pickle.

`MaskablePPO.load` reads these files too; reading them here runs no code that they may hold.
"""

import io
import json
import pathlib
import pickle
import zipfile
from collections.abc import Iterable
from typing import Any, NamedTuple

import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO

from agents.averaging import WeightAverage, Weights
from agents.candidate_policy import CandidatePolicy
from agents.features import Observed
from agents.flat import FlatPolicy
from agents.training_config import FlatSettings, Network, NetworkSettings
from envs.observation import COLUMNS
from gmapspring.config import Config, check_config
from gmapspring.errors import GmapspringError
from gmapspring.paths import write_atomically

FORMAT = 3
"""Version of the page, and of what its policy was shown: with another, a policy would play otherwise than it did."""
SCENE_JOINT = " + "
"""What stands between the names of scenes; files may well have a + in their names, but hardly with spaces around it."""
_PAGE = "gmapspring.json"
_LEARNT = "learnt.pt"  # not .pth: stable-baselines3 would take it for a part of its own
_TRANSIENT = ("_last_obs", "_last_episode_starts", "_last_original_obs", "ep_info_buffer", "ep_success_buffer")


class CheckpointError(GmapspringError, ValueError):
    """A file that is no policy, or one for another observation."""


class Page(NamedTuple):
    """What a saved policy says about itself."""

    scene: str
    """Names or files of the scenes it was trained on, with SCENE_JOINT between them."""
    mask: str
    """Mask mode it was trained with."""
    network: dict[str, Any]
    """Settings of its network."""
    n_steps: int
    """Environment steps it has seen."""
    cpu_seconds: float
    """CPU time its training took [s]."""
    best_return: float | None
    """Best validation return of the run so far, None before the first validation."""
    columns: dict[str, list[str]]
    """Columns of the observation that it reads, by table."""


class _Kept(Config):
    """What a page keeps of the configuration of the training."""

    network: Network


def observation_columns() -> dict[str, list[str]]:
    """Return the columns that a policy of this version reads."""
    return {name: [column.name for column in COLUMNS[name]] for name in Observed._fields if name in COLUMNS}


def save_checkpoint(paths: Iterable[pathlib.Path], model: MaskablePPO, learnt: Weights, page: Page) -> None:
    """Write a model as it plays, the weights it learns with, its optimizer and its page to one or more files."""
    stream = io.BytesIO()
    model.save(stream, exclude=_TRANSIENT)
    weights = io.BytesIO()
    torch.save(learnt, weights)
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr(_LEARNT, weights.getvalue())
        archive.writestr(_PAGE, json.dumps({"format": FORMAT, **page._asdict()}, indent=1))
    for path in paths:
        write_atomically(path, stream.getvalue())


def read_page(path: pathlib.Path) -> Page:
    """Return the page of a saved policy.

    Raises:
        CheckpointError: the file is missing, foreign, truncated, of another version or for another observation.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
            page = json.loads(archive.read(_PAGE))
        version = page.pop("format")
        if version != FORMAT:
            raise CheckpointError(f"{path} is of format {version}; this version reads {FORMAT}: train again")
        page = Page(**page)
    except OSError as error:
        raise CheckpointError(f"cannot read {path}: {error.strerror or error}") from None
    except (zipfile.BadZipFile, KeyError, ValueError, TypeError, EOFError) as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(f"{path} is not a policy saved by `python -m agents train`, or only part of one") from None
    if damaged:
        raise CheckpointError(f"{path} is damaged: {damaged} fails its checksum")
    _check_columns(path, page.columns)
    return page


def _check_columns(path: pathlib.Path, columns: dict[str, list[str]]) -> None:
    """Raise where a policy reads other columns than the environment of this version shows."""
    for name, known in observation_columns().items():
        if columns.get(name) != known:
            raise CheckpointError(
                f"{path} was trained on another observation: its table {name!r} has columns "
                f"{columns.get(name)}, here it has {known}; train again"
            )


def load_policy(
    path: pathlib.Path, observation_space: spaces.Dict, action_space: spaces.Discrete
) -> CandidatePolicy | FlatPolicy:
    """Return a saved policy, ready to predict; unless it is flat, the mesh may have another size than in training."""
    network = _read_network(path)
    policy: CandidatePolicy | FlatPolicy
    if isinstance(network, FlatSettings):
        policy = FlatPolicy(observation_space, action_space, lambda _: 0.0, network=network)
    else:
        policy = CandidatePolicy(observation_space, action_space, lambda _: 0.0, network=network)
    _put(path, "policy.pth", policy)
    policy.set_training_mode(False)
    return policy


def _read_network(path: pathlib.Path) -> FlatSettings | NetworkSettings:
    """Return the settings of a saved policy's network."""
    return check_config({"network": read_page(path).network}, _Kept, source=str(path)).network


def restore_model(path: pathlib.Path, model: MaskablePPO, average: WeightAverage) -> Page:
    """Put the weights, their average and the optimizer of a checkpoint into a model made for the same configuration."""
    page = read_page(path)
    _put(path, "policy.pth", model.policy)
    average.begin()
    _put(path, _LEARNT, model.policy)
    _put(path, "policy.optimizer.pth", model.policy.optimizer)
    model.num_timesteps = page.n_steps
    return page


def start_from(path: pathlib.Path, model: MaskablePPO) -> None:
    """Put the weights of a saved policy into a model that is to learn on; its optimizer starts anew.

    Raises:
        CheckpointError: the file is not a usable policy, or its network is not of the model's settings.
    """
    saved, own = _read_network(path).model_dump(), model.policy_kwargs["network"].model_dump()
    if differences := [f"{name} is {saved.get(name)} there, {own[name]} here" for name in own if saved.get(name) != own[name]]:
        raise CheckpointError(f"{path} has another network than this run: {'; '.join(differences)}; make them the same")
    _put(path, "policy.pth", model.policy)


def _put(path: pathlib.Path, member: str, into: torch.nn.Module | torch.optim.Optimizer) -> None:
    """Load the tensors of one member of a checkpoint."""
    try:
        with zipfile.ZipFile(path) as archive:
            tensors = torch.load(io.BytesIO(archive.read(member)), map_location="cpu", weights_only=True)
        if isinstance(into, FlatPolicy) and (reason := into.misfit(tensors)):
            raise CheckpointError(f"{path} cannot be used here: {reason}")
        into.load_state_dict(tensors)
    except CheckpointError:
        raise
    except (KeyError, RuntimeError, ValueError, pickle.UnpicklingError) as error:
        reason = " ".join(str(error).split())
        raise CheckpointError(f"{path} does not fit the network of this version: {member}: {reason:.300}") from None
