"""Steps per second of many robots: in one call of the kernel, and in Gymnasium's SyncVectorEnv.

python speed.py            # both in one process, one after the other, on this machine
"""

import argparse
import time

import gymnasium
import numpy as np

ENVIRONMENT = "softarm.training.gym_envs:SoftArmReach-v0"


def steps_per_s(mode: str, robots: int, seconds: float) -> float:
    """Return the control steps of single robots per second, with random actions and resets."""
    envs = gymnasium.make_vec(ENVIRONMENT, num_envs=robots, vectorization_mode=mode)
    envs.reset(seed=0)
    rng, steps = np.random.default_rng(0), 0
    actions = rng.uniform(-1.0, 1.0, (16, robots, 2)).astype(np.float32)
    # The first step compiles and loads.
    envs.step(actions[0])
    start = time.perf_counter()
    while time.perf_counter() - start < seconds:
        envs.step(actions[steps % 16])
        steps += 1
    took = time.perf_counter() - start
    envs.close()
    return steps * robots / took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3.0, help="for each measurement")
    seconds = parser.parse_args().seconds
    print("robots  one call  SyncVectorEnv  (steps/s)")
    for robots in (1, 16, 256):
        fast, slow = (steps_per_s(mode, robots, seconds) for mode in ("vector_entry_point", "sync"))
        print(f"{robots:6}  {fast:8,.0f}  {slow:13,.0f}  {fast / slow:.0f} times")


if __name__ == "__main__":
    main()
