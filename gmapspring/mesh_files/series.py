"""Write a body over time as a series that ParaView plays: a .vtu file for each frame, and a .pvd file that lists them."""

import pathlib
from xml.sax.saxutils import quoteattr

import numpy as np

from gmapspring import measure
from gmapspring.body import Body
from gmapspring.errors import MeshError
from gmapspring.mesh_files.vtu_writing import write_vtu
from gmapspring.paths import write_atomically


class Series:
    """The files of one series; the list is written anew with each frame, so that what was interrupted can be played."""

    def __init__(self, path: pathlib.Path) -> None:
        """Name the series: NAME.vtu stands for frames NAME_0000.vtu, NAME_0001.vtu, ... and their list NAME.pvd.

        Raises:
            MeshError: the name does not end in .vtu.
        """
        if path.suffix.lower() != ".vtu":
            raise MeshError(f"cannot write {path}: give a name that ends in .vtu")
        self.list_path = path.with_suffix(".pvd")
        """The file to open in ParaView."""
        self._stem = path.with_suffix("")
        self._frames: list[tuple[float, str]] = []

    def add(self, body: Body, time: float) -> None:
        """Write a body as it is now; time [s]."""
        path = self._stem.with_name(f"{self._stem.name}_{len(self._frames):04d}.vtu")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_body(path, body)
        self._frames.append((time, path.name))
        sets = (f'<DataSet timestep="{when!r}" part="0" file={quoteattr(name)}/>' for when, name in self._frames)
        lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "<Collection>", *sets]
        write_atomically(self.list_path, "\n".join([*lines, "</Collection>", "</VTKFile>\n"]).encode())


def write_body(path: pathlib.Path, body: Body) -> None:
    """Write a body as it is now: its nodes, its live tetrahedra, and what can be coloured by.

    On nodes: displacement [m], velocity [m/s], mass [kg], whether pinned. On tetrahedra: strain, volume ratio, piece, number
    in the mesh, and the mesh's regions.
    """
    alive, nodes = np.flatnonzero(body.is_alive), body.nodes
    on_nodes = {
        "displacement": nodes.position - body.mesh.points[nodes.point],
        "velocity": nodes.velocity,
        "mass": nodes.mass,
        "pinned": nodes.is_pinned,
    }
    on_tetrahedra = {
        "strain": measure.tetrahedron_strains(body)[alive],
        "volume_ratio": measure.volume_ratios(body)[alive],
        "piece": measure.components(body)[alive],
        "tetrahedron": alive,
    }
    on_tetrahedra |= {f"region:{name}": mask[alive] for name, mask in body.mesh.cell_regions.items()}
    write_vtu(path, nodes.position, body.vertex_of[alive], on_nodes, on_tetrahedra)
