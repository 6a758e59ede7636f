"""What episodes look like: where the camera of a scene stands, and frames of the body as its episode goes on."""

import dataclasses
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from envs.scene import Scene
from envs.surface import surface_of
from gmapspring.body import Body
from gmapspring.config import known_name
from gmapspring.render import draw, see_triangles
from gmapspring.rendering.camera import Camera
from gmapspring.rendering.heat import stamp_legend
from gmapspring.rendering.pieces import Moment, joined, moment_of, piece_surface
from gmapspring.rendering.skin import Surface, body_surface, outside
from gmapspring.rendering.style import Style
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]

STYLES: Mapping[str, str] = {
    "tissue": "what a surgeon would see: the surface, raw faces where it is cut open, the target and the anchors",
    "strain": "a heat map of the largest edge strain of each tetrahedron, up to the strain at which healthy tissue tears",
}
"""Styles of frames by name."""

SIZE = (480, 480)
"""Width and height of a frame [pixels]."""

MARGIN = 1.35
"""Room around the body at rest, which the load pulls and cuts let go."""

AZIMUTHS = tuple(range(-45, 315, 30))
"""Where the camera may stand around the body [degrees], never square to the sides of a box; of equally good places, the first."""

ELEVATIONS = {25.0: 1.0, -25.0: 0.5, 60.0: 0.5, -60.0: 0.4}
"""How high it may stand [degrees], and what a pixel of the target counts there: a body is best seen a little from above."""

PROBE = (96, 96)
"""Size of the pictures in which the target is looked for."""


class Frames:
    """Draw one episode after another.

    The task takes what hangs on no anchor off the body at once. Frames show it once more, pale, where it hung when it came
    loose: told before a cut what there is (`note`), the next frame knows what that cut has taken.
    """

    def __init__(self, style: str = "tissue", size: tuple[int, int] = SIZE, look: Style | None = None) -> None:
        """Choose a style by its name, a size [pixels], and colours and light."""
        self.style, self.size, self.look = known_name("render style", style, STYLES), size, look or Style()
        self._before: Moment | None = None
        self._removed = -1

    def note(self, body: Body, removed: int = -1) -> None:
        """Remember the body as it is before a cut; removed: the tetrahedron that the cut itself takes away, or -1."""
        self._before, self._removed = moment_of(body), removed

    def forget(self) -> None:
        """Begin an episode."""
        self._before = None

    def draw(self, scene: Scene, body: Body, strain: Array, fade: float | None = None) -> Array:
        """Return a frame, uint8 (height, width, 3).

        Args:
            scene: what is played.
            body: as it is now.
            strain: largest edge strain of each tetrahedron, (n_tetrahedra,).
            fade: how pale to draw what the last cut has freed, from 0 to 1, where it is gone; by default as the style has it.
        """
        is_heat = self.style == "strain"
        look = dataclasses.replace(self.look, strain_limit=scene.limits.strain) if is_heat else self.look
        surface = body_surface(body, scene.target, strain if is_heat else None, look)
        freed = self._freed(body)
        if freed is not None and (fade is None or fade < 1.0):
            assert self._before is not None
            share = look.fade if fade is None else fade
            surface = joined(surface, piece_surface(self._before, freed, scene.target, look, share))
        return self.draw_surface(scene, surface, look)

    def draw_surface(self, scene: Scene, surface: Surface, look: Style) -> Array:
        """Return a frame of any surface, seen as the scene's body is."""
        picture = draw(surface, camera_of(scene, self.size), self.size, look)
        if self.style == "strain" and look.legend:
            stamp_legend(picture, look.strain_limit, look.legend)
        return picture

    def _freed(self, body: Body) -> Array | None:
        """Return what has come loose since the body was noted, bool (n_tetrahedra,), or None for nothing."""
        if self._before is None:
            return None
        freed = self._before.is_alive & ~body.is_alive
        if self._removed >= 0:
            freed[self._removed] = False
        return freed if freed.any() else None


_CAMERAS: WeakKeyDictionary[Scene, dict[float, Camera]] = WeakKeyDictionary()


def camera_of(scene: Scene, size: tuple[int, int] = SIZE) -> Camera:
    """Return the camera of a scene, which stays where it is through all episodes: it stands where most of the target shows.

    It follows from mesh and target alone, found once a scene.
    """
    kept = _CAMERAS.setdefault(scene, {})
    aspect = size[0] / size[1]
    if aspect not in kept:
        azimuth, elevation = _view(scene)
        kept[aspect] = _centred(Camera.fit(scene.mesh.points, azimuth, elevation, aspect=aspect), scene.mesh.points, aspect)
    return kept[aspect]


def _centred(camera: Camera, points: Array, aspect: float) -> Camera:
    """Return a camera that looks the same way, with points (n, 3) in the middle of the picture and MARGIN around them."""
    size = (round(1000 * aspect), 1000)
    right, up, _ = camera.turn(np.eye(3)).T
    for _ in range(3):
        # Moving the eye changes perspective a little: a few rounds make that too small to see.
        screen = camera.project(points, size)[:, :2]
        low, high = screen.min(axis=0), screen.max(axis=0)
        aside = (0.5 * (low + high) - 0.5 * np.array(size)) * (camera.distance / camera.focal_length(size))
        x, y, z = (np.array(camera.target) + aside[0] * right - aside[1] * up).tolist()
        distance = camera.distance * MARGIN * float(((high - low) / size).max())
        camera = dataclasses.replace(camera, target=(x, y, z), distance=distance)
    return camera


def _view(scene: Scene) -> tuple[float, float]:
    """Return azimuth and elevation [degrees] from which most of the target is seen, or its nearest surface if none is."""
    tetrahedra, triangles = _bare_faces(scene)
    is_shown = scene.target[tetrahedra]
    if not is_shown.any():
        centroid = scene.mesh.points[scene.mesh.tetrahedra[scene.target]].mean(axis=(0, 1))
        distance = ((surface_of(scene.mesh).centroid - centroid) ** 2).sum(axis=1)
        is_shown = distance <= np.partition(distance, 3)[3]
    is_shown = np.append(is_shown, False)  # what the background, -1, picks
    views = [(float(azimuth), elevation) for elevation in ELEVATIONS for azimuth in AZIMUTHS]
    cameras = [Camera.fit(scene.mesh.points, *view) for view in views]
    # All from as far away: else a body that is seen end-on, and so drawn large, would always win.
    distance = max(camera.distance for camera in cameras)
    cameras = [dataclasses.replace(camera, distance=distance) for camera in cameras]
    seen = [
        float(is_shown[see_triangles(scene.mesh.points, triangles, camera, PROBE)[0]].sum()) * ELEVATIONS[camera.elevation]
        for camera in cameras
    ]
    return views[int(np.argmax(seen))]


def _bare_faces(scene: Scene) -> tuple[Array, Array]:
    """Return tetrahedron (n,) and points (n, 3), counter-clockwise from outside, of the bare faces of the uncut mesh."""
    mesh, slots = scene.mesh, np.flatnonzero(outside(scene.mesh))
    corners = OUTWARD_FACE_CORNERS[slots % 4]
    return slots // 4, mesh.tetrahedra[slots[:, None] // 4, corners].astype(np.int32)
