"""Rows of addresses: kernels find through them exactly the arrays that the structure holds."""

import copy
import pickle
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

import gmapspring as gs
from gmapspring.addresses import address_row, leaves, struct_reader
from tests import zoo


class Inner(NamedTuple):
    real: np.ndarray
    flags: np.ndarray


class Outer(NamedTuple):
    inner: Inner
    numbers: np.ndarray
    blocks: np.ndarray


class Longer(NamedTuple):
    outer: Outer
    more: np.ndarray


def outer(n, dtype=np.float64):
    """Return a structure of arrays of n rows, full of different numbers."""
    real = np.arange(8 * n, dtype=dtype).reshape(n, 8) / 7
    return Outer(Inner(real, np.arange(n) % 2 == 0), np.arange(n, dtype=np.int32), np.arange(12.0 * n).reshape(n, 4, 3))


read_outer = struct_reader(lambda dtype: outer(0, dtype))
read_longer = struct_reader(lambda dtype: Longer(outer(0, dtype), np.zeros(0)))


@njit
def digest(table, row, real):
    """Read every array, by elements, and write one number to each."""
    structure = read_outer(table, row, real)
    total = 0.0
    for i in range(len(structure.numbers)):
        total += structure.inner.real[i, 3] + structure.inner.flags[i] + structure.numbers[i] + structure.blocks[i, 2, 1]
        structure.inner.real[i, 7] = -1.0
    return total, structure.inner.real.shape, structure.blocks.shape


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_kernel_reads_and_writes_the_arrays_of_each_row(dtype):
    structures = [outer(n, dtype) for n in (3, 0, 5)]
    table = np.stack([address_row(structure) for structure in structures])
    for row, structure in enumerate(structures):
        inner = structure.inner
        expected = sum((inner.real[:, 3].astype(float) + inner.flags + structure.numbers + structure.blocks[:, 2, 1]).tolist())
        total, *shapes = digest(table, row, dtype(0))
        assert total == pytest.approx(expected, rel=1e-6) and shapes == [(len(inner.real), 8), (len(inner.real), 4, 3)]
        assert (inner.real[:, 7] == -1.0).all()


def test_without_a_compiler_the_same_arrays_are_read():
    structure = outer(4)
    found = read_outer(address_row(structure)[None], 0, np.float64(0))
    for one, other in zip(leaves(found), leaves(structure), strict=True):
        assert one.ctypes.data == other.ctypes.data and one.shape == other.shape and one.dtype == other.dtype


def test_a_row_of_more_serves_whoever_reads_its_beginning():
    longer = Longer(outer(3), np.ones(2))
    table = address_row(longer)[None]
    assert digest(table, 0, np.float64(0)) == digest(address_row(longer.outer)[None], 0, np.float64(0))
    assert read_longer(table, 0, np.float64(0)).more.tolist() == [1.0, 1.0]


def test_an_array_with_gaps_is_refused():
    gaps = outer(4)
    with pytest.raises(ValueError, match="not contiguous"):
        address_row(gaps._replace(numbers=gaps.numbers[::2]))


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda body: pickle.loads(pickle.dumps(body))])
def test_a_copied_body_has_addresses_of_its_own(copied):
    sim = gs.Simulation(zoo.build("slab"), gs.Material(5e3, 1e3), gravity=(0.0, 0.0, -9.81))
    twin = copied(sim)
    before = sim.body.nodes.state.copy()
    twin.remove_tetrahedron(0)
    twin.advance(1e-3)
    assert (sim.body.nodes.state == before).all() and sim.body.n_tetrahedra == twin.body.n_tetrahedra + 1
    sim.check_validity()
    twin.check_validity()
    sim.remove_tetrahedron(0)
    sim.advance(1e-3)
    assert sim.body.nodes.state.tobytes() == twin.body.nodes.state.tobytes()
