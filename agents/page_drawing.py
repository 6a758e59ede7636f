"""What is drawn in the page's picture: the body's skin, the edges that can be cut, the load, and the hint."""

from typing import Any

import numpy as np
import viser

from agents.page_colors import CUTTABLE, HINT, LOAD, N_HEAT, TISSUE, WIRE, Color, Paint
from agents.picking import EDGE_CORNERS_OF_TRIANGLE, Skin
from envs.scene import Scene

Array = np.ndarray[Any, Any]

RADIUS = 1.6
"""How large half the diagonal of the body is drawn, in units of the page."""
LIFT = 0.004
"""How far lines lie above the skin, so that they are not half sunk in it."""
NO_TRIANGLE = np.zeros((3, 3), np.float32)
NO_LINE = np.zeros((1, 2, 3), np.float32)
KNOB = 0.04 * np.array(
    [[(x, 0, 0), (0, y, 0), (0, 0, z)] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float32
)
"""An octahedron, what a node that is held in place is drawn as, (8, 3, 3)."""
DISTANCE, HEIGHT = 3.75, 1.8
"""From how far the picture is first seen, and from how high."""
ASIDE = 0.5
"""By how much it is first seen from the side of where the target lies, as an angle."""


class Drawing:
    """The nodes of the picture; they are made once and then changed in place."""

    def __init__(self, server: viser.ViserServer) -> None:
        """Make the nodes, with nothing to see."""
        self._scene = server.scene
        self._scene.set_up_direction("+z")
        self._add_light()
        self._parts = [self._mesh(f"/body/{number}", (200, 200, 200)) for number in range(max(N_HEAT, len(TISSUE)))]
        self._wire = self._lines("/wire", WIRE)
        self._cuttable = self._lines("/cuttable", CUTTABLE)
        self._anchors = self._mesh("/anchors", TISSUE["anchor"])
        self._hint = self._mesh("/hint", HINT)
        self._hint_edges = self._lines("/hint-edges", HINT)
        self._inside = self._mesh("/target-inside", TISSUE["target"])
        self._load = self._scene.add_arrows(
            "/load", NO_LINE, LOAD, shaft_radius=0.025, head_radius=0.07, head_length=0.16, visible=False
        )
        self._centre, self._zoom = np.zeros(3), 1.0
        self._camera = server.initial_camera

    def fit(self, scene: Scene) -> None:
        """Choose the scale at which a scene is drawn."""
        low, high = scene.mesh.points.min(axis=0), scene.mesh.points.max(axis=0)
        self._centre, self._zoom = 0.5 * (low + high), 2.0 * RADIUS / float(np.linalg.norm(high - low))
        # Lines of a width that fits the tetrahedra, so that a fine mesh is not painted over.
        unit = scene.spacing * self._zoom
        for lines, share in ((self._wire, 0.009), (self._cuttable, 0.022), (self._hint_edges, 0.04)):
            lines.thickness = float(np.clip(share * unit, 0.003, 0.03))

    def look_at_target(self, scene: Scene) -> None:
        """Have browsers that open the page see the scene from the side that the target lies on, and is pulled to."""
        offset = self._zoom * (scene.mesh.points[scene.mesh.tetrahedra[scene.target]].mean(axis=(0, 1)) - self._centre)
        size = float(np.linalg.norm(scene.load))
        toward = offset + (scene.load / size if size > 0.0 else 0.0)
        angle = float(np.arctan2(toward[1], toward[0])) + ASIDE
        height = HEIGHT if toward[2] > -0.1 * RADIUS else -HEIGHT
        self._camera.position = DISTANCE * np.cos(angle), DISTANCE * np.sin(angle), height
        self._camera.look_at, self._camera.up = (0.0, 0.0, 0.1), (0.0, 0.0, 1.0)

    def ray(self, origin: Any, direction: Any) -> tuple[Array, Array]:
        """Return a ray of the picture as one of the scene [m]."""
        return np.asarray(origin, dtype=np.float64) / self._zoom + self._centre, np.asarray(direction, dtype=np.float64)

    def body(self, position: Array, skin: Skin, paint: Paint, opacity: float) -> None:
        """Draw the skin: of each colour, the faces that have it."""
        corners = self._placed(position)[skin.triangles]
        for number, part in enumerate(self._parts):
            chosen = corners[paint.choice == number] if number < len(paint.colors) else corners[:0]
            if len(chosen):
                part.color = paint.colors[number]
            _fill(part, chosen, opacity)

    def lines(self, position: Array, skin: Skin, cuttable: Array, *, has_wire: bool) -> None:
        """Draw the edges of the skin, and over them those that can be cut, as nodes (n, 2)."""
        lifted = self._lifted(position, skin)
        edges = _once(skin.triangles[:, EDGE_CORNERS_OF_TRIANGLE].reshape(-1, 2))
        cuttable = _once(cuttable)
        others = edges[~np.isin(_numbered(edges), _numbered(cuttable))]
        _stretch(self._wire, lifted[others if has_wire else others[:0]])
        _stretch(self._cuttable, lifted[cuttable])

    def hint(self, position: Array, triangles: Array) -> None:
        """Draw the cut that is proposed, as triangles of nodes (n, 3)."""
        corners = self._placed(position)[triangles]
        _fill(self._hint, corners, None)
        _stretch(self._hint_edges, corners[:, EDGE_CORNERS_OF_TRIANGLE].reshape(-1, 2, 3))

    def inside(self, position: Array, triangles: Array) -> None:
        """Draw where the target meets healthy tissue, which is seen where the body is seen through."""
        _fill(self._inside, self._placed(position)[triangles], 0.4)

    def anchors(self, position: Array) -> None:
        """Draw the nodes that are held in place."""
        # Points of a cloud would cost a processor that draws by itself ten times as much.
        _fill(self._anchors, (self._placed(position)[:, None, None] + KNOB).reshape(-1, 3, 3), None)

    def load(self, middle: Array, force: Array) -> None:
        """Draw the direction of the load, from the middle of the target outward [m]."""
        size = float(np.linalg.norm(force))
        self._load.visible = size > 0.0
        if size > 0.0:
            start = self._placed(middle)
            self._load.points = np.array([[start, start + 0.9 * force / size]], np.float32)

    def _placed(self, position: Array) -> Array:
        """Return positions [m] as they are drawn."""
        return ((np.asarray(position, dtype=np.float64) - self._centre) * self._zoom).astype(np.float32)

    def _lifted(self, position: Array, skin: Skin) -> Array:
        """Return where nodes are drawn, a little above the skin."""
        placed = self._placed(position)
        one, two, three = np.moveaxis(placed[skin.triangles], 1, 0)
        across = np.cross(two - one, three - one)
        normal = np.zeros_like(placed)
        for corner in range(3):
            np.add.at(normal, skin.triangles[:, corner], across)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        # A node inside the body, or on a face without area, has no normal.
        return placed + LIFT * np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)

    def _add_light(self) -> None:
        """Light the picture from all sides too: a face in shadow keeps its colour."""
        # Without the viewer's surroundings, which a processor that draws by itself takes half a minute to get ready.
        self._scene.configure_environment_map(None)
        self._scene.configure_default_lights(cast_shadow=False)
        self._scene.add_light_ambient("/light", intensity=1.6)

    def _mesh(self, name: str, color: Color) -> viser.MeshHandle:
        return self._scene.add_mesh_simple(
            name, NO_TRIANGLE, np.array([[0, 1, 2]]), color=color, flat_shading=True, side="double", visible=False,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _lines(self, name: str, color: Color) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(name, NO_LINE, color, visible=False)


def _fill(mesh: viser.MeshHandle, corners: Array, opacity: float | None) -> None:
    """Give a mesh other triangles, by their corners (n, 3, 3)."""
    mesh.visible = len(corners) > 0
    if not len(corners):
        return
    n_before = len(mesh.vertices)
    mesh.vertices = corners.reshape(-1, 3)
    if len(mesh.vertices) != n_before:
        mesh.faces = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    mesh.opacity = None if opacity is None or opacity >= 1.0 else opacity


def _stretch(lines: viser.LineSegmentsHandle, points: Array) -> None:
    """Give lines other ends, (n, 2, 3)."""
    lines.visible = len(points) > 0
    if len(points):
        lines.points = np.asarray(points, np.float32)


def _numbered(edges: Array) -> Array:
    """Return a number for each edge, int64 (n,)."""
    return edges[:, 0].astype(np.int64) << 32 | edges[:, 1]


def _once(edges: Array) -> Array:
    """Return each edge once, whichever way it runs."""
    return np.unique(np.sort(edges, axis=1), axis=0) if len(edges) else edges
