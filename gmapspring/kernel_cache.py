"""The cache of compiled kernels on disk, which cannot go stale.

numba stamps a cached function with the date of its own file, so a change in a function that it calls from another file
goes unseen. Here the cache folder of a kernel is named by a hash of its own file, of every file that it imports, directly or
not, from what lies beside its package and from ours, and of every file there that defines named tuples, which kernels take
as arguments without importing them. A change anywhere a kernel can reach opens a fresh folder, a change elsewhere costs
nothing, and copies of the same sources share what has been compiled, wherever they lie and however old they are.
What others have installed is taken to stay as it is: only a new version of numba opens fresh folders.
"""

import ast
import hashlib
import os
import pathlib
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numba
from numba.core import caching

HERE = pathlib.Path(__file__).parents[1]
"""Where our packages lie."""
OURS = frozenset({"gmapspring", "envs"})
"""Our packages that have something for kernels of others."""
INSTALLED = ("site-packages", "dist-packages")
"""Names of folders in which packages are that nobody edits."""


class _Home(NamedTuple):
    """A folder with packages and modules."""

    folder: pathlib.Path
    packages: frozenset[str] | None
    """Those that count, None for all."""

    def holds(self, package: str) -> bool:
        """Return whether a package of that name counts."""
        return self.packages is None or package in self.packages


def source_of(function: Callable[..., Any]) -> tuple[pathlib.Path, int]:
    """Return the file of a function, and how many folders its outermost package lies above that."""
    source = pathlib.Path(function.__code__.co_filename)
    return source, function.__module__.count(".") + (source.name == "__init__.py")


def is_cacheable(function: Callable[..., Any]) -> bool:
    """Return whether a function has a file of its own, with its package around it: one typed at a prompt has not."""
    source, depth = source_of(function)
    return source.is_file() and len(source.parents) > depth


def cache_root() -> pathlib.Path:
    """Return the user's folder for compiled kernels, which need not lie beside a read-only install."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return pathlib.Path(os.environ["NUMBA_CACHE_DIR"])
    return pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache")) / "gmapspring"


@cache
def _imported_files(file: pathlib.Path, homes: tuple[_Home, ...]) -> tuple[pathlib.Path, ...]:
    """List the files, of those that may change, that a source file imports by absolute names."""
    return tuple(found for name in _imported_names(ast.parse(file.read_bytes())) for found in _files_of(name, homes))


def _imported_names(tree: ast.AST) -> Iterator[str]:
    """Name every module that a syntax tree imports, and every name it takes from one: that may be a module too."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif not isinstance(node, ast.expr):  # no expression holds a statement
            yield from _imported_names(node)


def _files_of(name: str, homes: tuple[_Home, ...]) -> list[pathlib.Path]:
    """Return the file of a module, if it may change under a kernel."""
    parts = name.split(".")
    bases = [home.folder.joinpath(*parts) for home in homes if home.holds(parts[0])]
    return [file for base in bases for file in (base.with_suffix(".py"), base / "__init__.py") if file.is_file()]


def _homes_of(source: pathlib.Path, depth: int) -> tuple[_Home, ...]:
    """Return where the modules lie that a kernel can reach and that may change: all beside its own, and ours.

    Of what is installed, only its own package counts: to read all that it imports would take longer than to compile.
    """
    folder = source.parents[depth]
    own = source.relative_to(folder).parts[0]
    beside = _Home(folder, frozenset({own, *OURS}) if folder.name in INSTALLED else None)
    return (beside,) if folder == HERE else (beside, _Home(HERE, OURS))


@cache
def _cache_folder(source: pathlib.Path, depth: int) -> pathlib.Path:
    """Return the cache folder for the kernels of one file: a hash of all sources they can reach, and of numba's version."""
    homes = _homes_of(source, depth)
    reached, waiting = {source}, [source]
    while waiting:
        new = set(_imported_files(waiting.pop(), homes)) - reached
        reached |= new
        waiting.extend(new)
    by_name: dict[str, pathlib.Path] = {}
    for home in homes:
        names = {file.relative_to(home.folder) for file in reached if file.is_relative_to(home.folder)}
        for package in {home.folder / name.parts[0] for name in names}:
            tuples = (file for file in package.rglob("*.py") if b"NamedTuple" in file.read_bytes())
            names |= {file.relative_to(home.folder) for file in tuples}
        by_name |= {name.as_posix(): home.folder / name for name in names}
    digest = hashlib.sha256(numba.__version__.encode())
    for name in sorted(by_name):
        digest.update(name.encode())
        digest.update(by_name[name].read_bytes())
    return cache_root() / f"{source.stem}-{digest.hexdigest()[:16]}"


@cache
def _is_writable(folder: pathlib.Path) -> bool:
    """Return whether files can be written there; the folder is made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


class _BySources(caching._CacheLocator):
    """Where numba keeps a kernel: in the folder that is named by its sources, whose dates do not matter."""

    def __init__(self, function: Callable[..., Any], folder: pathlib.Path) -> None:
        self._line, self._folder = function.__code__.co_firstlineno, folder

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "_BySources | None":
        """Return the place of a kernel, or None where nothing can be written there."""
        folder = _cache_folder(*source_of(py_func))
        return cls(py_func, folder) if _is_writable(folder) else None

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return what changes with the sources: nothing, since the folder does."""
        return ""

    def get_disambiguator(self) -> str:
        """Return what tells functions of the same name in the same file apart."""
        return str(self._line)


class _KernelCacheImpl(caching.CompileResultCacheImpl):
    # Where the folder cannot be written to, numba finds another place, by its own rules.
    _locator_classes = [_BySources, *caching.CompileResultCacheImpl._locator_classes]


class KernelCache(caching.FunctionCache):
    """What is kept of one kernel."""

    _impl_class = _KernelCacheImpl

    @property
    def is_empty(self) -> bool:
        """Return whether nothing is kept yet, for any types of arguments."""
        return not os.path.exists(self._cache_file._index_path)
