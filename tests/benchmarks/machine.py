"""What the machine could do at best."""

import numpy as np

from tests.benchmarks.timing import timed


def matrix_rate() -> float:
    """Measure the rate of float64 arithmetic in a matrix product on one thread [1/s]."""
    a, b, out = (np.ones((512, 512)) for _ in range(3))
    np.matmul(a, b, out=out)
    return 2.0 * 512**3 / min(timed(lambda: np.matmul(a, b, out=out)) for _ in range(15))


def bandwidth(n_bytes: int) -> float:
    """Measure how fast a working set of some bytes is read and written, by copying one half onto the other [B/s]."""
    half = max(n_bytes // 2, 4096)
    source, target = np.ones(half, np.uint8), np.zeros(half, np.uint8)
    repeats = max(1, int(2e6 // half))

    def copy() -> None:
        for _ in range(repeats):
            np.copyto(target, source)

    copy()
    return 2.0 * half * repeats / min(timed(copy) for _ in range(15))
