"""Contradictions between allowed values of a configuration."""

import re

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


@pytest.mark.parametrize(
    ("text", "said", "next_step"),
    [
        ("drivers: {rail: {acceleration_m_s2: 3}}", "limits.rail.braking_m_s2 is 1.7", "lower braking_m_s2 to 1.5"),
        ("limits: {rail: {braking_m_s2: 3.5}}", f"is 3.5, above {RAIL} 6.0", "lower braking_m_s2 to 3"),
        ("limits: {rail: {surge_m_s2: 1}}", f"is 1.0, below {RAIL} 6.0", "raise surge_m_s2 to 6.0"),
        ("drivers: {rail: {quick_stop_m_s2: 1.5}}", "is 1.5, below limits.rail.braking_m_s2 1.7", "to 1.7 or more"),
        ("limits: {rail: {latency_s: 0}}", "is 0.0, below 0.005", "remove the line for the default"),
        ("limits: {rail: {position_max_m: 0.3}}", "is 0.3, and the mechanical stop at 0.3 m", "within 0.28 m"),
        ("limits: {rail: {position_min_m: -0.29}}", "is -0.29, and the mechanical stop at 0.3 m", "within 0.28 m"),
        ("drivers: {regulator: {time_to_live_s: 0.031}}", "is 0.031, no longer than a tick (0.0333 s", "to 0.1"),
        ("drivers: {rail: {hold_s: 0.033}}", "is 0.033, no longer than a tick (0.0333 s", "to 0.045"),
        (
            "drivers: {rail: {time_to_live_s: 0.1, hold_s: 0.1, timeout_s: 0.05}}",
            "is 0.1, not above drivers.rail.hold_s 0.1",
            "to 0.2",
        ),
        ("drivers: {rail: {timeout_s: 0.2}}", "is 0.2, not below drivers.rail.time_to_live_s 0.15", "to 0.075"),
        ("failsafe: {rail_stale_s: 0.6}", "is 0.6, above 0.5: the safety filter brakes", "to 0.5 or less"),
        ("failsafe: {mocap_stale_s: 0.03}", "is 0.03, no longer than a tick (0.0333 s", "to 0.07 or more"),
        ("recorder: {directory: ~/logs}", "recorder.directory: is ~/logs, and ~ is not expanded", "the whole path"),
        ("api: {reports: ~ann/reports}", "api.reports: is ~ann/reports, and ~ is not expanded", "the whole path"),
        ("recorder: {keep_mb: 600}", "is 600, less than two files of recorder.file_max_mb 500", "keep_mb to 1000"),
        ("api: {port: 7447}", "api.port: is 7447, and drivers.mocap.endpoint tcp/127.0.0.1:7447 has", "another port"),
        ("api: {stop_port: 7447}", "api.stop_port: is 7447, and drivers.mocap.endpoint tcp", "another port"),
        ("{api: {port: 9}, ros: {router: tcp/127.0.0.1:9}}", "is 9, and ros.router tcp/127.0.0.1:9", "another port"),
        ("ros: {commands: stop}", "is stop, and ros.router is null: no command would arrive", "name the router"),
        ("ros: {commands: all, router: tcp/10.0.0.2:7447}", "tcp/10.0.0.2:7447 is on another machine", "127.0.0.1"),
        (
            "ros: {commands: all, router: tcp/127.0.0.1:7447}\napi: {token_file: token}",
            "is all, and api.token_file is token: every client of the router could command",
            "to stop, or remove token_file",
        ),
    ],
)
def test_each_contradiction_has_both_keys_their_values_and_the_next_step(refusals, text, said, next_step):
    (refusal,) = refusals(text)
    key = ".".join(re.findall("[a-z_0-9]+(?=:)", text.partition(",")[0]))
    assert refusal.startswith(f"1: {key}: ")
    assert said in refusal
    assert next_step in refusal.partition("; ")[2]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "limits: {rail: {braking_m_s2: 4, surge_m_s2: 8}}",  # measured on a robot whose arm pulls less
        "limits: {rail: {braking_m_s2: 1.7, surge_m_s2: 10.3}}",
        "limits: {rail: {braking_m_s2: 1}}\ndrivers: {rail: {acceleration_m_s2: 2}}",
        "limits: {rail: {position_min_m: -0.28, position_max_m: 0.28}}",
        "limits: {rail: {latency_s: 0.09}}",
        "{api: {port: 7447}, drivers: {mocap: {endpoint: tcp/192.168.1.5:7447}}}",  # another network's address
        "failsafe: {rail_stale_s: 0.04}\ndrivers: {regulator: {time_to_live_s: 0.04}}",
        "recorder: {keep_mb: 1000}",
        "ros: {commands: all, router: tcp/127.0.0.1:7447}",
        "ros: {commands: stop, router: tcp/10.0.0.2:7447}\napi: {token_file: token}",
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
