"""Meshes in files: reading gmsh, VTK and medit files, writing .vtu files that ParaView opens."""

from gmapspring.mesh_files.reading import MeshWarning, read_mesh
from gmapspring.mesh_files.vtu_writing import write_mesh, write_vtu

__all__ = ["MeshWarning", "read_mesh", "write_mesh", "write_vtu"]
