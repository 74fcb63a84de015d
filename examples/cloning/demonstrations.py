"""Fly a policy to random targets on a simulated robot and record a log: python demonstrations.py POLICY FLIGHTS LOG.

The control loop is the daemon's own. The log becomes a dataset with `softarm logs export --to lerobot`.
"""

import sys
import time
from pathlib import Path

import numpy as np

from softarm.daemon.logbook.ticks import TickFile
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.recordings import log_file
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.training.task.reach import TASKS

TASK = TASKS["reach-wide"]  # targets and cart starts


def record(policy: str, flights: int, path: Path, seed: int = 1) -> int:
    """Record flights from rest and return how many reached their target."""
    rng, loaded = np.random.default_rng(seed), registry.load(policy, {})
    path.parent.mkdir(parents=True, exist_ok=True)
    reached = 0
    with path.open("wb") as file:
        log = TickFile(file)
        lockstep = Lockstep(Config(), loaded, record=lambda *tick: log.write(tick))
        log.head(Config(), loaded.spec, 0, time.time_ns())
        targets, starts = TASK.sample_targets(rng, flights), rng.uniform(*TASK.cart_start_m, flights)
        for (y_m, z_m), start_m in zip(targets.tolist(), starts.tolist(), strict=True):
            reached += lockstep.fly(Goal("reach", y_m, z_m), start_m).reached
        log.flush()
    log_file.finish(path)
    return reached


if __name__ == "__main__":
    count = int(sys.argv[2])
    print(f"{record(sys.argv[1], count, Path(sys.argv[3]))} of {count} reached their target")
