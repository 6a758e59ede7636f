"""From the start of a Python process to the first step of an environment, with and without compiled kernels on disk."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from tests.benchmarks.rows import Plan, Row, at_most, failed, reason_of
from tests.benchmarks.timing import sampled

SCRIPT = """
import gymnasium, numpy
env = gymnasium.make("envs:Resect-v0", scene="box-108")
observation, info = env.reset(seed=0)
env.step(int(numpy.flatnonzero(observation["action_mask"])[0]))
"""
IMPORTS = "import gymnasium, numpy, envs.resect"
"""What leaves the bytecode of all that is imported; pip does the same when it installs."""
TIME_LIMIT = 300.0
"""[s]."""


def measure_start(plan: Plan) -> Iterator[Row]:
    """Yield cold and warm start in seconds; cold ones fill a folder of compiled kernels that warm ones then read."""
    cold, warm, reason = [], [], ""
    try:
        with tempfile.TemporaryDirectory() as bytecode:
            start_process(bytecode, bytecode, IMPORTS)
            for _ in range(1 if plan.is_quick else 2):
                with tempfile.TemporaryDirectory() as folder:
                    plan.say("cold start")
                    cold.append(start_process(folder, bytecode))
                    warm += [start_process(folder, bytecode) for _ in range(3)]
    except (subprocess.SubprocessError, OSError) as error:
        reason = reason_of(error)
    for name, taken, limit in (("cold", cold, 12.0), ("warm", warm, 2.5)):
        row_name, asked = f"{name} start to the first step, box-108", at_most(limit)
        if not taken:
            yield failed(row_name, reason, unit="s", asked=asked)
            continue
        sample = sampled(taken)
        note = f"best of {len(taken)} processes, interpreter and imports included; their bytecode is kept, as pip keeps it"
        yield Row(row_name, float(sample.times.min()), "s", sample.median, sample.high, asked, note=note)


def start_process(cache: str, bytecode: str, script: str = SCRIPT) -> float:
    """Run a script in a fresh process with folders for compiled kernels and bytecode; return the seconds it took."""
    environment = os.environ | {"NUMBA_CACHE_DIR": cache, "PYTHONPYCACHEPREFIX": bytecode}
    # Else nothing would be kept, and each process would compile a second's worth of imports, as few users' do.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", script], env=environment, check=True, capture_output=True, timeout=TIME_LIMIT)
    return time.perf_counter() - begin
