"""Questions of `softarm new rig`: asked at a terminal, otherwise errors that name the option."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.shared.errors import fail

if TYPE_CHECKING:
    from softarm.diagnosis.describe.proposal import Answers, Proposal, Question

RATE = click.FloatRange(min=0, min_open=True)
_VALUES = {"--unit": "UNIT", "--nominal": "NUMBER", "--rate": "HZ", "--command": "COLUMN", "--measured": "COLUMN"}


def is_terminal() -> bool:
    """Return whether somebody can be asked."""
    return sys.stdin.isatty()


def proposed(answers: "Answers", propose: "Callable[[Answers], Proposal]") -> "Proposal":
    """Return the content of the file; ask for unknown facts at a terminal, else end the command with all of them."""
    from softarm.diagnosis.data.trials import TrialError
    from softarm.diagnosis.describe.proposal import Unknown

    before = answers
    while True:
        try:
            return propose(answers)
        except Unknown as unknown:
            if not is_terminal():
                fail("\n".join(map(_lacking, unknown.questions)))
            before, answers = answers, _asked(unknown.questions, answers)
        except TrialError as error:
            if before is answers:
                raise
            click.echo(str(error), err=True)
            answers = before


def _lacking(question: "Question") -> str:
    """Return the error about a fact that no option gives."""
    value = question.prefix + (question.likely or "|".join(question.choices[:1]) or _VALUES[question.option])
    allowed = f"; allowed {', '.join(question.choices)}" if question.choices else ""
    return f"{question.option} is missing: {question.text}{allowed}; add e.g. {question.option} {_quoted(value)}"


def _quoted(value: str) -> str:
    return value if value.replace("=", "").replace("_", "").replace(".", "").isalnum() else f'"{value}"'


def _asked(questions: Sequence["Question"], answers: "Answers") -> "Answers":
    """Return the answers with the reply to the first question."""
    question = questions[0]
    choices = click.Choice(question.choices) if question.choices and question.option != "--measured" else None
    kind: Any = RATE if question.option == "--rate" else choices
    said = click.prompt(question.text[0].upper() + question.text[1:], default=question.likely or None, type=kind)
    match question.option:
        case "--unit":
            return replace(answers, units={**answers.units, question.prefix[:-1]: said})
        case "--nominal":
            return replace(answers, nominal={**answers.nominal, question.prefix[:-1]: said})
        case "--rate":
            return replace(answers, rate_hz=said)
        case "--command":
            return replace(answers, command=(said,))
        case "--measured":
            return replace(answers, measured=tuple(part.strip() for part in said.split(",")))
        case plain:
            return replace(answers, **{plain.removeprefix("--"): said})
