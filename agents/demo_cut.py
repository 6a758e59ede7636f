"""The first part of the demo: cut a liver, and hold every promise about it to account."""

import pathlib
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from rich.console import Console

import gmapspring as gs
from agents.table import print_table
from gmapspring import measure
from gmapspring.body import Body
from gmapspring.mesh_checks import paired_faces
from gmapspring.mesh_files import write_vtu
from gmapspring.render import render_body
from gmapspring.rendering.camera import Camera

Array = np.ndarray[Any, Any]

SETTLE_SECONDS = 0.1
"""Time that passes before the cuts [s]."""
OPENING_SECONDS = 0.15
"""Time in which the wound opens [s]."""
SLIT_REACH = 2.6
"""Reach of the slit around the middle of the tumour, in parts of the tumour's own reach."""
SLIT_AXIS = 1
"""The slit lies across this axis, y: gravity pulls it open."""
SIZE = (960, 720)
"""Width and height of the picture [pixels]."""
N_REMOVED = 8
"""Tetrahedra removed at the end of the slit."""


CONSERVED = ("", "before", "after the slit", "error", "own share of what was taken out", "error")
"""Columns of the table of what was conserved; errors are relative."""


UNITS = {"mass": "kg", "momentum": "kg m/s", "kinetic_energy": "J", "elastic_energy": "J"}
"""Units of the amounts."""


class Amounts(NamedTuple):
    """What a cut conserves."""

    mass: float
    """[kg]"""
    momentum: Array
    """[kg m/s], shape (3,)."""
    kinetic_energy: float
    """[J]"""
    elastic_energy: float
    """[J]"""


def amounts(body: Body) -> Amounts:
    """Return what a body has."""
    return Amounts(
        float(body.nodes.mass.sum()), measure.momentum(body), measure.kinetic_energy(body), measure.elastic_energy(body)
    )


def own_share(body: Body, tetrahedra: Array) -> Amounts:
    """Return what some tetrahedra have by themselves: the shares of theirs in nodes and springs, and nothing else."""
    quarter = 0.25 * body.tetrahedra.mass[tetrahedra, None]
    velocity = body.nodes.velocity[body.vertex_of[tetrahedra]]
    springs = body.edge_of[tetrahedra]
    strain = measure.edge_strains(body)[springs]
    return Amounts(
        float(4.0 * quarter.sum()),
        (quarter[..., None] * velocity).sum(axis=(0, 1)),
        float((0.5 * quarter * (velocity**2).sum(axis=2)).sum()),
        # With stiffness E V / l0^2 an edge stores E V (l / l0 - 1)^2 / 2.
        float((0.5 * body.tetrahedra.modulus[tetrahedra, None] * strain**2).sum()),
    )


def cut_liver(folder: pathlib.Path, console: Console) -> None:
    """Load the shipped liver, cut it, print what changed and what was conserved, and write it down."""
    mesh = gs.meshes.liver()
    sim = gs.Simulation(
        mesh,
        gs.Material(young_modulus=5e3, density=1000.0, viscosity=5.0),
        pinned=np.array(mesh.point_regions["anchor"]),
        gravity=(0.0, 0.0, -9.81),
    )
    body = sim.body
    console.print(f"A liver of {mesh.n_tetrahedra} tetrahedra: {body.n_nodes} nodes, {body.n_springs} springs.")
    n_substeps = sim.advance(SETTLE_SECONDS)
    console.print(
        f"Hung up by its anchor for {SETTLE_SECONDS} s of its time: {n_substeps} substeps of "
        f"{1e3 * SETTLE_SECONDS / n_substeps:.2f} ms (proven stable up to {1e3 * sim.stable_step:.2f} ms).",
        highlight=False,
        soft_wrap=True,
    )
    faces, removed = choose_cuts(mesh)
    start = amounts(body)
    report = sim.cut(faces=faces)
    _tell(console, f"\nA slit through the tumour, {len(faces)} faces", report)
    slit, share = amounts(body), own_share(body, removed)
    report = sim.cut(tetrahedra=removed)
    _tell(console, f"{len(removed)} tetrahedra taken out of it", report)
    sim.check_validity()
    rows = conservation_rows(start, slit, share, amounts(body))
    print_table(console, "\nWhat was conserved", CONSERVED, rows)
    sim.advance(OPENING_SECONDS)
    _write(folder, body, np.asarray(mesh.cell_regions["tumour"]))
    place = f"{folder / 'liver.png'}, and {folder / 'liver.vtu'} for ParaView"
    console.print(f"The cut body: {place}.", highlight=False, soft_wrap=True)


def choose_cuts(mesh: gs.Mesh) -> tuple[Array, Array]:
    """Return faces of a slit through the tumour, (k, 2) tetrahedra, and tetrahedra amid it, (m,)."""
    centroid = mesh.points[mesh.tetrahedra].mean(axis=1)
    tumour = mesh.cell_regions["tumour"]
    middle = centroid[tumour].mean(axis=0)
    reach = SLIT_REACH * np.linalg.norm(centroid[tumour] - middle, axis=1).max()
    slots = np.column_stack(paired_faces(mesh.tetrahedra, mesh.n_points))
    sides = slots // 4
    is_left = centroid[:, SLIT_AXIS] < middle[SLIT_AXIS]
    distance = np.linalg.norm(centroid - middle, axis=1)
    is_slit = (is_left[sides[:, 0]] != is_left[sides[:, 1]]) & (distance[sides] < reach).all(axis=1)
    return sides[is_slit], np.sort(np.argsort(distance)[:N_REMOVED])


def conservation_rows(start: Amounts, slit: Amounts, share: Amounts, end: Amounts) -> list[tuple[str, ...]]:
    """Return a line per amount: a cut changes none of it, a removal takes exactly the share of what is removed."""
    rows: list[tuple[str, ...]] = []
    for name in Amounts._fields:
        before, after, taken, rest = (np.asarray(getattr(item, name)) for item in (start, slit, share, end))
        # Momenta may cancel, so errors are told relative to what moves: mass times the speed of the kinetic energy.
        scale = np.sqrt(2.0 * start.mass * start.kinetic_energy) if name == "momentum" else np.abs(before)
        errors = [float(np.linalg.norm(error) / scale) for error in (after - before, after - rest - taken)]
        values = [float(np.linalg.norm(value)) for value in (before, after, taken)]
        rows.append(
            (
                f"{name.replace('_', ' ')} [{UNITS[name]}]",
                f"{values[0]:.6g}",
                f"{values[1]:.6g}",
                f"{errors[0]:.1e}",
                f"{values[2]:.6g}",
                f"{errors[1]:.1e}",
            )
        )
    return rows


def _tell(console: Console, what: str, report: gs.CutReport) -> None:
    """Print what an operation changed."""
    console.print(
        f"{what}: {len(report.new_nodes)} new nodes, {len(report.new_springs)} new springs, "
        f"{len(report.boundary_faces)} faces laid open, {report.n_removed_nodes} nodes and "
        f"{report.n_removed_springs} springs gone, {len(report.new_components)} pieces off.",
        highlight=False,
        soft_wrap=True,
    )


def _write(folder: pathlib.Path, body: Body, tumour: Array) -> None:
    """Write the body as it is now, as a mesh and as a picture."""
    alive = body.is_alive
    write_vtu(
        folder / "liver.vtu",
        body.nodes.position,
        body.vertex_of[alive],
        {"velocity": body.nodes.velocity, "mass": body.nodes.mass, "pinned": body.nodes.is_pinned},
        {"strain": measure.tetrahedron_strains(body)[alive], "tumour": tumour[alive]},
    )
    camera = Camera.fit(body.nodes.position, azimuth=-120.0, aspect=SIZE[0] / SIZE[1])
    Image.fromarray(render_body(body, highlight=tumour, camera=camera, size=SIZE)).save(folder / "liver.png")
