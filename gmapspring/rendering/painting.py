"""From samples to pixels: contact shadows in clefts, mesh lines, smooth edges, bytes."""

import numpy as np

from gmapspring.jit import kernel

CELL = 4
"""Samples along a side of the cells on which contact shadows are found."""

PIXELS = CELL / 2
"""The same in pixels."""

SQUARE = 2 * CELL
"""Samples along a square of four cells, each of which looks elsewhere: where a window begins, to show what the whole would."""

LARGEST_RADIUS = 64.0
"""Reach of contact shadows on the picture [cells], however near the eye comes."""

OCCLUSION_GAIN = 2.2
"""Makes the floor of a right-angled groove about a quarter darker, a narrow cleft up to black."""

N_TAPS = 8
_TURN = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(4 * N_TAPS)
_RADIUS = np.sqrt((np.arange(4 * N_TAPS) + 0.5) / (4 * N_TAPS))
TAPS = np.stack([_RADIUS * np.cos(_TURN), _RADIUS * np.sin(_TURN)], axis=1).reshape(N_TAPS, 4, 2).swapaxes(0, 1).copy()
"""Where contact shadows look: a sunflower in the unit disc, dealt out to the cells of each square of four, (4, N_TAPS, 2)."""

STEPS_PER_CELL = 4
_RADII = np.arange(STEPS_PER_CELL * int(LARGEST_RADIUS) + 1)[:, None, None, None] / STEPS_PER_CELL
OFFSETS = np.rint(_RADII * TAPS).astype(np.int64)
"""The same in whole cells for radii in steps of a quarter of a cell, (n_steps, 4, N_TAPS, 2)."""


@kernel
def _find_depths(nearness, depths):
    """Write the depth [m] in the middle of each cell, infinite where nothing is seen."""
    for row in range(depths.shape[0]):
        y = min(row * CELL + CELL // 2, nearness.shape[0] - 1)
        for column in range(depths.shape[1]):
            near = nearness[y, min(column * CELL + CELL // 2, nearness.shape[1] - 1)]
            depths[row, column] = np.float32(1.0) / near if near > 0.0 else np.float32(np.inf)


@kernel
def _rise(above, square, fade):
    """Return how steeply a neighbour stands above the tangent plane, 0 to 1, less with distance^2 * fade.

    above: its height over the plane [m]; square: its distance, squared [m^2].
    """
    # Most of a surface is no cleft: told here, without a root.
    if above * above <= 0.01 * square or fade * square >= 1.0:
        return 0.0
    return max(0.0, above / np.sqrt(square) - 0.1) * (1.0 - fade * square)


@kernel
def _shut_columns(rough, first, last):
    """Write the first and the last cell of each row that is not quite open; last is before first where all are."""
    for row in range(rough.shape[0]):
        first[row], last[row] = rough.shape[1], -1
        for column in range(rough.shape[1]):
            if rough[row, column] < 1.0:
                first[row] = min(first[row], column)
                last[row] = column


@kernel
def _smooth(rough, depths, reach, out):
    """Write the mean over each cell and those next to it that are no more than `reach` before or behind it.

    Weights 1 2 1 along both sides: the four deals of taps then count alike, and their pattern vanishes. The mean of open cells
    is open: only cells beside one that is not need to be looked at.
    """
    height, width = out.shape
    first, last = np.empty(height, np.int64), np.empty(height, np.int64)
    _shut_columns(rough, first, last)
    out[:] = 1.0
    for row in range(height):
        top, bottom = max(row - 1, 0), min(row + 2, height)
        for column in range(max(first[top:bottom].min() - 1, 0), min(last[top:bottom].max() + 2, width)):
            if depths[row, column] == np.inf:
                continue
            total, weight = np.float32(0.0), np.float32(0.0)
            for i in range(top, bottom):
                for j in range(max(column - 1, 0), min(column + 2, width)):
                    if abs(depths[i, j] - depths[row, column]) <= reach:
                        share = np.float32((2 - abs(i - row)) * (2 - abs(j - column)))
                        total, weight = total + share * rough[i, j], weight + share
            out[row, column] = total / weight


@kernel
def occlude(nearness, owner, normals, look, reach, out):
    """Write to each cell of CELL by CELL samples how open its surroundings are, 1 open to 0 shut.

    A neighbour within `reach` [m] that stands above the tangent plane takes light away, the more the steeper it stands
    (after Bavoil and Sainz, 2009). normals (n_triangles, 3) are as the eye sees them.
    """
    height, width = out.shape
    depths, rough = np.empty((height, width), np.float32), np.ones((height, width), np.float32)
    _find_depths(nearness, depths)
    # Lengths of the lens, in cells.
    middle_x, middle_y, focal = look.eye[0] / PIXELS, look.eye[1] / PIXELS, 1.0 / (look.eye[2] * PIXELS)
    per_cell, fade = 1.0 / focal, 0.25 / (reach * reach)
    for row in range(height):
        source = min(row * CELL + CELL // 2, owner.shape[0] - 1)
        y = (middle_y - row) * per_cell
        for column in range(width):
            depth, shut = np.float64(depths[row, column]), 0.0
            if depth == np.inf:
                continue
            t = owner[source, min(column * CELL + CELL // 2, owner.shape[1] - 1)]
            n0, n1, x = normals[t, 0], normals[t, 1], (column - middle_x) * per_cell
            # A neighbour at x', y', depth' is d = (x' depth' - x depth, y' depth' - y depth, depth - depth') away.
            along = n0 * x + n1 * y - normals[t, 2]
            radius, deal = min(reach * focal / depth, LARGEST_RADIUS), 2 * (row & 1) + (column & 1)
            step = int(STEPS_PER_CELL * radius)
            for tap in range(N_TAPS):
                to_x, to_y = OFFSETS[step, deal, tap, 0], OFFSETS[step, deal, tap, 1]
                if not (0 <= column + to_x < width and 0 <= row + to_y < height):
                    continue
                far = np.float64(depths[row + to_y, column + to_x])
                above = (far - depth) * along + far * per_cell * (n0 * to_x - n1 * to_y)
                # Below this no neighbour, a cell away at least, stands steeply enough to count.
                if far < np.inf and above > 0.05 * per_cell * min(depth, far):
                    d0 = (far - depth) * x + far * per_cell * to_x
                    d1 = (far - depth) * y - far * per_cell * to_y
                    shut += _rise(above, d0 * d0 + d1 * d1 + (depth - far) * (depth - far), fade)
            rough[row, column] = max(0.0, 1.0 - OCCLUSION_GAIN * shut / N_TAPS)
    _smooth(rough, depths, reach, out)


@kernel
def _collect(owner, row, runs, triangles, places):
    """Write what is seen in one row of pixels; return the number of runs and of entries.

    A run is a stretch of pixels that one triangle covers whole: its triangle, first column and the column behind the last,
    (width, 3). Other pixels have an entry per triangle seen: triangles (4 * width,) gets the triangle; places (4 * width, 3)
    the pixel position x, y in the middle of the samples it covers, always a point of the triangle, and its share of the pixel.
    """
    n_runs, n = 0, 0
    upper, lower = owner[2 * row], owner[2 * row + 1]
    for column in range(owner.shape[1] // 2):
        triangle, first = upper[2 * column], n
        if triangle == upper[2 * column + 1] and triangle == lower[2 * column] and triangle == lower[2 * column + 1]:
            if triangle >= 0:
                if n_runs and runs[n_runs - 1, 0] == triangle and runs[n_runs - 1, 2] == column:
                    runs[n_runs - 1, 2] = column + 1
                else:
                    runs[n_runs, 0], runs[n_runs, 1], runs[n_runs, 2] = triangle, column, column + 1
                    n_runs += 1
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
    return n_runs, n


@kernel
def _shade(grid, row, strength, mixed, shades):
    """Write the openness of a row of pixels, between the cells of the grid, two pixels wide and high each; mixed is scratch."""
    height, width = grid.shape
    above = max((row - 1) // 2, 0)
    below = min((row + 1) // 2, height - 1)
    near = np.float32(0.75)
    weight = near if row % 2 else np.float32(1.0) - near
    for cell in range(width):
        mixed[cell] = weight * grid[above, cell] + (np.float32(1.0) - weight) * grid[below, cell]
    far, strength = np.float32(1.0) - near, np.float32(strength)
    for column in range(len(shades)):
        cell = column // 2
        beside = min(cell + 1, width - 1) if column % 2 else max(cell - 1, 0)
        shades[column] = np.float32(1.0) - strength * (np.float32(1.0) - near * mixed[cell] - far * mixed[beside])


@kernel
def _blend_run(plan, run, y, shades, look, line):
    """Light a run of pixels of a row (3, width): along it, a triangle's light is a quadratic in the column."""
    t, first = run[0], run[1]
    x = first + 0.5
    a = plan[t, 0] * x + plan[t, 1] * y + plan[t, 2]
    b = plan[t, 3] * x + plan[t, 4] * y + plan[t, 5]
    c = plan[t, 6] * x + plan[t, 7] * y + plan[t, 8]
    u, v, w = plan[t, 0], plan[t, 3], plan[t, 6]
    start = a * (2.0 * a - 1.0), b * (2.0 * b - 1.0), c * (2.0 * c - 1.0), 4.0 * b * c, 4.0 * c * a, 4.0 * a * b
    slope = (
        u * (4.0 * a - 1.0), v * (4.0 * b - 1.0), w * (4.0 * c - 1.0),
        4.0 * (b * w + v * c), 4.0 * (c * u + w * a), 4.0 * (a * v + u * b),
    )  # fmt: skip
    bend = 2.0 * u * u, 2.0 * v * v, 2.0 * w * w, 4.0 * v * w, 4.0 * w * u, 4.0 * u * v
    wire, one, zero, rim = np.float32(look.wire), np.float32(1.0), np.float32(0.0), np.float32(1.2)
    a0, b0, c0 = np.float32(a * plan[t, 9]), np.float32(b * plan[t, 10]), np.float32(c * plan[t, 11])
    a1, b1, c1 = np.float32(u * plan[t, 9]), np.float32(v * plan[t, 10]), np.float32(w * plan[t, 11])
    part = shades[first : run[2]]
    for k in range(len(part)):
        step = np.float32(k)
        edge = min(abs(a0 + a1 * step), abs(b0 + b1 * step), abs(c0 + c1 * step))
        part[k] *= one - wire * min(one, max(zero, rim - edge))
    for i in range(3):
        q0, q1, q2 = 0.0, 0.0, 0.0
        for j in range(6):
            q0 += start[j] * plan[t, 12 + 3 * j + i]
            q1 += slope[j] * plan[t, 12 + 3 * j + i]
            q2 += bend[j] * plan[t, 12 + 3 * j + i]
        p0, p1, p2 = np.float32(q0), np.float32(q1), np.float32(q2)
        target = line[i, first : run[2]]
        for k in range(len(part)):
            step = np.float32(k)
            target[k] = part[k] * max(zero, p0 + step * (p1 + step * p2))


@kernel
def _blend(plan, triangles, places, shades, n, look, sky, line):
    """Blend n entries into a row of squared red, green, blue (3, width) that starts as sky.

    The plan is read in place: handing on slices of it would cost more than the light itself.
    """
    for entry in range(n):
        t, x, y, share = triangles[entry], places[entry, 0], places[entry, 1], places[entry, 2]
        a = plan[t, 0] * x + plan[t, 1] * y + plan[t, 2]
        b = plan[t, 3] * x + plan[t, 4] * y + plan[t, 5]
        c = plan[t, 6] * x + plan[t, 7] * y + plan[t, 8]
        edge = min(abs(a) * plan[t, 9], abs(b) * plan[t, 10], abs(c) * plan[t, 11])
        shade = shades[int(x)] * (1.0 - look.wire * min(1.0, max(0.0, 1.2 - edge)))
        p, q, r = a * (2.0 * a - 1.0), b * (2.0 * b - 1.0), c * (2.0 * c - 1.0)
        a, b, c = 4.0 * b * c, 4.0 * c * a, 4.0 * a * b
        for i in range(3):
            light = p * plan[t, 12 + i] + q * plan[t, 15 + i] + r * plan[t, 18 + i]
            light += a * plan[t, 21 + i] + b * plan[t, 24 + i] + c * plan[t, 27 + i]
            line[i, int(x)] += share * (shade * max(0.0, light) - sky[i])


@kernel
def _to_bytes(light):
    """Return a part of squared light as a byte; the square root is close to the curve of a screen, and exact everywhere."""
    return np.uint8(np.float32(255.0) * np.sqrt(min(np.float32(1.0), max(np.float32(0.0), light))) + np.float32(0.5))


@kernel
def _fill_sky(sky, first, last, pixels):
    """Write the colour of the background to some columns of a row of the picture."""
    red, green, blue = _to_bytes(np.float32(sky[0])), _to_bytes(np.float32(sky[1])), _to_bytes(np.float32(sky[2]))
    for column in range(first, last):
        pixels[3 * column], pixels[3 * column + 1], pixels[3 * column + 2] = red, green, blue


@kernel
def paint(plan, owner, grid, look, background, window, out):
    """Write the picture (height, 3 * width) uint8: each triangle seen in a pixel is lit once, where it is seen.

    owner has two by two samples per pixel of the window, outside which there is nothing; background (2, 3) holds the top and
    bottom colour, squared.
    """
    height, width = out.shape[0], owner.shape[1] // 2
    runs, triangles, places = np.empty((width, 3), np.int64), np.empty(4 * width, np.int32), np.empty((4 * width, 3))
    shades, mixed = np.ones(width, np.float32), np.empty(grid.shape[1], np.float32)
    line, levels = np.empty((3, width), np.float32), np.empty((3, width), np.uint8)
    for y in range(height):
        down = (y + 0.5) / height
        sky = (1.0 - down) * background[0] + down * background[1]
        if y < window.top or y >= window.bottom:
            _fill_sky(sky, 0, out.shape[1] // 3, out[y])
            continue
        _fill_sky(sky, 0, window.left, out[y])
        _fill_sky(sky, window.right, out.shape[1] // 3, out[y])
        row = y - window.top
        for i in range(3):
            line[i] = sky[i]
        n_runs, n = _collect(owner, row, runs, triangles, places)
        if look.occlusion > 0.0:
            _shade(grid, row, look.occlusion, mixed, shades)
        else:
            shades[:] = 1.0
        for run in range(n_runs):
            _blend_run(plan, runs[run], row + 0.5, shades, look, line)
        _blend(plan, triangles, places, shades, n, look, (sky[0], sky[1], sky[2]), line)
        for i in range(3):
            for column in range(width):
                levels[i, column] = _to_bytes(line[i, column])
        pixels = out[y, 3 * window.left : 3 * window.right]
        for column in range(width):
            for i in range(3):
                pixels[3 * column + i] = levels[i, column]
