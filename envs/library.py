"""Scenes by name: the shipped ones and users' own, each with the certificates that prove it can be solved."""

import hashlib
import json
import os
import pathlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, overload

from envs.scene import Certificate, Scene, build_mesh, build_scene
from envs.scene_config import SceneConfig
from gmapspring.config import closest, load_config
from gmapspring.errors import ConfigError
from gmapspring.paths import configs_folder

FORMAT = 1
"""Version of the certificate files."""


class Record(NamedTuple):
    """What certification found for one seed."""

    split: str
    """What the seed is reserved for."""

    seed: int
    """Seed of the scene."""

    certificate: Certificate | None
    """Proof that the scene can be solved, or None where it was rejected."""

    reason: str
    """Why it was rejected, else empty."""


class CertificateFile(NamedTuple):
    """Hold all certificates of one scene configuration."""

    digest: str
    """What the configuration was when they were made; see `scene_digest`."""

    trajectory: list[float]
    """Healthy strains along the first certificate, by which a change in the physics is told."""

    records: list[Record]
    """What was found, by split, then seed."""


class SceneSet(Sequence[Scene]):
    """List the certified scenes of one split; each is built when it is asked for, and all share one mesh."""

    def __init__(self, config: SceneConfig, records: list[Record]) -> None:
        """Keep what the scenes are built from; rejected seeds are left out."""
        self.config = config
        self.seeds = [record.seed for record in records if record.certificate]
        self._certificates = [record.certificate for record in records if record.certificate]

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self.seeds)

    @overload
    def __getitem__(self, index: int) -> Scene: ...
    @overload
    def __getitem__(self, index: slice) -> list[Scene]: ...
    def __getitem__(self, index: int | slice) -> Scene | list[Scene]:
        """Return one scene, or a list of them."""
        if isinstance(index, slice):
            return [self[i] for i in range(len(self))[index]]
        return build_scene(self.config, self.seeds[index], self._certificates[index])


def seeds_of(scenes: Sequence[Scene]) -> list[int]:
    """Return the seeds of scenes, without building those that are built only when they are asked for."""
    return scenes.seeds if isinstance(scenes, SceneSet) else [scene.seed for scene in scenes]


def shipped_scenes() -> list[str]:
    """Return the names of the shipped scene configurations."""
    return sorted(path.stem for path in (configs_folder() / "scenes").glob("*.yaml"))


def load_scene_config(scene: str | os.PathLike[str]) -> SceneConfig:
    """Return the configuration of a shipped scene by its name, or of a user's own by its file.

    Raises:
        ConfigError: there is no such scene, or its file has mistakes.
    """
    return load_config(_scene_file(scene), SceneConfig)


def load_scenes(scene: str | os.PathLike[str], split: str = "train") -> SceneSet:
    """Return the certified scenes of one split of a scene, shipped (a name) or a user's own (a file).

    Raises:
        ConfigError: there is no such scene or split, or its certificates are missing or made for another configuration.
    """
    path, where = _scene_file(scene), certificate_path(scene)
    # Files are read once, and again when they change.
    config, file = _certified(path, where, *(_changed_at(each) for each in (path, where)))
    if split not in config.splits:
        raise ConfigError(f"scene {config.name!r} has no split {split!r}; {closest(split, config.splits)}")
    scenes = SceneSet(config, [record for record in file.records if record.split == split])
    if not scenes:
        raise ConfigError(f"scene {config.name!r} has no certified {split} scene; run python -m envs.certify {scene}")
    return scenes


def play_list(scene: str | Scene | Sequence[Scene], split: str) -> Sequence[Scene]:
    """Return the scenes that an environment plays."""
    if isinstance(scene, Scene):
        return [scene]
    if isinstance(scene, Sequence) and not isinstance(scene, str):
        if not scene:
            raise ConfigError("the list of scenes is empty; give at least one")
        # Those of a set are scenes, built when they are asked for.
        strange = [] if isinstance(scene, SceneSet) else [each for each in scene if not isinstance(each, Scene)]
        if strange:
            raise ConfigError(f"{strange[0]!r} in the list of scenes is no Scene; give a name or a path by itself")
        return scene
    if not isinstance(scene, str | os.PathLike):
        raise ConfigError(f"{scene!r} is no scene; give a name, the path of a .yaml file, a Scene, or a list of Scenes")
    return load_scenes(scene, split)


def certificate_path(scene: str | os.PathLike[str]) -> pathlib.Path:
    """Return where the certificates of a scene lie: in configs/certificates if shipped, else beside its file."""
    path = _scene_file(scene)
    if path.resolve().parent == (configs_folder() / "scenes").resolve():
        return configs_folder() / "certificates" / f"{path.stem}.jsonl"
    return path.with_suffix(".certificates.jsonl")


def _changed_at(path: pathlib.Path) -> int:
    """Return when a file was last changed [ns], 0 where there is none."""
    return path.stat().st_mtime_ns if path.is_file() else 0


@lru_cache(maxsize=16)
def _certified(path: pathlib.Path, where: pathlib.Path, changed: int, certified: int) -> tuple[SceneConfig, CertificateFile]:
    """Return a configuration and its certificates, or raise where they do not belong together."""
    config = load_config(path, SceneConfig)
    if not where.is_file():
        raise ConfigError(f"scene {config.name!r} has no certificates ({where}); run python -m envs.certify {path}")
    file = read_certificates(where)
    if file.digest != scene_digest(config):
        raise ConfigError(
            f"{where} was made for another configuration than {path} now holds; run python -m envs.certify {path} --restart"
        )
    return config, file


def _scene_file(scene: str | os.PathLike[str]) -> pathlib.Path:
    """Return the file of a scene: a path if it looks like one, else a shipped name."""
    path = pathlib.Path(scene)
    if path.suffix in (".yaml", ".yml"):
        return path
    shipped = configs_folder() / "scenes" / f"{scene}.yaml"
    if not shipped.is_file():
        hint = closest(str(scene), shipped_scenes())
        raise ConfigError(f"there is no scene {str(scene)!r}; {hint} (or give the path of a .yaml file)")
    return shipped


# Certificate files ------------------------------------------------------------------------------------------------


def scene_digest(config: SceneConfig) -> str:
    """Return a hash of all that certificates depend on: the configuration without splits and budget, and the mesh."""
    left_out: Any = {"name": True, "splits": True, "budget": True, "mesh": {"path"}}
    fields = config.model_dump(mode="json", exclude=left_out, exclude_none=True)
    digest = hashlib.sha256(json.dumps(fields, sort_keys=True).encode())
    mesh = build_mesh(config.mesh)
    for array in (mesh.points, mesh.tetrahedra):
        digest.update(array.tobytes())
    for regions in (mesh.cell_regions, mesh.point_regions):
        for name in sorted(regions):
            digest.update(name.encode() + regions[name].tobytes())
    return digest.hexdigest()[:16]


def read_certificates(path: pathlib.Path) -> CertificateFile:
    """Return the certificates in a file, or raise `ConfigError` where it is not one."""
    try:
        header, *rows = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
        if header["format"] != FORMAT:
            raise ConfigError(f"{path} has certificate format {header['format']}; this version reads {FORMAT}")
        return CertificateFile(header["digest"], header["trajectory"], [_record(row) for row in rows])
    except (ValueError, KeyError, TypeError, UnicodeDecodeError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{path} is not a certificate file: {error!r}; make it again") from None


def write_certificates(path: pathlib.Path, file: CertificateFile) -> None:
    """Write certificates, one seed a line; the file is replaced in one go, so that it is never half written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    with partial.open("w", encoding="utf-8") as stream:
        for row in _rows(file):
            stream.write(json.dumps(row) + "\n")
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(path)


def _rows(file: CertificateFile) -> Iterator[dict[str, Any]]:
    """Yield the lines of a certificate file."""
    yield {"format": FORMAT, "digest": file.digest, "trajectory": file.trajectory}
    for record in file.records:
        row: dict[str, Any] = {"split": record.split, "seed": record.seed}
        if record.certificate is None:
            yield row | {"rejected": record.reason}
        else:
            yield row | vars(record.certificate)


def _record(row: dict[str, Any]) -> Record:
    """Return one line of a certificate file as a record."""
    split, seed = str(row.pop("split")), int(row.pop("seed"))
    if "rejected" in row:
        return Record(split, seed, None, str(row["rejected"]))
    return Record(split, seed, Certificate(**row | {"order": tuple(row["order"])}), "")
