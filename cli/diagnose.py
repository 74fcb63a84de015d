"""`softarm diagnose`: where robot and simulator differ, which effect is behind it, how far the gap shrinks."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.options import FILE

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from softarm.diagnosis.gap.result import Diagnosis
    from softarm.diagnosis.trials import Trial
    from softarm.schemas.model import Model

INPUT = click.Path(path_type=Path)
FOLDER = click.Path(path_type=Path, file_okay=False)
_TABLES = (".yaml", ".yml")
_READING = 0.05  # share of the bar that reading takes


@click.command()
@click.argument("inputs", metavar="INPUT...", type=INPUT, nargs=-1, required=True)
@click.option("--model", "model_file", type=FILE, help="Nominal simulator: a file or a shipped name "
              "(default: the campaign's model.yaml, else seed).")  # fmt: skip
@click.option("--data", type=FOLDER, help="Where the files of a stage.yaml lie (default: beside it).")
@click.option("--json", "json_file", type=FILE, help="Write the verdict to this file.")
@click.option("--report", "report_file", type=FILE, help="Write the report, one HTML page, to this file.")
@click.option("--patch", "patch_file", type=FILE, help="Write the model with the named effects to this file.")
def diagnose(
    inputs: tuple[Path, ...],
    model_file: Path | None,
    data: Path | None,
    json_file: Path | None,
    report_file: Path | None,
    patch_file: Path | None,
) -> None:
    """Find the effect that a simulator lacks, by recordings of the robot.

    An INPUT is a log of the daemon (.mcap), a trial folder, a campaign of them, or the stage.yaml of another rig. The
    verdict is named, incomplete, unknown or none; each of them is an answer, and the exit code is 0.

    \b
    Examples:
      softarm diagnose campaign --json verdict.json --report report.html --patch patched-model.yaml
      softarm diagnose logs/*.mcap --model mine.yaml --report report.html
      softarm diagnose stage.yaml --data recordings --json verdict.json
    """
    from rich.console import Console

    from softarm.cli.errors import fail
    from softarm.diagnosis import report
    from softarm.diagnosis.trials import TrialError
    from softarm.simulator import model_file as files

    tables = [path for path in inputs if path.suffix in _TABLES]
    if data is not None and not tables:
        raise click.UsageError("--data is where the files of a stage.yaml lie: name one as INPUT, or leave --data out")
    _check_places([path for path in (json_file, report_file, patch_file) if path is not None])
    console = Console()
    try:
        result = run(inputs, model_file, data, console)
    except (TrialError, files.ModelFileError) as error:
        fail(str(error))
    written = []
    try:
        if json_file is not None:
            json_file.write_text(result.verdict.model_dump_json(indent=1) + "\n", encoding="utf-8")
            written.append(json_file)
        if report_file is not None:
            report.write(result, report_file)
            written.append(report_file)
        if patch_file is not None and result.patched is not None:
            files.save(result.patched, patch_file)
            written.append(patch_file)
    except OSError as error:
        fail(f"{error.filename}: cannot be written ({error.strerror}); name another place")
    _show(result, console, json_file)
    if patch_file is not None and result.patched is None:
        click.echo(f"{patch_file}: not written, {_no_patch(result)}", err=True)
    if written:
        console.print(f"wrote {', '.join(map(str, written))}", soft_wrap=True, highlight=False)


def _check_places(paths: list[Path]) -> None:
    """Before minutes of work: can the results be put there? Ends the command with a sentence where not."""
    from softarm.cli.errors import fail

    for path in paths:
        if not path.parent.is_dir():
            fail(f"{path}: there is no folder {path.parent}; make it, or name another place")


def run(inputs: tuple[Path, ...], model_file: Path | None, data: Path | None, console: "Console") -> "Diagnosis":
    """Read and diagnose, with a bar. Raises TrialError and ModelFileError."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from softarm.diagnosis.diagnose import diagnose

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)

        def tell(text: str, share: float) -> None:
            bar.update(task, description=text, completed=_READING + share * (1 - _READING))

        trials = _read(inputs, data, lambda source: bar.update(task, description=f"reading {source.name}"))
        return diagnose(trials, _nominal(inputs, model_file, trials), tell)


def _read(inputs: tuple[Path, ...], data: Path | None, on_trial: "Callable[[Path], None]") -> "tuple[Trial, ...]":
    """Every trial of the inputs; the files of a stage.yaml may lie in `data`. Raises TrialError."""
    from softarm.diagnosis import tables
    from softarm.diagnosis.read import read_all
    from softarm.diagnosis.trials import unique_names

    if data is None:
        return read_all(inputs, on_trial)
    rest = read_all([path for path in inputs if path.suffix not in _TABLES], on_trial)
    own = (trial for path in inputs if path.suffix in _TABLES for trial in tables.read(path, data))
    return unique_names((*rest, *own))


def _nominal(inputs: tuple[Path, ...], model_file: Path | None, trials: "tuple[Trial, ...]") -> "Model | None":
    """The simulator in question: --model, a campaign's model.yaml, else the seed's; None for another rig's tables.

    Raises TrialError for campaigns with several, ModelFileError for one that cannot be read.
    """
    from softarm.diagnosis.folder import is_trial
    from softarm.diagnosis.trials import TrialError
    from softarm.schemas.model import Model
    from softarm.simulator import model_file as files

    if all(trial.stage is not None for trial in trials):
        return None
    if model_file is not None:
        return files.load(model_file)
    campaigns = {path if path.is_dir() and not is_trial(path) else path.parent for path in inputs}
    beside = sorted(folder / "model.yaml" for folder in campaigns)
    models = {path: files.load(path) for path in beside if path.is_file()}
    if not models:
        click.echo("no --model and no model.yaml beside the trials: the seed's simulator is taken as nominal", err=True)
        return Model()
    (one, model), *others = models.items()
    for other, another in others:
        if another != model:
            raise TrialError(f"{one} and {other} differ; say by --model which of the simulators is meant")
    return model


def _no_patch(result: "Diagnosis") -> str:
    if result.nominal is None:
        return "another rig has no model file; the parameters stand in the verdict"
    return f"nothing was named (verdict: {result.verdict.verdict})"


def _show(result: "Diagnosis", console: "Console", json_file: Path | None) -> None:
    """The answer in three sentences, a row a stage, every doubt."""
    from rich.table import Table

    from softarm.diagnosis import report
    from softarm.pages.numbers import percent, quantity

    verdict, gap = result.verdict, result.verdict.gap
    for sentence in report.answer(result):
        console.print(sentence, markup=False, highlight=False)
    table = Table("stage", "share", "before", "after", "ceiling", "floor")
    for stage, before in gap.before.items():
        share = verdict.where.share.get(stage)
        after = gap.after.get(stage) if verdict.effects else None
        others = (before, after, gap.ceiling.get(stage), gap.floor.get(stage))
        cells = [quantity(q.value, q.unit) if q else "-" for q in others]
        table.add_row(stage, "-" if share is None else percent(share), *cells)
    console.print(table)
    if verdict.next_experiment is not None:
        plan = verdict.next_experiment
        file = json_file or "VERDICT.json (of --json)"
        split = f" tells {', '.join(plan.separates)} apart" if plan.separates else ""
        console.print(f"next: the excitation {plan.excitation}{split}: softarm excite --plan {file}",
                      markup=False, highlight=False, soft_wrap=True)  # fmt: skip
    for warning in verdict.warnings:
        click.echo(f"warning: {warning}", err=True)
