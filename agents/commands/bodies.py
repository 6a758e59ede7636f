"""What commands about bodies have in common: which mesh, and what it is made of."""

import argparse
import pathlib

import gmapspring as gs
from agents.commands.command import number

SHIPPED = {"liver": gs.meshes.liver}
"""Meshes that go by a name."""


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """Declare the mesh."""
    endings = ".msh, .vtu, .vtk or .mesh"
    parser.add_argument("mesh", metavar="MESH", help=f"a {endings} file of tetrahedra, or the shipped {', '.join(SHIPPED)}")


def add_material(parser: argparse.ArgumentParser) -> None:
    """Declare what the body is made of."""
    parser.add_argument("--young-modulus", type=number, default=5e3, metavar="PA", help="Young's modulus [5000 Pa]")
    parser.add_argument("--density", type=number, default=1000.0, metavar="KG_M3", help="density [1000 kg/m^3]")
    parser.add_argument("--viscosity", type=number, default=5.0, metavar="PER_S", help="drag in proportion to mass [5 1/s]")
    parser.add_argument("--damping", type=number, default=0.0, metavar="S", help="damping in proportion to stiffness [0 s]")


def mesh_of(parsed: argparse.Namespace) -> gs.Mesh:
    """Return the mesh that was asked for."""
    # A file goes before a name: who has one called "liver" means it.
    if parsed.mesh in SHIPPED and not pathlib.Path(parsed.mesh).exists():
        return SHIPPED[parsed.mesh]()
    return gs.read_mesh(parsed.mesh)


def material_of(parsed: argparse.Namespace) -> gs.Material:
    """Return the material that was asked for."""
    if parsed.density == 0.0:
        raise gs.ConfigError("--density is 0; a body needs mass")
    return gs.Material(parsed.young_modulus, parsed.density, parsed.damping, parsed.viscosity)
