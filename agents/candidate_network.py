"""The candidate network: one small set of weights shared by all legal cuts, blind to how the mesh is numbered.

    tetrahedra -> embedding -> a few rounds of messages between those that are sewn to each other
    a legal cut and its two sides -> encoder -> mean, maximum and a weighted mean over the cuts, with the globals -> context
    encoded cut + context + how far it lies from the cuts that weigh most -> logit of the cut;  context -> value of the state

To renumber tetrahedra or faces permutes the logits and nothing else, and a mesh may have any size.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from agents.features import N_OWN, N_SIDE, OWN_FEATURES
from agents.segments import Graph, Segments, highest, log_softmax, messages, spread, total

OFFSET = OWN_FEATURES.index("offset x")
"""Where a candidate's features say where it lies."""


SAID = 8
"""Numbers that each cut has in a weighted mean, beside where it lies."""


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


class CandidateNetwork(nn.Module):
    """Score every candidate, and value the state they belong to."""

    def __init__(self, n_globals: int, hidden: int, n_rounds: int, n_heads: int) -> None:
        """Make the layers; hidden: width of all of them, n_rounds: of messages, n_heads: weighted means over the cuts."""
        super().__init__()
        self.embedding = nn.Linear(N_SIDE, hidden)
        self.own = nn.ModuleList(nn.Linear(hidden, hidden) for _ in range(n_rounds))
        self.sent = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(n_rounds))
        self.of_sides = nn.ModuleList(nn.Linear(hidden, hidden, bias=False) for _ in range(2))
        self.of_candidate = nn.Linear(N_OWN, hidden)
        self.encoder = nn.Linear(hidden, hidden)
        self.weight = nn.Linear(hidden, n_heads)
        self.n_heads = n_heads
        self.said = nn.Linear(hidden, SAID)
        self.context = nn.Sequential(nn.Linear(2 * hidden + n_heads * SAID + n_globals, hidden), nn.ReLU())
        self.from_candidate = nn.Linear(hidden, hidden, bias=False)
        self.from_context = nn.Linear(hidden, hidden)
        self.from_distance = nn.Linear(n_heads, hidden, bias=False)
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

    def forward(self, seen: Seen, of: Segments, graph: Graph) -> tuple[Tensor, Tensor]:
        """Return the log-probabilities of all candidates, (n_candidates,), and the values of the states, (n_states,).

        Args:
            seen: the states.
            of: which candidates belong to which state.
            graph: which tetrahedra are sewn to each other.
        """
        encoded = self._encode(seen, graph)
        mean, maximum = total(encoded, of) / of.length[:, None], encoded.gather(0, highest(encoded, of))
        said = torch.cat([self.said(encoded), seen.features[:, OFFSET : OFFSET + 3]], 1)
        weight = log_softmax(self.weight(encoded), of).exp()
        heard = total((weight[:, :, None] * said[:, None]).flatten(1), of).unflatten(1, (self.n_heads, -1))
        context = self.context(torch.cat([mean, maximum, heard[:, :, :-3].flatten(1), seen.of_state], 1))
        away = said[:, None, -3:] - spread(heard[:, :, -3:].flatten(1), of).unflatten(1, (self.n_heads, 3))
        # In place, like the rectifiers of the encoder: new memory costs as much as the sum.
        joined = self.from_candidate(encoded).add_(spread(self.from_context(context), of))
        joined = joined.add_(self.from_distance(away.square().sum(2)))
        return log_softmax(self.logit(joined.relu_()).flatten(), of), self.value(self.value_encoder(context)).flatten()

    def _encode(self, seen: Seen, graph: Graph) -> Tensor:
        """Return what is known of each candidate, (n_candidates, hidden)."""
        known = self.embedding(seen.tetrahedra).relu_()
        for own, sent in zip(self.own, self.sent, strict=True):
            known = known + own(known).add_(messages(sent(known), graph)).relu_()
        encoded = self.of_candidate(seen.features)
        for layer, side in zip(self.of_sides, seen.sides, strict=True):
            encoded = encoded + layer(known).index_select(0, side)
        return self.encoder(encoded.relu_()).relu_()
