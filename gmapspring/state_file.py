"""A simulation in one file (.npz): mesh, material, settings and the state of every array; no pickles."""

import dataclasses
import io
import json
import pathlib
import zipfile

import numpy as np

from gmapspring.body import Material
from gmapspring.errors import GmapspringError, StateFileError
from gmapspring.mesh import Mesh
from gmapspring.paths import write_atomically
from gmapspring.snapshot import Snapshot

FORMAT, VERSION = "gmapspring state", 1


def write(path: pathlib.Path, simulation) -> None:
    """Write a simulation to a file, atomically: either the whole file is there or the old one."""
    body, state = simulation.body, simulation.save_state()
    settings = dict(format=FORMAT, version=VERSION, integrator=simulation.integrator.name,
                    dtype=body.node_rows.state.dtype.name, keep_manifold=simulation.keep_manifold, tolerance=simulation.tolerance,
                    time=state.time, n_substeps=state.n_substeps, gravity=body.matter.gravity.tolist())
    arrays = {"settings": np.array(json.dumps(settings)), "mesh.points": body.mesh.points,
              "mesh.tetrahedra": body.mesh.tetrahedra}
    arrays |= {f"material.{name}": np.asarray(value) for name, value in dataclasses.asdict(body.material).items()}
    arrays |= {f"cell_regions.{name}": mask for name, mask in body.mesh.cell_regions.items()}
    arrays |= {f"point_regions.{name}": mask for name, mask in body.mesh.point_regions.items()}
    for group in ("gmap", "nodes", "springs"):
        arrays |= {f"{group}.{i}": array for i, array in enumerate(getattr(state.body, group))}
    arrays["load"] = state.body.load
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_atomically(path, buffer.getvalue())


def read(path: pathlib.Path, simulation_type: type):
    """Read a simulation; raise StateFileError for a file that is not one, is cut short, or is of another version."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise StateFileError(f"{path}: there is no such file") from None
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        raise StateFileError(f"{path}: not a whole state file ({error}); save it again") from error
    settings = _settings(path, arrays)
    try:
        return _rebuild(arrays, settings, simulation_type)
    except (KeyError, TypeError, ValueError, IndexError, GmapspringError) as error:
        raise StateFileError(f"{path}: the state file contradicts itself ({error}); save it again") from error


def _settings(path: pathlib.Path, arrays: dict[str, np.ndarray]) -> dict:
    """Return the settings of a file that is ours and of this version."""
    try:
        settings = json.loads(str(arrays["settings"]))
    except (KeyError, ValueError):
        settings = {}
    if settings.get("format") != FORMAT:
        raise StateFileError(f"{path}: not a state file of gmapspring; write one with Simulation.save")
    if settings.get("version") != VERSION:
        raise StateFileError(f"{path}: written in version {settings.get('version')} of the format; this one reads {VERSION}")
    return settings


def _rebuild(arrays: dict[str, np.ndarray], settings: dict, simulation_type: type):
    """Build the simulation anew, then put the saved state into it and check it."""
    def group(name: str) -> dict[str, np.ndarray]:
        return {key.split(".", 1)[1]: array for key, array in arrays.items() if key.startswith(name + ".")}

    def in_order(name: str) -> tuple[np.ndarray, ...]:
        members = group(name)
        return tuple(members[str(i)] for i in range(len(members)))

    mesh = Mesh(arrays["mesh.points"], arrays["mesh.tetrahedra"], group("cell_regions"), group("point_regions"))
    how = dict(tolerance=settings.get("tolerance"))  # files written before there was one have none
    if how["tolerance"] is None:
        how = dict(integrator=settings["integrator"], dtype=np.dtype(settings["dtype"]).type)
    simulation = simulation_type(mesh, Material(**group("material")), gravity=settings["gravity"],
                                 keep_manifold=settings["keep_manifold"], **how)
    snapshot = Snapshot(in_order("gmap"), in_order("nodes"), in_order("springs"), arrays["load"])
    state = simulation.save_state()._replace(body=snapshot, time=settings["time"], n_substeps=settings["n_substeps"])
    simulation.load_state(state)
    simulation.check_validity()
    return simulation
