"""A rail that the diagnosis calls late is flown as a late one, also where too few set-points stepped to measure it."""

import pytest

from softarm.daemon.limits.findings import RailFindings, compared
from softarm.daemon.limits.measured import Bound, Measured, measure
from softarm.evaluation.closing.diagnosed import with_diagnosed
from softarm.evaluation.closing.wires import refusals
from softarm.schemas.config import Config, Limits, RailLimits
from softarm.schemas.verdict import Estimate, Gap, Interval, NamedEffect, Shrink, Verdict, Where

UNSEEN = measure((), 6.0)
BOUNDS = (Bound(value, 0.97, value, 100, 50.0) for value in (0.05, 0.05, 2.6, 8.0, 0.02))
SEEN = Measured(*BOUNDS, 6.0, 100, 100, 100, 100, 1, 50.0, ())


def findings(measured=UNSEEN, latency_s=1 / 30):
    config = Config(limits=Limits(rail=RailLimits(latency_s=latency_s)))
    return RailFindings(config, measured, compared(measured, config))


def named(value, high, effect="rail.delay"):
    late = NamedEffect(
        name=effect,
        parameters={"delay": Estimate(value=value, low=value, high=high, unit="s")},
        confidence=0.9,
        shrink=Shrink(stage=Interval(value=0.5, low=0.4, high=0.6)),
    )
    where = Where(stage="rail", share={"rail": 1.0}, regime="throughout")
    return Verdict(verdict="named", where=where, effects=(late,), gap=Gap(before={}, after={}, floor={}, ceiling={}))


def flown(rail):
    return rail.patched.limits.rail.latency_s


def test_the_latency_limit_is_the_upper_end_of_the_interval():
    rail = with_diagnosed(findings(), named(0.0887, 0.0894))
    assert flown(rail) == 0.09
    assert (
        "latency_s was 0.0333333. the diagnosis names rail.delay, 89 ms, 89 at most; only 0 set-point" in rail.patch()
    )
    assert "latency_s: 0.09" in rail.patch()
    assert not any("latency_s" in text for text in refusals(Config(), rail))


@pytest.mark.parametrize(
    ("verdict", "latency_s"),
    [(named(0.02, 0.03), 1 / 30), (named(0.0887, 0.0894), 0.12), (named(0.0887, 0.0894, "mocap.latency"), 1 / 30)],
)
def test_the_latency_is_never_relaxed_and_only_the_rail_counts(verdict, latency_s):
    assert flown(with_diagnosed(findings(latency_s=latency_s), verdict)) == latency_s


def test_a_measured_latency_takes_precedence():
    assert flown(with_diagnosed(findings(SEEN), named(0.0887, 0.0894))) == 0.05


def test_a_latency_beyond_the_allowed_range_moves_no_rail():
    rail = with_diagnosed(findings(), named(0.24, 0.25))
    assert "no allowed value covers it: check the drive" in refusals(Config(), rail)[0]
