"""`gmapspring mesh`: what a mesh is like, and the same mesh in another format."""

import argparse
import pathlib
from math import isfinite

from rich.console import Console

from agents.commands.bodies import add_material, add_mesh, material_of, mesh_of
from agents.commands.command import Command, add_json, print_json
from agents.table import print_table
from gmapspring.integrators import INTEGRATORS
from gmapspring.mesh_files.text_writing import WRITERS, write_any
from gmapspring.mesh_info import N_BINS, MeshInfo, describe

BAR = 40
"""Length of the longest bar of the histogram, in characters."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    kinds = parser.add_subparsers(required=True, metavar="info | convert")
    info = kinds.add_parser("info", help="counts, quality, boundary, pieces, singular nodes, stable steps, memory")
    add_mesh(info)
    add_material(info)
    add_json(info)
    info.set_defaults(act=_info)
    convert = kinds.add_parser("convert", help="write a mesh in another format")
    add_mesh(convert)
    convert.add_argument("out", type=pathlib.Path, help=f"a file that ends in {', '.join(WRITERS)}")
    convert.set_defaults(act=_convert)


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Do what was asked with a mesh."""
    code: int = parsed.act(parsed, console)
    return code


def _info(parsed: argparse.Namespace, console: Console) -> int:
    """Print what a mesh is like."""
    info = describe(mesh_of(parsed), material_of(parsed), sorted(INTEGRATORS))
    if parsed.json:
        print_json(info.as_dict())
        return 0
    print_table(console, f"{parsed.mesh}", ("fact", "value"), _facts(info))
    most = max(info.quality_histogram)
    bars = [
        (f"{place / N_BINS:.1f} to {(place + 1) / N_BINS:.1f}", f"{count}", "#" * -(-BAR * count // most))
        for place, count in enumerate(info.quality_histogram)
    ]
    print_table(console, "\nquality: 1 for a regular tetrahedron, 0 for a flat one", ("mean ratio", "tetrahedra", ""), bars)
    return 0


def _facts(info: MeshInfo) -> list[tuple[str, str]]:
    """Return the facts as names and words."""
    steps = ", ".join(f"{name} {f'{1e3 * step:.3g} ms' if isfinite(step) else 'any'}" for name, step in info.stable_steps.items())
    quality = ", ".join(f"{name} {value:.3f}" for name, value in info.quality.items())
    return [
        ("points, edges, faces, tetrahedra", f"{info.n_points}, {info.n_edges}, {info.n_faces}, {info.n_tetrahedra}"),
        ("size [m]", " x ".join(f"{length:.4g}" for length in info.extent)),
        ("volume [m^3]", f"{info.volume:.6g}"),
        ("regions", ", ".join(f"{name} ({count})" for name, count in info.regions.items()) or "none"),
        ("parts held together by faces", str(info.n_components)),
        ("boundary", f"{info.n_boundary_faces} faces, {info.boundary_area:.4g} m^2, {_shape(info)}"),
        ("singular nodes", str(info.n_singular_nodes)),
        ("points that become several nodes", str(info.n_pinched_points)),
        ("points in the same place", _cracks(info)),
        ("quality", f"{quality}; the worst is tetrahedron {info.worst_tetrahedron}"),
        ("stable step", steps),
        ("memory of the body", f"{info.n_bytes / 2**20:.2f} MiB"),
    ]


def _cracks(info: MeshInfo) -> str:
    """Return how many points coincide, and what that means."""
    n = info.n_coincident_points
    return f"{n}: not watertight, the mesh has cracks there; merge these points where it is made" if n else "0"


def _shape(info: MeshInfo) -> str:
    """Return the boundary's Euler characteristic in words."""
    known = {2: " (a sphere)", 0: " (a torus, or a sphere within a pierced one)"} if info.n_components == 1 else {}
    return f"Euler characteristic {info.boundary_euler}{known.get(info.boundary_euler, '')}"


def _convert(parsed: argparse.Namespace, console: Console) -> int:
    """Write a mesh in another format."""
    mesh = mesh_of(parsed)
    write_any(parsed.out, mesh)
    console.print(f"wrote {mesh.n_tetrahedra} tetrahedra to {parsed.out}", highlight=False, soft_wrap=True)
    return 0


COMMAND = Command(
    "tell what a mesh is like, or write it in another format",
    "mesh info liver\nmesh convert liver liver.vtu\nmesh info body.msh --young-modulus 2e4 --json",
    add_arguments,
    run,
)
