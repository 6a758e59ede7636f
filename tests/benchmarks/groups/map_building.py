"""Building the map, and the memory it takes."""

from collections.abc import Iterator

import numpy as np

from gmapspring.topology.build import build_gmap
from gmapspring.topology.gmap import N_EDGES, N_VERTICES, GMap
from tests.benchmarks.bodies import EDGES, mesh_of
from tests.benchmarks.rows import Plan, Row, at_most
from tests.benchmarks.timing import interleave, timed


def measure_map(plan: Plan) -> Iterator[Row]:
    """Yield building time and memory per tetrahedron."""
    sizes = ("2k", "20k") if plan.is_quick else ("2k", "20k", "200k")
    meshes = {size: mesh_of(size) for size in sizes}
    maps = {size: build_gmap(mesh.tetrahedra, mesh.n_points) for size, mesh in meshes.items()}

    def timer(size: str):
        mesh = meshes[size]
        return lambda: timed(build_gmap, mesh.tetrahedra, mesh.n_points) / mesh.n_tetrahedra

    samples = interleave({size: timer(size) for size in sizes}, 7 if plan.is_quick else 15)
    for size, sample in samples.items():
        yield Row(
            f"building the map, {size}, per tetrahedron", 1e6 * sample.low, "µs", 1e6 * sample.median, 1e6 * sample.high,
            at_most(1.0), float(edges_missing(size, maps[size])), 0.0, "edges too many or too few",
            "CGAL bare 1.6 µs, with attributes 10 µs",
        )  # fmt: skip
    for size, gmap in maps.items():
        yield Row(f"memory of the map, {size}, per tetrahedron", live_bytes(gmap) / len(gmap.image), "B",
                  asked=at_most(80.0), reference="MOKA 3,154 B; CGAL 1,847 B")  # fmt: skip


def edges_missing(size: str, gmap: GMap) -> int:
    """Return by how many the edges of the map differ from the distinct pairs of points that the tetrahedra join."""
    mesh = mesh_of(size)
    ends = np.sort(mesh.tetrahedra[:, EDGES].reshape(-1, 2).astype(np.int64), axis=1)
    return abs(int(gmap.counts[N_EDGES]) - len(np.unique(ends[:, 0] * mesh.n_points + ends[:, 1])))


def live_bytes(gmap: GMap) -> int:
    """Return the bytes of the map's live rows; tables of vertices and edges have spare rows, which take no memory until used."""
    live = {"vertex_dart": gmap.counts[N_VERTICES], "link": gmap.counts[N_VERTICES], "edge_dart": gmap.counts[N_EDGES]}
    return sum(array[: live.get(name)].nbytes for name, array in gmap._asdict().items() if name != "counts")
