"""Labels of components after cuts of many faces at once: against scipy, and without a walk through the whole body."""

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import gmapspring as gs
from gmapspring.batch import BodyBatch
from gmapspring.cut import cut, sew_face
from gmapspring.topology.gmap import STAMP
from gmapspring.topology.walks import LAST_STAMP

MATERIAL = gs.Material(young_modulus=5e3, density=1e3)


def pieces_of(body):
    """Return scipy's number of the piece of each live tetrahedron: those linked by sewn faces."""
    slots = np.arange(4 * body.mesh.n_tetrahedra)
    beyond = body.gmap.image.reshape(-1) // 6
    links = coo_matrix((np.ones(len(slots)), (slots // 4, beyond // 4)), shape=(body.mesh.n_tetrahedra,) * 2)
    return connected_components(links, directed=False)[1][body.is_alive]


def check_labels(body):
    """Check that two live tetrahedra have one label if and only if they are in one piece."""
    labels, pieces = body.gmap.component_of[body.is_alive], pieces_of(body)
    pairs = np.unique(np.stack([labels, pieces], axis=1), axis=0)
    assert len(pairs) == len(np.unique(labels)) == len(np.unique(pieces))


def sewn_pairs(body):
    """Return the pairs of tetrahedra that a sewn face links, (k, 2)."""
    slots = np.arange(4 * body.mesh.n_tetrahedra)
    beyond = body.gmap.image.reshape(-1) // 6
    return np.stack([slots // 4, beyond // 4], axis=1)[slots < beyond]


@pytest.mark.parametrize("n_faces", [1, 6, 40, 150])
@pytest.mark.parametrize("n_removed", [0, 1, 12])
@pytest.mark.parametrize("is_sewn", [False, True])
def test_labels_are_those_of_scipy_until_all_has_been_cut(n_faces, n_removed, is_sewn):
    body = gs.Simulation(gs.meshes.box((8, 7, 6)), MATERIAL).body
    rng = np.random.default_rng(n_faces + 1000 * n_removed)
    seen = set(np.unique(body.gmap.component_of).tolist())
    n_came_off = 0
    for _ in range(min(3000 // n_faces, 200)):
        pairs = sewn_pairs(body)
        if not len(pairs):
            break
        if n_faces == 1:
            # Round one place, so that single cuts free something.
            pairs = pairs[np.argsort(pairs.sum(axis=1))[:40]]
        chosen = pairs[rng.permutation(len(pairs))[:n_faces]]
        removed = rng.permutation(np.flatnonzero(body.is_alive))[:n_removed]
        if is_sewn:
            # The last stamps there are, or nearly: while pieces are looked for they begin anew.
            body.gmap.mark[:], body.gmap.counts[STAMP] = 0, LAST_STAMP - rng.integers(200 * n_faces)
        report = cut(body, chosen, removed)
        new = set(report.new_components.tolist())
        assert not new & seen and new <= set(body.gmap.component_of.tolist())
        seen |= new
        n_came_off += len(new)
        check_labels(body)
        if is_sewn:
            for one, other in chosen[: n_faces // 4]:
                if body.is_alive[one] and body.is_alive[other]:
                    sew_face(body, one, other)
            check_labels(body)
            seen |= set(body.gmap.component_of.tolist())
    assert n_came_off > 10


def test_what_a_piece_held_together_comes_apart_with_it():
    # The middle is the smallest: it comes off at either plane, and only then the two ends are known to have parted.
    body = gs.Simulation(gs.meshes.box((24, 6, 6)), MATERIAL).body
    x = body.mesh.points[body.mesh.tetrahedra].mean(axis=1)[:, 0]
    pairs = sewn_pairs(body)
    slab = np.digitize(x, [10.0, 14.0])
    report = cut(body, pairs[slab[pairs[:, 0]] != slab[pairs[:, 1]]])
    assert len(report.new_components) == 2
    check_labels(body)


def test_stitches_between_two_halves_hold_until_the_last_one_is_cut():
    # Each stitch is far from all others: to find that they hold together takes a walk round to the last one that is left.
    body = gs.Simulation(gs.meshes.box((12, 12, 12)), MATERIAL).body
    x = body.mesh.points[body.mesh.tetrahedra].mean(axis=1)[:, 0]
    pairs = sewn_pairs(body)
    across = pairs[(x[pairs] > 6.0).sum(axis=1) == 1]
    is_stitch = np.arange(len(across)) % 9 == 0
    cut(body, across[~is_stitch])
    stitches = across[is_stitch]
    assert not len(cut(body, stitches[:-1]).new_components)
    check_labels(body)
    assert len(cut(body, stitches[-1:]).new_components) == 1
    check_labels(body)


def test_a_row_that_was_a_smaller_body_when_its_stamps_began_anew_has_no_old_marks():
    large, small = (gs.Simulation(gs.meshes.box(cells), MATERIAL) for cells in ((8, 7, 6), (1, 1, 1)))
    batch = BodyBatch([large])
    batch.bodies[0].gmap.counts[STAMP] = LAST_STAMP - 5000
    cut(batch.bodies[0], isolating(batch.bodies[0], [3, 500, 900]))
    assert batch.arrays.gmap.mark.max() > LAST_STAMP - 5000
    batch.put(0, small)
    batch.bodies[0].gmap.counts[STAMP] = LAST_STAMP
    cut(batch.bodies[0], sewn_pairs(batch.bodies[0])[:1])
    batch.put(0, large)
    assert batch.arrays.gmap.mark[0].max() <= batch.bodies[0].gmap.counts[STAMP] < 100
    cut(batch.bodies[0], isolating(batch.bodies[0], [3, 500, 900]))
    check_labels(batch.bodies[0])


def isolating(body, tetrahedra):
    """Return the pairs at the faces of some tetrahedra."""
    pairs = sewn_pairs(body)
    return pairs[np.isin(pairs, tetrahedra).any(axis=1)]


@pytest.mark.parametrize("kind", ["freed", "removed", "all but one face"])
def test_cuts_here_and_there_look_at_what_lies_about_them_alone(kind):
    body = gs.Simulation(gs.meshes.box((20, 20, 20)), MATERIAL).body
    rng = np.random.default_rng(0)
    centre = body.mesh.points[body.mesh.tetrahedra].mean(axis=1)
    inside = np.flatnonzero((np.abs(centre - 10.0) < 8.0).all(axis=1))
    some = rng.permutation(inside)[:12]
    pairs = isolating(body, some)
    if kind == "all but one face":
        pairs = pairs[np.sort(np.unique([np.flatnonzero((pairs == one).any(axis=1))[1:] for one in some]))]
    before = body.gmap.counts[STAMP]
    if kind == "removed":
        cut(body, (), some)
    else:
        cut(body, pairs)
    n_seen = np.count_nonzero(body.gmap.mark > before)
    check_labels(body)
    assert len(np.unique(body.gmap.component_of[body.is_alive])) == (13 if kind == "freed" else 1)
    # Those about its corners alone are some seventy.
    assert n_seen < 12 * 75 < body.mesh.n_tetrahedra / 50
