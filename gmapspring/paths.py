"""Where the shipped configuration lies, and how files are written so that none is ever half there."""

import contextlib
import os
import pathlib


def configs_folder() -> pathlib.Path:
    """Return the folder of shipped scenes, training set-ups and meshes, in a wheel as in a clone or editable install."""
    package = pathlib.Path(__file__).resolve().parent
    for folder in (package / "configs", package.parent / "configs"):
        if folder.is_dir():
            return folder
    raise FileNotFoundError(f"no configs folder in {package} or beside it; install the package again")


def config_file(kind: str, name: str) -> pathlib.Path:
    """Return the file of a configuration: a path if it looks like one, else what ships under configs/kind by that name."""
    path = pathlib.Path(name)
    return path if path.suffix in (".yaml", ".yml") else configs_folder() / kind / f"{name}.yaml"


def write_atomically(path: pathlib.Path, content: bytes) -> None:
    """Write a file beside its place and move it there: whoever reads it sees the old file or the new one."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {path.parent}")
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        with unfinished.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(unfinished, path)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise
