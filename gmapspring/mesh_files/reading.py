"""Read a mesh from a file of any supported format, meeting foreign files half-way."""

import os
import pathlib
import warnings
from collections.abc import Callable

import numpy as np

from gmapspring import mesh_checks
from gmapspring.errors import MeshError
from gmapspring.mesh import Mesh
from gmapspring.mesh_files.gmsh import read_gmsh
from gmapspring.mesh_files.medit import read_medit
from gmapspring.mesh_files.raw_mesh import RawMesh
from gmapspring.mesh_files.vtk_legacy import read_vtk
from gmapspring.mesh_files.vtu_reading import read_vtu

READERS: dict[str, Callable[[pathlib.Path], RawMesh]] = {
    ".msh": read_gmsh,
    ".vtu": read_vtu,
    ".vtk": read_vtk,
    ".mesh": read_medit,
}
"""Readers by file ending; .mesh needs the optional package meshio."""


class MeshWarning(UserWarning):
    """A mesh file was repaired while it was read."""


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh from a gmsh .msh (1, 2, 4.1), .vtu, legacy .vtk or medit .mesh file.

    Points that no tetrahedron uses are dropped and tetrahedra that are wound the other way are turned: a `MeshWarning`
    says how many. Surface cells are ignored, and so are other solids, with a warning. Regions: gmsh's physical
    volumes become cell regions and its named lower-dimensional groups point regions; in VTK files arrays called
    "region:NAME"; in medit files nonzero references, as cell regions "ref_N".

    Raises:
        MeshError: the file is missing, truncated, foreign, or holds no mesh that a body can be built on.
    """
    path = pathlib.Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise MeshError(f"cannot read {path}: the ending {path.suffix!r} is none of {', '.join(READERS)}")
    try:
        raw = reader(path)
        mesh, repairs = _tidied(raw)
    except MeshError as error:
        raise MeshError(f"cannot read {path}: {error}") from error
    except OSError as error:
        raise MeshError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # foreign bytes can fail in any way; whatever it is, the file is the culprit
        raise MeshError(f"cannot read {path}: truncated or corrupt ({type(error).__name__}: {error})") from error
    if repairs:
        warnings.warn(f"{path}: {'; '.join(repairs)}", MeshWarning, stacklevel=2)
    return mesh


def _tidied(raw: RawMesh) -> tuple[Mesh, list[str]]:
    """Return the mesh of a file without unused points and negative tetrahedra, and what was done to it."""
    repairs = []
    others = ", ".join(f"{count} {kind}" for kind, count in raw.ignored_solids.items())
    if len(raw.tetrahedra) == 0:
        raise MeshError(f"no linear tetrahedra in it ({others or 'no solid cells'}); export a tetrahedral mesh")
    if others:
        repairs.append(f"ignored solid cells that are not linear tetrahedra: {others}")
    points = mesh_checks.checked_shape(raw.points)
    tetrahedra = raw.tetrahedra.copy()
    mesh_checks.check_range(tetrahedra, len(points))
    is_used = np.zeros(len(points), dtype=bool)
    is_used[tetrahedra.ravel()] = True
    if not is_used.all():
        repairs.append(f"dropped {np.count_nonzero(~is_used)} points that no tetrahedron uses")
        points = points[is_used]
        tetrahedra = (np.cumsum(is_used) - 1)[tetrahedra]
    with np.errstate(over="ignore", invalid="ignore"):
        is_negative = mesh_checks.signed_volumes(points, tetrahedra) < -mesh_checks.flat_limits(points, tetrahedra)
    if is_negative.any():
        repairs.append(f"turned {np.count_nonzero(is_negative)} tetrahedra that were wound the other way")
        tetrahedra[is_negative, 2:] = tetrahedra[is_negative][:, [3, 2]]
    point_regions = {name: mask[is_used] for name, mask in raw.point_regions.items()}
    return Mesh(points, tetrahedra, raw.cell_regions, point_regions), repairs
