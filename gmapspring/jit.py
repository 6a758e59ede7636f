"""The decorators of compiled functions, with a cache on disk that cannot go stale.

numba stamps a cached function with the date of its own file, so a change in a function that it calls from another file
goes unseen. Here the cache folder of a kernel is named by a hash of its own file, of every file of these packages that it
imports, directly or not, and of every file that defines named tuples, which kernels take as arguments without importing
them. A change anywhere a kernel can reach opens a fresh folder, a change elsewhere costs nothing.
"""

import ast
import hashlib
import os
import pathlib
import sys
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numba
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

_settings: Any = numba.config
_compile: Any = numba.njit


def cache_root() -> pathlib.Path:
    """Return the user's folder for compiled kernels, which need not lie beside a read-only install."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return pathlib.Path(os.environ["NUMBA_CACHE_DIR"])
    return pathlib.Path(os.environ.get("XDG_CACHE_HOME", pathlib.Path.home() / ".cache")) / "gmapspring"


@cache
def _imported_files(source: pathlib.Path, root: pathlib.Path) -> tuple[pathlib.Path, ...]:
    """List the files under root that a source file imports by absolute names."""
    return tuple(file for name in _imported_names(ast.parse(source.read_bytes())) for file in _files_of(name, root))


def _imported_names(tree: ast.AST) -> Iterator[str]:
    """Name every module that a syntax tree imports, and every name it takes from one: that may be a module too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _files_of(name: str, root: pathlib.Path) -> list[pathlib.Path]:
    """Return the file of a module under root, if there is one."""
    base = root.joinpath(*name.split("."))
    return [file for file in (base.with_suffix(".py"), base / "__init__.py") if file.is_file()]


@cache
def _cache_folder(source: pathlib.Path, root: pathlib.Path) -> str:
    """Return the cache folder for the kernels of one file: a hash of all sources they can reach, and of numba's version."""
    reached, waiting = {source}, [source]
    while waiting:
        new = set(_imported_files(waiting.pop(), root)) - reached
        reached |= new
        waiting.extend(new)
    for package in {root / file.relative_to(root).parts[0] for file in reached}:
        reached |= {file for file in package.rglob("*.py") if b"NamedTuple" in file.read_bytes()}
    digest = hashlib.sha256(numba.__version__.encode())
    for file in sorted(reached):
        digest.update(file.relative_to(root).as_posix().encode())
        digest.update(file.read_bytes())
    return str(cache_root() / f"{source.stem}-{digest.hexdigest()[:16]}")


class _Announcement(event.Listener):
    """Says, once a process, that kernels are being compiled: else the first step seems to hang."""

    is_made = False

    def on_start(self, started: Any) -> None:
        """Say so before the first kernel of these packages; one from the cache gives no event."""
        if not self.is_made and started.data["dispatcher"].py_func in _kernels:
            self.is_made = True
            print("gmapspring: compiling kernels for this machine, once; it takes up to a minute", file=sys.stderr, flush=True)

    def on_end(self, ended: Any) -> None:
        """Say nothing."""


_kernels: set[Callable[..., Any]] = set()
"""The functions that are cached once compiled."""
event.register("numba:compile", _Announcement())
OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False, "no_cfunc_wrapper": True}
"""No interpreter lock, IEEE arithmetic, no checks of indices."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for the inner loops, to be called from Python, and cache it on disk."""
    source = pathlib.Path(function.__code__.co_filename)
    depth = function.__module__.count(".") + (source.name == "__init__.py")
    is_package_file = source.is_file() and len(source.parents) > depth
    before = _settings.CACHE_DIR
    if is_package_file:
        # The cache folder of a function is fixed when it is decorated: other users of numba keep their own.
        _settings.CACHE_DIR = _cache_folder(source, source.parents[depth])
    try:
        _kernels.update({function} if is_package_file else {})
        return _compile(function, cache=is_package_file, **OPTIONS)
    finally:
        _settings.CACHE_DIR = before


def part(function: Callable[..., Any]) -> Any:
    """Compile a function that only kernels call: it is optimised within each of them, and not on its own."""
    dispatcher: Any = _compile(function, no_cpython_wrapper=True, pipeline_class=_PartCompiler, **OPTIONS)
    if not _settings.DISABLE_JIT:

        def refuse(*arguments: Any, **keywords: Any) -> None:
            raise TypeError(f"{function.__name__} is a part of kernels: call it from a kernel, not from Python")

        # Python would follow the way in that is not there: so none of the compiled forms is shown to it.
        dispatcher._compile_for_args = refuse
        dispatcher.add_overload = lambda result: dispatcher.overloads.update({tuple(result.signature.args): result})
    return dispatcher


class _PartCompiler(Compiler):
    """numba's compiler, into a library that is only linked into others."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *arguments: Any) -> None:
        super().__init__(typingctx, targetctx, library, *arguments)
        self.state.library = _PartLibrary(targetctx.codegen(), "part")


class _PartLibrary(JITCodeLibrary):
    """The code of one part and of those that it calls, neither optimised as a whole nor turned into machine code.

    numba would do both for every function, though a kernel takes in the code of all that it calls and optimises it anew:
    what lies several calls deep would be optimised several times.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Set nothing: the code runs nowhere."""
