"""Contradictions between allowed values of a configuration."""

import pytest

from softarm.daemon.config.configuration import ConfigurationError, load
from softarm.daemon.config.contradictions import contradictions
from softarm.schemas.config import Config

RAIL = "drivers.rail.acceleration_m_s2"


@pytest.fixture
def refusals(tmp_path):
    def refusals(text: str) -> list[str]:
        path = tmp_path / "arm.yaml"
        path.write_text(text)
        try:
            load(path)
        except ConfigurationError as refusal:
            return [problem.removeprefix(f"{path}:") for problem in refusal.problems]
        return []

    return refusals


def test_the_defaults_have_no_contradiction():
    assert list(contradictions(Config())) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "drivers: {rail: {acceleration_m_s2: 3}}",
            f"1: {RAIL}: limits.rail.braking_m_s2 is 1.7, above {RAIL} 3.0 less the arm's pull of 1.5 (limits.rail."
            "surge_m_s2 10.5 less the ramp, at most half of it): the cart cannot brake that hard; "
            "lower braking_m_s2 to 1.5, or raise the ramp",
        ),
        (
            "limits: {rail: {braking_m_s2: 3.5}}",
            f"1: limits.rail.braking_m_s2: is 3.5, above {RAIL} 6.0 less the arm's pull of 3 (limits.rail.surge_m_s2 "
            "10.5 less the ramp, at most half of it): the cart cannot brake that hard; "
            "lower braking_m_s2 to 3, or raise the ramp",
        ),
        (
            "limits:\n  rail: {surge_m_s2: 1}",
            f"2: limits.rail.surge_m_s2: is 1.0, below {RAIL} 6.0: the drive alone accelerates the cart faster "
            "than assumed; raise surge_m_s2 to 6.0 plus the arm's pull, or lower the ramp",
        ),
        (
            "drivers: {rail: {quick_stop_m_s2: 1.5}}",
            "1: drivers.rail.quick_stop_m_s2: is 1.5, below limits.rail.braking_m_s2 1.7: an emergency stop would "
            "brake less than assumed; raise quick_stop_m_s2 to 1.7 or more",
        ),
        (
            "limits: {rail: {latency_s: 0}}",
            "1: limits.rail.latency_s: is 0.0, below 0.005: no command reaches drivers.rail.driver dryve_d1 faster; "
            "measure the latency, or remove the line for the default",
        ),
        (
            "limits: {rail: {position_max_m: 0.3}}",
            "1: limits.rail.position_max_m: is 0.3, and the mechanical stop at 0.3 m is less than 0.02 m beyond it: "
            "the cart would hit the stop before the failsafe reacts; move the limit within 0.28 m of the middle",
        ),
        (
            "limits: {rail: {position_min_m: -0.29}}",
            "1: limits.rail.position_min_m: is -0.29, and the mechanical stop at 0.3 m is less than 0.02 m "
            "beyond it: the cart would hit the stop before the failsafe reacts; "
            "move the limit within 0.28 m of the middle",
        ),
        (
            "drivers: {regulator: {time_to_live_s: 0.031}}",
            "1: drivers.regulator.time_to_live_s: is 0.031, no longer than a tick (0.0333 s at control.rate_hz 30): "
            "the regulator would vent between two commands; raise it to 0.1",
        ),
        (
            "drivers: {rail: {hold_s: 0.033}}",
            "1: drivers.rail.hold_s: is 0.033, no longer than a tick (0.0333 s at control.rate_hz 30): the cart would "
            "be braked between two set-points; raise it to 0.045 or remove the line",
        ),
        (
            "drivers: {rail: {timeout_s: 0.4, time_to_live_s: 0.3}}",
            "1: drivers.rail.timeout_s: is 0.4, not below drivers.rail.time_to_live_s 0.3: the link would still wait "
            "for an answer when it must switch the drive off; lower it to 0.1",
        ),
        (
            "failsafe: {rail_stale_s: 0.6}",
            "1: failsafe.rail_stale_s: is 0.6, above 0.5: the safety filter brakes for an axis reading older "
            "than that without reporting an event; lower it to 0.5 or less",
        ),
        (
            "drivers: {rail: {hold_s: 0.1, time_to_live_s: 0.1, timeout_s: 0.05}}",
            "1: drivers.rail.time_to_live_s: is 0.1, not above drivers.rail.hold_s 0.1: the drive would be switched "
            "off before it brakes; raise it to 0.2",
        ),
        (
            "failsafe: {mocap_stale_s: 0.03}",
            "1: failsafe.mocap_stale_s: is 0.03, no longer than a tick (0.0333 s at control.rate_hz 30): a valid "
            "reading of motion capture would count as too old; raise it to 0.07 or more",
        ),
        (
            "recorder: {file_max_mb: 500, keep_mb: 600}",
            "1: recorder.keep_mb: is 600, less than two files of recorder.file_max_mb 500: a log would be deleted as "
            "soon as the next one is full; raise keep_mb to 1000 or lower file_max_mb",
        ),
    ],
)
def test_each_contradiction_has_both_keys_their_values_and_the_next_step(refusals, text, said):
    assert refusals(text) == [said]


@pytest.mark.parametrize(
    "text",
    [
        "limits: {rail: {braking_m_s2: 4, surge_m_s2: 8}}",  # measured on a robot whose arm pulls less
        "limits: {rail: {braking_m_s2: 1.7, surge_m_s2: 10.3}}",
        "limits: {rail: {braking_m_s2: 1}}\ndrivers: {rail: {acceleration_m_s2: 2}}",
        "limits: {rail: {position_min_m: -0.28, position_max_m: 0.28}}",
        "limits: {rail: {latency_s: 0.09}}",
        "failsafe: {rail_stale_s: 0.04}\ndrivers: {regulator: {time_to_live_s: 0.04}}",
    ],
)
def test_valid_configurations_have_no_contradiction(refusals, text):
    assert refusals(text) == []


def test_all_contradictions_are_reported_in_the_files_order(refusals):
    reported = refusals("limits:\n  rail:\n    surge_m_s2: 1\n    latency_s: 0\nfailsafe: {pressure_stale_s: 0.01}\n")
    assert [problem.split(": ")[:2] for problem in reported] == [
        ["3", "limits.rail.surge_m_s2"],
        ["4", "limits.rail.latency_s"],
        ["5", "failsafe.pressure_stale_s"],
    ]


def test_the_configuration_inside_an_old_log_stays_readable():
    old = Config.model_validate_json('{"limits": {"rail": {"latency_s": 0.0, "braking_m_s2": 20.0}}}')
    assert len(list(contradictions(old))) == 3  # the quick stop is weaker, too
