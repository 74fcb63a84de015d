"""Findings of all checks of this computer: `softarm check`, `softarm doctor` and the start of the daemon."""

from enum import StrEnum
from typing import NamedTuple

from softarm.common.yaml_lines import Place


class State(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    # The arm can fly, with restrictions.
    WARNING = "warning"
    # The arm cannot fly.
    PROBLEM = "problem"


class Finding(NamedTuple):
    """Result of one check."""

    name: str
    state: State
    figure: str  # the result with value and unit, and the allowed values
    advice: str = ""  # the next step
    place: Place = ()  # key of the configuration that causes the finding


def ok(name: str, figure: str, advice: str = "") -> Finding:
    """Return a finding without a problem; `advice` may name an option."""
    return Finding(name, State.OK, figure, advice)


def warning(name: str, figure: str, advice: str) -> Finding:
    """Return a finding that does not prevent a flight."""
    return Finding(name, State.WARNING, figure, advice)


def problem(name: str, figure: str, advice: str = "", place: Place = ()) -> Finding:
    """Return a finding that prevents a flight."""
    return Finding(name, State.PROBLEM, figure, advice, place)


def graded(name: str, state: State, figure: str, advice: str) -> Finding:
    """Return a finding of any severity; one without a problem needs no advice."""
    return Finding(name, state, figure, "" if state is State.OK else advice)


def by(value: float, fine: float, bearable: float) -> State:
    """Return the severity of a value that is better the smaller it is; NaN is a problem."""
    return State.OK if value <= fine else State.WARNING if value <= bearable else State.PROBLEM
