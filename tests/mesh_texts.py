"""Small mesh files of every kind, written down by hand, and how tests read them."""

import warnings

import numpy as np
import pytest

from gmapspring import meshes
from gmapspring.errors import MeshError
from gmapspring.mesh import Mesh
from gmapspring.mesh_files import MeshWarning, read_mesh

GROUPS = """$PhysicalNames
3
2 4 "wall"
3 7 "whole organ"
3 8 "tumour"
$EndPhysicalNames
"""
"""How both later versions of the format name groups of elements."""

GMSH_1 = """$NOD
6
1 0 0 0
2 1 0 0
30 0 1 0
4 0 0 1
5 1 1 1
9 7 7 7
$ENDNOD
$ELM
4
1 15 0 0 1 9
2 2 4 1 3 1 2 30
3 4 7 1 4 1 2 30 4
4 4 0 2 4 30 2 4 5
$ENDELM
"""
"""Two tetrahedra, the second wound the other way, and a point and a triangle beside them. Node 9 is on neither."""

GMSH_2 = """$MeshFormat
2.2 0 8
$EndMeshFormat
""" + GROUPS + """$Nodes
5
1 0 0 0
2 1 0 0
30 0 1 0
4 0 0 1
5 1 1 1
$EndNodes
$Elements
5
1 2 2 4 1 1 2 30
2 4 2 7 1 1 2 30 4
3 4 3 7 1 0 2 30 4 5
4 4 2 8 1 2 30 4 5
5 15 0 1
$EndElements
"""
"""The second tetrahedron is in two groups, so gmsh writes it twice."""

GMSH_4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
""" + GROUPS + """$Entities
1 0 1 2
1 0 0 0 0
1 0 0 0 1 1 0 1 4 0
1 0 0 0 1 1 1 1 7 1 1
2 0 0 0 1 1 1 2 7 -8 0
$EndEntities
$Nodes
2 5 1 30
2 1 0 3
1
2
30
0 0 0
1 0 0
0 1 0
3 1 0 2
4
5
0 0 1
1 1 1
$EndNodes
$Elements
3 3 1 3
2 1 2 1
1 1 2 30
3 1 4 1
2 1 2 30 4
3 2 4 1
3 2 30 4 5
$EndElements
"""

VTK_LEGACY = """# vtk DataFile Version 3.0
by hand
ASCII
DATASET UNSTRUCTURED_GRID
FIELD FieldData 1
TIME 1 1 double
0.5
POINTS 5 float
0 0 0 1 0 0 0 1 0
0 0 1 1 1 1
CELLS 3 14
3 0 1 2
4 0 1 2 3
4 1 2 3 4
CELL_TYPES 3
5
10
10
CELL_DATA 3
SCALARS region:tumour int 1
LOOKUP_TABLE default
1
0
1
POINT_DATA 5
VECTORS velocity float
0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
FIELD FieldData 1
region%3atop 1 5 unsigned_char
0 0 0 1 1
METADATA
INFORMATION 0

"""

MEDIT = """MeshVersionFormatted 2
Dimension 3
Vertices
5
0 0 0 0
1 0 0 0
0 1 0 0
0 0 1 0
1 1 1 0
Triangles
1
1 2 3 4
Tetrahedra
2
1 2 3 4 0
2 3 4 5 6
End
"""

TEXTS = {"gmsh 1": (".msh", GMSH_1), "gmsh 2": (".msh", GMSH_2), "gmsh 4": (".msh", GMSH_4),
         "vtk": (".vtk", VTK_LEGACY), "medit": (".mesh", MEDIT)}  # fmt: skip


def marked_box():
    """Return a box with regions."""
    box = meshes.box((2, 2, 1), 0.1)
    corner = {"lump & <rest>": np.arange(24) % 3 == 0, "none": np.zeros(24, dtype=bool)}
    return Mesh(box.points + 1 / 3, box.tetrahedra, corner, {"höhe": box.points[:, 2] > 0.05})


def saved(folder, kind):
    """Write one of the texts to a file and return its path."""
    ending, text = TEXTS[kind]
    path = folder / f"mesh{ending}"
    path.write_text(text)
    return path


def quietly(path):
    """Read a mesh without its warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        return read_mesh(path)


def refusal(path):
    """Return the message of the error that a file is refused with; it names the file."""
    with pytest.raises(MeshError) as caught:
        quietly(path)
    assert str(path) in str(caught.value)
    return str(caught.value)
