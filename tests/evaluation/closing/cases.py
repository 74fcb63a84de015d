"""Rail limits that a campaign shows and verdicts of a diagnosis, for the tests of closing a gap."""

from softarm.daemon.limits.findings import RailFindings, compared
from softarm.daemon.limits.measured import Bound, Measured, measure
from softarm.evaluation.closing.fly import Replanning
from softarm.policies.mppi.policy import Mppi
from softarm.schemas.config import Config
from softarm.schemas.verdict import Verdict
from tests.diagnosis.verdicts import effect, gap, rms, verdict

UNSEEN = measure((), 6.0)


def seen(latency_s: float = 0.05) -> Measured:
    """Return limits that a campaign measured."""
    bounds = (Bound(value, 0.97, value, 100, 50.0) for value in (latency_s, latency_s, 2.6, 8.0, 0.02))
    return Measured(*bounds, 6.0, 100, 100, 100, 100, 1, 50.0, ())


def findings(config: Config, measured: Measured = UNSEEN) -> RailFindings:
    """Return the measured limits beside those of a configuration."""
    return RailFindings(config, measured, compared(measured, config))


def named(name: str, value: float, high: float) -> Verdict:
    """Return a verdict that names a delay, s."""
    stage = name.partition(".")[0]
    level = rms("kPa", **{stage: 0.1})
    delay = effect(name, confidence=0.9, delay=(value, value, high, "s"))
    return verdict("named", delay, stage=stage, share={stage: 1.0}, gaps=gap(level, level, level))


class QuickReplanning(Replanning):
    """A replanning policy with a short search and a clock that stands still, so that other work changes no figure."""

    def load(self) -> Mppi:
        return Mppi(horizon_s=1.0, rollouts=128, rounds=1, model=str(self.model), clock=lambda: 0)
