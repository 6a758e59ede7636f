"""The layers of the candidate network that are compiled: values and slopes of what torch would make of them, row by row."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from agents.layers import Company, Graph, Meeting, exchange, meet, score  # noqa: E402
from agents.segments import segments  # noqa: E402

N_LANES = 3


def random_graph(rng, n_rows, n_links):
    """Return a symmetric graph some of whose rows, the last among them, have no neighbour, and its matrix."""
    matrix = np.zeros((n_rows, n_rows), dtype=bool)
    pairs = rng.choice(n_rows - 1, size=(n_links, 2))
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    matrix[pairs[:, 0], pairs[:, 1]] = matrix[pairs[:, 1], pairs[:, 0]] = True
    matrix[[4, 5]] = matrix[:, [4, 5]] = False
    offset = np.append(0, np.cumsum(matrix.sum(axis=1)))
    assert matrix.any() and not matrix[-1].any()
    return Graph(torch.tensor(np.nonzero(matrix)[1]), torch.tensor(offset)), torch.tensor(matrix)


def exchange_case(rng, n):
    """Return an exchange between n rows as layer, the same row by row, and shapes of what they take."""
    graph, matrix = random_graph(rng, n, n + n // 2)

    def fast(known, told, bias):
        return exchange(known, 1.0 * told, bias, graph)

    def slow(known, told, bias):
        told_itself, told_others = told.split(N_LANES, 1)
        heard = [told_others[row].sum(0) for row in matrix]
        return known + torch.stack([(a + bias + 0.5 * b).clamp_min(0.0) for a, b in zip(told_itself, heard, strict=True)])

    return fast, slow, [(n, N_LANES), (n, 2 * N_LANES), (N_LANES,)]


def meeting_case(rng, n):
    """Return a meeting of the candidates of three states, with sides drawn at random, some of them shared, likewise."""
    counts, n_tetrahedra, n_centres = [n, 1, 2 * n], n + 2, 2
    sides = torch.tensor(rng.integers(0, n_tetrahedra, (2, sum(counts))))
    places = torch.tensor(rng.normal(size=(sum(counts), 5)))

    def at(dtype):
        # As columns of a wider table.
        return Meeting(segments(np.append(0, np.cumsum(counts))), sides, places.to(dtype)[:, 1:4])

    def fast(own, *company):
        return meet(1.0 * own, Company(*company), at(own.dtype))

    def slow(own, state, sides, centres, distant):
        first, second = sides.split(N_LANES, 1)
        states, sides, places = at(own.dtype)
        rows = zip(own, states.state_of, *sides, places, strict=True)
        return torch.stack([
            (row + state[of] + first[one] + second[two]
             + sum((place - centre).square().sum() * worth for centre, worth in zip(centres[of].split(3), distant, strict=True))
            ).clamp_min(0.0) for row, of, one, two, place in rows
        ])  # fmt: skip

    shapes = [(sum(counts), N_LANES), (len(counts), N_LANES), (n_tetrahedra, 2 * N_LANES)]
    return fast, slow, [*shapes, (len(counts), 3 * n_centres), (n_centres, N_LANES)]


def score_case(rng, n):
    """Return scores of n rows, likewise."""

    def fast(rows, bias, weight):
        return score(1.0 * rows, bias, weight)

    def slow(rows, bias, weight):
        return torch.stack([(row + bias).clamp_min(0.0).dot(weight) for row in rows])

    return fast, slow, [(n, N_LANES), (N_LANES,), (N_LANES,)]


CASES = {"exchange": exchange_case, "meet": meeting_case, "score": score_case}
cases = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def numbers(rng, shapes, dtype):
    """Return numbers to be differentiated; the layers overwrite copies of theirs."""
    return [torch.tensor(rng.normal(size=shape), dtype=dtype, requires_grad=True) for shape in shapes]


@cases
def test_a_layer_has_the_value_and_the_slopes_of_a_loop(case, rng):
    fast, slow, shapes = case(rng, 30)
    given = numbers(rng, shapes, torch.float32)
    twins = [[part.detach().clone().requires_grad_() for part in given] for _ in range(2)]
    found, expected = fast(*twins[0]), slow(*twins[1])
    weight = torch.randn(expected.shape, generator=torch.Generator().manual_seed(0))
    for result in (found, expected):
        (weight * result).sum().backward()
    torch.testing.assert_close(found, expected)
    for one, other in zip(*twins, strict=True):
        assert other.grad.abs().max() > 0.1
        torch.testing.assert_close(one.grad, other.grad, atol=1e-5, rtol=1e-5)


@cases
def test_slopes_of_a_layer_are_those_of_small_differences(case, rng):
    fast, _, shapes = case(rng, 8)
    assert torch.autograd.gradcheck(fast, numbers(rng, shapes, torch.float64))


@cases
def test_what_is_no_number_is_not_hidden_by_a_layer(case, rng):
    fast, slow, shapes = case(rng, 30)
    for place in range(len(shapes)):
        given = [part.detach() for part in numbers(rng, shapes, torch.float32)]
        given[place].view(-1)[0] = np.nan
        is_missing = slow(*given).isnan()
        assert is_missing.any() and not is_missing.all() or case is score_case
        torch.testing.assert_close(fast(*given).isnan(), is_missing)
