"""The decorators of compiled functions: kernels, which are called from Python, and parts, which only kernels call."""

import gc
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

from gmapspring.kernel_cache import KernelCache, is_cacheable
from gmapspring.numba_flags import compare_quickly

_settings: Any = numba.config
_compile: Any = numba.njit


@cache
def announce() -> None:
    """Say, once a process, that kernels are being compiled: else the first step seems to hang."""
    print("gmapspring: compiling kernels for this machine, once; it takes up to a minute", file=sys.stderr, flush=True)


class _Compilation(event.Listener):
    """Announces the first kernel of these packages that is compiled, and keeps the garbage collector off the while.

    It would go through all that numba makes, time and again. A kernel from the cache gives no event.
    """

    n_open, was_on = 0, False

    def on_start(self, started: Any) -> None:
        """Begin with a kernel, and go on with all that it calls."""
        if not self.n_open and started.data["dispatcher"].py_func in _kernels:
            announce()
            self.was_on = gc.isenabled()
            gc.disable()
            self.n_open = 1
        elif self.n_open:
            self.n_open += 1

    def on_end(self, ended: Any) -> None:
        """Turn the collector on again, if it was, with the kernel's end."""
        if self.n_open:
            self.n_open -= 1
            if not self.n_open and self.was_on:
                gc.enable()


_kernels: set[Callable[..., Any]] = set()
"""The functions that are cached once compiled."""
event.register("numba:compile", _Compilation())
compare_quickly()
OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False, "no_cfunc_wrapper": True}
"""No interpreter lock, IEEE arithmetic, no checks of indices."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function for the inner loops, to be called from Python, and cache it on disk."""
    dispatcher = _compile(function, **OPTIONS)
    if is_cacheable(function) and not _settings.DISABLE_JIT:
        _kernels.add(function)
        dispatcher._cache = KernelCache(function)
    return dispatcher


def is_to_be_compiled(dispatcher: Any) -> bool:
    """Return whether a kernel would be compiled if it were called, and kept on disk: it has never been, for any types."""
    cache = getattr(dispatcher, "_cache", None)
    return isinstance(cache, KernelCache) and not dispatcher.signatures and cache.is_empty


def part(function: Callable[..., Any], **options: Any) -> Any:
    """Compile a function that only kernels call: it is optimised within each of them, and not on its own."""
    dispatcher: Any = _compile(function, no_cpython_wrapper=True, pipeline_class=_PartCompiler, **OPTIONS, **options)
    if not _settings.DISABLE_JIT:

        def refuse(*arguments: Any, **keywords: Any) -> None:
            raise TypeError(f"{function.__name__} is a part of kernels: call it from a kernel, not from Python")

        # Python would follow the way in that is not there: so none of the compiled forms is shown to it.
        dispatcher._compile_for_args = refuse
        dispatcher.add_overload = lambda result: dispatcher.overloads.update({tuple(result.signature.args): result})
    return dispatcher


def inlined_part(function: Callable[..., Any]) -> Any:
    """Compile a part that is put whole wherever it is called.

    For one with few callers that hands over structures of many arrays: a call would copy a hundred numbers each way.
    """
    return part(function, forceinline=True)


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

    # numba asks where the machine code is, and sets what it runs in: there is none.

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> "_PartLibrary":
        return self

    def set_env(self, name: str, environment: Any) -> None:
        pass
