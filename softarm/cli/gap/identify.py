"""`softarm identify`: fit the arm's stiffness, damping, muscle gain and offset to recordings."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.gap.recorded import limits_option, refuse_misplaced, write_limits
from softarm.cli.shared.console import (
    FILE,
    FOLDER,
    INPUT,
    check_places,
    json_option,
    model_option,
    print_table,
    print_text,
    warn,
)
from softarm.cli.shared.errors import NOTHING, leaves
from softarm.common.processes import bar
from softarm.common.quantity import KPA_PER_PSI

if TYPE_CHECKING:
    from softarm.diagnosis.identify.identify import Identification, IdentifiedParameter


@click.command()
@click.argument("inputs", type=INPUT, nargs=-1, required=True)
@click.option("--out", type=FILE, required=True, help="Model file to write.")
@click.option("--check", "checks", type=INPUT, multiple=True, help="Held-out recording, only compared; repeatable.")
@click.option("--plots", type=FOLDER, help="Folder for pictures (PNG).")
@limits_option
@json_option
@model_option
def identify(
    inputs: tuple[Path, ...],
    out: Path,
    checks: tuple[Path, ...],
    plots: Path | None,
    limits_file: Path | None,
    json_file: Path | None,
    model_file: Path | None,
) -> None:
    """Fit the arm to INPUTS: logs of the daemon (.mcap), trial folders, or campaigns of them.

    It measures parameters that the simulator has; `softarm diagnose` finds effects that it lacks.

    It starts with the paper's method: torques by inverse dynamics, then least squares. It then fits the simulator to
    the motion of every link. The 95 % intervals come from leaving out blocks of 1.5 s. Masses and lengths are those
    of --model. --limits also measures the rail: its worst latency, braking and acceleration.

    \b
    Examples:
      softarm identify logs/seed.mcap --check logs/sinusoid.mcap --out mine.yaml --plots pictures
      softarm identify campaign --out mine.yaml --json mine.json
      softarm identify logs/*.mcap --out mine.yaml --limits limits-patch.yaml
    """
    import json

    from softarm.common import files
    from softarm.diagnosis.data.read import read_all
    from softarm.diagnosis.identify.identify import identify as fit
    from softarm.schemas.model import Model
    from softarm.simulator import model_file as models

    refuse_misplaced((*inputs, *checks))
    check_places(out, json_file, limits_file)
    leaves(NOTHING)
    model = models.load(model_file) if model_file else Model()
    with bar("reading", total=None) as shown:

        def progress(text: object) -> None:
            shown.show(text=str(text))

        trials, held_out = read_all(inputs, progress), read_all(checks, progress)
        result = fit(model, trials, held_out, progress)
    models.save(result.model, out)
    summary = result.summary()
    if limits_file is not None:
        summary |= {"limits": write_limits((*inputs, *checks), limits_file).summary()}
    if json_file is not None:
        files.write_text(json_file, json.dumps(summary, indent=1) + "\n")
    pictures = _pictures(result, plots)
    _show(result)
    written = [out, *filter(None, (json_file, limits_file)), *pictures]
    click.echo(f"wrote {', '.join(map(str, written))}")


def _pictures(result: "Identification", folder: Path | None) -> list[Path]:
    if folder is None:
        return []
    from softarm.diagnosis.identify import plots

    return plots.save(result, folder)


def _show(result: "Identification") -> None:
    """Print the parameters with their intervals, the errors of the fit and every warning."""
    rows = [
        (str(number), _cell(k), _cell(d), _cell(b, 6), f"{b['value'] * KPA_PER_PSI:.4f}", _cell(o))
        for number, (k, d, b, o) in enumerate(result.joints, 1)
    ]
    print_table(("joint", "K (N m/rad)", "D (N m s/rad)", "b (N m/kPa)", "b (N m/psi)", "offset (N m)"), rows)
    low, high = result.regression.range_nm
    print_text(
        f"torque RMSE {result.regression.rmse_nm:.4f} N m by regression, {result.torque_rmse_nm:.4f} N m refined "
        f"(torques {low:.2f} .. {high:.2f} N m); link ends within {result.refinement.rmse_m * 1e3:.2f} mm RMS"
    )
    for check in result.checks:
        y, z = check.rmse_m
        print_text(f"held-out {check.trial}: tip within {y * 1e3:.2f} mm in y, {z * 1e3:.2f} mm in z RMS")
    warn(*(f"warning: {text}" for text in result.warnings))


def _cell(estimate: "IdentifiedParameter", digits: int = 4) -> str:
    half = (estimate["high"] - estimate["low"]) / 2
    return f"{estimate['value']:.{digits}f} ±{half:.{digits}f}"
