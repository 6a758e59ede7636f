"""Plays the prototype environment in a process of its own: a number of steps in on a line, seconds per step out.

Run as a script, with the prototype's folder as argument, in a folder where the prototype may write.
"""

import sys
import time


def main() -> None:
    """Answer until the input ends."""
    sys.path.insert(0, sys.argv[1])
    import env as prototype
    import numpy as np

    world = prototype.CutEnv(prototype.pool("b200", 2, 0))
    rng = np.random.default_rng(0)
    world.reset(seed=0)
    print("ready", flush=True)
    for line in sys.stdin:
        taken = 0.0
        for _ in range(int(line)):
            action = int(rng.choice(np.flatnonzero(world.action_masks())))
            begin = time.perf_counter()
            _, _, terminated, truncated, _ = world.step(action)
            taken += time.perf_counter() - begin
            if terminated or truncated:
                world.reset()
        print(taken / int(line), flush=True)


if __name__ == "__main__":
    main()
