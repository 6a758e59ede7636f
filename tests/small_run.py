"""Training runs of a few updates on the smallest scenes; importing this needs torch."""

from rich.console import Console

from agents.progress import ProgressReport
from agents.training import Trainer
from agents.training_config import TrainingConfig
from envs.library import certificate_path, read_certificates, write_certificates
from gmapspring.config import check_config
from gmapspring.paths import configs_folder

UPDATE = 32
"""Steps of an update of the small run."""

SMALL = {
    "scene": "box-48",
    "seed": 5,
    "network": {"hidden": 8, "rounds": 1},
    "shaping": {"weight": 1.0},
    "ppo": {
        "n_envs": 2,
        "n_steps": UPDATE // 2,
        "batch_size": 16,
        "n_epochs": 1,
        "learning_rate": 1e-2,
        "learning_rate_half_life": 100,
        "clip_range": 0.2,
        "entropy": 0.01,
        "gamma": 0.99,
        "gae_lambda": 0.95,
    },
    "stop": {"steps": 4 * UPDATE},
    "validation": {"every_updates": 2, "episodes": 1, "keep_checkpoints": 1},
}
"""A run of four updates, validated after the second and the fourth."""


class Quiet(ProgressReport):
    """A report that prints nothing, and may do something with every text."""

    def __init__(self, on_text=lambda text: None):
        super().__init__(Console(quiet=True), "test")
        self.on_text = on_text

    def update(self, fraction, text):
        self.on_text(text)

    def note(self, text):
        self.on_text(text)


def small_config(**changes):
    """Return the configuration of the small run, changed."""
    return check_config(SMALL | changes, TrainingConfig)


def trained(folder, n_updates=4, *, resume=False, start=None, on_text=lambda text: None, **changes):
    """Train up to a number of updates and return (trainer, result)."""
    config = small_config(stop={"steps": n_updates * UPDATE}, **changes)
    trainer = Trainer(config, folder, start=start, resume=resume)
    return trainer, trainer.run(Quiet(on_text))


def few_scenes(folder, n_scenes=3):
    """Return a scene file with the first few certified scenes of each split of box-48."""
    path = folder / "few.yaml"
    path.write_text((configs_folder() / "scenes" / "box-48.yaml").read_text())
    file = read_certificates(certificate_path("box-48"))
    kept = []
    for split in ("train", "validation", "test"):
        kept += [record for record in file.records if record.split == split and record.certificate][:n_scenes]
    write_certificates(certificate_path(path), file._replace(records=kept))
    return str(path)


def is_same(one, other):
    """Tell whether two modules have the same weights, bit for bit."""
    states = one.state_dict(), other.state_dict()
    return states[0].keys() == states[1].keys() and all(states[0][name].equal(states[1][name]) for name in states[0])


def optimizer_tensors(trainer):
    """Return all tensors of the optimizer's state, in order."""
    state = trainer.model.policy.optimizer.state_dict()["state"]
    return [tensor for entry in state.values() for tensor in entry.values()]
