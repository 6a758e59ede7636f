"""How fast it is: `python -m tests.benchmarks.speed` measures every row of the table in docs/speed.md, in one interleaved run."""

import os

# Set before numba, numpy or torch start: one thread everywhere, so that a row says what one core does.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "TI_NUM_THREADS"):
    os.environ[_name] = "1"
