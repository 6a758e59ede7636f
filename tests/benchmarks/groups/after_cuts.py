"""What random cuts leave behind: the time per spring of a step, against the freshly built body; as it is, and renumbered."""

import time
from collections.abc import Iterator

import numpy as np

from gmapspring import Simulation
from gmapspring.body import Body
from tests.benchmarks.bodies import Case, IndexedModel, make_case, ours
from tests.benchmarks.groups.cuts import interior_faces
from tests.benchmarks.indexed import plain_indexed, with_step
from tests.benchmarks.rows import Plan, Row, at_most
from tests.benchmarks.timing import calibrated, difference, interleave, positions_after, ratio

SPLIT_SHARE, REMOVED_SHARE = 0.3, 0.1
"""Parts of the interior faces and of the tetrahedra that are cut."""
N_CHECKED = 20
"""Steps after which positions are compared; little pieces that came off spin, and the more steps the more round-off grows."""
LIMITS = {"float32": at_most(1.1), "float64": at_most(1.2)}
LIMITED = ("liver", "20k")
"""Sizes for which there are limits, and no renumbering is done for them."""
TOLERATED = {"float64": 1e-9, "float32": 1e-2}
MEANS = f"positions after {N_CHECKED} steps against an indexed model of the cut body, relative to the largest displacement"


def measure_after_cuts(plan: Plan) -> Iterator[Row]:
    """Yield the ratios for several sizes and both precisions; only two sizes have limits."""
    for size in ("liver",) if plan.is_quick else ("liver", "20k", "200k"):
        for dtype in (np.float32, np.float64):
            yield from measure_one(plan, make_case(size), size, dtype)


def measure_one(plan: Plan, case: Case, size: str, dtype: type) -> Iterator[Row]:
    """Yield the rows of one body."""
    cut, renumbered = case.simulate(dtype), case.simulate(dtype)
    for each in (cut, renumbered):
        cut_at_random(each)
    started = time.perf_counter()
    renumbered.renumber()
    taken = time.perf_counter() - started
    steppers = {"fresh": ours(case, dtype)}
    errors = {}
    expected, origin = expected_positions(cut, case)
    for name, simulation in (("cut", cut), ("renumbered", renumbered)):
        steppers[name] = ours(case, simulation=simulation)._replace(positions=lambda body=simulation.body: at_corners(body))
        errors[name] = difference(positions_after(steppers[name], N_CHECKED), expected, origin)
    steppers["fresh"].advance(1)
    n_fresh, n_cut = case.simulate(dtype).body.n_springs, cut.body.n_springs
    samples = interleave({name: calibrated(stepper) for name, stepper in steppers.items()}, plan.rounds)
    kind = np.dtype(dtype).name
    notes = {"cut": f"{n_fresh} springs before, {n_cut} after; {cut.body.n_nodes} nodes after",
             "renumbered": f"renumbering took {1e3 * taken:.2g} ms"}
    for name, note in notes.items():
        value, scale = ratio(samples[name], samples["fresh"]), n_fresh / n_cut
        what = "after random cuts" if name == "cut" else "after random cuts, renumbered"
        yield Row(
            f"time per spring {what} / freshly built, {size}, {kind}",
            scale * value.value, "", scale * value.low, scale * value.high,
            LIMITS[kind] if name == "cut" and size in LIMITED else None, errors[name], TOLERATED[kind], MEANS, note=note,
        )  # fmt: skip


def expected_positions(cut: Simulation, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners' positions after N_CHECKED steps by an indexed model of the cut body, and before."""
    model = index_body(cut, case)
    corners = cut.body.gmap.vertex_of[cut.body.is_alive].ravel()
    return positions_after(with_step(plain_indexed(model), case.step), N_CHECKED)[corners], model.position[corners]


def at_corners(body: Body) -> np.ndarray:
    """Return the position of each corner of each live tetrahedron, which no renumbering changes, (n, 3)."""
    return body.nodes.position[body.gmap.vertex_of[body.is_alive].ravel()]


def cut_at_random(simulation: Simulation) -> None:
    """Split some faces and remove some tetrahedra, chosen at random."""
    rng = np.random.default_rng(0)
    n = simulation.body.mesh.n_tetrahedra
    faces = interior_faces(simulation)
    # In portions, as an episode would cut: a body that is cut in one go could be laid out in one go.
    for part in np.array_split(faces[rng.random(len(faces)) < SPLIT_SHARE], 20):
        simulation.cut(faces=part)
    for part in np.array_split(np.flatnonzero(rng.random(n) < REMOVED_SHARE), 20):
        simulation.cut(tetrahedra=part)


def index_body(simulation: Simulation, case: Case) -> IndexedModel:
    """Return the body as it is now as an indexed model in float64."""
    nodes, springs, n = simulation.body.nodes, simulation.body.springs, simulation.body.n_nodes
    # Rows that only pad the arrays join nodes beyond the last one.
    is_spring = (springs.endpoints < n).all(axis=1)
    stiffness, rest_length, damping = (
        np.asarray(values[is_spring], np.float64) for values in (springs.stiffness, springs.rest_length, springs.damping)
    )
    return IndexedModel(
        position=np.array(nodes.position, dtype=np.float64),
        endpoints=springs.endpoints[is_spring].astype(np.uint32),
        stiffness=stiffness,
        rest_length=rest_length,
        damping=damping,
        inverse_mass=np.where(nodes.is_pinned, 0.0, 1.0 / nodes.mass),
        gravity=np.where(nodes.is_pinned[:, None], 0.0, case.gravity),
        drag=float(case.material.viscosity),
    )
