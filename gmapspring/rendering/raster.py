"""The z-buffer: which triangle is seen at every sample of a picture.

Corners are snapped to 1/256 of a sample and covered samples are found in whole numbers, with the top-left rule: two
triangles that share an edge cover each sample along it exactly once, whatever the order and the machine.
"""

import threading
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gmapspring.jit import kernel

BACKGROUND = -1
SUBSAMPLES = 256
LARGEST_COORDINATE = 1 << 20  # [samples]: products of snapped coordinates stay far below 2**63


class Window(NamedTuple):
    """A part of a picture [pixels]; the right column and the bottom row lie just outside."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        """Return the number of columns."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """Return the number of rows."""
        return self.bottom - self.top


@kernel
def _find_reach(screen, reach):
    """Write the least and the largest x, then y, of all points that can be drawn; tell whether there is one."""
    reach[:, 0], reach[:, 1] = np.inf, -np.inf
    for i in range(screen.shape[0]):
        x, y = screen[i, 0], screen[i, 1]
        if screen[i, 2] > 0.0 and abs(x) < LARGEST_COORDINATE and abs(y) < LARGEST_COORDINATE:
            reach[0, 0], reach[0, 1] = min(reach[0, 0], x), max(reach[0, 1], x)
            reach[1, 0], reach[1, 1] = min(reach[1, 0], y), max(reach[1, 1], y)
    return reach[0, 0] <= reach[0, 1]


def find_window(screen: NDArray[np.float64], size: tuple[int, int], grid: int) -> Window:
    """Return the part of a picture in which all that can be drawn lies, with room for one cell of a grid around it.

    screen (n, 3) holds x, y [pixels] and one over the depth; size is (width, height), grid the side of a cell [pixels]. A window
    begins at a corner of a cell. Where there is nothing to draw it holds the first cell: no part is empty.
    """
    reach = np.empty((2, 2))
    if not _find_reach(screen, reach):
        return Window(0, 0, min(grid, size[0]), min(grid, size[1]))
    sides = []
    for (low, high), length in zip(reach.tolist(), size, strict=True):
        first = min(max(int(low) // grid - 1, 0), (length - 1) // grid)
        sides.append((grid * first, min(max(grid * (int(high) // grid + 2), grid * (first + 1)), length)))
    (left, right), (top, bottom) = sides
    return Window(left, top, right, bottom)


@kernel
def _edge_bias(dx, dy):
    """Return 0 for a top or left edge, whose samples belong to the triangle, else -1."""
    return 0 if dy < 0 or (dy == 0 and dx > 0) else -1


@kernel
def _snap(coordinate):
    """Return the nearest whole number of 1/SUBSAMPLES of a sample."""
    return np.int64(np.floor(coordinate * SUBSAMPLES + 0.5))


@kernel
def _is_drawable(screen, a, b, c):
    """Tell whether all three corners lie in front of the eye and within the range of the snapped grid."""
    for corner in (a, b, c):
        if not screen[corner, 2] > 0.0:
            return False
        if not (abs(screen[corner, 0]) < LARGEST_COORDINATE and abs(screen[corner, 1]) < LARGEST_COORDINATE):
            return False
    return True


@kernel
def _narrow(first, last, edge, step):
    """Return the columns of first..last on which edge - step * column >= 0."""
    if step > 0:
        return first, min(last, edge // step)
    if step < 0:
        return max(first, -(edge // -step)), last
    return first, last if edge >= 0 else first - 1


@kernel
def _fill(triangle, x, y, w, nearness, owner):
    """Draw one triangle with snapped corners x, y (tuples of 3) in positive order and inverse depths w."""
    height, width = owner.shape
    half = SUBSAMPLES // 2
    left = max(0, (min(x[0], x[1], x[2]) - half) // SUBSAMPLES)
    right = min(width - 1, (max(x[0], x[1], x[2]) - half) // SUBSAMPLES + 1)
    top = max(0, (min(y[0], y[1], y[2]) - half) // SUBSAMPLES)
    bottom = min(height - 1, (max(y[0], y[1], y[2]) - half) // SUBSAMPLES + 1)
    dx0, dy0 = x[2] - x[1], y[2] - y[1]  # edge opposite each corner
    dx1, dy1 = x[0] - x[2], y[0] - y[2]
    dx2, dy2 = x[1] - x[0], y[1] - y[0]
    area = dx2 * (y[2] - y[0]) - dy2 * (x[2] - x[0])
    bias0, bias1, bias2 = _edge_bias(dx0, dy0), _edge_bias(dx1, dy1), _edge_bias(dx2, dy2)
    slope = -(dy0 * w[0] + dy1 * w[1] + dy2 * w[2]) / area * SUBSAMPLES
    for row in range(top, bottom + 1):
        sample_y = row * SUBSAMPLES + half
        e0 = dx0 * (sample_y - y[1]) - dy0 * (half - x[1])
        e1 = dx1 * (sample_y - y[2]) - dy1 * (half - x[2])
        e2 = dx2 * (sample_y - y[0]) - dy2 * (half - x[0])
        first, last = _narrow(left, right, e0 + bias0, dy0 * SUBSAMPLES)
        first, last = _narrow(first, last, e1 + bias1, dy1 * SUBSAMPLES)
        first, last = _narrow(first, last, e2 + bias2, dy2 * SUBSAMPLES)
        start = (e0 * w[0] + e1 * w[1] + e2 * w[2]) / area + slope * first
        near_line, owner_line = nearness[row, first : last + 1], owner[row, first : last + 1]
        # Stores without a branch: the compiler takes many samples at a time.
        for i in range(last + 1 - first):
            near = np.float32(start + slope * i)
            is_nearer = near > near_line[i]
            near_line[i] = near if is_nearer else near_line[i]
            owner_line[i] = triangle if is_nearer else owner_line[i]


@kernel
def _rasterise(screen, triangles, is_closed, nearness, owner):
    """Draw all triangles, the first one in front where two are equally near."""
    for triangle in range(triangles.shape[0]):
        # y points down, so an outward (counter-clockwise) triangle comes in negative order: swap two corners.
        a, c, b = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        if not _is_drawable(screen, a, b, c):
            continue
        x = _snap(screen[a, 0]), _snap(screen[b, 0]), _snap(screen[c, 0])
        y = _snap(screen[a, 1]), _snap(screen[b, 1]), _snap(screen[c, 1])
        w = screen[a, 2], screen[b, 2], screen[c, 2]
        area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
        if area > 0:
            _fill(np.int32(triangle), x, y, w, nearness, owner)
        elif area < 0 and not is_closed:
            _fill(
                np.int32(triangle), (x[0], x[2], x[1]), (y[0], y[2], y[1]), (w[0], w[2], w[1]), nearness, owner
            )


def rasterise(
    screen: NDArray[np.float64], triangles: NDArray[np.int32], size: tuple[int, int], is_closed: bool = False
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the inverse depth (0 where nothing) and the triangle (-1 where nothing) at each sample, (height, width).

    screen (n, 3) holds x, y [samples] and one over the depth; size is (width, height). Triangles that reach behind
    the eye are left out. On a closed surface only triangles that face the eye are drawn: the others are hidden anyhow.
    The arrays are overwritten by the thread's next call.
    """
    nearness, owner = _buffers((size[1], size[0]))
    nearness[:], owner[:] = 0.0, BACKGROUND
    _rasterise(np.ascontiguousarray(screen), triangles, is_closed, nearness, owner)
    return nearness, owner


@kernel
def find_depths(nearness, samples, window, out):
    """Write the depth [m] of the nearest of each pixel's samples, where there are any in a window of out, (height, width)."""
    for row in range(window.bottom - window.top):
        for column in range(window.right - window.left):
            near = np.float32(0.0)
            for i in range(samples):
                for j in range(samples):
                    near = max(near, nearness[samples * row + i, samples * column + j])
            if near > 0.0:
                out[window.top + row, window.left + column] = np.float32(1.0) / near


_LAST = threading.local()


def _buffers(shape: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return arrays of a shape from the thread's own, kept from its last calls: fresh memory costs more time than the drawing."""
    n = shape[0] * shape[1]
    if len(getattr(_LAST, "nearness", ())) < n:
        _LAST.nearness, _LAST.owner = np.empty(n, np.float32), np.empty(n, np.int32)
    return _LAST.nearness[:n].reshape(shape), _LAST.owner[:n].reshape(shape)
