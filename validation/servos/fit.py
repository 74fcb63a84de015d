"""Identification of a servo by BAM (Better Actuator Models), which runs in a Python 3.12 of its own.

As BAM's own program does, CMA-ES minimises the mean error of free simulations over the parameters of one of its models.
`validation/servos/benchmark.py` starts it.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from bam.actuators import actuators
from bam.logs import Logs
from bam.model import Model, models
from bam.simulate import Simulator
from cmaes import CMA

EVALUATIONS = 1000
SIGMA = 0.2  # first standard deviation, as a share of the bounds


def fitted(law: str, servo: str, logs: dict[str, Any]) -> Model:
    """Return the model of a kind with the smallest error on the logs of a batch."""
    model = models[law]()
    model.set_actuator(actuators[servo]())
    free = [each for each in model.get_parameters().values() if each.optimize]
    low, high = (np.array([getattr(each, end) for each in free]) for end in ("min", "max"))
    start = (np.array([each.value for each in free]) - low) / (high - low)
    search = CMA(start, SIGMA, bounds=np.tile((0.0, 1.0), (len(free), 1)), seed=1)

    def put(share: Any) -> None:
        for each, value in zip(free, low + share * (high - low), strict=True):
            each.value = float(value)

    best, least = start, np.inf
    for _ in range(EVALUATIONS // search.population_size):
        candidates = [search.ask() for _ in range(search.population_size)]
        rated = []
        for share in candidates:
            put(share)
            rated.append((share, float(np.mean(np.abs(errors(model, logs))))))
        search.tell(rated)
        best, least = min([(best, least), *rated], key=lambda each: each[1])
    put(best)
    return model


def errors(model: Model, logs: dict[str, Any]) -> Any:
    """Return simulated minus recorded angles of all logs of a batch, rad."""
    simulated, _, _ = Simulator(model).rollout_log(logs, simulate_control=True)
    return np.array(simulated) - np.array([each["position"] for each in logs["entries"]])


def main() -> None:
    """Fit a servo's logs with one model, and print the error on the held-out log and the time as JSON."""
    folder, servo, law, held_out = sys.argv[1:]
    training, other = Logs(folder), Logs(folder)
    training.logs = [each for each in training.logs if Path(each["filename"]).stem != held_out]
    other.logs = [each for each in other.logs if Path(each["filename"]).stem == held_out]
    start = time.process_time()
    model = fitted(law, servo, training.make_batch())
    left = errors(model, other.make_batch())
    print(json.dumps({"rms_rad": float(np.sqrt(np.mean(left**2))), "processor_s": time.process_time() - start}))


if __name__ == "__main__":
    main()
