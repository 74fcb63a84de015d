"""Findings of the doctor on a running daemon, models, limits and configuration."""

from dataclasses import replace
from pathlib import Path

import pytest

from softarm.common.finding import Finding, State
from softarm.daemon.doctor import examination, from_logs, models, running
from softarm.daemon.doctor.examination import PARTS, Target
from softarm.daemon.doctor.models import Golden, Models
from softarm.daemon.doctor.running import Running
from softarm.daemon.limits.findings import MeasuredLimit
from softarm.daemon.limits.measured import Bound
from softarm.recordings.log_file import listing
from softarm.schemas.config import Config, Control, Policy

DATA = Path(__file__).parents[2] / "data"


def status(tick=0, **changes):
    """Return the fields of GET /api/status that are checked, of a healthy daemon."""
    return {
        "t_ns": round(tick * 1e9 / 30),
        "tick": tick,
        "late_ns": 100_000,
        "missed_total": 0,
        "mode": "disarmed",
        "stalled": False,
        "observed": {"mocap_sequence": 4 * tick, "values": [0.1, *[0.0] * 7]},
        "rail_position_m": 0.102,
        "rail_velocity_m_s": 0.0,
        "events": [],
        "ages_ms": {"mocap": 8.0, "pressure": 12.0, "rail": 9.0},
        "problems": {"mocap": None, "regulator": None, "rail": None},
        "rail_cycle_max_ms": 12.0,
        "policy_ns": 500_000,
        "recorder": {"problem": None},
        "arming_refusals": [],
        "version": "1.0",
        "uptime_s": 3.0,
    } | changes


def judged(first=None, last=None):
    facts = Running("http://robot", None, (status(**(first or {})), status(60, **(last or {}))))
    return {each.name: each for each in running.judge(facts, Config())}


def test_a_healthy_daemon_has_no_findings():
    findings = judged()
    assert {each.state for each in findings.values()} == {State.OK}
    assert findings["loop"].figure.startswith("30.0 Hz")
    assert findings["motion capture's rate"].figure == "120 frames a second"


@pytest.mark.parametrize(
    ("last", "name", "state", "says"),
    [
        ({"stalled": True}, "loop", State.PROBLEM, "no longer ticks"),
        ({"missed_total": 2}, "loop", State.PROBLEM, "2 missed now"),
        ({"t_ns": 3_000_000_000}, "loop", State.PROBLEM, "20.0 Hz"),
        ({"observed": {"mocap_sequence": 40}}, "motion capture's rate", State.WARNING, "20 frames"),
        ({"ages_ms": {"mocap": 70.0, "pressure": 0, "rail": 0}}, "motion capture", State.WARNING, "70 ms"),
        ({"ages_ms": {"mocap": 0, "pressure": 200.0, "rail": 0}}, "regulator", State.PROBLEM, "pressure_stale_s"),
        ({"problems": {"mocap": None, "regulator": None, "rail": "no axis"}}, "rail", State.PROBLEM, "no axis"),
        ({"rail_cycle_max_ms": 28.0}, "rail's exchanges", State.WARNING, "28.0 ms"),
        ({"rail_cycle_max_ms": 40.0}, "rail's exchanges", State.PROBLEM, "latency_s is 33 ms"),
        ({"events": [{"name": "rail_not_homed"}]}, "rail's zero", State.PROBLEM, "softarm rail home"),
        ({"policy_ns": 25_000_000}, "policy's time", State.WARNING, "25.0 ms"),
        ({"arming_refusals": ["the drive is off"]}, "arming", State.PROBLEM, "the drive is off"),
        ({"recorder": {"problem": "the disk is full"}}, "recorder", State.PROBLEM, "the disk is full"),
    ],
)
def test_the_daemons_status_is_compared_with_the_configuration(last, name, state, says):
    findings = judged(last=last)
    finding = findings.pop(name)
    assert finding.state is state
    assert says in f"{finding.figure} {finding.advice}"
    assert {each.state for each in findings.values()} <= {State.OK}


@pytest.mark.parametrize(
    ("axis_m", "velocity_m_s", "state"),
    [
        (0.108, 0.0, State.OK),
        (0.091, 0.0, State.OK),
        (0.112, 0.0, State.WARNING),
        (0.085, 0.0, State.WARNING),
        (-0.2, 0.0, State.PROBLEM),
        (-0.2, 0.5, None),
        (None, None, None),
    ],
)
def test_the_axis_of_a_resting_cart_is_compared_with_motion_capture(axis_m, velocity_m_s, state):
    here = {"rail_position_m": axis_m, "rail_velocity_m_s": velocity_m_s}
    findings = judged(here, here)
    assert (findings["rail's zero"].state if "rail's zero" in findings else None) is state


def test_before_the_first_reading_a_device_is_a_problem():
    nothing = {"ages_ms": {"mocap": None, "pressure": None, "rail": None}, "observed": None}
    findings = judged(nothing, nothing)
    assert [findings[name].state for name in ("motion capture", "regulator", "rail")] == [State.PROBLEM] * 3


def test_a_daemon_that_refuses_the_status_is_a_problem():
    facts = Running("http://robot", "a token is needed")
    (finding,) = running.judge(facts, Config())
    assert finding.state is State.PROBLEM
    assert "--token-file" in finding.advice
    assert facts.in_use
    assert not Running("u", None, (status(),)).in_use
    assert Running("u", None, (status(mode="armed"),)).in_use


def test_every_shipped_model_reproduces_its_golden_run():
    facts = models.look(Config())
    assert {each.name for each in facts.goldens} == {"reach", "reach-wide", "reach-robust", "shelf"}
    assert all(each.error is None and 0.0 <= each.off <= each.allowed for each in facts.goldens)
    assert 1 <= len(facts.steps_ms) <= models.STEPS
    assert min(facts.steps_ms) > 0.0
    assert models.look(Config(), measured=False).steps_ms == ()


def test_a_missing_and_a_broken_policy_are_reported():
    config = Config(control=Control(policy="raech"), policies={"mine": Policy(plugin="onx")})
    findings = [each for each in models.judge(models.look(config), 0.02) if each.state is State.PROBLEM]
    assert [each.name for each in findings] == ["policies", "policy"]
    assert "policies.mine: no plugin 'onx'" in findings[0].figure
    assert "did you mean 'reach'" in findings[1].figure


def test_the_first_step_of_a_policy_has_a_time_limit(monkeypatch):
    monkeypatch.setattr(models.trial, "TRIAL_S", 0.0)
    error = models.look(Config(control=Control(policy="hold"))).error
    assert error == "policy 'hold': no first step within 0 s; repair the policy or choose another"


@pytest.mark.parametrize(
    ("steps_ms", "state"),
    [
        ((1.0,) * 10, State.OK),
        ((1.0,) * 9 + (25.0,), State.WARNING),
        ((15.0,) * 10, State.WARNING),
        ((25.0,) * 10, State.PROBLEM),
    ],
)
def test_a_policys_time_is_compared_with_its_budget(steps_ms, state):
    facts = Models("1.0", (Golden("reach", 1e-7, 1e-4),), "reach", steps_ms=steps_ms)
    assert {each.name: each.state for each in models.judge(facts, 0.02)} == {"golden runs": State.OK, "policy": state}


def test_a_golden_run_with_another_result_is_a_problem():
    facts = Models("1.0", (Golden("reach", error="off by 0.1"), Golden("shelf", 0, 1e-4)), "reach", steps_ms=(1.0,))
    findings = {each.name: each.state for each in models.judge(facts, 0.02)}
    assert findings == {"golden run": State.PROBLEM, "policy": State.OK}


def test_limits_less_strict_than_measured_are_problems():
    row = MeasuredLimit("latency_s", 0.033, Bound(0.06, 0.99, 0.05, 300, 60.0), 0.033, "act within 0.03 s")
    unknown = replace(row, bound=None, why="only 3 were seen")
    states = [each.state for each in from_logs.judge((row, replace(row, advised=0.06), unknown), DATA)]
    assert states == [State.OK, State.PROBLEM, State.WARNING]
    (nothing,) = from_logs.judge((), DATA)
    assert nothing.state is State.WARNING
    assert "softarm excite rail-dashes" in nothing.advice


def test_a_log_is_read_for_the_limits(tmp_path):
    rows = from_logs.look(DATA, listing(DATA), Config())
    assert [row.key for row in rows] == ["latency_s", "braking_m_s2", "surge_m_s2", "drag_m_s"]
    assert from_logs.look(tmp_path, listing(tmp_path), Config()) == ()


def of_configuration(path: Path | None) -> list[Finding]:
    target = Target(path, *examination.configuration(path, wires=True), "http://robot", None)
    return list(PARTS["configuration"](target))


def test_the_doctor_finds_the_mistakes_that_check_finds(tmp_path):
    (tmp_path / "arm.yaml").write_text("drivers: {mocap: {driver: zenho}}")
    (finding,) = of_configuration(tmp_path / "arm.yaml")
    assert (finding.state, "did you mean 'zenoh'" in finding.figure) == (State.PROBLEM, True)


def test_a_sound_configuration_has_no_problem_and_a_missing_one_a_warning(tmp_path):
    (tmp_path / "sound.yaml").write_text("")
    assert [each.state for each in of_configuration(tmp_path / "sound.yaml")] == [State.OK]
    assert [each.state for each in of_configuration(None)] == [State.WARNING]
