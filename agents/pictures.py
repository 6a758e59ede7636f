"""The pictures of the documentation, by one command: `python -m agents.pictures` writes them all to docs/.

The same versions of all packages give the same bytes.
"""

import argparse
import pathlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from agents.choice import home_of, make_policy
from agents.liver_picture import cut_liver_picture
from agents.map_pictures import map_pictures
from agents.png import picture_as_png
from agents.video import Player, record_video
from envs.frames import Frames
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError, GmapspringError
from gmapspring.paths import write_atomically

Array = np.ndarray[Any, Any]

DOCS = pathlib.Path(__file__).resolve().parents[1] / "docs"

POLICY = "shield:rim-first"
"""Who cuts in the film, unless another policy is named."""

LEARNED = "learned policy"
"""What a saved policy is called in the film."""

SCENE, SPLIT, INDEX = "box-192", "test", 0
"""What it cuts, unless it is at home elsewhere."""

STRAIN_SIZE = (720, 540)

LARGEST = 300_000
"""Bytes of the largest picture that a page should have to load."""


def write_pictures(folder: pathlib.Path, policy: str = POLICY, only: Sequence[str] = ()) -> list[pathlib.Path]:
    """Write pictures to a folder and return their files; only: names of some of PICTURES, by default all."""
    written = []
    for name, make in PICTURES.items():
        if not only or name in only:
            written += make(folder, policy)
    return written


def write_liver(folder: pathlib.Path, policy: str) -> list[pathlib.Path]:
    """Write the liver cut open."""
    return [_write(folder / "cut-liver.png", picture_as_png(cut_liver_picture()))]


def write_film(folder: pathlib.Path, policy: str) -> list[pathlib.Path]:
    """Write a film of a policy that cuts a target free."""
    scene = home_of(policy).scene if policy.endswith(".zip") else SCENE
    env = ResectEnv(scene, SPLIT, home_of(policy).mask)
    path = folder / "cutting.gif"
    # A reader cares that it has learnt, not where its file lies.
    name = LEARNED if policy.endswith(".zip") else policy
    record_video([Player(name, make_policy(policy, env, 0), env)], path, (INDEX,))
    return [path]


def write_strain(folder: pathlib.Path, policy: str) -> list[pathlib.Path]:
    """Write a heat map of strain, at the moment of a certified order at which healthy tissue bears most."""
    env = ResectEnv("liver", SPLIT)
    env.reset(seed=0, options={"index": INDEX})
    frames = Frames("strain", STRAIN_SIZE)
    assert env.scene.certificate is not None
    most, picture = -1.0, None
    for action in env.scene.certificate.order:
        env.step(action)
        if env.task.tissue.healthy_strain > most:
            most, picture = env.task.tissue.healthy_strain, frames.draw(env.scene, env.task.simulation.body, env.task.strain)
    assert picture is not None
    return [_write(folder / "strain.png", picture_as_png(picture))]


def write_map(folder: pathlib.Path, policy: str) -> list[pathlib.Path]:
    """Write the map in pictures: darts, what cuts split, and links of vertices."""
    return [_write(folder / f"{name}.png", content) for name, content in map_pictures().items()]


PICTURES: Mapping[str, Callable[[pathlib.Path, str], list[pathlib.Path]]] = {
    "liver": write_liver, "film": write_film, "strain": write_strain, "map": write_map,
}  # fmt: skip
"""Pictures by the names that --only takes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the pictures that the command line asks for, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m agents.pictures", description="make the pictures of the documentation")
    parser.add_argument("policy", nargs="?", default=POLICY, help=f"who cuts in the film, a name or a *.zip [{POLICY}]")
    parser.add_argument("--out", type=pathlib.Path, default=DOCS, help="folder [docs/ of the clone]")
    parser.add_argument("--only", nargs="+", choices=PICTURES, default=[], help="some of them")
    parsed = parser.parse_args(arguments)
    try:
        if not parsed.out.is_dir():
            raise ConfigError(f"there is no folder {parsed.out}; make it, or name another by --out")
        for path in write_pictures(parsed.out, parsed.policy, parsed.only):
            size = path.stat().st_size
            print(f"{path}: {size / 1e3:.0f} kB" + (", more than a page should load" if size > LARGEST else ""))
    except (GmapspringError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def _write(path: pathlib.Path, content: bytes) -> pathlib.Path:
    """Write a file and return its path."""
    write_atomically(path, content)
    return path


if __name__ == "__main__":
    sys.exit(main())
