"""The heat map: colours of numbers, and the legend that tells which colour means what."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

STOPS = np.array([[0.17, 0.25, 0.55], [0.20, 0.60, 0.70], [0.95, 0.88, 0.55], [0.93, 0.50, 0.25], [0.70, 0.08, 0.10]])
"""Colours, evenly spaced from nothing to the limit."""

SMALLEST_SIDE = 160
"""Pictures whose shorter side has fewer pixels get no legend: it could not be read, and would hide the body."""

MOST_TICKS = 6
"""Numbers beside the bar, at most."""

INK, PAPER = (45, 50, 60, 255), (255, 255, 255, 190)
"""Colours of a legend's text and of what lies behind it: red, green, blue, opacity."""


@dataclass(frozen=True)
class Patch:
    """What is laid over a picture: its colours times their opacity, and what shows through."""

    light: NDArray[np.float32]
    """(height, width, 3), 0 to 255."""
    clearness: NDArray[np.float32]
    """(height, width, 1), 0 to 1."""


def heat_colors(share: NDArray[Any]) -> NDArray[np.float64]:
    """Return the colour of each number between 0 and 1, shape (n, 3); NaN has the last one."""
    places = np.linspace(0.0, 1.0, len(STOPS))
    share = np.nan_to_num(share, nan=1.0)
    return np.stack([np.interp(share, places, channel) for channel in STOPS.T], axis=1)


def ticks(limit: float) -> list[float]:
    """Return round numbers from 0 up to a limit above 0, evenly spaced, at most MOST_TICKS of them."""
    step = 10.0 ** np.floor(np.log10(limit / MOST_TICKS))
    # A little more than the limit, which itself is to be shown where a step lands on it.
    factor = next(f for f in (1, 2, 5, 10) if int(limit * (1 + 1e-9) / (f * step)) < MOST_TICKS)
    return [float(f"{i * factor * step:.12g}") for i in range(int(limit * (1 + 1e-9) / (factor * step)) + 1)]


def stamp_legend(picture: NDArray[np.uint8], limit: float, title: str) -> None:
    """Lay a colour bar from 0 to limit, with numbers and a title, over the lower left corner of a picture (height, width, 3).

    Nothing is drawn on pictures that are too small for it, or where the limit is no number above 0.
    """
    height, width = picture.shape[:2]
    if min(height, width) < SMALLEST_SIDE or not 0.0 < limit < np.inf:
        return
    patch = legend_patch(min(height, width), float(limit), title)
    rows, columns = patch.light.shape[:2]
    margin = min(height, width) // 40
    place = picture[height - margin - rows : height - margin, margin : margin + columns]
    inside = place.shape[:2]
    place[:] = (place * patch.clearness[: inside[0], : inside[1]] + patch.light[: inside[0], : inside[1]] + 0.5).astype(np.uint8)


@lru_cache(maxsize=16)
def legend_patch(side: int, limit: float, title: str) -> Patch:
    """Return the legend of pictures whose shorter side is `side` pixels."""
    # Pillow is needed for letters alone, which its wheel brings along; frames without a legend do without it.
    from PIL import Image, ImageDraw, ImageFont

    text = max(10, side // 32)
    font = ImageFont.load_default(text)
    numbers = ticks(limit)
    labels = [f"{number:g}" for number in numbers]
    gap, bar_height, bar_width = text // 2, 8 * text, text
    wide = max(font.getlength(label) for label in labels)
    columns = int(max(font.getlength(title), bar_width + 2 * gap + wide)) + 2 * gap + 1
    rows = bar_height + int(3.6 * text)
    image = Image.new("RGBA", (columns, rows), PAPER)
    pen = ImageDraw.Draw(image)
    top = int(2.3 * text)
    pen.text((gap, int(1.2 * text)), title, INK, font, anchor="ls")
    shares = 1.0 - (np.arange(bar_height) + 0.5) / bar_height
    for row, color in enumerate((255.0 * heat_colors(shares) + 0.5).astype(int).tolist()):
        pen.line([(gap, top + row), (gap + bar_width - 1, top + row)], (*color, 255))
    for number, label in zip(numbers, labels, strict=True):
        y = top + round((1.0 - number / limit) * bar_height)
        pen.line([(gap + bar_width, y), (gap + bar_width + gap // 2, y)], INK)
        pen.text((2 * gap + bar_width, y), label, INK, font, anchor="lm")
    pixels = np.asarray(image, dtype=np.float32)
    opacity = pixels[..., 3:] / np.float32(255.0)
    return Patch(pixels[..., :3] * opacity, np.float32(1.0) - opacity)
