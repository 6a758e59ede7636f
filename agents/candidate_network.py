"""The candidate network: one small set of weights shared by all legal cuts, blind to how the mesh is numbered.

    features of each legal cut -> encoder -> mean and maximum over the cuts, with the globals -> context
    encoded cut + context -> logit of the cut;  context -> value of the state

To renumber tetrahedra or faces permutes the logits and nothing else, and a mesh may have any size.
"""

import torch
from torch import Tensor, nn

from agents.features import N_FEATURES
from agents.segments import Segments, highest, log_softmax, spread, total


class CandidateNetwork(nn.Module):
    """Score every candidate, and value the state they belong to."""

    def __init__(self, n_globals: int, hidden: int) -> None:
        """Make the layers; hidden: width of all of them."""
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(N_FEATURES, hidden), nn.ReLU(True), nn.Linear(hidden, hidden), nn.ReLU(True))
        self.context = nn.Sequential(nn.Linear(2 * hidden + n_globals, hidden), nn.ReLU())
        self.from_candidate = nn.Linear(hidden, hidden, bias=False)
        self.from_context = nn.Linear(hidden, hidden)
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

    def forward(self, features: Tensor, of: Segments, of_state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the log-probabilities of all candidates, (n_candidates,), and the values of the states, (n_states,).

        Args:
            features: of the candidates, shape (n_candidates, N_FEATURES).
            of: which candidates belong to which state.
            of_state: globals of the states, shape (n_states, n_globals).
        """
        encoded = self.encoder(features)
        mean, maximum = total(encoded, of) / of.length[:, None], encoded.gather(0, highest(encoded, of))
        context = self.context(torch.cat([mean, maximum, of_state], 1))
        # In place, like the rectifiers of the encoder: new memory costs as much as the sum.
        joined = self.from_candidate(encoded).add_(spread(self.from_context(context), of)).relu_()
        return log_softmax(self.logit(joined).flatten(), of), self.value(self.value_encoder(context)).flatten()
