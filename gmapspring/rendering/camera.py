"""A turntable camera with perspective: where the eye is, and where a point lands on the picture."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmapspring.jit import kernel

NEAREST = 1e-3
"""Depth below which a point counts as behind the eye, as a share of the camera's distance."""


@dataclass(frozen=True)
class Camera:
    """An eye on a sphere around a target, z up: azimuth 0 looks from +x, azimuth 90 from +y."""

    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The point in the middle of the picture [m]."""
    distance: float = 1.0
    """Distance of the eye from the target [m]."""
    azimuth: float = -60.0
    """Angle of the eye around the vertical [degrees]."""
    elevation: float = 25.0
    """Angle of the eye above the horizon [degrees]."""
    field_of_view: float = 28.0
    """Full angle over the shorter side of the picture [degrees]."""

    def __post_init__(self) -> None:
        """Refuse a camera that cannot see."""
        if not (math.isfinite(self.distance) and self.distance > 0.0):
            raise ValueError(f"distance must be finite and above 0 m, not {self.distance}")
        if not 0.0 < self.field_of_view < 180.0:
            raise ValueError(f"field_of_view must lie between 0 and 180 degrees, not {self.field_of_view}")

    @classmethod
    def fit(
        cls,
        points: ArrayLike,
        azimuth: float = -60.0,
        elevation: float = 25.0,
        *,
        aspect: float = 1.0,
        margin: float = 1.15,
    ) -> "Camera":
        """Return the nearest camera that sees all finite points (n, 3) [m], with a margin around them.

        aspect is the width of the picture over its height. To turn around a body without a change of
        scale, replace the azimuth of a camera that was fitted once.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            return cls(azimuth=azimuth, elevation=elevation)
        centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
        slope = math.tan(math.radians(0.5 * cls.field_of_view)) / margin
        slopes = slope * np.array([max(aspect, 1.0), max(1.0 / aspect, 1.0)])
        seen = _turned(points - centre, _axes(azimuth, elevation))
        needed = (np.abs(seen[:, :2]) / slopes).max(axis=1) + seen[:, 2]
        # A body without extent (one point) still needs a distance above zero.
        distance = max(float(needed.max()), 1e-6)
        return cls((float(centre[0]), float(centre[1]), float(centre[2])), distance, azimuth, elevation)

    def turn(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return vectors (..., 3) as the eye sees them: parts to the right, up, and towards the eye."""
        return _turned(vectors, _axes(self.azimuth, self.elevation))

    def focal_length(self, size: tuple[int, int]) -> float:
        """Return the focal length in pixels for a picture of (width, height) pixels."""
        return 0.5 * min(size) / math.tan(math.radians(0.5 * self.field_of_view))

    def project(self, points: ArrayLike, size: tuple[int, int]) -> NDArray[np.float64]:
        """Return (n, 3): x to the right and y down [pixels], and one over the depth [1/m].

        The corner of the picture is (0, 0), the centre of its first pixel (0.5, 0.5). One over the depth is
        linear on the screen and larger where nearer; it is 0 for points behind the eye or not finite.
        """
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        screen, axes = np.empty((len(points), 3)), _axes(self.azimuth, self.elevation)
        middle, target = np.array([0.5 * size[0], 0.5 * size[1]]), np.array(self.target, dtype=np.float64)
        _project(points, target, axes, float(self.distance), self.focal_length(size), middle, screen)
        return screen


def _axes(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Return the right, up and backward directions of a camera, one a row."""
    a, e = math.radians(azimuth), math.radians(elevation)
    right = [-math.sin(a), math.cos(a), 0.0]
    up = [-math.sin(e) * math.cos(a), -math.sin(e) * math.sin(a), math.cos(e)]
    backward = [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)]
    return np.array([right, up, backward])


def _turned(vectors: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the parts of vectors (..., 3) along three axes; summed here, for @ rounds as the machine pleases."""
    vectors = np.ascontiguousarray(vectors, dtype=np.float64)
    parts = np.empty_like(vectors)
    _turn(vectors.reshape(-1, 3), axes, parts.reshape(-1, 3))
    return parts


@kernel
def _turn(vectors, axes, out):
    """Write the parts of vectors (n, 3) along three axes."""
    for i in range(vectors.shape[0]):
        for part in range(3):
            out[i, part] = vectors[i, 0] * axes[part, 0] + vectors[i, 1] * axes[part, 1] + vectors[i, 2] * axes[part, 2]


@kernel
def _project(points, target, axes, distance, focal, middle, out):
    """Write where points (n, 3) land on the picture, and one over the depth."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - target[0], points[i, 1] - target[1], points[i, 2] - target[2]
        right = x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]
        up = x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]
        backward = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]
        depth = distance - backward
        is_visible = np.isfinite(right) and np.isfinite(up) and np.isfinite(backward) and depth > NEAREST * distance
        inverse = 1.0 / depth if is_visible else 0.0
        scale = focal * inverse
        out[i, 0] = middle[0] + scale * (right if is_visible else 0.0)
        out[i, 1] = middle[1] - scale * (up if is_visible else 0.0)
        out[i, 2] = inverse
