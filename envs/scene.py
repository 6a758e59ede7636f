"""A scene: one body, its target, its load and its rules, as plain data; made from a configuration and a seed."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from envs.scene_config import Limits, MaterialField, Physics, SceneConfig
from envs.scene_kinds import BoxMesh, FileMesh
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh
from gmapspring.mesh_files import read_mesh
from gmapspring.meshes import box

Array = np.ndarray[Any, Any]

MODULUS_DIGITS = 3
"""Decimals kept of a modulus [Pa]: far finer than any effect, coarse enough that libraries of mathematics agree."""
DIRECTION_DIGITS = 9
"""Decimals kept of a load direction, for the same reason."""


class NoSceneError(ConfigError):
    """A seed that gives no scene, where another seed of the same configuration may."""


@dataclass(frozen=True)
class Certificate:
    """Hold the proof that a scene can be solved at the least cost: an order of cuts that the body survives."""

    optimum: float
    """Least total cost J* of any set of cuts that frees the target."""

    order: tuple[int, ...]
    """Action ids of the cheapest plan, in the order that survives."""

    load_factor: float
    """What the configured load was multiplied by, so that the peak strain is kappa times the limit."""

    peak_strain: float
    """Largest healthy strain met on the way."""

    lowest_volume_ratio: float
    """Smallest healthy volume ratio met on the way."""

    @property
    def plan(self) -> tuple[int, ...]:
        """Return the action ids of the cheapest plan, ascending."""
        return tuple(sorted(self.order))


@dataclass(frozen=True, eq=False)
class Scene:
    """Hold everything that defines one episode's body, load and rules; arrays are read-only."""

    name: str
    """Name of the configuration that it was made from."""

    seed: int
    """Seed that it was made from."""

    mesh: Mesh
    """The uncut body."""

    target: Array
    """Tetrahedra to be freed, bool, shape (n_tetrahedra,); none of them is an anchor."""

    pinned: Array
    """Points that never move, bool, shape (n_points,)."""

    young_modulus: Array
    """Stiffness of each tetrahedron [Pa], float64, shape (n_tetrahedra,)."""

    load: Array
    """Total force on whatever target is still attached [N], float64, shape (3,); calibrated if certified."""

    spacing: float
    """Unit of length h [m]: costs count areas in h^2 and volumes in h^3."""

    reference_modulus: float
    """Unit of stiffness [Pa]: the modulus around which the field varies."""

    physics: Physics
    """How the body moves between two cuts."""

    limits: Limits
    """What healthy tissue bears."""

    budget: float
    """Cost at which an episode is cut short, in multiples of the optimum."""

    certificate: Certificate | None = None
    """Proof that the scene can be solved, where one has been found."""

    no_cut: Array | None = None
    """Vessel: healthy tetrahedra that must not be laid open, bool, shape (n_tetrahedra,); None for none."""

    tool_radius: float | None = None
    """How far from the last cut the next may lie, in units of length h; None for anywhere."""

    @cached_property
    def anchor(self) -> Array:
        """Return the tetrahedra with a pinned corner, bool, shape (n_tetrahedra,)."""
        return _read_only(np.asarray(self.pinned[self.mesh.tetrahedra].any(axis=1)))

    @cached_property
    def vessel(self) -> Array:
        """Return the tetrahedra that must not be laid open, bool, shape (n_tetrahedra,)."""
        return _read_only(np.zeros(self.mesh.n_tetrahedra, bool)) if self.no_cut is None else self.no_cut

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone."""
        return {name: self.__dict__[name] for name in self.__dataclass_fields__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the fields; unpickled arrays would be writable, so they are frozen here too."""
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        self.__dict__.update(state)


def build_scene(config: SceneConfig, seed: int, certificate: Certificate | None = None) -> Scene:
    """Return the scene of a seed: the same seed gives the same bits on every machine.

    Args:
        config: what all seeds have in common.
        seed: what the target, the stiffness field, the load direction and the vessel are drawn from, in this order.
        certificate: proof to attach; its load factor scales the load.
    """
    rng = np.random.default_rng(seed)
    mesh = build_mesh(config.mesh)
    spacing = length_unit(config.mesh)
    pinned = config.pinned.points(mesh)
    is_anchor = pinned[mesh.tetrahedra].any(axis=1)
    target = config.target.draw(mesh, config.mesh, spacing, rng) & ~is_anchor
    if not is_anchor.any():
        raise ConfigError(f"scene {config.name!r}: no tetrahedron is chosen by pinned")
    if not target.any():
        raise NoSceneError(f"scene {config.name!r}, seed {seed}: all that target chooses are anchors, which never belong to it")
    young_modulus = modulus_field(config.material, mesh, rng)
    direction = np.round(config.load.direction.draw(mesh, target, rng), DIRECTION_DIGITS)
    vessel = None if config.no_cut is None else _read_only(config.no_cut.draw(mesh, target, pinned, rng))
    # The footprint of the target, so that the force grows with it as a traction would.
    footprint = float(mesh.volumes[target].sum()) ** (2.0 / 3.0)
    factor = 1.0 if certificate is None else certificate.load_factor
    return Scene(
        name=config.name,
        seed=seed,
        mesh=mesh,
        target=_read_only(target),
        pinned=_read_only(pinned),
        young_modulus=_read_only(young_modulus),
        load=_read_only(direction * (config.load.traction * footprint * factor)),
        spacing=spacing,
        reference_modulus=config.material.young_modulus,
        physics=config.physics,
        limits=config.limits,
        budget=config.budget,
        certificate=certificate,
        no_cut=vessel,
        tool_radius=None if config.tool is None else config.tool.radius,
    )


@lru_cache(maxsize=16)
def build_mesh(config: BoxMesh | FileMesh) -> Mesh:
    """Return the mesh of a configuration; all scenes of one configuration share it."""
    if isinstance(config, BoxMesh):
        return box(config.cells, config.spacing)
    return read_mesh(config.path)


@lru_cache(maxsize=16)
def length_unit(config: BoxMesh | FileMesh) -> float:
    """Return the unit of length [m]: as configured, else the cube of which six mean tetrahedra make one."""
    if config.spacing is not None:
        return config.spacing
    mean_volume = float(build_mesh(config).volumes.mean())
    return float(round(np.cbrt(6.0 * mean_volume), 9))


def modulus_field(config: MaterialField, mesh: Mesh, rng: np.random.Generator) -> Array:
    """Return a smooth random stiffness E = E0 exp(s g) [Pa], g a sum of random plane waves, shape (n_tetrahedra,).

    The waves have unit power together, so that g has a standard deviation near one over a body larger than a wave.
    """
    wave_vectors = rng.normal(size=(config.n_waves, 3)) / config.correlation_length
    phases = rng.uniform(0.0, 2.0 * np.pi, config.n_waves)
    amplitudes = rng.normal(size=config.n_waves)
    centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
    waves = np.cos((centroids[:, None, :] * wave_vectors).sum(axis=2) + phases) * amplitudes
    power = np.sqrt((amplitudes**2).sum() / 2.0)
    logarithm = config.log_scale * waves.sum(axis=1) / power
    return np.asarray(np.round(config.young_modulus * np.exp(logarithm), MODULUS_DIGITS))


def _read_only(array: Array) -> Array:
    """Return the array, frozen."""
    array.flags.writeable = False
    return array
