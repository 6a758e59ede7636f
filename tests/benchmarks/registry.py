"""All groups of rows. To add one: write its function in groups/ and enter it here; the run and the table take it up."""

from tests.benchmarks.groups.after_cuts import measure_after_cuts
from tests.benchmarks.groups.cuts import measure_cuts
from tests.benchmarks.groups.environment import measure_reset, measure_single, measure_vector
from tests.benchmarks.groups.frames import measure_frames
from tests.benchmarks.groups.kernel import measure_kernel
from tests.benchmarks.groups.map_building import measure_map
from tests.benchmarks.groups.paper import measure_paper
from tests.benchmarks.groups.peers import measure_peers
from tests.benchmarks.groups.scaling import measure_scaling
from tests.benchmarks.groups.start import measure_start
from tests.benchmarks.groups.terms import measure_terms
from tests.benchmarks.groups.training import measure_training
from tests.benchmarks.rows import Group

GROUPS: dict[str, Group] = {
    "kernel": measure_kernel,
    "terms": measure_terms,
    "paper": measure_paper,
    "cuts": measure_cuts,
    "map": measure_map,
    "after-cuts": measure_after_cuts,
    "reset": measure_reset,
    "single": measure_single,
    "vector": measure_vector,
    "training": measure_training,
    "frames": measure_frames,
    "start": measure_start,
    "scaling": measure_scaling,
    # Last, since what other libraries load and set stays in the process.
    "peers": measure_peers,
}
"""Groups by the names that --rows takes, in the order they run."""

TITLES: dict[str, str] = {
    "kernel": "The spring kernel",
    "terms": "Terms cost only where a scene names them",
    "paper": "The paper's table: finding cells by darts",
    "cuts": "Cuts, with masses and stiffness shared anew",
    "map": "Building the map",
    "after-cuts": "A step after random cuts",
    "reset": "Reset",
    "single": "A single environment",
    "vector": "The vector environment",
    "training": "Training",
    "frames": "Frames and pixel observations",
    "start": "Start",
    "scaling": "From two thousand to a million tetrahedra",
    "peers": "Peers",
}
"""Headings of the report."""
