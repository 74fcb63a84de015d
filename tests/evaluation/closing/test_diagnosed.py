"""A rail that the diagnosis calls late is flown as a late one, also where too few set-points stepped to measure it."""

import pytest

from softarm.evaluation.closing.diagnosed import with_diagnosed
from softarm.evaluation.closing.wires import refusals
from softarm.schemas.config import Config, Limits, RailLimits
from tests.evaluation.closing import cases


def findings(measured=cases.UNSEEN, latency_s=1 / 30):
    return cases.findings(Config(limits=Limits(rail=RailLimits(latency_s=latency_s))), measured)


def named(value, high, effect="rail.delay"):
    return cases.named(effect, value, high)


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
    assert flown(with_diagnosed(findings(cases.seen()), named(0.0887, 0.0894))) == 0.05


def test_a_latency_beyond_the_allowed_range_moves_no_rail():
    rail = with_diagnosed(findings(), named(0.24, 0.25))
    assert "no allowed value covers it: check the drive" in refusals(Config(), rail)[0]
