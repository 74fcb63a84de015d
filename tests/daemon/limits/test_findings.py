"""Comparison of measured and configured limits, and the patch: never less strict, always valid."""

import itertools
from dataclasses import replace

import pytest

from softarm.daemon.config.configuration import load
from softarm.daemon.config.contradictions import contradictions
from softarm.daemon.limits.findings import RailFindings, compared, findings
from softarm.daemon.limits.measured import Bound, Measured
from softarm.schemas.config import Config

# Rail limits of most tests, independent of the defaults.
CONFIG = Config.model_validate({"limits": {"rail": {"latency_s": 0.0333, "braking_m_s2": 3.0, "surge_m_s2": 9.0}}})


def measured(latency=None, braking=None, surge=None, drag=None, surely=None, ramp=6.0) -> Measured:
    def bound(value):
        return None if value is None else Bound(value, 0.99, value, 300, 60.0)

    values = (latency, latency if surely is None else surely, braking, surge, drag)
    return Measured(*map(bound, values), ramp, 300, 300, 300, 300, 3, 120.0, ())


def found(config: Config, seen: Measured) -> RailFindings:
    return RailFindings(config, seen, compared(seen, config))


@pytest.mark.parametrize(
    ("seen", "advised"),
    [
        (measured(0.0333, 3.5, 8.0), {}),
        (measured(0.041, 3.0, 9.0, surely=0.036), {}),  # within what a step may be misjudged by
        (measured(0.0571, 3.5, 8.0, surely=0.052), {"latency_s": 0.058}),
        (measured(0.01, 1.43, 8.0), {"braking_m_s2": 1.4}),
        (measured(0.01, 2.9, 11.31), {"surge_m_s2": 11.4}),
        (measured(0.01, 3.5, 8.0, 0.049), {}),  # the margin covers it
        (measured(0.01, 3.0, 8.0, 0.051), {"drag_m_s": 0.06}),
        (measured(0.01, 6.0, 8.0, 0.08), {}),  # of a robot that brakes twice as hard as is counted on
        (measured(0.01, 2.0, 8.0, 0.08), {"braking_m_s2": 2.0, "drag_m_s": 0.08}),
        (measured(0.01, 6.0, 8.0, 0.25), {"drag_m_s": 0.25}),
        (
            measured(0.01, -0.1, 8.0, 0.25),
            {"braking_m_s2": None, "drag_m_s": 0.25},
        ),  # nothing that is allowed covers the braking
        (measured(0.01, 0.0, 8.0, 0.25), {"braking_m_s2": None, "drag_m_s": 0.25}),
        (measured(None, None, None), {}),
    ],
)
def test_a_lax_limit_is_rounded_to_the_safe_side(seen, advised):
    rows = compared(seen, CONFIG)
    assert {row.key: row.advised for row in rows if row.is_too_lax} == advised


def test_no_limit_is_relaxed_and_a_valid_configuration_stays_valid():
    drives = (
        {"acceleration_m_s2": 6.0},
        {"acceleration_m_s2": 3.0},
        {"acceleration_m_s2": 8.0, "quick_stop_m_s2": 8.0},
    )
    limits = ({"braking_m_s2": 1.0}, {"braking_m_s2": 1.4, "surge_m_s2": 12.0, "latency_s": 0.1})
    seen = itertools.product((0.006, 0.05, 0.199), (0.4, 1.3, 5.5), (4.0, 6.7, 15.0))
    for drive, limit, values in itertools.product(drives, limits, tuple(seen)):
        rail = {"acceleration_max_m_s2": 8.0, **limit}
        config = Config.model_validate({"limits": {"rail": rail}, "drivers": {"rail": drive}})
        assert list(contradictions(config)) == []
        result = found(config, measured(*values, ramp=drive["acceleration_m_s2"]))
        old, new = config.limits.rail, result.patched.limits.rail
        assert new.latency_s >= max(old.latency_s, values[0] - 0.005)
        assert new.braking_m_s2 <= min(old.braking_m_s2, 1.05 * max(values[1], old.braking_m_s2))
        assert new.surge_m_s2 >= old.surge_m_s2
        assert list(contradictions(result.patched)) == []


def test_braking_that_a_new_surge_contradicts_is_lowered_with_it():
    config = Config.model_validate({"limits": {"rail": {"surge_m_s2": 6.5, "braking_m_s2": 5.5}}})
    result = found(config, measured(0.03, 5.6, 8.1))
    braking = next(row for row in result.rows if row.key == "braking_m_s2")
    assert (braking.advised, result.patched.limits.rail.surge_m_s2) == (3.9, 8.1)
    assert "with surge_m_s2 8.1 at most 3.9 is consistent" in braking.why


@pytest.mark.parametrize(
    "config",
    [
        {"limits": {"rail": {"braking_m_s2": 3.0, "surge_m_s2": 9.0}}},
        {"limits": {"rail": {"braking_m_s2": 1.4}}, "drivers": {"rail": {"acceleration_m_s2": 3.0}}},
        {
            "limits": {"rail": {"acceleration_max_m_s2": 9.0, "surge_m_s2": 8.5, "braking_m_s2": 7.0}},
            "drivers": {"rail": {"acceleration_m_s2": 8.0, "quick_stop_m_s2": 8.0}},
        },
    ],
)
@pytest.mark.parametrize("seen", [measured(0.057, 1.2, 10.3), measured(), measured(0.01, 8.0, 5.0)])
def test_a_patch_is_a_configuration_that_check_accepts(tmp_path, config, seen):
    config = Config.model_validate(config)
    result = found(config, seen)
    path = tmp_path / "limits-patch.yaml"
    path.write_text(result.patch())
    assert load(path).limits == result.patched.limits
    assert load(path).drivers.rail == result.patched.drivers.rail
    assert max(map(len, result.patch().splitlines())) < 160


def test_a_limit_without_an_allowed_value_is_reported_and_kept():
    result = found(CONFIG, measured(0.03, -0.4, 9.0))
    braking = next(row for row in result.rows if row.key == "braking_m_s2")
    assert (braking.is_too_lax, braking.advised) == (True, None)
    assert "check the drive" in braking.advice
    assert "# no allowed value covers it" in result.patch()
    assert result.patched == CONFIG


def test_too_little_data_is_reported_with_the_next_step(cart):
    result = findings([cart(seconds=10.0)])
    assert not any(row.is_too_lax for row in result.rows)
    latency, braking, surge, _ = (row.why for row in result.rows)
    assert "59 required: record more with `softarm excite rail-dashes`" in latency
    assert braking == surge == "Not measured: without the latency the time of a set-point's effect is unknown"
    assert result.config == Config()


def test_recordings_are_compared_with_their_newest_configuration(cart):
    careful = Config.model_validate({"limits": {"rail": {"latency_s": 0.1}}})
    motions = [replace(cart(seconds=2.0), config=config) for config in (Config(), careful)]
    assert findings(motions).config == careful
    assert findings(motions, Config()).config == Config()
