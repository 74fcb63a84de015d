"""Who is asked before `softarm close-gap --config` moves a robot, and what is said when it stays where it is."""

from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from softarm.cli import wires
from softarm.daemon.limits.findings import RailFindings, compared
from softarm.daemon.limits.measured import measure
from softarm.flights.closing import story
from softarm.schemas.config import Config, Limits, RailLimits

SAID = ("latency_s", "braking_m_s2", "surge_m_s2", "drag_m_s")
KNOWN = Config(limits=Limits(rail=RailLimits(**{key: getattr(RailLimits(), key) for key in SAID})))


def closed(config=KNOWN):
    measured = measure((), 6.0)
    return SimpleNamespace(retrained=object(), rail=RailFindings(config, measured, compared(measured, config)))


CLOSED = closed()


def bench(file=Path("softarm.yaml"), **changed):
    usual = {"twin": False, "robot": "reality", "declared": True, "yes": False, "goals": 1, "out": Path("out")}
    return wires.Bench(file, **usual | changed, spent={})


@pytest.fixture
def terminal(monkeypatch):
    """A person at a terminal, who answers as the test says; what was flown."""
    person = SimpleNamespace(says=False, flown=[], asked=[])

    def confirm(text, **options):
        assert options["default"] is False
        person.asked.append(text)
        return person.says

    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(click, "confirm", confirm)
    monkeypatch.setattr(story, "sentences", lambda closed: ["Fly the retrained one."])
    monkeypatch.setattr(wires, "_flown", lambda *arguments: person.flown.append(arguments) or "flown")
    return person


def test_without_a_configuration_nothing_is_asked_and_nothing_moves(terminal):
    assert wires.through_wires(bench(file=None))(CLOSED) is None
    assert wires.through_wires(bench())(SimpleNamespace(retrained=None)) is None
    assert terminal.asked == []


def test_a_robot_moves_when_a_person_says_so_and_stays_when_not(terminal, capsys):
    still = wires.through_wires(bench())(CLOSED)
    assert (still.title, still.ended, still.flights) == ("the robot of softarm.yaml", "not wanted", 0)
    assert "Fly the retrained one.\nThe robot of softarm.yaml will move" in capsys.readouterr().err
    terminal.says = True
    assert wires.through_wires(bench())(CLOSED) == "flown"
    assert terminal.asked == ["Is its surrounding free, and somebody at the emergency stop?"] * 2


def test_leave_given_before_is_not_asked_for_and_what_moves_is_said(terminal, capsys):
    assert wires.through_wires(bench(yes=True))(CLOSED) == "flown"
    assert terminal.asked == []
    assert "The robot of softarm.yaml will move" in capsys.readouterr().err


def test_nobody_is_asked_about_a_twin(terminal):
    assert wires.through_wires(bench(twin=True))(closed(Config())) == "flown"
    assert terminal.asked == []


def test_no_leave_stands_for_limits_that_nobody_knows(terminal):
    still = wires.through_wires(bench(yes=True))(closed(Config()))
    assert still.ended.startswith("limits.rail.latency_s is neither configured nor seen")
    assert terminal.flown == []


def test_where_nobody_can_be_asked_it_is_said_before_minutes_of_work(terminal, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    wires.check_wires(Path("softarm.yaml"), twin=False, yes=False)
    assert "softarm.yaml: its robot will not move, for nobody can be asked; give --yes" in capsys.readouterr().err
    assert wires.through_wires(bench())(CLOSED).ended == "nobody could be asked; give --yes"
    wires.check_wires(Path("softarm.yaml"), twin=True, yes=False)
    assert capsys.readouterr().err == ""
