"""What random cuts leave behind: the time per spring of a step, against the freshly built body."""

from collections.abc import Iterator

import numpy as np

from gmapspring import Simulation
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
TOLERATED = {"float64": 1e-9, "float32": 1e-2}
MEANS = f"positions after {N_CHECKED} steps against an indexed model of the cut body, relative to the largest displacement"


def measure_after_cuts(plan: Plan) -> Iterator[Row]:
    """Yield the ratio for two sizes and both precisions."""
    for size in ("liver",) if plan.is_quick else ("liver", "20k"):
        for dtype in (np.float32, np.float64):
            yield measure_one(plan, make_case(size), size, dtype)


def measure_one(plan: Plan, case: Case, size: str, dtype: type) -> Row:
    """Return the row of one body."""
    cut = case.simulate(dtype)
    cut_at_random(cut)
    steppers = {"fresh": ours(case, dtype), "cut": ours(case, simulation=cut)}
    steppers["cut"] = steppers["cut"]._replace(positions=lambda: cut.body.nodes.position)
    model = index_body(cut, case)
    expected = positions_after(with_step(plain_indexed(model), case.step), N_CHECKED)
    error = difference(positions_after(steppers["cut"], N_CHECKED), expected, model.position)
    steppers["fresh"].advance(1)
    n_fresh, n_cut = case.simulate(dtype).body.n_springs, cut.body.n_springs
    samples = interleave({name: calibrated(stepper) for name, stepper in steppers.items()}, plan.rounds)
    value, scale, kind = ratio(samples["cut"], samples["fresh"]), n_fresh / n_cut, np.dtype(dtype).name
    note = f"{n_fresh} springs before, {n_cut} after; {cut.body.n_nodes} nodes after"
    return Row(
        f"time per spring after random cuts / freshly built, {size}, {kind}", scale * value.value, "", scale * value.low,
        scale * value.high, LIMITS[kind], error, TOLERATED[kind], MEANS, note=note,
    )  # fmt: skip


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
