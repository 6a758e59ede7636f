"""The map in pictures: darts and their links, and what a cut splits; every line follows from the tables of the topology."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

import gmapspring as gs
from agents.link_picture import link_figure
from agents.png import figure_as_png
from gmapspring.body import Body
from gmapspring.rendering.camera import Camera
from gmapspring.topology.darts import DARTS_PER_TETRAHEDRON, EDGE_CORNERS, FACE_CORNERS, ORDERINGS
from gmapspring.topology.gmap import alpha, face_of, is_free

Array = np.ndarray[Any, Any]

LINKS = {0: "#d1495b", 1: "#2e8b57", 2: "#2f6db5", 3: "#8e44ad"}
"""Colour of the links of each involution."""

INK, PAPER = "#2b313b", "#c9d1da"
OLD, NEW = "#56606e", "#d1495b"
"""Colours of cells that were there, and of those that a cut has made."""

SHRINK = 0.72
"""Size of each tetrahedron over its own, drawn about its middle, so that links across faces show."""

DARTS_EYE, CUT_EYE = (75.0, 14.0), (-25.0, 28.0)
"""Azimuth and elevation [degrees] at which few lines hide one another."""


def map_pictures() -> dict[str, bytes]:
    """Return the pictures as PNG files, by name."""
    figures = {"map-darts": darts_figure(), "map-cut": cut_figure(), "map-links": link_figure()}
    return {name: figure_as_png(figure) for name, figure in figures.items()}


def darts_figure() -> Figure:
    """Draw the 24 darts of a tetrahedron with alpha_0 to alpha_2, and alpha_3 between two tetrahedra."""
    figure = Figure(figsize=(10.0, 4.9), layout=_layout())
    one, two = figure.subplots(1, 2)
    _draw_darts(one, _body(gs.meshes.single()), (0, 1, 2))
    one.set_title("one tetrahedron: 24 darts, four faces of six", fontsize=11, color=INK)
    _draw_darts(two, _body(gs.meshes.two_tetrahedra()), (0, 3))
    two.set_title(r"two, sewn: $\alpha_3$ links the six darts of a face to those beyond it", fontsize=11, color=INK)
    meanings = ("the dart at the edge's other end", "along the face's next edge", "on the other face at the edge",
                "on the other side of the face")  # fmt: skip
    for i, meaning in enumerate(meanings):
        figure.axes[0].plot([], [], color=LINKS[i], linewidth=2.0, label=rf"$\alpha_{i}$: {meaning}")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return figure


def cut_figure() -> Figure:
    """Draw six tetrahedra round an edge: whole, with a face split, and with a second one split, at which the edge splits."""
    figure = Figure(figsize=(10.0, 7.2), layout=_layout())
    panels = figure.subplots(2, 3)
    body_of = gs.Simulation(gs.meshes.box((1, 1, 1)), gs.Material(1e3, 1e3))
    body, before = body_of.body, (0, 0)
    faces = ring(body)
    titles = ("whole", "one face split", "the opposite face split: two pieces")
    for column, title in enumerate(titles):
        if column:
            body_of.split_face(*faces[3 * (column - 1)])
        counts = body.n_nodes, body.n_springs, len(np.unique(face_of(body.gmap)[body.is_alive]))
        title = f"{title}\n{counts[0]} vertices, {counts[1]} edges, {counts[2]} faces"
        panels[0, column].set_title(title, fontsize=11, color=INK)
        _draw_tetrahedra(panels[0, column], body)
        _draw_cells(panels[1, column], body, before if column else (body.n_nodes, body.n_springs))
        before = body.n_nodes, body.n_springs
    words = (r"tetrahedra, and $\alpha_3$ where two are sewn", "vertices and edges; those that a cut has made in red")
    for row, word in enumerate(words):
        panels[row, 1].text(0.5, -0.02, word, transform=panels[row, 1].transAxes, ha="center", va="top", fontsize=10, color=INK)
    return figure


def ring(body: Body) -> list[tuple[int, int]]:
    """Return the pairs of tetrahedra sewn round the first edge with no free face, in the order of alpha_2 and alpha_3."""
    n_darts = DARTS_PER_TETRAHEDRON * body.mesh.n_tetrahedra
    for start in range(n_darts):
        pairs, dart = [], start
        while alpha(body.gmap, 3, dart) != dart:
            beyond = alpha(body.gmap, 3, dart)
            pairs.append((dart // DARTS_PER_TETRAHEDRON, beyond // DARTS_PER_TETRAHEDRON))
            dart = alpha(body.gmap, 2, beyond)
            if dart == start:
                return pairs
    raise ValueError("the mesh has no inner edge")


def dart_places(body: Body) -> Array:
    """Return where to draw each dart, from its vertex half way along its edge, inside its face, (n_darts, 2, 3) [m]."""
    corners = _shrunk(body)[:, ORDERINGS]  # (n_tets, 24, 4, 3): vertex, the edge's other end, the face's third, the fourth
    vertex, other, third = corners[:, :, 0], corners[:, :, 1], corners[:, :, 2]
    start = 0.76 * vertex + 0.13 * other + 0.11 * third
    end = 0.46 * vertex + 0.43 * other + 0.11 * third
    return np.stack([start, end], axis=2).reshape(-1, 2, 3)


def _draw_darts(panel: Axes, body: Body, involutions: tuple[int, ...]) -> None:
    """Draw darts as arrows, and a line between the same points of two darts for each link."""
    places = dart_places(body)
    _frame(panel)
    camera = Camera.fit(body.mesh.points, *DARTS_EYE)
    for tetrahedron in _shrunk(body):
        for i, j in EDGE_CORNERS:
            panel.plot(*_seen(camera, tetrahedron[[i, j]]), color=PAPER, linewidth=1.0, zorder=1)
    for start, end in places:
        (x0, x1), (y0, y1) = _seen(camera, np.stack([start, end]))
        panel.annotate("", (x1, y1), (x0, y0), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.3, "mutation_scale": 7,
                                                           "shrinkA": 0, "shrinkB": 0}, zorder=3)  # fmt: skip
    darts = np.arange(len(places))
    for i in involutions:
        linked = alpha(body.gmap, i, darts)
        # alpha_0 leads to the other end of the edge, where heads meet; the others keep the vertex, where tails are.
        part = {0: (0.0, 1.0), 1: (1.0, 0.0), 2: (0.4, 0.6), 3: (0.6, 0.4)}[i]
        at = part[0] * places[:, 0] + part[1] * places[:, 1]
        for dart in darts[linked > darts]:
            ends = np.stack([at[dart], at[linked[dart]]])
            panel.plot(*_seen(camera, ends), color=LINKS[i], linewidth=1.8, zorder=2)


def _draw_tetrahedra(panel: Axes, body: Body) -> None:
    """Draw each tetrahedron by itself, and a link between the middles of faces that are sewn."""
    _frame(panel)
    camera = Camera.fit(body.mesh.points, *CUT_EYE)
    corners = _shrunk(body)
    # Far ones first; drawn one over another, near ones stand in front.
    for t in np.argsort(camera.turn(corners.mean(axis=1))[:, 2], kind="stable"):
        for face in FACE_CORNERS:
            panel.fill(*_seen(camera, corners[t, face]), facecolor="#5f9fb0", alpha=0.10, edgecolor=INK, linewidth=0.8)
    middles, free = corners[:, FACE_CORNERS].mean(axis=2), is_free(body.gmap)
    for t, f in np.argwhere(~free):
        beyond = int(body.gmap.image[t, f]) // 6
        if 4 * t + f < beyond:
            ends = np.stack([middles[t, f], middles[beyond // 4, beyond % 4]])
            panel.plot(*_seen(camera, ends), color=LINKS[3], linewidth=2.6, marker="o", markersize=3.5, zorder=4)


def _draw_cells(panel: Axes, body: Body, before: tuple[int, int]) -> None:
    """Draw vertices and edges, each vertex drawn towards the tetrahedra that hold it, and what is new since `before` in red."""
    _frame(panel)
    camera = Camera.fit(body.mesh.points, *CUT_EYE)
    places = vertex_places(body)
    # A piece of a vertex or edge that split is as new as its twin: both lie where one was.
    points = body.nodes.point
    is_new_point = np.isin(points, points[before[0]:])
    ends = body.springs.endpoints
    pairs = np.sort(points[ends], axis=1) @ np.array([body.mesh.n_points, 1])
    is_new_edge = np.isin(pairs, pairs[before[1]:])
    for edge, is_new in zip(ends, is_new_edge, strict=True):
        color, width, order = (NEW, 2.0, 3) if is_new else (OLD, 1.0, 2)
        panel.plot(*_seen(camera, places[edge]), color=color, linewidth=width, zorder=order)
    for place, is_new in zip(places, is_new_point, strict=True):
        panel.plot(*_seen(camera, place[None]), "o", color=NEW if is_new else OLD, markersize=7, zorder=4)


def vertex_places(body: Body) -> Array:
    """Return each vertex moved a little towards the middle of the tetrahedra that hold it, (n_nodes, 3) [m]."""
    corners = body.nodes.position[body.vertex_of]
    total, count = np.zeros((body.n_nodes, 3)), np.zeros(body.n_nodes)
    np.add.at(total, body.vertex_of, corners.mean(axis=1)[:, None])
    np.add.at(count, body.vertex_of, 1.0)
    return 0.85 * body.nodes.position + 0.15 * total / count[:, None]


def _shrunk(body: Body) -> Array:
    """Return the corners of each tetrahedron, drawn together about its middle, (n_tets, 4, 3) [m]."""
    corners = np.asarray(body.nodes.position[body.vertex_of], dtype=np.float64)
    middle = corners.mean(axis=1, keepdims=True)
    return middle + SHRINK * (corners - middle)


def _body(mesh: gs.Mesh) -> Body:
    """Return a mesh as a body at rest."""
    return gs.Simulation(mesh, gs.Material(1e3, 1e3)).body


def _seen(camera: Camera, points: Array) -> tuple[Array, Array]:
    """Return where points (n, 3) lie on the picture, x and y up."""
    screen = camera.project(points, (1000, 1000))
    return screen[:, 0], -screen[:, 1]


def _frame(panel: Axes) -> None:
    """Prepare a panel without axes."""
    panel.set_axis_off()
    panel.set_aspect("equal")


def _layout() -> ConstrainedLayoutEngine:
    """Return a layout with room at the rim."""
    return ConstrainedLayoutEngine(h_pad=0.12, w_pad=0.08)
