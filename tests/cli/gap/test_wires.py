"""Tests of the confirmation before `softarm close-gap --config` moves a robot."""

from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from softarm.cli.gap import close_gap as wires
from softarm.evaluation.closing import story
from softarm.schemas.config import Config, Limits, RailLimits
from tests.evaluation.closing.cases import findings

SAID = ("latency_s", "braking_m_s2", "surge_m_s2", "drag_m_s")
KNOWN = Config(limits=Limits(rail=RailLimits(**{key: getattr(RailLimits(), key) for key in SAID})))


def closed(config=KNOWN):
    return SimpleNamespace(retrained=object(), rail=findings(config))


CLOSED = closed()


def bench(file=Path("softarm.yaml"), **changed):
    usual = {"twin": False, "robot": "reality", "declared": True, "yes": False, "goals": 1, "out": Path("out")}
    return wires.Bench(file, **usual | changed, spent={})


@pytest.fixture
def terminal(monkeypatch):
    """Simulate a person at a terminal and return the answers, questions and flights."""
    person = SimpleNamespace(confirms=False, flown=[], asked=[])

    def confirm(text, **options):
        assert options["default"] is False
        person.asked.append(text)
        return person.confirms

    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(click, "confirm", confirm)
    monkeypatch.setattr(story, "sentences", lambda closed: ["Fly the retrained one."])
    monkeypatch.setattr(wires, "_flown", lambda *arguments: person.flown.append(arguments) or "flown")
    return person


def test_without_a_configuration_nothing_moves(terminal):
    assert wires.through_wires(bench(file=None), CLOSED) is None
    assert wires.through_wires(bench(), SimpleNamespace(retrained=None)) is None
    assert terminal.asked == []


def test_a_robot_moves_only_after_a_person_confirms(terminal, capsys):
    still = wires.through_wires(bench(), CLOSED)
    assert (still.title, still.ended, still.flights) == ("the robot of softarm.yaml", "not confirmed", 0)
    assert "Fly the retrained one.\nThe robot of softarm.yaml will move" in capsys.readouterr().err
    terminal.confirms = True
    assert wires.through_wires(bench(), CLOSED) == "flown"
    assert terminal.asked == ["Is the area clear, and is a person at the emergency stop?"] * 2


def test_the_yes_option_skips_the_question_and_prints_the_motion(terminal, capsys):
    assert wires.through_wires(bench(yes=True), CLOSED) == "flown"
    assert terminal.asked == []
    assert "The robot of softarm.yaml will move" in capsys.readouterr().err


def test_a_twin_needs_no_confirmation(terminal):
    assert wires.through_wires(bench(twin=True), closed(Config())) == "flown"
    assert terminal.asked == []


def test_unknown_limits_refuse_motion_even_with_the_yes_option(terminal):
    still = wires.through_wires(bench(yes=True), closed(Config()))
    assert still.ended.startswith("limits.rail.latency_s is neither configured nor measured")
    assert terminal.flown == []


def test_a_missing_terminal_is_reported_before_the_long_work(terminal, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    wires.check_wires(Path("softarm.yaml"), twin=False, yes=False)
    assert "softarm.yaml: its robot will not move without confirmation; add --yes or --twin" in capsys.readouterr().err
    assert wires.through_wires(bench(), CLOSED).ended == "not confirmed, since there is no terminal; add --yes"
    wires.check_wires(Path("softarm.yaml"), twin=True, yes=False)
    assert capsys.readouterr().err == ""
