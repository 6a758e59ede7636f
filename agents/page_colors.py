"""The colours of the page: what each face of the body is painted with, and the legend that says so."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.picking import Skin
from envs.scene import Scene
from envs.task import Resection
from gmapspring.measure import tetrahedron_strains
from gmapspring.rendering import heat

Array = np.ndarray[Any, Any]
Color = tuple[int, int, int]
"""Red, green, blue, each from 0 to 255."""

TISSUE = {
    "healthy tissue": (201, 98, 88),
    "healthy, laid open": (243, 172, 160),
    "target": (54, 158, 170),
    "target, laid open": (142, 220, 222),
    "vessel": (126, 74, 168),
    "anchor": (74, 70, 84),
}
"""What a face may belong to, and its colour."""
CUTTABLE: Color = (255, 196, 0)
HINT: Color = (46, 204, 64)
LOAD: Color = (20, 90, 200)
WIRE: Color = (58, 34, 34)
N_HEAT = 16
"""Steps of the heat map."""


@dataclass(frozen=True, eq=False)
class Paint:
    """The colours of some faces."""

    colors: list[Color]
    """What there is to choose from."""
    choice: Array
    """Which of them each face has, int64 (n_triangles,)."""


def paint_tissue(scene: Scene, task: Resection, skin: Skin) -> Paint:
    """Return what each face belongs to."""
    tets, faces = np.divmod(skin.slots, 4)
    names = list(TISSUE)
    is_original = task.table.face_of_slot[tets, faces] < 0
    choice = np.where(is_original, names.index("healthy tissue"), names.index("healthy, laid open"))
    target = np.where(is_original, names.index("target"), names.index("target, laid open"))
    choice = np.where(scene.target[tets], target, choice)
    choice = np.where(scene.vessel[tets], names.index("vessel"), choice)
    # A face held in place by all its corners; those of anchors that reach into the body look like what they are.
    point = task.simulation.body.nodes.point[skin.triangles]
    is_held = is_original & scene.pinned[point].all(axis=1)
    return Paint(list(TISSUE.values()), np.where(is_held, names.index("anchor"), choice))


def paint_strain(task: Resection, skin: Skin) -> Paint:
    """Return how much each face's tetrahedron is strained, up to the limit of tearing."""
    share = tetrahedron_strains(task.simulation.body)[skin.slots // 4] / task.scene.limits.strain
    choice = np.clip(np.nan_to_num(share, nan=1.0) * N_HEAT, 0, N_HEAT - 1).astype(np.int64)
    return Paint(heat_colors(), choice)


def heat_colors() -> list[Color]:
    """Return the colours of the heat map, from no strain to the limit."""
    colors = np.rint(255.0 * heat.heat_colors(np.linspace(0.0, 1.0, N_HEAT))).astype(int)
    return [(red, green, blue) for red, green, blue in colors.tolist()]


def legend(limit: float, *, is_heat: bool) -> str:
    """Return the legend as HTML; limit: the strain at which tissue tears."""
    marks = {"a click cuts here": CUTTABLE, "hint": HINT, "load on the target": LOAD}
    chips = "".join(_chip(name, color) for name, color in ({} if is_heat else TISSUE).items())
    chips += "".join(_chip(name, color) for name, color in marks.items())
    bar = ""
    if is_heat:
        stops = ", ".join(_css(color) for color in heat_colors())
        bar = (
            f'<div style="height:12px;border-radius:3px;background:linear-gradient(to right, {stops})"></div>'
            '<div style="display:flex;justify-content:space-between"><span>strain 0</span>'
            f"<span>{limit / 2:g}</span><span>{limit:g}: tears</span></div>"
        )
    return f'<div id="legend" style="font-size:0.8em;line-height:1.6;padding:0 0.75em 0.4em">{bar}{chips}</div>'


def _chip(name: str, color: Color) -> str:
    """Return a word beside its colour."""
    box = f'<span style="width:10px;height:10px;border-radius:2px;display:inline-block;background:{_css(color)}"></span>'
    return f'<span style="display:inline-block;white-space:nowrap;margin-right:10px">{box} {name}</span>'


def _css(color: Color) -> str:
    return f"rgb({color[0]},{color[1]},{color[2]})"
