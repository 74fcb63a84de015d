"""Diagnose servos whose friction another program simulates, and predict a held-out motion beside that program's fits.

BAM (Better Actuator Models) has six models of friction, with parameters that its authors identified on servos. Its own
simulator records each servo with each model on a pendulum. The diagnosis gets the recordings and an MJCF with the same
numbers, which holds the friction of the first model alone. BAM needs a Python 3.12 of its own, with
`pip install better-actuator-models==1.0.2 cmaes`.

    python -m validation.servos.benchmark make FOLDER --python BAM/bin/python
    python -m validation.servos.benchmark run FOLDER
    python -m validation.servos.benchmark compare FOLDER --python BAM/bin/python
    python -m validation.servos.benchmark score FOLDER --json FILE
"""

import json
import subprocess
import time
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from benchmarks import results
from softarm.cli.shared.errors import failing
from softarm.common import batch
from softarm.common.batch import JobsFailed, Kept, Work
from softarm.common.files import sha256_of
from softarm.diagnosis.data.trials import TrialError
from validation.blind import seal
from validation.rigs.benchmark import FOLDER, answered, run_command

HELD_OUT = "sin_sin-100"
FITTED = "m1", "m6"  # the model that MJCF holds, and the most general one
MODELS = "nominal", *FITTED, "diagnosis"  # compared on the held-out motion
STAGE = """kind: mujoco
name: servo
channels:
  measured:
    time: {source: t, unit: s}
    columns: {servo: {source: servo, unit: rad}}
  command:
    time: {source: t, unit: s}
    columns: {servo: {source: servo_command, unit: rad}}
model: {mjcf: robot.xml}
trials:
"""
_FADING, _LOADED = {"servo.stiction", "servo.coulomb_friction"}, {"servo.load_friction"}
# Model of the friction -> effects of which one is to be named, and further ones that this friction contains.
EXPECTED: Mapping[str, tuple[set[str], set[str]]] = {
    "m1": (set(), set()),
    "m2": (_FADING, set()),
    "m3": (_LOADED, set()),
    "m4": (_LOADED, _FADING),
    "m5": (_LOADED, _FADING),
    "m6": (_LOADED, _FADING),
}


def make(folder: Path, python: Path) -> int:
    """Record all cases and return their number. Raises TrialError if BAM cannot record them."""
    _bam(python, "recorder.py", str(folder))
    cases = sorted((folder / "data").iterdir())
    for case in cases:
        (case / "stage.yaml").write_text(_stage(case), encoding="utf-8")
    return len(cases)


def _stage(case: Path, without: str = "") -> str:
    """Return the description of a case's recordings, all but one."""
    names = sorted(file.stem for file in (case / "recordings").glob("*.csv") if file.stem != without)
    rows = (f"  - {{name: {n}, kind: {n.rpartition('-')[0]}, files: recordings/{n}.csv}}\n" for n in names)
    return STAGE + "".join(rows)


def _bam(python: Path, program: str, *arguments: str) -> str:
    """Return the output of a program of this package in BAM's Python."""
    command = [str(python), str(Path(__file__).parent / program), *arguments]
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        why = getattr(error, "stderr", "") or str(error)
        raise TrialError(
            f"{python}: cannot run {program} ({why.strip().splitlines()[-1]}); give a Python 3.12 with "
            "better-actuator-models==1.0.2 and cmaes"
        ) from error


def outcome(truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> str:
    """Return right, more (right and a foreign name), silent or wrong."""
    needed, further = EXPECTED[truth["law"]]
    groups = [{each["name"], *each["equivalents"]} for each in verdict["effects"]]
    if not groups:
        return "silent" if needed or verdict["verdict"] != "none" else "right"
    if not any(group & needed for group in groups):
        return "wrong"
    return "right" if all(group & (needed | further) for group in groups) else "more"


def compare(folder: Path, python: Path, law: str) -> None:
    """Predict the held-out motion of every servo with one model of friction, and keep it in FOLDER/compared."""
    cases = {case.name: case for case in sorted((folder / "data").glob(f"*-{law}"))}
    fit = sha256_of(Path(__file__).with_name("fit.py"))
    kept = Kept(
        lambda name: folder / "compared" / f"{name}.json",
        lambda name: {"tool": seal.tool_version(), "data": sha256_of(cases[name]), "fit": fit},
    )
    work = Work(partial(_compared, logs=folder / "logs", python=python))
    batch.run("comparing", work, cases, kept=kept).complete()


def _compared(case: Path, logs: Path, python: Path) -> dict[str, Any]:
    """Return errors on the held-out motion, RMS in rad, and processor seconds, by model."""
    figures = {"nominal": {"rms_rad": _left(case, case / "robot.xml", None)}, "diagnosis": _diagnosed(case)}
    servo = case.name.rpartition("-")[0]
    for law in FITTED:
        figures[law] = json.loads(_bam(python, "fit.py", str(logs / case.name), servo, law, HELD_OUT))
    return figures


def _diagnosed(case: Path) -> dict[str, float]:
    from softarm.diagnosis.diagnose import diagnose_files
    from softarm.diagnosis.rigs.mjcf.patch import patched

    with TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "recordings").symlink_to(case / "recordings")
        (place / "robot.xml").write_bytes((case / "robot.xml").read_bytes())
        (place / "stage.yaml").write_text(_stage(case, HELD_OUT), encoding="utf-8")
        began = time.process_time()
        verdict = diagnose_files([place / "stage.yaml"], processes=1).verdict
        seconds = time.process_time() - began
        answer, model = place / "verdict.json", place / "patched.xml"
        answer.write_text(verdict.model_dump_json())
        patch = patched(place / "robot.xml", verdict, calibration=True, best_fit=True)
        model.write_text((place / "robot.xml").read_text() if patch is None else patch.text)
        return {"rms_rad": _left(case, model, answer), "processor_s": seconds}


def _left(case: Path, model: Path, verdict: Path | None) -> float:
    """Return the RMS error of a free simulation of the held-out motion, rad."""
    import mujoco

    from softarm.diagnosis.rigs.mjcf.runtime import RuntimeEffects, Simulation

    t, command, angle = np.loadtxt(case / "recordings" / f"{HELD_OUT}.csv", delimiter=",", skiprows=1).T
    robot = mujoco.MjModel.from_xml_path(str(model))
    data = mujoco.MjData(robot)
    data.qpos[0], data.ctrl[0] = angle[0], command[0]
    effects = None if verdict is None else Simulation(RuntimeEffects.read(verdict, model, best_fit=True), robot, data)
    seen, each = [], round((t[1] - t[0]) / robot.opt.timestep)
    for wanted in command:
        seen.append(data.qpos[0] if effects is None else effects.readings[0])
        for _ in range(each):
            if effects is None:
                data.ctrl[0] = wanted
                mujoco.mj_step(robot, data)
            else:
                effects.step(np.array([wanted]))
    return float(np.sqrt(np.mean((np.array(seen) - angle) ** 2)))


def score(folder: Path) -> dict[str, Any]:
    """Return outcomes by model of friction, sizes beside the true ones, and the errors on the held-out motion."""
    cases = answered(folder)
    if any(reply["tool"] != seal.tool_version() for _, reply in cases):
        raise TrialError(f"{folder}: contains answers of another version; use `run` again")
    found: dict[str, Counter[str]] = {law: Counter() for law in EXPECTED}
    for truth, reply in cases:
        found[truth["law"]][outcome(truth, reply["verdict"]) if reply["verdict"] else "failed"] += 1
    compared = {file.stem: json.loads(file.read_text()) for file in sorted((folder / "compared").glob("*.json"))}
    return {
        "outcomes": {law: dict(counts) for law, counts in found.items()},
        "shares": {truth["case"]: share for truth, reply in cases if (share := _share(truth, reply)) is not None},
        "held_out": {name: {model: each[model] for model in MODELS} for name, each in compared.items()},
        "processor_s": sorted(reply["seconds"] for _, reply in cases),
    }


def _share(truth: Mapping[str, Any], reply: Mapping[str, Any]) -> list[float] | None:
    """Return the true share of the load friction of a joint that stands still, and the named one with its interval."""
    effects = reply["verdict"]["effects"] if reply["verdict"] else ()
    named = next((each["parameters"]["share"] for each in effects if each["name"] == "servo.load_friction"), None)
    if named is None or truth["law"] not in ("m3", "m4"):
        return None
    # BAM's share applies to the difference of the torques on both sides of the gear, twice the load at rest.
    true = 2 * (truth["load_friction_base"] + truth.get("load_friction_stribeck", 0.0))
    return [true, named["value"], named["low"], named["high"]]


PYTHON = click.option("--python", type=click.Path(path_type=Path), required=True, help="BAM's interpreter.")


@click.group()
def main() -> None:
    """Diagnose servos that BAM simulates."""


@main.command("make")
@FOLDER
@PYTHON
def make_command(folder: Path, python: Path) -> None:
    """Record every servo with every model of friction."""
    with failing(TrialError):
        click.echo(f"{make(folder, python)} cases recorded in {folder}")


main.add_command(run_command)


@main.command("compare")
@FOLDER
@PYTHON
@click.option("--law", type=click.Choice(tuple(EXPECTED)), default="m6", show_default=True, help="True friction.")
def compare_command(folder: Path, python: Path, law: str) -> None:
    """Predict a held-out motion beside BAM's fits; continues an interrupted run."""
    with failing(TrialError, JobsFailed):
        compare(folder, python, law)


@main.command("score")
@FOLDER
@results.json_option
def score_command(folder: Path, json_file: Path | None) -> None:
    """Print outcomes and held-out errors."""
    with failing(TrialError):
        results.report("servos", score(folder), json_file)


if __name__ == "__main__":
    main()
