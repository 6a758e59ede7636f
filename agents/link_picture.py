"""Links of vertices in a picture: a sphere inside the body, a disc on its surface, a ring where it is pinched."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

import gmapspring as gs
from gmapspring.body import Body
from gmapspring.render import Style, Surface, draw
from gmapspring.rendering.camera import Camera
from gmapspring.rendering.shading import corner_normals
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS
from gmapspring.topology.gmap import EDGES, FACES, TETRAHEDRA, boundary_vertices, link_characteristic, singular_vertices

Array = np.ndarray[Any, Any]

INK = "#2b313b"
SKIN, LINING = (0.25, 0.55, 0.66), (0.95, 0.74, 0.55)
"""Colours of a link seen from outside the small ball, and from within."""
INNER = 0.99
"""Radius of the lining."""
STYLE = Style(background=((1.0, 1.0, 1.0),) * 2, wire=0.7, gloss=0.1)
SIZE = (480, 480)


class Example(NamedTuple):
    """A vertex to show."""

    title: str
    body: Body
    node: int
    eye: tuple[float, float]
    """Azimuth and elevation of the camera [degrees], from where holes show."""


def link_figure() -> Figure:
    """Draw the link of a vertex inside a box, of one on its surface, and of one that a removal has pinched."""
    figure = Figure(figsize=(10.0, 4.2), layout=ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.08))
    for panel, example in zip(figure.subplots(1, 3), examples(), strict=True):
        surface = link_surface(example.body, example.node)
        panel.imshow(draw(surface, Camera.fit(surface.points, *example.eye), SIZE, STYLE))
        panel.set_axis_off()
        corners, edges, triangles = link_counts(example.body, example.node)
        count = f"{corners} edges $-$ {edges} faces $+$ {triangles} tetrahedra = {corners - edges + triangles}"
        panel.set_title(f"{example.title}\n{count}", fontsize=11, color=INK)
    return figure


def examples() -> list[Example]:
    """Return a vertex whose link is a sphere, one with a disc, and one with a ring."""
    whole, pinched = _box(), _box()
    is_bare = boundary_vertices(whole.body.gmap)
    inside = _nearest(whole.body, np.flatnonzero(~is_bare), (1.0, 1.0, 1.0))
    bare = _nearest(whole.body, np.flatnonzero(is_bare), (3.0, 1.0, 1.0))
    ring = _pinch(pinched)
    return [
        Example("inside: a sphere", whole.body, inside, (-30.0, 25.0)),
        Example("on the surface: a disc", whole.body, bare, (25.0, 20.0)),
        Example("pinched: a ring", pinched.body, ring, (90.0, 60.0)),
    ]


def link_surface(body: Body, node: int) -> Surface:
    """Return the link of a vertex as a surface about the origin, each triangle twice: its outside, and a lining within."""
    tetrahedra, corners = np.nonzero((body.vertex_of == node) & body.is_alive[:, None])
    opposite = body.vertex_of[tetrahedra[:, None], OUTWARD_FACE_CORNERS[corners]]
    ways = body.nodes.position[opposite] - body.nodes.position[node]
    points = (ways / np.linalg.norm(ways, axis=2, keepdims=True)).reshape(-1, 3)
    points = np.concatenate([points, INNER * points])
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    n = len(tetrahedra)
    triangles[n:] = triangles[n:, ::-1]
    colors = np.repeat([SKIN, LINING], n, axis=0)
    return Surface(points, triangles, colors, corner_normals(points, triangles, np.zeros(2 * n, np.bool_)), True)


def link_counts(body: Body, node: int) -> tuple[int, int, int]:
    """Return the numbers of edges, faces and tetrahedra round a vertex: its link's corners, edges and triangles."""
    link = body.gmap.link[node]
    return int(link[EDGES]), int(link[FACES]), int(link[TETRAHEDRA])


def _pinch(simulation: gs.Simulation) -> int:
    """Remove the first tetrahedron that leaves a vertex whose link is a ring, and return that vertex."""
    start = simulation.save_state()
    for tetrahedron in range(simulation.body.mesh.n_tetrahedra):
        simulation.remove_tetrahedron(tetrahedron)
        gmap = simulation.body.gmap
        rings = singular_vertices(gmap)[link_characteristic(gmap)[singular_vertices(gmap)] == 0]
        if len(rings):
            return int(rings[0])
        simulation.load_state(start)
    raise ValueError("no removal pinches this body")


def _nearest(body: Body, nodes: Array, place: tuple[float, float, float]) -> int:
    """Return which of some nodes lies nearest to a place."""
    return int(nodes[np.linalg.norm(body.nodes.position[nodes] - place, axis=1).argmin()])


def _box() -> gs.Simulation:
    """Return a box of 27 cubes."""
    return gs.Simulation(gs.meshes.box((3, 3, 3)), gs.Material(1e3, 1e3))
