"""A machine that cuts, sews, saves and steps at random: the body stays valid and equal to its naive double."""

import itertools
import pathlib
import pickle
import tempfile

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

import gmapspring as gs
from tests import naive_links, zoo
from tests.bits import assert_same_bits, bits_of
from tests.twins import Twins

MESHES = ("single", "two", "ring", "fan", "star", "slab", "torus", "cubes_sharing_an_edge", "pinched_block")
PICKS = st.integers(0, 10**6)
"""Numbers that pick an item of a list whose length is known only when the rule runs."""


def pick(items, number):
    """Return the item that a number picks."""
    return items[number % len(items)]


class RandomCuts(RuleBasedStateMachine):
    """Every rule does the same to the fast and to the naive body; the invariant compares them."""

    @initialize(name=st.sampled_from(MESHES), seed=st.integers(0, 99), integrator=st.sampled_from(["rk4", "symplectic_euler"]))
    def build(self, name, seed, integrator):
        self.twins = Twins(zoo.build(name), seed, integrator=integrator)
        self.saved = None

    @precondition(lambda self: self.twins.naive.sewn_faces())
    @rule(number=PICKS)
    def split(self, number):
        self.twins.split_face(*pick(self.twins.naive.sewn_faces(), number))

    @precondition(lambda self: len(self.twins.naive.alive) > 1)
    @rule(number=PICKS)
    def remove(self, number):
        self.twins.remove_tetrahedron(pick(sorted(self.twins.naive.alive), number))

    @precondition(lambda self: self.twins.naive.open_faces())
    @rule(number=PICKS, is_turned=st.booleans())
    def sew(self, number, is_turned):
        pair = pick(self.twins.naive.open_faces(), number)
        self.twins.sew_face(*(pair[::-1] if is_turned else pair))

    @precondition(lambda self: self.twins.naive.sewn_faces())
    @rule(faces=st.lists(PICKS, max_size=6), tetrahedra=st.lists(PICKS, max_size=3))
    def cut_a_batch(self, faces, tetrahedra):
        sewn, alive = self.twins.naive.sewn_faces(), sorted(self.twins.naive.alive)
        removed = {pick(alive, number) for number in tetrahedra}
        self.twins.cut(sorted({pick(sewn, number) for number in faces}), sorted(removed)[: len(alive) - 1])

    @rule()
    def save(self):
        self.saved = self.twins.sim.save_state(), self.twins.naive.snapshot(), bits_of(self.twins.sim)

    @precondition(lambda self: self.saved is not None)
    @rule()
    def load(self):
        state, snapshot, bits = self.saved
        self.twins.sim.load_state(state)
        self.twins.naive.restore(snapshot)
        assert_same_bits(bits_of(self.twins.sim), bits)

    @rule(seed=st.integers(0, 99))
    def set_loads(self, seed):
        self.twins.set_loads(np.random.default_rng(seed))

    @rule()
    def pickle_and_unpickle(self):
        bits = bits_of(self.twins.sim)
        self.twins.sim = pickle.loads(pickle.dumps(self.twins.sim))
        assert_same_bits(bits_of(self.twins.sim), bits)

    @rule()
    def write_and_read_a_file(self):
        bits = bits_of(self.twins.sim)
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "state.npz"
            self.twins.sim.save(path)
            self.twins.sim = gs.Simulation.load(path)
        assert_same_bits(bits_of(self.twins.sim), bits)

    @rule(n_steps=st.integers(1, 3))
    def advance(self, n_steps):
        self.twins.advance(n_steps)

    @precondition(lambda self: self.twins.naive.open_faces())
    @rule(number=PICKS)
    def refuse_to_split_twice(self, number):
        before = bits_of(self.twins.sim)
        with pytest.raises(gs.TopologyError):
            self.twins.sim.split_face(*pick(self.twins.naive.open_faces(), number))
        assert_same_bits(bits_of(self.twins.sim), before)

    @precondition(lambda self: self.twins.naive.sewn_faces())
    @rule(number=PICKS)
    def refuse_to_sew_what_is_sewn(self, number):
        before = bits_of(self.twins.sim)
        with pytest.raises(gs.TopologyError):
            self.twins.sim.sew_face(*pick(self.twins.naive.sewn_faces(), number))
        assert_same_bits(bits_of(self.twins.sim), before)

    @invariant()
    def both_bodies_agree(self):
        if hasattr(self, "twins"):  # false before build has run
            self.twins.assert_agreement()


TestRandomCuts = RandomCuts.TestCase
TestRandomCuts.settings = settings(max_examples=25, stateful_step_count=12, deadline=None)


@pytest.mark.parametrize(("name", "seed"), [("box", 0), ("slab", 1), ("star", 2)])
def test_a_body_that_keeps_manifold_refuses_just_what_would_pinch_it(name, seed):
    twins, rng = Twins(zoo.build(name), seed, keep_manifold=True), np.random.default_rng(seed)
    refused = {"split_face": [], "remove_tetrahedron": [], "sew_face": []}
    for _ in range(60):
        operation, arguments = random_call(twins.naive, rng)
        before = twins.naive.snapshot()
        getattr(twins.naive, operation)(*arguments)
        would_pinch = bool(naive_links.singular_nodes(twins.naive))
        try:
            getattr(twins.sim, operation)(*arguments)
            was_refused = False
        except gs.TopologyError:
            was_refused = True
            twins.naive.restore(before)
        assert was_refused == would_pinch
        refused[operation].append(was_refused)
    twins.assert_agreement()
    assert all(not all(answers) for answers in refused.values())
    assert any(any(answers) for answers in refused.values())


@pytest.mark.parametrize(("name", "seed"), [("box", 0), ("slab", 1), ("star", 2)])
def test_cuts_at_once_are_refused_just_where_they_pinch_in_the_end(name, seed):
    rng, answers = np.random.default_rng(seed), {False: 0, True: 0}
    for _ in range(40):
        twins = Twins(zoo.build(name), seed, keep_manifold=True)
        for _ in range(2):
            faces = [pick(twins.naive.sewn_faces(), int(rng.integers(10**6))) for _ in range(rng.integers(2, 12))]
            removed = rng.choice(sorted(twins.naive.alive), rng.integers(0, 3), replace=False).tolist()
            state, before = twins.naive.snapshot(), bits_of(twins.sim)
            twins.naive.cut(faces, removed)
            would_pinch = bool(naive_links.singular_nodes(twins.naive))
            answers[would_pinch] += 1
            if would_pinch:
                with pytest.raises(gs.TopologyError, match="would pinch the body at node"):
                    twins.sim.cut(faces, removed)
                twins.naive.restore(state)
                assert_same_bits(bits_of(twins.sim), before)
            else:
                twins.sim.cut(faces, removed)
        twins.assert_agreement()
    assert min(answers.values()) > 5


def test_cuts_at_once_may_pinch_on_the_way():
    twins = Twins(zoo.build("slab"), keep_manifold=True)
    tets = sorted(twins.naive.alive)
    # One by one, in ascending order, some would be refused; but what is left of the slab is one of its cubes.
    with pytest.raises(gs.TopologyError, match="pinch"):
        for tet in tets[6:]:
            twins.sim.remove_tetrahedron(tet)
    twins = Twins(zoo.build("slab"), keep_manifold=True)
    twins.sim.cut(tetrahedra=tets[6:])
    assert twins.sim.body.is_alive.sum() == 6 and not len(gs.topology.gmap.singular_vertices(twins.sim.body.gmap))


def test_what_is_pinched_already_may_be_cut_but_not_pinched_again():
    sim = gs.Simulation(gs.meshes.box((4, 4, 4)), gs.Material(5e3, 1e3))
    node = 31
    vertex_of = sim.body.vertex_of
    star = {tet: set(vertex_of[tet].tolist()) - {node} for tet in np.flatnonzero((vertex_of == node).any(axis=1))}
    # With two tetrahedra gone that share the node alone, its link is a ring. Faces all around one of the holes part it into two.
    one, other = next((a, b) for a, b in itertools.combinations(star, 2) if not star[a] & star[b] and parting(sim, star, a, b))
    sim.cut(tetrahedra=[one, other])
    assert gs.topology.gmap.singular_vertices(sim.body.gmap).tolist() == [node]
    sim.keep_manifold = True
    ring = parting(sim, star, one, other)
    before = bits_of(sim)
    with pytest.raises(gs.TopologyError, match=f"pinch the body at node {node}"):
        sim.cut(faces=ring)
    assert_same_bits(bits_of(sim), before)
    # With a way from hole to hole cut open as well, nothing of the ring is left.
    way = [(a, int(b)) for a in star for b in sim.body.gmap.image[a] // 24 if a < b and b in star]
    sim.cut(faces=way)
    assert not len(gs.topology.gmap.singular_vertices(sim.body.gmap))


def parting(sim, star, one, other):
    """List the faces that part those of a star that touch one of its tetrahedra from the rest; none where another is near."""
    near = {tet for tet in star if star[tet] & star[one]}
    if any(star[tet] & star[other] for tet in near):
        return []
    across = {tet: [int(beyond) for beyond in sim.body.gmap.image[tet] // 24 if beyond != tet] for tet in near}
    faces = [(tet, beyond) for tet in near for beyond in across[tet] if beyond in star and beyond not in near]
    touched = set().union(*(star[tet] & star[beyond] for tet, beyond in faces))
    return [] if touched & star[one] or touched & star[other] else faces


def random_call(naive, rng):
    """Draw an operation that can be done to a body, and its arguments."""
    choices = {"split_face": naive.sewn_faces(), "sew_face": naive.open_faces()}
    if len(naive.alive) > 12:
        choices["remove_tetrahedron"] = [(tet,) for tet in sorted(naive.alive)]
    operation = rng.choice(sorted(name for name, calls in choices.items() if calls))
    return str(operation), pick(choices[operation], int(rng.integers(10**6)))


def test_a_body_that_keeps_manifold_refuses_a_suture_that_would_pinch_it():
    twins = Twins(zoo.build("slab"), keep_manifold=True)
    twins.split_face(3, 10)
    twins.split_face(2, 7)
    before = bits_of(twins.sim)
    with pytest.raises(gs.TopologyError, match="pinch"):
        twins.sim.sew_face(3, 10)
    assert_same_bits(bits_of(twins.sim), before)
