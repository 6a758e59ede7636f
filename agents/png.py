"""Figures and pictures as PNG files that depend on nothing but what is drawn."""

import io
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image


def figure_as_png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100, metadata={"Software": None})
    return stream.getvalue()


def picture_as_png(picture: np.ndarray[Any, Any]) -> bytes:
    """Return a picture, uint8 (height, width, 3), as the bytes of a file."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "PNG", optimize=True)
    return stream.getvalue()
