"""The candidate network: one small set of weights shared by all tetrahedra and all legal cuts, blind to numbers and turns.

    tetrahedron -> embedding -> rounds of messages between tetrahedra that are sewn to each other -> what is known of it
    mean, maximum and weighted means over the tetrahedra, with the globals -> context -> value of the state
    legal cut + what is known of its two sides + context + how far it lies from where the weights are -> logit of the cut

To renumber tetrahedra or faces permutes the logits and nothing else, to turn or mirror the whole scene changes nothing at
all, and a mesh may have any size.
"""

from collections.abc import Collection, Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from agents.features import N_OWN, N_SIDE, OWN_FEATURES, SIDE_FEATURES
from agents.layers import Company, Graph, Meeting, exchange, meet, score
from agents.segments import Segments, highest, log_softmax, total
from agents.training_config import NetworkSettings
from envs.observation import COLUMNS

TURNED = ("offset x", "offset y", "offset z", "load_direction_x", "load_direction_y", "load_direction_z")
"""What changes when all of the scene is turned: of it, only distances are taken."""
OFFSET, SIDE_OFFSET = OWN_FEATURES.index("offset x"), SIDE_FEATURES.index("offset x")
"""Where a cut and a tetrahedron say where they lie."""
SAID = 8
"""Numbers of each tetrahedron that go into a weighted mean, beside where it lies."""
WHOLE = 16
"""Products of so many columns are fast: the library takes twice as long for 9 as for 16."""
STRAINED = ("highest healthy strain", "strain", "volume ratio", "healthy_strain", "target_strain", "lowest_volume_ratio")
"""What tells how strained the body is, among the features and the globals."""


class Seen(NamedTuple):
    """A batch of states as the network takes it."""

    features: Tensor
    """Of the candidates, shape (n_candidates, N_OWN)."""
    sides: Tensor
    """The two tetrahedra of each candidate, int64, shape (2, n_candidates)."""
    tetrahedra: Tensor
    """What they show, shape (n_tetrahedra, N_SIDE)."""
    of_state: Tensor
    """Globals of the states, shape (n_states, n_globals)."""


class Owners(NamedTuple):
    """What belongs to which state."""

    candidates: Segments
    tetrahedra: Segments


class CandidateNetwork(nn.Module):
    """Score every candidate, and value the state they belong to."""

    def __init__(self, settings: NetworkSettings) -> None:
        """Make the layers."""
        super().__init__()
        hidden, heads, n_globals = settings.hidden, settings.heads, len(COLUMNS["globals"])
        self.embedding = nn.Linear(N_SIDE, hidden)
        self.own = nn.ModuleList(nn.Linear(hidden, hidden) for _ in range(settings.rounds))
        self.sent = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(settings.rounds))
        self.weight, self.said = nn.Linear(hidden, heads), nn.Linear(hidden, SAID)
        self.context = nn.Sequential(nn.Linear(2 * hidden + heads * SAID + n_globals, hidden), nn.ReLU())
        self.of_candidate = nn.Linear(N_OWN, hidden)
        self.of_sides = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(2))
        self.from_context = nn.Linear(hidden, hidden, bias=False)
        self.from_distance = nn.Linear(heads, hidden, bias=False)
        self.encoder = nn.Linear(hidden, hidden)
        self.logit = nn.Linear(hidden, 1)
        self.value_encoder = nn.Sequential(nn.Linear(hidden, hidden), nn.ReLU())
        self.value = nn.Linear(hidden, 1)
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.orthogonal_(layer.weight, 1.0)
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)
        with torch.no_grad():
            # All actions start about equally likely, and all values near zero.
            self.logit.weight.mul_(0.01)
            self.value.weight.mul_(0.1)
        hidden_names = {*TURNED, *(STRAINED if settings.is_blind_to_strain else ())}
        of_state = [column.name for column in COLUMNS["globals"]]
        self._sees = [_without(hidden_names, names) for names in (OWN_FEATURES, SIDE_FEATURES, of_state)]

    def forward(self, seen: Seen, graph: Graph, of: Owners) -> tuple[Tensor, Tensor]:
        """Return the log-probabilities of all candidates, (n_candidates,), and the values of the states, (n_states,).

        Args:
            seen: the states.
            graph: which tetrahedra are sewn to each other.
            of: what belongs to which state.
        """
        sees_candidate, _, sees_state = self._sees
        known = self._known(seen.tetrahedra, graph)
        offset = seen.tetrahedra[:, SIDE_OFFSET : SIDE_OFFSET + 3]
        context, centres = self._context(known, offset, seen.of_state * sees_state, of.tetrahedra)
        own = linear(seen.features, self.of_candidate.weight * sees_candidate)
        # What is added to all candidates of a state is added to the state: there are fewer of them.
        state = self.from_context(context) + self.of_candidate.bias
        company = Company(state, _together(known, self.of_sides), centres, self.from_distance.weight.t().contiguous())
        own = meet(own, company, Meeting(of.candidates, seen.sides, seen.features[:, OFFSET : OFFSET + 3]))
        logit = score(linear(own, self.encoder.weight), self.encoder.bias, self.logit.weight[0]) + self.logit.bias
        return log_softmax(logit, of.candidates), self.value(self.value_encoder(context)).flatten()

    def _known(self, tetrahedra: Tensor, graph: Graph) -> Tensor:
        """Return what is known of each tetrahedron after all messages, (n_tetrahedra, hidden)."""
        # What is hidden is left out by the weights: to clear it in what is seen would take longer.
        known = linear(tetrahedra, self.embedding.weight * self._sees[1], self.embedding.bias).relu_()
        for own, sent in zip(self.own, self.sent, strict=True):
            bias: Any = own.bias
            known = exchange(known, _together(known, (own, sent)), bias, graph)
        return known

    def _context(self, known: Tensor, offset: Tensor, of_state: Tensor, of: Segments) -> tuple[Tensor, Tensor]:
        """Return what is known of each state, (n_states, hidden), and where its weighted means lie, (n_states, heads * 3)."""
        mean, maximum = total(known, of) / of.length[:, None], known.gather(0, highest(known, of))
        n_heads = self.weight.out_features
        filling = known.new_zeros(-(n_heads + SAID) % WHOLE, known.shape[1])
        both = linear(known, torch.cat([self.weight.weight, self.said.weight, filling]))
        weight, said, _ = both.split([n_heads, SAID, len(filling)], 1)
        weight = log_softmax(weight + self.weight.bias, of).exp()
        said = torch.cat([said + self.said.bias, offset], 1)
        heard = total((weight[:, :, None] * said[:, None]).flatten(1), of).unflatten(1, (weight.shape[1], -1))
        context = self.context(torch.cat([mean, maximum, heard[:, :, :SAID].flatten(1), of_state], 1))
        return context, heard[:, :, SAID:].flatten(1)


def _together(rows: Tensor, layers: Iterable[Any]) -> Tensor:
    """Return what linear layers make of the same rows, side by side and without their biases: one large product is fast."""
    return linear(rows, torch.cat([layer.weight for layer in layers]))


def _without(hidden: Collection[str], names: Sequence[str]) -> Tensor:
    """Return a factor for each feature: 0 for what is hidden."""
    return torch.tensor([float(name not in hidden) for name in names])
