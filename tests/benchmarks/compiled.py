"""The same step in C: compiled on the spot where gcc is there, called through ctypes."""

import ctypes
import hashlib
import os
import pathlib
import shutil
import subprocess
import tempfile
from functools import cache

import numba
import numpy as np

from gmapspring.machine import cpu_flags
from tests.benchmarks.bodies import IndexedModel
from tests.benchmarks.timing import Stepper, timed

SOURCE = pathlib.Path(__file__).with_name("spring_step.c")
FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", "-std=gnu11", "-lm")
VECTOR_FLAGS = ("avx512f", "avx512dq")
"""What the processor must offer for the AVX-512 form."""
C_NAME = {np.dtype(np.float64): "double", np.dtype(np.float32): "float"}
LINE = 64
"""Bytes of a cache line, at which rows start."""


class NotAvailable(RuntimeError):
    """A contestant that cannot run here."""


@cache
def library() -> ctypes.CDLL:
    """Compile the C source into the user's cache, once for each source, compiler and processor; return the library."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise NotAvailable("gcc is not installed")
    target = subprocess.run([compiler, *FLAGS, "-Q", "--help=target"], capture_output=True, check=True).stdout
    name = hashlib.sha256(SOURCE.read_bytes() + target + " ".join(FLAGS).encode()).hexdigest()[:16]
    cache_home = os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache"
    folder = pathlib.Path(cache_home) / "gmapspring-benchmarks"
    built = folder / f"spring_step-{name}.so"
    if not built.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as unfinished:
            fresh = pathlib.Path(unfinished) / "step.so"
            done = subprocess.run([compiler, str(SOURCE), *FLAGS, "-o", str(fresh)], capture_output=True, text=True)
            if done.returncode:
                raise NotAvailable(f"gcc refuses spring_step.c: {done.stderr.strip().splitlines()[-1:]}")
            fresh.replace(built)
    return ctypes.CDLL(str(built))


def peak_rate() -> float:
    """Measure the highest rate of float64 arithmetic: independent multiply-adds in registers [1/s]."""
    run, n_rounds = library().peak_double, 100_000
    run.restype = ctypes.c_double
    return 12 * 8 * 2 * n_rounds / min(timed(run, ctypes.c_long(n_rounds)) for _ in range(25))


def plain_c(model: IndexedModel) -> Stepper:
    """Return the body stepped by plain C, in the precision of the model; advance takes (step, n_steps)."""
    dtype = model.position.dtype
    run = getattr(library(), f"plain_{C_NAME[dtype]}")
    first, second = (np.ascontiguousarray(model.endpoints[:, end]) for end in (0, 1))
    constants = (first, second, model.stiffness, model.stiffness * model.rest_length, model.damping,
                 np.repeat(model.inverse_mass, 3), np.ascontiguousarray(model.gravity))
    position, *rest = work = [np.array(model.position), *(np.zeros_like(model.position) for _ in range(6))]
    real, sizes = _real(dtype), (ctypes.c_long(len(position)), ctypes.c_long(len(first)))
    kept, drag, is_damped = [_pointer(a) for a in constants], real(model.drag), ctypes.c_int(model.is_damped)
    changed = [_pointer(a) for a in work]

    def restart() -> None:
        position[:] = model.position
        for array in rest:
            array[:] = 0

    def advance(step: float, n_steps: int) -> None:
        # The arrays are named so that they live as long as the pointers to them.
        assert constants and work
        run(ctypes.c_long(n_steps), real(step), *sizes, *kept, drag, *changed, is_damped)

    return Stepper(restart, advance, lambda: position)


def vector_c(model: IndexedModel, by_newton: bool) -> Stepper:
    """Return the body stepped by AVX-512 intrinsics, in the precision of the model; advance takes (step, n_steps)."""
    missing = [flag for flag in VECTOR_FLAGS if flag not in cpu_flags()]
    if missing:
        raise NotAvailable(f"the processor has no {' and no '.join(missing)}")
    dtype, n = model.position.dtype, len(model.position)
    run = getattr(library(), f"vector_{C_NAME[dtype]}")
    blocks = grouped(model.endpoints, n, 8 if dtype == np.float64 else 16)
    constants = (*_springs(model, blocks), *_nodes(model))
    start = aligned((n + 2, 8), dtype)
    start[:n, :3] = model.position
    # The ends of a dummy spring lie apart: a length of zero would turn its zero stiffness into NaN.
    start[n + 1, :3] = 1.0
    state, *rest = work = [aligned((n + 2, 8), dtype) for _ in range(3)]
    work += [aligned((n + 2, 4), dtype), aligned((len(blocks),), dtype)]
    real, sizes = _real(dtype), (ctypes.c_long(n), ctypes.c_long(len(blocks)))
    kept, changed = [_pointer(a) for a in constants], [_pointer(a) for a in work]
    flags = (ctypes.c_int(model.is_damped), ctypes.c_int(by_newton))
    drag = real(model.drag)

    def restart() -> None:
        for array in work[:3]:
            array[:] = start
        work[3][:] = 0

    def advance(step: float, n_steps: int) -> None:
        assert constants and rest
        run(ctypes.c_long(n_steps), real(step), *sizes, *kept, drag, *changed, *flags)

    return Stepper(restart, advance, lambda: state[:n, :3])


def _springs(model: IndexedModel, blocks: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return endpoints, stiffness, tension and damping in the order of the blocks, dummies between the two last nodes."""
    n, dtype, is_spring = len(model.position), model.position.dtype, blocks >= 0
    result = []
    for end in (0, 1):
        nodes = aligned((len(blocks),), np.uint32)
        nodes[:] = np.where(is_spring, model.endpoints[blocks, end], n + end)
        result.append(nodes)
    for values in (model.stiffness, model.stiffness * model.rest_length, model.damping):
        padded = aligned((len(blocks),), dtype)
        padded[:] = np.where(is_spring, values[blocks], 0)
        result.append(padded)
    return tuple(result)


def _nodes(model: IndexedModel) -> tuple[np.ndarray, np.ndarray]:
    """Return inverse masses and gravity in rows of four, with two dummy nodes that never move."""
    n, dtype = len(model.position), model.position.dtype
    inverse_mass, gravity = aligned((n + 2,), dtype), aligned((n + 2, 4), dtype)
    inverse_mass[:n], gravity[:n, :3] = model.inverse_mass, model.gravity
    return inverse_mass, gravity


def grouped(endpoints: np.ndarray, n_nodes: int, width: int) -> np.ndarray:
    """Order springs in blocks of a width without a common node; int64, a multiple of width long, -1 for a dummy."""
    return group_springs(endpoints.astype(np.int64), n_nodes, width)


@numba.njit(cache=True)
def group_springs(endpoints, n_nodes, width):
    """Put each spring into the first block with room, among the last few opened, that touches neither of its nodes."""
    reach = 64
    n_blocks = 0
    last_block = np.full(n_nodes, -1, np.int64)
    # A bit for each of the last blocks in which a node is used.
    used = np.zeros(n_nodes, np.uint64)
    fill = np.zeros(len(endpoints) + 1, np.int64)
    blocks = np.full((len(endpoints) + 1, width), -1, np.int64)
    first_open = 0
    for s in range(len(endpoints)):
        i, j = endpoints[s, 0], endpoints[s, 1]
        block = max(first_open, n_blocks - reach)
        while block < n_blocks and (fill[block] == width or is_used(used, last_block, i, block)
                                    or is_used(used, last_block, j, block)):
            block += 1
        n_blocks = max(n_blocks, block + 1)
        blocks[block, fill[block]] = s
        fill[block] += 1
        use(used, last_block, i, block)
        use(used, last_block, j, block)
        while first_open < n_blocks and fill[first_open] == width:
            first_open += 1
    return blocks[:n_blocks].reshape(-1)


@numba.njit(cache=True)
def is_used(used, last_block, node, block):
    """Tell whether a node is used in one of the last 64 blocks it was used in."""
    age = last_block[node] - block
    return last_block[node] >= 0 and 0 <= age < 64 and (used[node] >> np.uint64(age)) & np.uint64(1) != 0


@numba.njit(cache=True)
def use(used, last_block, node, block):
    """Note that a node is used in a block."""
    if last_block[node] < 0 or block > last_block[node]:
        shift = block - last_block[node] if last_block[node] >= 0 else 64
        used[node] = (used[node] << np.uint64(shift) if shift < 64 else np.uint64(0)) | np.uint64(1)
        last_block[node] = block
    else:
        used[node] |= np.uint64(1) << np.uint64(last_block[node] - block)


def aligned(shape: tuple[int, ...], dtype: np.dtype | type) -> np.ndarray:
    """Return zeros that start at a cache line."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + LINE, np.uint8)
    start = -raw.ctypes.data % LINE
    return raw[start : start + size].view(dtype).reshape(shape)


def _real(dtype: np.dtype) -> type:
    """Return the C type of a dtype."""
    return ctypes.c_double if dtype == np.float64 else ctypes.c_float


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return the address of an array's numbers."""
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)
