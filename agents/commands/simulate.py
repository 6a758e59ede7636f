"""`gmapspring simulate`: let a body move, cut it on the way, and write what happens as a ParaView series."""

import argparse
import csv
import io
import pathlib
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

import gmapspring as gs
from agents.commands.bodies import add_material, add_mesh, material_of, mesh_of
from agents.commands.command import Command, add_json, number, positive, print_json, say
from agents.progress import ProgressReport
from gmapspring import measure
from gmapspring.config import known_name
from gmapspring.integrators import INTEGRATORS
from gmapspring.mesh_files.series import Series
from gmapspring.paths import write_atomically
from gmapspring.selecting import select_points, select_tetrahedra

TIMED = re.compile(r"(.+)@([\d.eE+-]+)")
"""A part of the mesh, and when it is cut [s]."""
PAIR = re.compile(r"(\d+)-(\d+)")
"""The face between two tetrahedra."""

Array = np.ndarray[Any, Any]


class Event(NamedTuple):
    """A cut at a time."""

    time: float
    """[s]"""
    what: str
    """As it was asked for."""
    cut: Callable[[gs.Simulation], gs.CutReport]
    """Carry it out."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_mesh(parser)
    part = "a cell region, a half space such as z<0.02 [m], or tetrahedra such as 3,8"
    parser.add_argument("--cut", action="append", default=[], metavar="PART[@SECONDS]",
                        help=f"cut along the border of a part: {part}; or a face, as 3-8, between two tetrahedra")  # fmt: skip
    parser.add_argument("--remove", action="append", default=[], metavar="PART[@SECONDS]", help="take a part out")
    parser.add_argument("--pin", metavar="PART", help="hold points: a point region, a half space, or numbers [anchor, if any]")
    parser.add_argument("--gravity", nargs=3, type=float, default=(0.0, 0.0, -9.81), metavar=("X", "Y", "Z"),
                        help="[0 0 -9.81 m/s^2]")  # fmt: skip
    add_material(parser)
    parser.add_argument("--integrator", help=f"{', '.join(sorted(INTEGRATORS))} [rk4]")
    parser.add_argument("--seconds", type=number, default=1.0, help="time to simulate [1]")
    parser.add_argument("--frames", type=positive, default=30, help="frames of the series, evenly spaced, the first aside [30]")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/simulation/run.vtu"),
                        help="name of the series [runs/simulation/run.vtu]")  # fmt: skip
    add_json(parser)


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Simulate; write frames, their list and a table of energies."""
    mesh = mesh_of(parsed)
    simulation, events = _simulation(parsed, mesh), _events(parsed, mesh)
    series, rows = Series(parsed.out), []
    times = np.linspace(0.0, parsed.seconds, parsed.frames + 1).tolist()
    with ProgressReport(say(parsed), f"simulating {parsed.mesh}") as report:
        for time in times:
            for event in [event for event in events if event.time <= time]:
                events.remove(event)
                _advance_to(simulation, event.time)
                _tell(report, event, event.cut(simulation))
            _advance_to(simulation, time)
            series.add(simulation.body, time)
            rows.append(_measured(simulation, time))
            _write_rows(series.list_path.with_suffix(".csv"), rows)
            report.update(time / parsed.seconds if parsed.seconds else 1.0, f"{time:.3g} of {parsed.seconds:g} s")
    if parsed.json:
        print_json({"series": str(series.list_path)} | rows[-1])
        return 0
    last = ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in rows[-1].items())
    places = f"open {series.list_path} in ParaView; numbers: {series.list_path.with_suffix('.csv')}"
    console.print(f"in the end: {last}\n{places}", highlight=False, soft_wrap=True)
    return 0


def _simulation(parsed: argparse.Namespace, mesh: gs.Mesh) -> gs.Simulation:
    """Return the body at rest, as asked for."""
    if parsed.integrator is not None:
        known_name("integrator", parsed.integrator, INTEGRATORS)
    pin = parsed.pin or ("anchor" if "anchor" in mesh.point_regions else None)
    pinned = None if pin is None else select_points(mesh, pin)
    return gs.Simulation(mesh, material_of(parsed), pinned=pinned, gravity=parsed.gravity, integrator=parsed.integrator)


def _events(parsed: argparse.Namespace, mesh: gs.Mesh) -> list[Event]:
    """Return the cuts in their order; those of one time in the order of the command line, cuts before removals."""
    found = [_event(text, "cut", mesh) for text in parsed.cut] + [_event(text, "remove", mesh) for text in parsed.remove]
    late = next((event for event in found if event.time > parsed.seconds), None)
    if late:
        raise gs.ConfigError(f"{late.what} is at {late.time:g} s, but --seconds is {parsed.seconds:g}; give a later end")
    return sorted(found, key=lambda event: event.time)


def _event(text: str, kind: str, mesh: gs.Mesh) -> Event:
    """Return the cut that an argument asks for."""
    timed = TIMED.fullmatch(text)
    part, what = timed[1] if timed else text, f"--{kind} {text}"
    try:
        time = number(timed[2]) if timed else 0.0
    except argparse.ArgumentTypeError as error:
        raise gs.ConfigError(f"{what}: {error}") from None
    if kind == "cut" and (pair := PAIR.fullmatch(part)):
        one, other = int(pair[1]), int(pair[2])
        return Event(time, what, lambda simulation: simulation.split_face(one, other))
    mask = select_tetrahedra(mesh, part)
    if kind == "cut":
        return Event(time, what, lambda simulation: simulation.cut(faces=_faces_around(simulation.body, mask)))
    return Event(time, what, lambda simulation: simulation.cut(tetrahedra=np.flatnonzero(mask & simulation.body.is_alive)))


def _faces_around(body: gs.Body, mask: Array) -> list[tuple[int, int]]:
    """Return the sewn faces between some tetrahedra and all others."""
    beyond = body.gmap.image // 24
    return [(int(one), int(other)) for one in np.flatnonzero(mask & body.is_alive) for other in beyond[one] if not mask[other]]


def _advance_to(simulation: gs.Simulation, time: float) -> None:
    """Let time pass until then [s]."""
    simulation.advance(max(0.0, time - simulation.time))


def _tell(report: ProgressReport, event: Event, done: gs.CutReport) -> None:
    """Say what a cut changed."""
    changes = f"{len(done.new_nodes)} new nodes, {len(done.new_springs)} new springs, {len(done.new_components)} pieces off"
    report.note(f"{event.time:.3g} s  {event.what}: {changes}")


def _measured(simulation: gs.Simulation, time: float) -> dict[str, float]:
    """Return what is measured at a frame: time [s], energies [J], momentum [kg m/s], largest strain, counts."""
    body = simulation.body
    strains = measure.edge_strains(body)
    return {
        "time": time,
        "kinetic_energy": measure.kinetic_energy(body),
        "elastic_energy": measure.elastic_energy(body),
        "gravitational_energy": measure.gravitational_energy(body),
        "momentum": float(np.linalg.norm(measure.momentum(body))),
        "largest_strain": float(strains.max(initial=0.0)),
        "n_nodes": body.n_nodes,
        "n_springs": body.n_springs,
        "n_tetrahedra": body.n_tetrahedra,
        "n_pieces": int(simulation.components().max(initial=-1)) + 1,
    }


def _write_rows(path: pathlib.Path, rows: list[dict[str, float]]) -> None:
    """Write what was measured so far."""
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(path, stream.getvalue().encode())


COMMAND = Command(
    "let a body move, cut it on the way, and write a series for ParaView",
    "simulate liver --cut tumour@0.2 --seconds 0.5 --out runs/simulation/liver.vtu\n"
    "simulate body.msh --pin 'z<0.01' --cut 12-57@0.1 --remove 'x>0.2@0.3' --gravity -1 0 -9.81",
    add_arguments,
    run,
)
