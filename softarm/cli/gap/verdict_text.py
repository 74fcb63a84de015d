"""Text of a diagnosis for the terminal."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.printing import print_table, print_text, warn

if TYPE_CHECKING:
    from softarm.diagnosis.engine.result import Diagnosis

CALIBRATION_SHOWN = 0.02  # least share of its stage's gap; the report lists all
CONFIG = "softarm.yaml"  # the robot's configuration, which a diagnosis does not need


def show(result: "Diagnosis", json_file: Path | None) -> None:
    """Print the answer, a paragraph and a table row per stage, the next steps and the warnings."""
    from softarm.diagnosis import report
    from softarm.reporting.numbers import percent, quantity

    verdict, gap = result.verdict, result.verdict.gap
    print_text("\n".join(report.answer(result)))
    if len({effect.name.rpartition(".")[0] for effect in verdict.effects}) > 1:
        print_text("\n".join(f"{stage}: {text}" for stage, text in report.paragraphs(result).items()))
    rows = []
    for stage, before in gap.before.items():
        share = verdict.where.share.get(stage)
        after = gap.after.get(stage) if verdict.effects else None
        others = (before, after, gap.calibrated.get(stage), gap.ceiling.get(stage), gap.floor.get(stage))
        cells = [quantity(q.value, q.unit) if q else "-" for q in others]
        rows.append((stage, "-" if share is None else percent(share), *cells))
    print_table(("stage", "share", "before", "after", "calibrated", "ceiling", "floor"), rows)
    if verdict.calibration and verdict.effects:
        print_text(report.calibration_in_words(result))
    if shown := [each for each in verdict.calibration if each.shrink > CALIBRATION_SHOWN]:
        found = [
            (each.name, quantity(each.nominal, each.unit), report.interval(each, each.unit), report.tolerance(each))
            for each in shown
        ]
        print_table(("calibrated", "nominal", "fitted, 95 % interval", "tolerance"), found)
    if (flight := report.flight(result)) is not None and verdict.next_experiment is not None:
        separated = verdict.next_experiment.separates
        purpose = f" separates {', '.join(separated)}" if separated else ""
        click.echo(f"next: the excitation {flight.name}{purpose}: {_command(flight.name, json_file)}")
    for step in report.steps(result):
        print_text(f"next: {step}")
    warn(*(f"warning: {text}" for text in verdict.warnings))


def _command(excitation: str, json_file: Path | None) -> str:
    """Return the command that plays an excitation, on the robot if its configuration is in this folder."""
    choice = f"--plan {shlex.quote(str(json_file))}" if json_file is not None else excitation
    if Path(CONFIG).is_file():
        return f"softarm excite {choice} --config {CONFIG}"
    return f"softarm excite {choice} --simulated\n(a simulated robot; for yours, use --config FILE instead)"
