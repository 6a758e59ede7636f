"""The same body and step by others. Each peer is one file with `prepare(case, model)`; to add one, enter it in PEERS."""

import importlib
from typing import NamedTuple

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.timing import Stepper


class Peer(NamedTuple):
    """Somebody else's way to step the body."""

    module: str
    """File of this folder that holds `prepare`."""
    differs: str = ""
    """What is not the same as in ours; empty where only the code is another."""
    tolerated: float = 1e-9
    """Largest error that counts as the same result, NaN where the model is another."""


ANOTHER_MODEL = float("nan")

PEERS: dict[str, Peer] = {
    "NumPy": Peer("numpy_arrays"),
    "SciPy sparse": Peer("scipy_sparse"),
    "PyTorch": Peer("torch_tensors"),
    "Taichi": Peer("taichi_kernel"),
    "Warp (CPU)": Peer("warp_kernels"),
    "MuJoCo flex": Peer(
        "mujoco_flex",
        "its own model: finite elements (Saint Venant-Kirchhoff, Poisson ratio 0.25), equal masses; its RK4, no collisions",
        ANOTHER_MODEL,
    ),
    "PyBullet": Peer(
        "pybullet_soft",
        "its own model and integrator: mass/spring soft body, deformable world (an implicit step), equal springs and masses",
        ANOTHER_MODEL,
    ),
}
"""Peers by the names that the table gives them."""


def prepare(peer: Peer, case: Case, model: IndexedModel) -> Stepper:
    """Return a peer's body; ImportError where it is not installed."""
    prepared: Stepper = importlib.import_module(f"tests.benchmarks.peers.{peer.module}").prepare(case, model)
    return prepared
