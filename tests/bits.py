"""Every array and number of a simulation, to see that nothing at all has changed."""

import numpy as np


def bits_of(sim):
    """Return copies of all arrays of a body that mean something, by name; scratch arrays and dead rows are left out."""
    body = sim.body
    n_nodes, n_springs = body.n_nodes, body.n_springs
    found = {"time": np.float64(sim.time), "n_substeps": np.int64(sim.n_substeps)}
    for name in ("image", "vertex_of", "edge_of", "component_of"):
        found[f"gmap.{name}"] = getattr(body.gmap, name)
    found["gmap.vertex_dart"] = body.gmap.vertex_dart[:n_nodes]
    found["gmap.link"] = body.gmap.link[:n_nodes]
    found["gmap.edge_dart"] = body.gmap.edge_dart[:n_springs]
    found["gmap.counts"] = body.gmap.counts[:4]
    for name, rows in body.node_rows._asdict().items():
        if name != "force":
            found[f"nodes.{name}"] = rows[:n_nodes]
    for name, rows in body.spring_rows._asdict().items():
        if name != "coefficient":
            found[f"springs.{name}"] = rows[:n_springs]
    for name, rows in body.tetrahedra._asdict().items():
        found[f"tetrahedra.{name}"] = rows
    return {name: np.array(rows, copy=True) for name, rows in found.items()}


def assert_same_bits(one, other):
    """Check that two such collections are equal to the last bit."""
    assert one.keys() == other.keys()
    differing = [name for name in one if one[name].tobytes() != other[name].tobytes()]
    assert not differing, f"changed: {', '.join(differing)}"
