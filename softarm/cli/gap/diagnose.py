"""`softarm diagnose`: name the effect that the simulator lacks, and how far it shrinks the gap."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.gap.recorded import limits_option, refuse_misplaced, write_limits
from softarm.cli.shared.console import (
    FILE,
    FOLDER,
    INPUT,
    WIDE,
    Number,
    check_places,
    print_table,
    print_text,
    typed,
    warn,
)
from softarm.cli.shared.errors import NOTHING, fail, leaves
from softarm.common.batch import Workers, workers_options
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.diagnosis.engine.result import Diagnosis
    from softarm.diagnosis.many import Options
    from softarm.schemas.verdict import Verdict


@click.command()
@click.argument("inputs", metavar="INPUT...", type=INPUT, nargs=-1, required=True)
@click.option(
    "--model",
    "model_file",
    type=FILE,
    help="Nominal simulator: a file or a shipped name (default: the campaign's model.yaml, else seed).",
)
@click.option("--data", type=FOLDER, help="Folder of the data files of a stage.yaml (default: its own folder).")
@click.option("--json", "json_file", type=FILE, help="Write the verdict to this file.")
@click.option("--report", "report_file", type=FILE, help="Write the report, one HTML page, to this file.")
@click.option(
    "--patch",
    "patch_file",
    type=FILE,
    help="Write the model with effects and calibration to this file; .xml for a MuJoCo model.",
)
@click.option("--calibration/--no-calibration", default=True, help="Write the calibration to the patch as well.")
@click.option(
    "--best-fit", is_flag=True, help="Patch of a rig: write the effects that predict best, named or not; no diagnosis."
)
@click.option(
    "--budget",
    "budget_s",
    type=Number(min=0.0, min_open=True),
    default=120.0,
    show_default=True,
    metavar="SECONDS",
    help="Processor time for another rig; of longer recordings the most informative stretches are used.",
)
@limits_option
@click.option("--out", type=FOLDER, help="Diagnose each INPUT on its own, and write all results to this folder.")
@workers_options("With --out: ")
def diagnose(
    inputs: tuple[Path, ...],
    model_file: Path | None,
    data: Path | None,
    json_file: Path | None,
    report_file: Path | None,
    patch_file: Path | None,
    calibration: bool,
    best_fit: bool,
    budget_s: float,
    limits_file: Path | None,
    out: Path | None,
    workers: Workers,
) -> None:
    """Find the effect that a simulator lacks, from recordings of the robot.

    An INPUT is a log of the daemon (.mcap), a trial folder, a campaign of them, or the stage.yaml of another rig or
    its folder. The verdict is named, incomplete, unknown or none; the exit code is 0 for each of them.

    Without --out, all INPUTs are recordings of one robot. With --out, each is diagnosed on its own: a table in the
    terminal, index.html and index.json of all, and NAME.html, NAME.json and NAME.yaml (the patch) of each. The same
    command resumes.

    \b
    Examples:
      softarm diagnose campaign --json verdict.json --report report.html --patch patched-model.yaml
      softarm diagnose logs/*.mcap --model mine.yaml --report report.html --limits limits-patch.yaml
      softarm diagnose stage.yaml --data recordings --json verdict.json --patch patched.xml
      softarm diagnose campaigns/* rigs/* --out reports --workers 4
    """
    from softarm.common import files
    from softarm.diagnosis import report
    from softarm.diagnosis.data.read import TABLES, stage_of_folder
    from softarm.diagnosis.diagnose import diagnose_files
    from softarm.diagnosis.many import Options, patch

    inputs = tuple(map(stage_of_folder, inputs))
    stages = [path for path in inputs if path.suffix in TABLES]
    if best_fit and (patch_file is None or not stages):
        raise click.UsageError("--best-fit is for the patch of a stage.yaml: add --patch FILE, or omit --best-fit")
    _refuse_misused(stages, data, model_file if out is None else None, limits_file)
    refuse_misplaced(inputs)
    places = {"--json": json_file, "--report": report_file, "--patch": patch_file, "--limits": limits_file}
    if out is not None:
        if wrong := [name for name, place in {**places, "--data": data}.items() if place is not None]:
            raise click.UsageError(f"{wrong[0]} is for one diagnosis: omit it, or omit --out")
        _diagnose_all(inputs, Options(out, model_file, budget_s, calibration), workers)
        return
    if wrong := [name for name in typed() if name in ("--workers", "--ray")]:
        raise click.UsageError(f"{wrong[0]} is for many diagnoses: add --out FOLDER")
    check_places(*places.values())
    mjcf = _mjcf_of(patch_file, inputs, data)
    leaves(NOTHING)
    with bar("reading") as shown:
        result = diagnose_files(inputs, model_file, data, shown.report, warn, budget_s)
    patched = None
    if mjcf is not None:
        patched = _mjcf_patch(mjcf, result, calibration, best_fit)
    elif patch_file is not None and len(stages) < 2:
        patched = patch(result, stages[0] if stages else None, calibration, best_fit)
    if json_file is not None:
        files.write_text(json_file, result.verdict.model_dump_json(indent=1) + "\n")
    if report_file is not None:
        report.write(result, report_file)
    if patch_file is not None and patched is not None:
        files.write_text(patch_file, patched)
    if limits_file is not None:
        write_limits(inputs, limits_file, result.verdict)
    places["--patch"] = patch_file if patched is not None else None
    written = [str(place) for place in places.values() if place is not None]
    show(result, json_file)
    if patch_file is not None and patched is None:
        reason = _no_patch(result.verdict, len(stages), calibration, best_fit)
        click.echo(f"{patch_file}: not written, {reason}", err=True)
    if written:
        click.echo(f"wrote {', '.join(written)}")


def _refuse_misused(stages: list[Path], data: Path | None, model: Path | None, limits: Path | None) -> None:
    """Raise UsageError if an option of a robot is given with the stage.yaml of another rig, or the other way round."""
    if data is not None and not stages:
        raise click.UsageError("--data is for the data files of a stage.yaml: name one as INPUT, or omit --data")
    if model is not None and stages:
        raise click.UsageError(
            f"--model is the simulator of the robot, but {stages[0]} is another rig and holds its own nominal model; "
            f"omit --model, and write the values under `model:` in {stages[0]}"
        )
    if limits is not None and stages:
        raise click.UsageError(f"--limits is for the rail of the robot, but {stages[0]} is another rig; omit --limits")


def _diagnose_all(inputs: tuple[Path, ...], options: "Options", workers: Workers) -> None:
    """Diagnose each input on its own and print the table; end the command with exit code 1 if one has failed."""
    from softarm.diagnosis import many

    leaves(f"finished diagnoses are kept in {options.out}; the same command continues")
    rows = many.diagnose_all(inputs, options, workers)
    print_table(many.COLUMNS, [(row["name"], *many.cells(row)) for row in rows])
    warn(*(f"{row['name']}: {note}" for row in rows for note in row["notes"]))
    click.echo(f"wrote {options.out / 'index.html'} and {options.out / 'index.json'}")
    if failed := [f"{row['input']}: {row['failure']}" for row in rows if row["failure"]]:
        fail("\n".join(failed))


def _mjcf_of(patch: Path | None, inputs: tuple[Path, ...], data: Path | None) -> Path | None:
    """Return the MJCF file that a patch changes, None for a YAML patch; end the command if it cannot be written."""
    from softarm.diagnosis.data import stage_file
    from softarm.diagnosis.data.read import TABLES

    if patch is None or patch.suffix.lower() in TABLES:
        return None
    if patch.suffix.lower() != ".xml":
        raise click.UsageError(f"--patch: {patch}; allowed .yaml, or .xml for a MuJoCo model or URDF; rename it")
    if len(inputs) != 1 or inputs[0].suffix not in TABLES:
        raise click.UsageError("--patch: .xml is for one stage.yaml of kind mujoco; name a .yaml, or that file alone")
    (stage, *_) = stage_file.load(inputs[0])
    if stage.about.kind != "mujoco":
        raise click.UsageError(f"--patch: .xml is for a stage of kind mujoco; this is {stage.about.kind}: name a .yaml")
    return stage.file(str(stage.about.model["mjcf"]), data or inputs[0].parent)


def _mjcf_patch(model: Path, result: "Diagnosis", calibration: bool, best_fit: bool) -> str | None:
    """Return the patched text of an MJCF file, and show the changes."""
    from softarm.diagnosis.rigs.mjcf import patch

    found = patch.patched(model, result.verdict, calibration, best_fit)
    if found is None:
        return None
    for text in (found.diff.rstrip(), *(f"left out: {text}" for text in found.left_out)):
        if text:
            click.echo(text)
    return found.text if found.diff else None


def _no_patch(verdict: "Verdict", stage_files: int, calibration: bool, best_fit: bool) -> str:
    """Return why there is no patch."""
    if stage_files > 1:
        return "it is for one stage.yaml; diagnose each file alone"
    if verdict.findings(calibration, best_fit):
        return "since no finding changes the model (see above)"
    if verdict.findings(calibration=True):
        return f"no effect was named (verdict: {verdict.verdict}); for the calibration omit --no-calibration"
    return f"no effect was named and nothing calibrated (verdict: {verdict.verdict})"


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
    print_table(("stage", "share", "before", "after", "calibrated", "ceiling", "floor"), rows, width=WIDE)
    if verdict.calibration and verdict.effects:
        print_text(report.calibration_in_words(result))
    if shown := [each for each in verdict.calibration if each.shrink > CALIBRATION_SHOWN]:
        found = [
            (each.name, quantity(each.nominal, each.unit), report.interval(each, each.unit), report.tolerance(each))
            for each in shown
        ]
        print_table(("calibrated", "nominal", "fitted, 95 % interval", "tolerance"), found, width=WIDE)
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
