"""gmapspring: deformable tetrahedral bodies whose mesh is a 3-dimensional generalized map, so that every cut is exact."""

from gmapspring import measure, meshes
from gmapspring.body import Body, Material
from gmapspring.cut import CutReport
from gmapspring.errors import (
    ConfigError,
    DivergenceError,
    GmapspringError,
    MeshError,
    StabilityError,
    StateFileError,
    TopologyError,
)
from gmapspring.mesh import Mesh
from gmapspring.mesh_files import read_mesh, write_mesh
from gmapspring.simulation import Simulation

__all__ = [
    "Body", "ConfigError", "CutReport", "DivergenceError", "GmapspringError", "Material", "Mesh", "MeshError", "Simulation",
    "StabilityError", "StateFileError", "TopologyError", "measure", "meshes", "read_mesh", "write_mesh",
]
