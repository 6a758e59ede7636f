"""Parts of a mesh in a few letters, for command lines: a region, a half space such as "z<0.02", or numbers."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from gmapspring.config import closest
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh

Array = np.ndarray[Any, Any]

HALF_SPACE = re.compile(r"([xyz])([<>])([-+.\deE]+)")
"""An axis, a side, and where on the axis [m]."""


def select_tetrahedra(mesh: Mesh, text: str) -> Array:
    """Return the tetrahedra of a cell region, with their centroid in a half space, or of numbers such as "3,8", as a mask.

    Raises:
        ConfigError: there is no such part, or nothing is in it.
    """
    centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
    return _select(text, mesh.cell_regions, centroids, "tetrahedra")


def select_points(mesh: Mesh, text: str) -> Array:
    """Return the points of a point region, in a half space, or of numbers, as a mask; see `select_tetrahedra`."""
    return _select(text, mesh.point_regions, mesh.points, "points")


def _select(text: str, regions: Mapping[str, Array], places: Array, items: str) -> Array:
    """Return a mask over items, whose places are (n, 3) [m]."""
    if text in regions:
        mask = np.array(regions[text])
    elif half := HALF_SPACE.fullmatch(text):
        mask = _in_half_space(places, *half.groups())
    elif re.fullmatch(r"\d+(,\d+)*", text):
        mask = _numbered(text, len(places), items)
    else:
        known = f"; {closest(text, regions)}" if regions else ""
        raise ConfigError(f"{text!r} names no {items}: give a region, a half space such as z<0.02, or numbers such as 3,8{known}")
    if not mask.any():
        low, high = (np.round(bound, 6).tolist() for bound in (places.min(axis=0), places.max(axis=0)))
        raise ConfigError(f"{text!r} holds no {items}; they lie between {low} and {high} m")
    return mask


def _in_half_space(places: Array, axis: str, side: str, bound: str) -> Array:
    """Return which places lie on a side of a plane across an axis."""
    try:
        limit = float(bound)
    except ValueError:
        raise ConfigError(f"{axis}{side}{bound} has no number behind {side}; give metres, as in {axis}{side}0.02") from None
    values = places[:, "xyz".index(axis)]
    return values < limit if side == "<" else values > limit


def _numbered(text: str, n: int, items: str) -> Array:
    """Return the mask of numbers parted by commas."""
    numbers = np.array([int(part) for part in text.split(",")])
    if numbers.max() >= n:
        raise ConfigError(f"there is no {numbers.max()} among {n} {items}, numbered from 0")
    mask = np.zeros(n, bool)
    mask[numbers] = True
    return mask
