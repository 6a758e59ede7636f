"""How frames look: colours and light."""

from dataclasses import dataclass

Color = tuple[float, float, float]
"""Red, green, blue, each from 0 to 1."""


@dataclass(frozen=True)
class Style:
    """Colours and light of a frame."""

    outside: Color = (0.62, 0.21, 0.18)
    """The original surface."""
    inside: Color = (0.97, 0.58, 0.52)
    """Raw faces that a cut has laid open."""
    target: Color = (0.25, 0.66, 0.70)
    """Highlighted tetrahedra, on the original surface."""
    target_inside: Color = (0.58, 0.88, 0.88)
    """Highlighted tetrahedra, on raw faces."""
    pinned: Color = (0.22, 0.20, 0.26)
    """Surface at pinned nodes, fading out towards free ones."""
    background: tuple[Color, Color] = ((0.96, 0.97, 0.98), (0.84, 0.87, 0.90))
    """Behind the body, at the top and at the bottom."""
    strain_limit: float = 0.5
    """Strain at the end of the heat map, the limit of tearing in the shipped scenes."""
    legend: str = "strain"
    """Title of the colour bar that a heat map comes with; empty for no bar."""
    fade: float = 0.72
    """How far pieces that hang on no pinned node pale into the background: 0 not at all, 1 as far as light lets them."""
    gloss: float = 0.5
    """Strength of highlights: 0 is dull, 1 wet."""
    wire: float = 0.12
    """Darkness of the mesh lines: 0 draws none, 1 draws black."""
    occlusion: float = 1.0
    """Strength of contact shadows in clefts: 0 draws none and saves their time."""
