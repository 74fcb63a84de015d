"""Close the gap of hidden faults of the independent robot, singly and in pairs, in all ways.

    python -m validation.closing --out runs/closing --json closing.json

A case records eight trials of a robot with its faults, 135 s together, and runs `softarm close-gap` on them. A case
that the same code has finished in --out is not repeated. Needs the extras `mujoco`, `train` and `diagnosis`.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import click

from benchmarks import results
from softarm.common import files
from softarm.common.processes import bar
from softarm.common.revision import code_version
from softarm.evaluation.closing.fly import fly
from softarm.evaluation.robots import with_faults
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import record
from softarm.schemas.config import Config
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.simulator import model_file
from validation.blind.cases import PROGRAMME

SINGLE = (
    "rail.delay_s=0.09",
    "rail.acceleration_m_s2=2.5",
    "rail.lag_s=0.1",
    "rail.viscous_n_s_m=12",
    "regulator.dead_time_s=0.12",
    "regulator.gain=-0.3",
    "arm.payload_kg=0.1",
    "arm.damping=1",
    "arm.stiffness=0.5",
    "arm.muscle_gain=-0.35",
)
# A fault of the rail with one of another stage.
PAIRS = tuple(zip(SINGLE[:5], SINGLE[5:], strict=True))
CASES = (*((fault,) for fault in SINGLE), *PAIRS)
LEVEL_FLIGHTS = 324
POLICY = "reach"
RETRAINING_S = 120.0


def record_campaign(folder: Path, robot: RobotParameters) -> None:
    """Record eight trials of a robot, and the nominal model."""
    for number, kind in enumerate(PROGRAMME, 1):
        of = EXCITATIONS[kind]
        record(
            of.at, folder / f"trial-{number}", of.duration_s, robot, 1000 + number, kind=kind, held=not of.moves_rail
        )
    model_file.save(Model(), folder / "model.yaml")


def level_of(out: Path) -> float:
    """Return the old policy's success on the robot without a fault, flown once for each folder."""
    file = out / f"level-{POLICY}.json"
    if not file.exists():
        flown = fly(MODELS / f"{POLICY}.onnx", RobotParameters(), Config(), LEVEL_FLIGHTS)
        files.write_text(file, json.dumps(flown.share))
    level: float = json.loads(file.read_text(encoding="utf-8"))
    return level


def closed(case: tuple[str, ...], out: Path) -> dict[str, Any]:
    """Return the summary of a case, made now unless it exists. Raises ClickException if close-gap fails."""
    folder = out / "+".join(case)
    summary = folder / "closed" / "summary.json"
    if not (folder / "campaign" / "model.yaml").exists():
        shutil.rmtree(folder / "campaign", ignore_errors=True)
        record_campaign(folder / "campaign", with_faults(RobotParameters(), case))
    if not summary.exists():
        shutil.rmtree(summary.parent, ignore_errors=True)
        command = [sys.executable, "-m", "softarm.cli.main", "close-gap", str(folder / "campaign")]
        command += ["--out", str(summary.parent), "--policy", POLICY, "--seconds", f"{RETRAINING_S:g}"]
        command += [part for fault in case for part in ("--fault", fault)]
        with (folder / "log.txt").open("w") as log:
            done = subprocess.run(command, check=False, stdout=log, stderr=subprocess.STDOUT)
        if done.returncode not in (0, 3):
            raise click.ClickException(
                f"close-gap ended with {done.returncode}: see {folder / 'log.txt'}, remove {folder}"
            )
    found: dict[str, Any] = json.loads(summary.read_text(encoding="utf-8"))
    return {key: found[key] for key in ("verdict", "effects", "ways", "fly", "spent")}


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default="runs/closing", show_default=True)
@click.option("--cases", type=click.IntRange(1, len(CASES)), default=len(CASES), help="Only the first so many cases.")
@results.json_option
def main(out: Path, cases: int, json_file: Path | None) -> None:
    """Close the gap of ten faults and five pairs, and print a row for each.

    \b
    Example:
      python -m validation.closing --out runs/closing --cases 3 --json closing.json
    """
    out /= code_version()
    out.mkdir(parents=True, exist_ok=True)
    level = level_of(out)
    found: dict[str, dict[str, Any]] = {}
    with bar("closing gaps", cases) as shown:
        for case in CASES[:cases]:
            found["+".join(case)] = closed(case, out)
            results.write(json_file, {"level": level, "cases": found})
            shown.advance(1, "+".join(case))
    results.report("closing", {"level": level, "cases": found}, json_file)


if __name__ == "__main__":
    main()
