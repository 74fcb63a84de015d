"""`softarm diagnose`: name the effect that the simulator lacks, and how far it shrinks the gap."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.gap.inputs import refuse_misplaced
from softarm.cli.gap.rail_limits import limits_option, write_limits
from softarm.cli.gap.verdict_text import show
from softarm.cli.shared.errors import writing
from softarm.cli.shared.interrupt import NOTHING, leaves
from softarm.cli.shared.options import FILE, FOLDER, INPUT, check_places
from softarm.cli.shared.printing import warn
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.diagnosis.engine.result import Diagnosis


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
    "--budget",
    "budget_s",
    type=click.FloatRange(min=0.0, min_open=True),
    default=120.0,
    show_default=True,
    metavar="SECONDS",
    help="Processor time for another rig; of longer recordings the most informative stretches are used.",
)
@limits_option
def diagnose(
    inputs: tuple[Path, ...],
    model_file: Path | None,
    data: Path | None,
    json_file: Path | None,
    report_file: Path | None,
    patch_file: Path | None,
    calibration: bool,
    budget_s: float,
    limits_file: Path | None,
) -> None:
    """Find the effect that a simulator lacks, from recordings of the robot.

    An INPUT is a log of the daemon (.mcap), a trial folder, a campaign of them, or the stage.yaml of another rig. The
    verdict is named, incomplete, unknown or none; the exit code is 0 for each of them.

    \b
    Examples:
      softarm diagnose campaign --json verdict.json --report report.html --patch patched-model.yaml
      softarm diagnose logs/*.mcap --model mine.yaml --report report.html --limits limits-patch.yaml
      softarm diagnose stage.yaml --data recordings --json verdict.json --patch patched.xml
    """
    from softarm.common import files
    from softarm.diagnosis import report
    from softarm.diagnosis.data.read import TABLES
    from softarm.diagnosis.from_files import diagnose_files
    from softarm.diagnosis.rigs import patch
    from softarm.simulator import model_file as models

    if data is not None and not any(path.suffix in TABLES for path in inputs):
        raise click.UsageError("--data is for the data files of a stage.yaml: name one as INPUT, or omit --data")
    if model_file is not None and (stage := next((path for path in inputs if path.suffix in TABLES), None)):
        raise click.UsageError(
            f"--model is the simulator of the robot, but {stage} is another rig and holds its own nominal model; omit "
            f"--model, and write the values under `model:` in {stage}"
        )
    refuse_misplaced(inputs)
    check_places(json_file, report_file, patch_file, limits_file)
    mjcf = _mjcf_of(inputs, data) if patch_file is not None and patch_file.suffix == ".xml" else None
    leaves(NOTHING)
    with bar("reading") as shown:
        result = diagnose_files(inputs, model_file, data, shown.report, warn, budget_s)
    written = []
    stage_files = [path for path in inputs if path.suffix in TABLES]
    patched = result.calibrated if calibration else result.patched
    rig_patch = None
    if patch_file is not None and len(stage_files) == 1:
        if mjcf is not None:
            rig_patch = _mjcf_patch(mjcf, result, calibration)
        else:
            rig_patch = patch.patched(stage_files[0], result.verdict, calibration)
    with writing():
        if json_file is not None:
            files.write_text(json_file, result.verdict.model_dump_json(indent=1) + "\n")
            written.append(json_file)
        if report_file is not None:
            report.write(result, report_file)
            written.append(report_file)
        if patch_file is not None and patched is not None:
            models.save(patched, patch_file)
            written.append(patch_file)
        elif patch_file is not None and rig_patch is not None:
            files.write_text(patch_file, rig_patch)
            written.append(patch_file)
        if limits_file is not None:
            write_limits(inputs, limits_file, result.verdict)
            written.append(limits_file)
    show(result, json_file)
    if patch_file is not None and patch_file not in written:
        click.echo(f"{patch_file}: not written, {_no_patch(result, len(stage_files))}", err=True)
    if written:
        click.echo(f"wrote {', '.join(map(str, written))}")


def _mjcf_of(inputs: tuple[Path, ...], data: Path | None) -> Path:
    """Return the MJCF file of the only input; end the command if it is no stage.yaml of kind mujoco."""
    from softarm.diagnosis.data import stage_file
    from softarm.diagnosis.data.read import TABLES

    if len(inputs) != 1 or inputs[0].suffix not in TABLES:
        raise click.UsageError("--patch: .xml is for one stage.yaml of kind mujoco; name a .yaml, or that file alone")
    (stage, *_) = stage_file.load(inputs[0])
    if stage.about.kind != "mujoco":
        raise click.UsageError(f"--patch: .xml is for a stage of kind mujoco; this is {stage.about.kind}: name a .yaml")
    return stage.file(str(stage.about.model["mjcf"]), data or inputs[0].parent)


def _mjcf_patch(model: Path, result: "Diagnosis", calibration: bool) -> str | None:
    """Return the patched text of an MJCF file, and show the changes."""
    from softarm.diagnosis.rigs.mjcf import patch

    found = patch.patched(model, result.verdict, calibration)
    if found is None:
        return None
    click.echo(found.diff.rstrip())
    for text in found.left_out:
        click.echo(f"MJCF has no attribute for {text}; --patch FILE.yaml writes it")
    return found.text


def _no_patch(result: "Diagnosis", stage_files: int) -> str:
    if stage_files > 1:
        return "it is for one stage.yaml; diagnose each file alone"
    return f"no effect was named and nothing calibrated (verdict: {result.verdict.verdict})"
