"""`softarm check` of a rig's stage.yaml: find everything that `softarm diagnose` would refuse."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.errors import fail
from softarm.cli.shared.printing import print_table

if TYPE_CHECKING:
    from softarm.diagnosis.data.trials import Trial

WARNINGS_MAX = 20  # printed; the rest is counted


def check_stage(file: Path, data: Path | None) -> None:
    """Read every trial and column, build each stage's view, and print their contents. Exits with 1 for mistakes."""
    from softarm.diagnosis.data import tables
    from softarm.diagnosis.data.trials import TrialError
    from softarm.diagnosis.rigs.diagnose import view_of

    trials = tables.read(file, data)
    columns = ("trial", "kind", "channel", "rows", "seconds", "column", "from", "to", "unit")
    rows = dict.fromkeys(row for trial in trials for row in _rows(trial))
    print_table(columns, [*rows], f"{file}: contents", width=140)
    stages = {trial.stage.name: trial.stage.kind for trial in trials if trial.stage is not None}
    problems = []
    for name in stages:
        try:
            view_of([trial for trial in trials if trial.stage is not None and trial.stage.name == name])
        except TrialError as error:
            problems.append(str(error))
    warnings = [*dict.fromkeys(text for trial in trials for text in trial.warnings)]
    for text in warnings[:WARNINGS_MAX]:
        click.echo(f"warning: {text}", err=True)
    if len(warnings) > WARNINGS_MAX:
        click.echo(f"warning: and {len(warnings) - WARNINGS_MAX} more", err=True)
    if problems:
        fail("\n".join(problems))
    count = f"{len(trials)} trial{'s' if len(trials) > 1 else ''}"
    click.echo(f"{file}: valid; {count} of {', '.join(f'{name} ({kind})' for name, kind in stages.items())}")


def _rows(trial: "Trial") -> list[tuple[str, ...]]:
    """Return a row for each column of a trial, in the unit of its stage file; joints of one model share theirs."""
    rows: list[tuple[str, ...]] = []
    joint = trial.stage.name if trial.stage is not None and trial.stage.kind == "mujoco" else None
    name = trial.name if joint is None else trial.name.removesuffix(f"/{joint}")
    for channel, series in trial.channels.items():
        seconds = f"{series.t_s[-1] - series.t_s[0]:.4g}"
        for column, values in series.columns.items():
            if joint is not None and channel == "measured" and column != joint:
                continue
            own = trial.stage.units[channel].get(column) if trial.stage is not None else None
            worth, unit = (own.factor, own.name) if own is not None else (1.0, "")
            low, high = f"{values.min() / worth:.4g}", f"{values.max() / worth:.4g}"
            rows.append((name, trial.kind, channel, str(len(series)), seconds, column, low, high, unit))
    return rows
