"""Sums, maxima and softmax over segments: values and slopes of a loop."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents.segments import highest, log_softmax, segments, spread, total  # noqa: E402

COUNTS = [3, 1, 40, 7]
"""Rows of some states."""


def ragged():
    """Return the segments of some states, and which rows they are."""
    offset = np.append(0, np.cumsum(COUNTS))
    return segments(offset), [slice(first, last) for first, last in zip(offset[:-1], offset[1:], strict=True)]


def slow_spread(states, own):
    """Return each state's numbers once for each of its rows."""
    return torch.cat([states[i].expand(rows.stop - rows.start, *states.shape[1:]) for i, rows in enumerate(own)])


def fast_maximum(rows, of):
    """Return the highest of each state's rows, lane by lane."""
    return rows.gather(0, highest(rows, of))


def steep_log_softmax(rows, of):
    """Return log-probabilities of logits whose exponentials alone would overflow."""
    return log_softmax(60.0 * rows, of)


def slow_log_softmax(rows, own):
    """Return the same, one state and one lane after the other."""
    lanes = (60.0 * rows).reshape(len(rows), -1).unbind(1)
    return torch.stack([torch.cat([lane[part].log_softmax(0) for part in own]) for lane in lanes], 1).reshape(rows.shape)


# Functions of numbers and segments, the same of numbers and slices, and the shape of the numbers.
TWINS = {
    "total": (total, lambda rows, own: torch.stack([rows[part].sum(0) for part in own]), (sum(COUNTS), 5)),
    "total of one lane": (total, lambda rows, own: torch.stack([rows[part].sum() for part in own]), (sum(COUNTS),)),
    "spread": (spread, slow_spread, (len(COUNTS), 5)),
    "spread of one lane": (spread, slow_spread, (len(COUNTS),)),
    "maximum": (fast_maximum, lambda rows, own: torch.stack([rows[part].amax(0) for part in own]), (sum(COUNTS), 5)),
    "log_softmax": (steep_log_softmax, slow_log_softmax, (sum(COUNTS), 5)),
    "log_softmax of one lane": (steep_log_softmax, slow_log_softmax, (sum(COUNTS),)),
}


def compare(fast, slow, numbers):
    """Check that two functions have the same value, and the same slope under a random weight, in float32."""
    one, other = (numbers.clone().requires_grad_() for _ in range(2))
    found, expected = fast(one), slow(other)
    weight = torch.randn(expected.shape, generator=torch.Generator().manual_seed(0))
    for result in (found, expected):
        (weight * result).sum().backward()
    # Sums of 40 numbers of size 1, or logits of size 200, in float32.
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-5)
    torch.testing.assert_close(one.grad, other.grad, atol=1e-3, rtol=1e-4)


@pytest.mark.parametrize(("fast", "slow", "shape"), TWINS.values(), ids=TWINS)
def test_what_is_done_to_segments_has_the_value_and_the_slope_of_a_loop(fast, slow, shape, rng):
    of, own = ragged()
    numbers = torch.tensor(rng.normal(size=shape), dtype=torch.float32)
    compare(lambda rows: fast(rows, of), lambda rows: slow(rows, own), numbers)


def test_what_is_no_number_counts_as_the_highest():
    of, rows = segments(np.array([0, 3, 5])), torch.tensor([1.0, np.nan, 2.0, np.nan, 7.0])
    assert highest(rows, of).tolist() == [1, 3]


SMALL = [2, 1, 4]
"""Rows of some states, few enough for differences."""
SLOPES = {
    "total": (total, (sum(SMALL), 2)),
    "spread": (spread, (len(SMALL), 2)),
    "log_softmax": (log_softmax, (sum(SMALL), 2)),
    "maximum": (fast_maximum, (sum(SMALL), 2)),
}


@pytest.mark.parametrize(("function", "shape"), SLOPES.values(), ids=SLOPES)
def test_slopes_are_those_of_small_differences(function, shape, rng):
    of = segments(np.append(0, np.cumsum(SMALL)))
    numbers = torch.tensor(rng.normal(size=shape), requires_grad=True)
    assert torch.autograd.gradcheck(lambda rows: function(rows, of), (numbers,))
