"""From samples to pixels: contact shadows in clefts, mesh lines, smooth edges, bytes."""

import numpy as np

from gmapspring.jit import kernel

CELL = 4
"""Samples along a side of the cells on which contact shadows are found."""

LARGEST_RADIUS = 64.0
"""Reach of contact shadows on the picture [cells], however near the eye comes."""

OCCLUSION_GAIN = 2.2
"""Makes the floor of a right-angled groove about a quarter darker, a narrow cleft up to black."""

N_TAPS = 8
_TURN = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(4 * N_TAPS)
_RADIUS = np.sqrt((np.arange(4 * N_TAPS) + 0.5) / (4 * N_TAPS))
TAPS = np.stack([_RADIUS * np.cos(_TURN), _RADIUS * np.sin(_TURN)], axis=1).reshape(N_TAPS, 4, 2).swapaxes(0, 1).copy()
"""Where contact shadows look: a sunflower in the unit disc, dealt out to the cells of each square of four, (4, N_TAPS, 2)."""


@kernel
def _find_depths(nearness, depths):
    """Write the depth [m] in the middle of each cell, infinite where nothing is seen."""
    for row in range(depths.shape[0]):
        y = min(row * CELL + CELL // 2, nearness.shape[0] - 1)
        for column in range(depths.shape[1]):
            near = nearness[y, min(column * CELL + CELL // 2, nearness.shape[1] - 1)]
            depths[row, column] = np.float32(1.0) / near if near > 0.0 else np.float32(np.inf)


@kernel
def _rise(normal, here, there, fade):
    """Return how steeply a neighbour stands above the tangent plane, 0 to 1, less with distance^2 * fade.

    here and there are places on the picture over the focal length, x and y down, and the depth there [m].
    """
    d0, d1, d2 = there[0] * there[2] - here[0] * here[2], here[1] * here[2] - there[1] * there[2], here[2] - there[2]
    square = d0 * d0 + d1 * d1 + d2 * d2 + 1e-30
    sine = (normal[0] * d0 + normal[1] * d1 + normal[2] * d2) / np.sqrt(square)
    return max(0.0, sine - 0.1) * max(0.0, 1.0 - fade * square)


@kernel
def _smooth(rough, depths, reach, out):
    """Write the mean over each cell and those next to it that are no more than `reach` before or behind it.

    Weights 1 2 1 along both sides: the four deals of taps then count alike, and their pattern vanishes.
    """
    height, width = out.shape
    for row in range(height):
        for column in range(width):
            out[row, column] = 1.0
            if depths[row, column] == np.inf:
                continue
            total, weight = np.float32(0.0), np.float32(0.0)
            for i in range(max(row - 1, 0), min(row + 2, height)):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if abs(depths[i, j] - depths[row, column]) <= reach:
                        share = np.float32((2 - abs(i - row)) * (2 - abs(j - column)))
                        total, weight = total + share * rough[i, j], weight + share
            out[row, column] = total / weight


@kernel
def occlude(nearness, owner, normals, focal, reach, out):
    """Write to each cell of CELL by CELL samples how open its surroundings are, 1 open to 0 shut.

    A neighbour within `reach` [m] that stands above the tangent plane takes light away, the more the steeper it stands
    (after Bavoil and Sainz, 2009). focal is in cells; normals (n_triangles, 3) are as the eye sees them.
    """
    height, width = out.shape
    depths, rough = np.empty((height, width), np.float32), np.ones((height, width), np.float32)
    _find_depths(nearness, depths)
    per_cell, fade = 1.0 / focal, 0.25 / (reach * reach)
    for row in range(height):
        source = min(row * CELL + CELL // 2, owner.shape[0] - 1)
        for column in range(width):
            depth, shut = depths[row, column], 0.0
            if depth == np.inf:
                continue
            t = owner[source, min(column * CELL + CELL // 2, owner.shape[1] - 1)]
            normal = normals[t, 0], normals[t, 1], normals[t, 2]
            radius, deal = min(reach * focal / depth, LARGEST_RADIUS), 2 * (row & 1) + (column & 1)
            here = (column - 0.5 * width) * per_cell, (row - 0.5 * height) * per_cell, depth
            for tap in range(N_TAPS):
                to_x, to_y = int(np.rint(radius * TAPS[deal, tap, 0])), int(np.rint(radius * TAPS[deal, tap, 1]))
                if 0 <= column + to_x < width and 0 <= row + to_y < height:
                    far = depths[row + to_y, column + to_x]
                    if far < np.inf:
                        there = here[0] + to_x * per_cell, here[1] + to_y * per_cell, far
                        shut += _rise(normal, here, there, fade)
            rough[row, column] = max(0.0, 1.0 - OCCLUSION_GAIN * shut / N_TAPS)
    _smooth(rough, depths, reach, out)


@kernel
def _collect(owner, row, triangles, places):
    """Write what is seen in one row of pixels, one entry per triangle and pixel, and return the number of entries.

    triangles (4 * width,) gets the triangle; places (4 * width, 3) the pixel position x, y in the middle of the samples
    it covers, always a point of the triangle, and its share of the pixel.
    """
    n = 0
    for column in range(owner.shape[1] // 2):
        triangle, first = owner[2 * row, 2 * column], n
        if (
            triangle == owner[2 * row, 2 * column + 1]
            and triangle == owner[2 * row + 1, 2 * column]
            and triangle == owner[2 * row + 1, 2 * column + 1]
        ):
            if triangle >= 0:
                triangles[n] = triangle
                places[n, 0], places[n, 1], places[n, 2] = column + 0.5, row + 0.5, 1.0
                n += 1
            continue
        for j in range(4):
            triangle = owner[2 * row + (j >> 1), 2 * column + (j & 1)]
            if triangle < 0:
                continue
            entry = first
            while entry < n and triangles[entry] != triangle:
                entry += 1
            if entry == n:
                triangles[n], places[n, 0], places[n, 1], places[n, 2] = triangle, 0.0, 0.0, 0.0
                n += 1
            places[entry, 0] += column + 0.25 + 0.5 * (j & 1)
            places[entry, 1] += row + 0.25 + 0.5 * (j >> 1)
            places[entry, 2] += 1.0
        for entry in range(first, n):
            count = places[entry, 2]
            places[entry, 0], places[entry, 1] = places[entry, 0] / count, places[entry, 1] / count
            places[entry, 2] = 0.25 * count
    return n


@kernel
def _shade(places, n, grid, look, shades):
    """Write the openness of n entries, between the four nearest cells of the grid."""
    height, width = grid.shape
    for entry in range(n):
        v = min(max(places[entry, 0] * (2.0 / CELL) - 0.5, 0.0), width - 1.0)
        u = min(max(places[entry, 1] * (2.0 / CELL) - 0.5, 0.0), height - 1.0)
        row, column = min(int(u), height - 2), min(int(v), width - 2)
        u, v = u - row, v - column
        upper = (1.0 - v) * grid[row, column] + v * grid[row, column + 1]
        lower = (1.0 - v) * grid[row + 1, column] + v * grid[row + 1, column + 1]
        shades[entry] = 1.0 - look.occlusion * (1.0 - (1.0 - u) * upper - u * lower)


@kernel
def _blend(plan, triangles, places, shades, n, look, sky, line):
    """Blend n entries into a row of squared red, green, blue (3 * width,) that starts as sky.

    The plan is read in place: handing on slices of it would cost more than the light itself.
    """
    for entry in range(n):
        t, x, y, share = triangles[entry], places[entry, 0], places[entry, 1], places[entry, 2]
        a = plan[t, 0] * x + plan[t, 1] * y + plan[t, 2]
        b = plan[t, 3] * x + plan[t, 4] * y + plan[t, 5]
        c = plan[t, 6] * x + plan[t, 7] * y + plan[t, 8]
        edge = min(abs(a) * plan[t, 9], abs(b) * plan[t, 10], abs(c) * plan[t, 11])
        shade = shades[entry] * (1.0 - look.wire * min(1.0, max(0.0, 1.2 - edge)))
        p, q, r = a * (2.0 * a - 1.0), b * (2.0 * b - 1.0), c * (2.0 * c - 1.0)
        a, b, c = 4.0 * b * c, 4.0 * c * a, 4.0 * a * b
        column = 3 * int(x)
        for i in range(3):
            light = p * plan[t, 12 + i] + q * plan[t, 15 + i] + r * plan[t, 18 + i]
            light += a * plan[t, 21 + i] + b * plan[t, 24 + i] + c * plan[t, 27 + i]
            line[column + i] += share * (shade * max(0.0, light) - sky[i])


@kernel
def paint(plan, owner, grid, look, background, out):
    """Write the picture (height, 3 * width) uint8: each triangle seen in a pixel is lit once, where it is seen.

    owner has two by two samples per pixel; background (2, 3) holds the top and bottom colour, squared.
    """
    height, width = out.shape[0], out.shape[1] // 3
    triangles, places = np.empty(4 * width, np.int32), np.empty((4 * width, 3))
    shades, line = np.ones(4 * width), np.empty(3 * width, np.float32)
    for row in range(height):
        down = (row + 0.5) / height
        sky = (1.0 - down) * background[0] + down * background[1]
        for i in range(3):
            line[i::3] = sky[i]
        n = _collect(owner, row, triangles, places)
        if look.occlusion > 0.0:
            _shade(places, n, grid, look, shades)
        _blend(plan, triangles, places, shades, n, look, (sky[0], sky[1], sky[2]), line)
        pixels = out[row]
        for i in range(3 * width):
            # The square root is close to the curve of a screen, and exact everywhere.
            light = min(np.float32(1.0), max(np.float32(0.0), line[i]))
            pixels[i] = np.uint8(np.float32(255.0) * np.sqrt(light) + np.float32(0.5))
