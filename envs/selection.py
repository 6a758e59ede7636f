"""Which scene an episode plays: drawn from the environment's own generator, or as `reset(options=...)` asks."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from envs.action_table import action_table
from envs.calibrate import recalibrated
from envs.library import seeds_of
from envs.scene import Scene
from gmapspring.config import closest
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh

CHOICES = {
    "index": "number of a scene in the environment's list",
    "scene_seed": "seed of a scene in the environment's list",
    "scene": "a Scene on a mesh with as many tetrahedra and interior faces",
}
"""Options that choose a scene; at most one may be given."""

CHANGES = {
    "load_factor": "what to multiply the load by",
    "load": "total force on the target [N], shape (3,)",
    "target": "tetrahedra to be freed, bool, shape (n_tetrahedra,)",
    "young_modulus": "stiffness [Pa], shape (n_tetrahedra,)",
    "mesh": "a Mesh with as many points, tetrahedra and interior faces; all else is kept",
    "kappa": "peak strain of the gentlest known order over the limit: the load is scaled to it",
}
"""Options that change the chosen scene, `kappa` after all others; of a changed scene only what kappa proves anew is certified."""


class Selection(NamedTuple):
    """The scene of an episode."""

    scene: Scene | None
    """A scene that is not one of the list as it stands, or None."""

    place: int
    """Number in the list, -1 for a scene given as an option."""


def select(scenes: Sequence[Scene], drawn: int, options: Mapping[str, Any] | None) -> Selection:
    """Return the scene of an episode: the drawn one unless the options choose or change it.

    Raises:
        ConfigError: an option is unknown or does not fit; all mistakes are listed.
    """
    options = options or {}
    mistakes = [
        f"  options.{name}: unknown option; {closest(str(name), CHOICES | CHANGES)}"
        for name in options
        if name not in CHOICES and name not in CHANGES
    ]
    choices = [name for name in CHOICES if name in options]
    if len(choices) > 1:
        mistakes.append(f"  options: {' and '.join(choices)} each choose a scene; give one of them")
    if mistakes:
        raise ConfigError("\n".join(["reset options have mistakes:", *mistakes]))
    selection = _chosen(scenes, drawn, options)
    changes = {name: options[name] for name in CHANGES if name in options}
    if not changes:
        return selection
    return Selection(_changed(selection.scene or scenes[selection.place], changes), selection.place)


def _chosen(scenes: Sequence[Scene], drawn: int, options: Mapping[str, Any]) -> Selection:
    """Return the scene before changes."""
    if "scene" in options:
        if not isinstance(options["scene"], Scene):
            raise ConfigError(f"options.scene is {options['scene']!r}; give an envs.scene.Scene")
        return Selection(options["scene"], -1)
    if "scene_seed" in options:
        seeds = seeds_of(scenes)
        if options["scene_seed"] not in seeds:
            raise ConfigError(f"options.scene_seed = {options['scene_seed']!r} is none of the {len(seeds)} scenes here")
        return Selection(None, seeds.index(options["scene_seed"]))
    index = options.get("index", drawn)
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < len(scenes):
        raise ConfigError(f"options.index = {index!r} is not a whole number from 0 to {len(scenes) - 1}")
    return Selection(None, int(index))


def _changed(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return a scene with some of it replaced, and its load scaled if that is asked for."""
    others = {name: value for name, value in changes.items() if name != "kappa"}
    changed = _replaced(scene, others) if others else scene
    if "kappa" not in changes:
        return changed
    kappa = float(_array("kappa", changes["kappa"], ()))
    if not 0.0 < kappa < 1.0:
        raise ConfigError(f"options.kappa = {kappa:g} does not lie between 0 and 1")
    return recalibrated(changed, kappa)


def _replaced(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return a scene with some of it replaced: what was proved of the old one does not hold for it."""
    n_tets = scene.mesh.n_tetrahedra
    values: dict[str, Any] = {"certificate": None}
    load = _array("load", changes.get("load", scene.load), (3,)) * float(
        _array("load_factor", changes.get("load_factor", 1.0), ())
    )
    values["load"] = _frozen(load)
    if "young_modulus" in changes:
        values["young_modulus"] = _frozen(_array("young_modulus", changes["young_modulus"], (n_tets,)))
        if not (values["young_modulus"] > 0.0).all():
            raise ConfigError("options.young_modulus must be positive everywhere")
    if "target" in changes:
        target = np.array(changes["target"])
        if (
            target.dtype != np.bool_
            or target.shape != (n_tets,)
            or not target.any()
            or (target & (scene.anchor | scene.vessel)).any()
        ):
            raise ConfigError(
                f"options.target must be a bool mask of shape ({n_tets},), not empty and without anchors and vessels"
            )
        values["target"] = _frozen(target)
    if "mesh" in changes:
        values["mesh"] = _fitting(changes["mesh"], scene.mesh)
    changed = dataclasses.replace(scene, **values)
    if (changed.target & changed.anchor).any():
        raise ConfigError("options.mesh has target tetrahedra at pinned points; number both as the scene's mesh does")
    return changed


def _fitting(mesh: Any, old: Mesh) -> Mesh:
    """Return a mesh that can take the place of a scene's, or raise."""
    if not isinstance(mesh, Mesh):
        raise ConfigError(f"options.mesh must be a gmapspring Mesh, not {type(mesh).__name__}")
    given, wanted = ((each.n_points, each.n_tetrahedra, action_table(each).n_faces) for each in (mesh, old))
    if given != wanted:
        raise ConfigError(f"options.mesh has {given} points, tetrahedra and interior faces; the scene's has {wanted}")
    return mesh


def _array(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Return an option as a new float64 array of a shape, or raise."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.full(shape, np.nan)
    if array.shape != shape or not np.isfinite(array).all():
        what = f"finite numbers of shape {shape}" if shape else "a finite number"
        raise ConfigError(f"options.{name} must be {what}")
    return array


def _frozen(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the array, read-only."""
    array.flags.writeable = False
    return array
