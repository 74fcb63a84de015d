"""What a check says: how it is, the figure, what to do."""

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARNING = "warning"  # flies, and may not fly well
    PROBLEM = "problem"  # does not fly


class Finding(NamedTuple):
    """One check's answer."""

    name: str
    state: State
    figure: str  # what was found, with its unit
    advice: str = ""  # the next step


def ok(name: str, figure: str, advice: str = "") -> Finding:
    """All is well; advice: what else could be had."""
    return Finding(name, State.OK, figure, advice)


def warning(name: str, figure: str, advice: str) -> Finding:
    """It flies, and may not fly well."""
    return Finding(name, State.WARNING, figure, advice)


def problem(name: str, figure: str, advice: str) -> Finding:
    """It does not fly."""
    return Finding(name, State.PROBLEM, figure, advice)


def by(value: float, fine: float, bearable: float) -> State:
    """Of a number that is better the smaller it is; NaN is a problem."""
    return State.OK if value <= fine else State.WARNING if value <= bearable else State.PROBLEM
