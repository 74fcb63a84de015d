"""Records `flight.mcap`, the flight that `tests/daemon/runtime/test_golden_log.py` replays.

Only when the tick's behaviour is changed on purpose is
a new one made, in the commit that changes it:

    python tests/data/record_flight.py
"""

import dataclasses
import tempfile
from pathlib import Path

from softarm.common import revision
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.runtime.offline import Lockstep
from softarm.policies import registry
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Config
from softarm.schemas.config import Recorder as RecorderConfig
from softarm.schemas.goals import Goal

FLIGHT = Path(__file__).with_name("flight.mcap")


def record(directory: Path) -> Path:
    """Fly the simulated robot in lockstep; returns the log."""
    config = Config(recorder=RecorderConfig(directory=directory))
    policy = registry.load("reach")
    recorder = Recorder(config, policy.spec)
    recorder.start()
    daemon, runners = Lockstep(config, policy, record=recorder.tick), {}
    tick = daemon.controller.tick
    daemon.controller.tick = lambda inputs: tick(inputs, runners)  # as the loop hands over a policy that was loaded

    def fly(y_m: float, z_m: float, ticks: int) -> None:
        daemon.tick(daemon.request("goal", Goal("reach", y_m, z_m)))
        for _ in range(ticks):
            daemon.tick()

    def ask(*kinds: str) -> None:
        for kind in kinds:
            daemon.tick(daemon.request(kind))
            daemon.tick()

    daemon.arm()
    fly(-0.30, 0.62, 60)
    fly(-0.10, 0.65, 12)  # the next goal comes in mid-swing
    fly(-0.42, 0.68, 45)
    ask("goal", "cancel_goal")  # the first is refused: it says no goal
    fly(0.35, 0.60, 40)  # beyond the rail: the safety filter holds the cart back
    fly(-0.30, 0.60, 15)
    ask("stop", "acknowledge")
    change = dataclasses.replace(daemon.request("policy"), policy="pid")
    runners[change.number] = InlineRunner(registry.load("pid"))
    daemon.tick(change)
    recorder.policy(runners[change.number].policy.spec)
    daemon.arm()
    fly(-0.20, 0.60, 60)
    ask("disarm")
    recorder.stop()
    return recorder.path


if __name__ == "__main__":
    revision.machine = lambda: {"name": "anybody's"}
    with tempfile.TemporaryDirectory() as directory:
        FLIGHT.write_bytes(record(Path(directory)).read_bytes())
    print(f"recorded {FLIGHT}")
