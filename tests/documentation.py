"""Pages whose code is run: blocks are written to files, applied or executed, and what they print is what the page says.

Of a page, every block fenced as python, sh, yaml or diff counts:

    python, yaml   beginning with `# FOLDER/NAME.py`: a file, which is written before anything runs
    diff           a change of a file, told by `+++ FILE`: the lines that stay or go stand there exactly once
    python, sh     anything else: run in order in one folder, python blocks in one namespace
    text           what the block before it prints; ... stands for anything
"""

import contextlib
import io
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from typing import NamedTuple

REPOSITORY = pathlib.Path(__file__).parents[1]
OVERLAY = '''import importlib.util, pathlib, sys

FOLDER, REPOSITORY = pathlib.Path({folder!r}), pathlib.Path({repository!r})


class Overlay:
    @staticmethod
    def find_spec(name, path=None, target=None):
        place = FOLDER.joinpath(*name.split("."))
        if (place / "__init__.py").is_file():
            places = [str(place), str(REPOSITORY.joinpath(*name.split(".")))]
            return importlib.util.spec_from_file_location(name, place / "__init__.py", submodule_search_locations=places)
        file = place.with_suffix(".py")
        return importlib.util.spec_from_file_location(name, file) if "." in name and file.is_file() else None


sys.meta_path.insert(0, Overlay)
'''
"""Lets every Python that starts with it take modules from a folder before those of the repository: a copy of all packages would
have to compile all kernels anew."""
FILE_HEAD = re.compile(r"# ([\w./-]+\.(?:py|yaml))\n")


class Block(NamedTuple):
    """One fenced block."""

    language: str
    code: str
    output: str | None
    """What the page says that it prints, None where it says nothing."""

    @property
    def file(self) -> str | None:
        """Return the file that the block is the text of, if it is one."""
        head = FILE_HEAD.match(self.code) if self.language in ("python", "yaml") else None
        return head[1] if head else None


def read_page(path: str) -> str:
    """Return a page of the repository."""
    return (REPOSITORY / path).read_text(encoding="utf-8")


def blocks_of(page: str) -> list[Block]:
    """Return the blocks of a page that are code, each with what it is said to print."""
    found: list[Block] = []
    for language, code in re.findall(r"^```(\w+)\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE):
        if language == "text":
            assert found and found[-1].output is None, f"a text block is the output of nothing:\n{code}"
            found[-1] = found[-1]._replace(output=code)
        else:
            found.append(Block(language, code, None))
    return found


def sections_of(page: str) -> dict[str, str]:
    """Return the text under each heading of second rank, by the heading."""
    parts = re.split(r"^## (.*)$", page, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def check_blocks(blocks: Sequence[Block], folder: pathlib.Path, **settings: str) -> None:
    """Write, apply and run blocks in a folder, and compare what they print with the page; settings go into the environment.

    What the blocks write or change of the packages takes effect from the folder; the repository stays as it is.
    """
    for block in blocks:
        if block.file:
            (folder / block.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / block.file).write_text(block.code, encoding="utf-8")
        elif block.language == "diff":
            apply_diff(block.code, folder)
    (folder / "sitecustomize.py").write_text(OVERLAY.format(folder=str(folder), repository=str(REPOSITORY)))
    runnable = [block for block in blocks if block.language in ("python", "sh") and not block.file]
    path = os.pathsep.join([str(pathlib.Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(REPOSITORY)]), "PATH": path} | settings
    jobs = json.dumps([[block.language, block.code] for block in runnable])
    run = subprocess.run([sys.executable, __file__], input=jobs, cwd=folder, env=environment, capture_output=True, text=True,
                         timeout=600)  # fmt: skip
    assert run.returncode == 0, run.stdout + run.stderr
    for block, printed in zip(runnable, json.loads(run.stdout), strict=True):
        if block.output is not None:
            expected = re.escape(block.output).replace(re.escape("..."), ".*?")
            assert re.fullmatch(expected, printed, flags=re.DOTALL), f"{block.code}\nprints\n{printed}\nnot\n{block.output}"


def apply_diff(diff: str, folder: pathlib.Path) -> None:
    """Change files as a diff says, wherever in them its lines stand; lines of context are checked, line numbers are not used."""
    for part in re.split(r"^--- .*\n(?=\+\+\+ )", diff, flags=re.MULTILINE)[1:]:
        head, *hunks = re.split(r"^@@.*\n", part, flags=re.MULTILINE)
        path = folder / head.strip().removeprefix("+++ ")
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(REPOSITORY / path.relative_to(folder), path)
        text = path.read_text(encoding="utf-8")
        for hunk in hunks:
            lines = hunk.splitlines(keepends=True)
            old = "".join(line[1:] for line in lines if line[0] in " -")
            new = "".join(line[1:] for line in lines if line[0] in " +")
            assert text.count(old) == 1, f"{path} holds {text.count(old)} times:\n{old}"
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")


def run_block(language: str, code: str, names: dict[str, object]) -> str:
    """Run one block and return what it prints on standard output."""
    if language == "sh":
        return subprocess.run(["bash", "-euc", code], stdout=subprocess.PIPE, text=True, check=True).stdout
    stream = io.StringIO()
    with contextlib.redirect_stdout(stream):
        exec(compile(code, "block.py", "exec"), names)
    return stream.getvalue()


def missing_links(page: str, place: pathlib.Path) -> list[str]:
    """Return the links of a page that lead to no file, given the folder it lies in."""
    return [link for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page) if not (place / link).exists()]


if __name__ == "__main__":
    # The folder of this file comes first otherwise, and its modules would be taken for others of their names.
    sys.path[0] = os.getcwd()
    _names: dict[str, object] = {"__name__": "__main__"}
    print(json.dumps([run_block(language, code, _names) for language, code in json.load(sys.stdin)]))
