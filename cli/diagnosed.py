"""What a diagnosis says, on the terminal."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.printing import print_table, print_text

if TYPE_CHECKING:
    from softarm.diagnosis.engine.result import Diagnosis

CONFIG = "softarm.yaml"  # of the robot; a diagnosis does without


def show(result: "Diagnosis", json_file: Path | None) -> None:
    """The answer in three sentences, stages one by one where several differ, a row a stage, the next step, doubts."""
    from softarm.diagnosis import report
    from softarm.pages.numbers import percent, quantity

    verdict, gap = result.verdict, result.verdict.gap
    print_text("\n".join(report.answer(result)))
    if len({effect.name.rpartition(".")[0] for effect in verdict.effects}) > 1:
        print_text("\n".join(f"{stage}: {text}" for stage, text in report.paragraphs(result).items()))
    rows = []
    for stage, before in gap.before.items():
        share = verdict.where.share.get(stage)
        after = gap.after.get(stage) if verdict.effects else None
        others = (before, after, gap.ceiling.get(stage), gap.floor.get(stage))
        cells = [quantity(q.value, q.unit) if q else "-" for q in others]
        rows.append((stage, "-" if share is None else percent(share), *cells))
    print_table(("stage", "share", "before", "after", "ceiling", "floor"), rows)
    if (flight := report.flight(result)) is not None and verdict.next_experiment is not None:
        apart = verdict.next_experiment.separates
        split = f" tells {', '.join(apart)} apart" if apart else ""
        click.echo(f"next: the excitation {flight.name}{split}: {_command(flight.name, json_file)}")
    for step in report.steps(result):
        print_text(f"next: {step}")
    for warning in verdict.warnings:
        click.echo(f"warning: {warning}", err=True)


def _command(excitation: str, json_file: Path | None) -> str:
    """What plays it, as it can be typed: from the verdict if one was written, on the robot if its file is here."""
    what = f"--plan {shlex.quote(str(json_file))}" if json_file is not None else excitation
    if Path(CONFIG).is_file():
        return f"softarm excite {what} --config {CONFIG}"
    return (
        f"softarm excite {what} --simulated\n(that is a simulated robot; for yours, --config and its file in its place)"
    )
