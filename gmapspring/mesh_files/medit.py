"""Read medit .mesh files through the optional package meshio."""

import contextlib
import io
import pathlib
from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh_files.raw_mesh import RawMesh

SOLIDS = ("hexahedron", "wedge", "pyramid", "tetra10")
"""meshio's names of the solids that are not linear tetrahedra."""


def read_medit(path: pathlib.Path) -> RawMesh:
    """Read a medit file; nonzero references of tetrahedra become cell regions "ref_N"."""
    mesh = _read(path)
    no_rows, no_references = np.zeros((0, 4), dtype=np.int64), np.zeros(0, dtype=np.int64)
    chosen = [place for place, block in enumerate(mesh.cells) if block.type == "tetra"]
    tetrahedra = np.concatenate([no_rows, *(mesh.cells[place].data for place in chosen)])
    values = mesh.cell_data["medit:ref"]
    references = np.concatenate([no_references, *(values[place] for place in chosen)])
    regions = {f"ref_{number}": references == number for number in np.unique(references) if number != 0}
    ignored = {block.type: len(block.data) for block in mesh.cells if block.type in SOLIDS}
    return RawMesh(np.asarray(mesh.points, dtype=np.float64), tetrahedra, regions, {}, ignored)


def _read(path: pathlib.Path) -> Any:
    """Return meshio's mesh; meshio prints its errors and ends the process, here they become a `MeshError`."""
    try:
        import meshio
    except ImportError as error:
        raise MeshError(f"reading {path.suffix} files needs meshio: pip install gmapspring[mesh]") from error
    if path.stat().st_size == 0:
        raise MeshError("the file is empty")
    printed = io.StringIO()
    try:
        with contextlib.redirect_stderr(printed), contextlib.redirect_stdout(printed):
            return meshio.read(path, file_format="medit")
    except (SystemExit, Exception) as error:
        reason = " ".join(printed.getvalue().split()) or f"{type(error).__name__}: {error}"
        raise MeshError(f"truncated or corrupt (meshio: {reason})") from error
