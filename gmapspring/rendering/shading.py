"""Light: smooth normals up to a crease, and how bright each triangle is, at six of its points.

Only additions, products, quotients and square roots: the same picture, byte for byte, on any machine.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gmapspring.jit import kernel

CREASE = 0.6
"""Cosine of the angle between two faces above which the edge between them is shown sharp."""

N_PLAN = 30
"""Columns of a plan, the numbers that the pixels of a triangle need (see `make_plan`)."""


class Drawing(NamedTuple):
    """Triangles as the eye sees them: x to the right, y up, z towards the eye."""

    screen: NDArray[np.float64]
    """Position of each point on the picture [pixels] and one over its depth [1/m], shape (n_points, 3)."""
    triangles: NDArray[np.int32]
    """Points of each triangle, counter-clockwise seen from outside, shape (n_triangles, 3)."""
    normals: NDArray[np.float64]
    """Unit normal at each corner, shape (n_triangles, 3, 3)."""
    colors: NDArray[np.float64]
    """Squared red, green, blue of each corner (about linear light), shape (n_triangles, 3, 3)."""


class Look(NamedTuple):
    """Numbers of the light and the lens."""

    gloss: float
    """Strength of highlights: 0 is dull, 1 wet."""
    wire: float
    """Darkness of the mesh lines: 0 draws none, 1 draws black."""
    occlusion: float
    """Strength of contact shadows: 0 draws none."""
    eye: tuple[float, float, float]
    """Middle of the picture, x and y [pixels], and one over the focal length [1/pixels]."""


@kernel
def square_colors(colors, out):
    """Write squared colours, about linear light, of values held between 0 and 1; what is no number is black."""
    for i in range(len(colors)):
        color = min(1.0, max(0.0, colors[i])) if colors[i] == colors[i] else 0.0
        out[i] = color * color


@kernel
def _face_normals(points, triangles, out):
    """Write the outward normal of each triangle, twice its area long, and that length, (n_triangles, 4)."""
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            left = (points[b, j] - points[a, j]) * (points[c, k] - points[a, k])
            out[t, i] = left - (points[b, k] - points[a, k]) * (points[c, j] - points[a, j])
        out[t, 3] = np.sqrt(out[t, 0] * out[t, 0] + out[t, 1] * out[t, 1] + out[t, 2] * out[t, 2])


@kernel
def _list_triangles(triangles, n_points):
    """Return the triangles around each point: start (n_points + 1,) into around (3 * n_triangles,)."""
    start = np.zeros(n_points + 1, np.int64)
    around = np.empty(triangles.size, np.int64)
    for t in range(triangles.shape[0]):
        for i in range(3):
            start[triangles[t, i]] += 1
    for point in range(n_points):
        start[point + 1] += start[point]
    for t in range(triangles.shape[0] - 1, -1, -1):
        for i in range(3):
            # Filled from the end of each list, so that its start is left where it belongs.
            start[triangles[t, i]] -= 1
            around[start[triangles[t, i]]] = t
    return start, around


@kernel
def _corner_normals(triangles, is_smooth, faces, start, around, out):
    """Sum, at each smooth corner, the normals of the smooth triangles around it that are not past a crease."""
    for t in range(triangles.shape[0]):
        for i in range(3):
            x, y, z = faces[t, 0], faces[t, 1], faces[t, 2]
            point = triangles[t, i]
            for place in range(start[point], start[point + 1] if is_smooth[t] else start[point]):
                other = around[place]
                cosine = (
                    faces[t, 0] * faces[other, 0] + faces[t, 1] * faces[other, 1] + faces[t, 2] * faces[other, 2]
                )
                if other != t and is_smooth[other] and cosine > CREASE * faces[t, 3] * faces[other, 3]:
                    x, y, z = x + faces[other, 0], y + faces[other, 1], z + faces[other, 2]
            length = np.sqrt(x * x + y * y + z * z)
            # A triangle without area, or not finite, has no direction: let it face the eye.
            scale = 1.0 / length if 0.0 < length < np.inf else 0.0
            out[t, i, 0], out[t, i, 1], out[t, i, 2] = 0.0, 0.0, 1.0
            if scale > 0.0:
                out[t, i, 0], out[t, i, 1], out[t, i, 2] = x * scale, y * scale, z * scale


def corner_normals(
    points: NDArray[np.float64], triangles: NDArray[np.int32], is_smooth: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return unit normals at all corners (n_triangles, 3, 3): area-weighted means where smooth, else flat."""
    faces, normals = np.empty((len(triangles), 4)), np.empty((len(triangles), 3, 3))
    _face_normals(points, triangles, faces)
    start, around = _list_triangles(triangles, len(points))
    _corner_normals(triangles, is_smooth, faces, start, around, normals)
    return normals


@kernel
def _brightness(n, v, gloss):
    """Return the diffuse and the mirrored light at a point with unit normal n and unit direction v to the eye.

    A key light from the upper right, a weak fill from the left, and a sky that is brighter than the ground. Diffuse
    light wraps a little past the edge of shadow, as it does in tissue; highlights are by Phong (1975).
    """
    to_key = 0.36 * n[0] + 0.48 * n[1] + 0.80 * n[2]
    key = max(0.0, (to_key + 0.2) / 1.2)
    fill = max(0.0, -0.80 * n[0] + 0.60 * n[2])
    facing = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
    sharp = max(0.0, 2.0 * to_key * facing - (0.36 * v[0] + 0.48 * v[1] + 0.80 * v[2]))
    for _ in range(4):
        sharp *= sharp
    edge = 1.0 - max(0.0, facing)
    return 0.26 + 0.08 * n[1] + 0.74 * key + 0.22 * fill, gloss * (0.40 * sharp + 0.10 * edge * edge * edge)


@kernel
def _light(place, normal, color, look):
    """Return the squared red, green, blue of a point at pixel position `place`, of any length of normal."""
    v0, v1 = (look.eye[0] - place[0]) * look.eye[2], (place[1] - look.eye[1]) * look.eye[2]
    scale = 1.0 / np.sqrt(v0 * v0 + v1 * v1 + 1.0)
    n0, n1, n2 = normal
    unit = 1.0 / np.sqrt(n0 * n0 + n1 * n1 + n2 * n2 + 1e-30)
    diffuse, mirrored = _brightness(
        (n0 * unit, n1 * unit, n2 * unit), (v0 * scale, v1 * scale, scale), look.gloss
    )
    return color[0] * diffuse + mirrored, color[1] * diffuse + mirrored, color[2] * diffuse + mirrored


@kernel
def _light_point(drawing, t, i, j, side, look, out, column):
    """Write the light half way between corners i and j of a triangle; side is -1 where it is seen from behind."""
    p, q = drawing.triangles[t, i], drawing.triangles[t, j]
    screen, normals, colors = drawing.screen, drawing.normals, drawing.colors
    light = _light(
        (0.5 * (screen[p, 0] + screen[q, 0]), 0.5 * (screen[p, 1] + screen[q, 1])),
        (
            side * (normals[t, i, 0] + normals[t, j, 0]),
            side * (normals[t, i, 1] + normals[t, j, 1]),
            side * (normals[t, i, 2] + normals[t, j, 2]),
        ),
        (
            0.5 * (colors[t, i, 0] + colors[t, j, 0]),
            0.5 * (colors[t, i, 1] + colors[t, j, 1]),
            0.5 * (colors[t, i, 2] + colors[t, j, 2]),
        ),
        look,
    )
    out[t, column], out[t, column + 1], out[t, column + 2] = light


@kernel
def make_plan(drawing, look, is_closed, out):
    """Write per triangle all that its pixels need, (n_triangles, N_PLAN).

    Columns 3i to 3i+2: weight of corner i (0 to 1) as slopes along x and y and an offset. Columns 9 to 11: distance of
    corner i from the opposite edge [pixels]. Then squared red, green, blue at six points: the corners, and the middle of
    the edge opposite each; a pixel's light is the quadratic through them. Hidden triangles are left as they were.
    """
    for t in range(drawing.triangles.shape[0]):
        a, b, c = drawing.triangles[t, 0], drawing.triangles[t, 1], drawing.triangles[t, 2]
        x = drawing.screen[a, 0], drawing.screen[b, 0], drawing.screen[c, 0]
        y = drawing.screen[a, 1], drawing.screen[b, 1], drawing.screen[c, 1]
        area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
        if area == 0.0 or (is_closed and area > 0.0):
            continue
        side = 1.0 if area < 0.0 else -1.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            dx, dy = x[k] - x[j], y[k] - y[j]
            out[t, 3 * i], out[t, 3 * i + 1] = -dy / area, dx / area
            out[t, 3 * i + 2] = (dy * x[j] - dx * y[j]) / area
            out[t, 9 + i] = abs(area) / np.sqrt(dx * dx + dy * dy)
            _light_point(drawing, t, i, i, side, look, out, 12 + 3 * i)
            _light_point(drawing, t, j, k, side, look, out, 21 + 3 * i)
