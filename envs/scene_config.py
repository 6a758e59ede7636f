"""The form of a scene file: what all seeds of a scene have in common, checked field by field.

Every model forbids unknown keys, and its fields say their units. What comes in several kinds is in scene_kinds.py.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

from envs.scene_kinds import BoxMesh, ConeDirection, FileMesh, FixedDirection, OutwardDirection, PinnedPlane, PinnedRegion, Vector
from envs.targets import Channel, EllipsoidTarget, NoCutRegion, RegionTarget, TopCubeTarget, UnderSurfaceTarget
from gmapspring.config import Config, names_of
from gmapspring.integrators import INTEGRATORS

Share = Annotated[float, Field(gt=0.0, lt=1.0)]

SPLITS = ("train", "validation", "test")
"""Uses that seeds are reserved for."""


class MaterialField(Config):
    """Describe the random stiffness E = young_modulus * exp(log_scale * g(x))."""

    young_modulus: PositiveFloat
    """Median stiffness [Pa]."""
    log_scale: Annotated[float, Field(ge=0.0)]
    """Standard deviation of log E; below 0.8 a rule of geometry alone solves the task."""
    correlation_length: PositiveFloat
    """Length over which the stiffness changes [m]."""
    n_waves: PositiveInt = 3
    """Plane waves that the field g is made of."""


class Load(Config):
    """Describe the total force on whatever target is still attached."""

    traction: PositiveFloat
    """Force per footprint of the target, (its volume)^(2/3) [Pa], before calibration."""
    direction: Annotated[ConeDirection | OutwardDirection | FixedDirection, Field(discriminator="kind")]


class Physics(Config):
    """Say how the body moves between two cuts."""

    density: PositiveFloat
    """[kg/m^3]"""
    viscosity: Annotated[float, Field(ge=0.0)]
    """Drag per mass [1/s]."""
    damping: Annotated[float, Field(ge=0.0)] = 0.0
    """Spring damping per stiffness [s]."""
    gravity: Vector = (0.0, 0.0, 0.0)
    """[m/s^2]"""
    settle_seconds: PositiveFloat
    """Time that passes after each cut [s]."""
    initial_settle_seconds: PositiveFloat
    """Time that passes before the first cut [s]."""
    rest_tolerance: PositiveFloat | None = None
    """A settling ends early once no node can move any further than this in what is left of its time, in units of length h."""
    integrator: Annotated[str, names_of("integrator", INTEGRATORS)]
    """A name of gmapspring.integrators.INTEGRATORS."""
    dtype: Literal["float64", "float32"] = "float64"
    """Precision of the state."""


class Limits(Config):
    """Say what attached healthy tissue bears; past any of these it collapses."""

    strain: PositiveFloat
    """Largest edge strain."""
    volume_ratio: Annotated[float, Field(ge=0.0, lt=1.0)]
    """Smallest volume of a tetrahedron over its rest volume."""
    healthy_share: Share
    """Smallest volume of attached healthy tissue over that at the start."""


class Tool(Config):
    """Describe a blade that moves from cut to cut."""

    radius: PositiveFloat
    """How far apart the centroids of two cuts in a row may lie at rest, in units of length h; where nothing legal lies so near,
    the tool is set down anew anywhere."""


class Split(Config):
    """Reserve seeds for one use."""

    seeds: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]]
    """First seed, and the one after the last."""
    count: PositiveInt
    """Certified scenes wanted, taken from the range in order."""

    @model_validator(mode="after")
    def _range_is_wide_enough(self) -> Self:
        first, stop = self.seeds
        if stop - first < self.count:
            raise ValueError(f"seeds {first} to {stop} (excluded) are fewer than count = {self.count}")
        return self


SplitName = Annotated[str, names_of("split", SPLITS)]


class SceneConfig(Config):
    """Describe a family of scenes; a seed makes one of it."""

    name: str
    """Name of the family, as in `gym.make("envs:Resect-v0", scene=name)`."""
    mesh: Annotated[BoxMesh | FileMesh, Field(discriminator="kind")]
    material: MaterialField
    pinned: Annotated[PinnedPlane | PinnedRegion, Field(discriminator="kind")]
    target: Annotated[TopCubeTarget | EllipsoidTarget | UnderSurfaceTarget | RegionTarget, Field(discriminator="kind")]
    no_cut: Annotated[NoCutRegion | Channel, Field(discriminator="kind")] | None = None
    """Vessel: what must not be laid open; by default nothing."""
    tool: Tool | None = None
    """What cuts; by default something that gets anywhere at once."""
    load: Load
    physics: Physics
    limits: Limits
    kappa: Share
    """Peak strain of the certificate over the limit: the higher, the harder."""
    budget: Annotated[float, Field(gt=1.0)]
    """Cost at which an episode is cut short, in multiples of the optimum."""
    splits: dict[SplitName, Split]
    """Seeds of the scenes to learn from, to choose a policy by, and to judge it by."""

    @field_validator("splits")
    @classmethod
    def _splits_are_disjoint(cls, splits: dict[str, Split]) -> dict[str, Split]:
        ordered = sorted(splits.items(), key=lambda item: item[1].seeds)
        for (name, split), (other, following) in zip(ordered, ordered[1:], strict=False):
            if split.seeds[1] > following.seeds[0]:
                raise ValueError(f"the seeds of {name} and {other} overlap; a held-out scene must be new")
        return splits

    @model_validator(mode="after")
    def _cubes_need_a_box(self) -> Self:
        if isinstance(self.target, TopCubeTarget) and not isinstance(self.mesh, BoxMesh):
            raise ValueError("target.kind 'top_cube' needs mesh.kind 'box'; choose 'ellipsoid' or 'region'")
        if isinstance(self.no_cut, Channel) and not (isinstance(self.mesh, BoxMesh) and isinstance(self.pinned, PinnedPlane)):
            raise ValueError("no_cut.kind 'channel' needs mesh.kind 'box' and pinned.kind 'plane'; choose 'region'")
        return self
