"""Steps after a diagnosis: patch the model, compare the ways to use the patch, write the results."""

import importlib.util
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from softarm.common import files
from softarm.common.processes import bar
from softarm.common.words import did_you_mean
from softarm.daemon.limits.findings import RailFindings
from softarm.diagnosis import report
from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.closing import story
from softarm.evaluation.closing.closed import Closed, Place, Spent
from softarm.evaluation.closing.diagnosed import with_diagnosed
from softarm.evaluation.closing.fly import MOST, NONE, Flown, Replanning, compare, fly
from softarm.evaluation.closing.outcomes import ADAPTIVE, HELD_OUT, NEW, NOMINAL, OLD, PATCHED, REPLANNED, TITLES
from softarm.evaluation.closing.wires import Wires
from softarm.evaluation.robots import with_faults
from softarm.evaluation.runner import load
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import RailLimits
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Model
from softarm.simulator import model_file
from softarm.training.run.retrain import Retrained, RetrainingConfig, load_weights, retrain

LIMITS, PATCH = "limits-patch.yaml", "patched-model.yaml"
FILES = ("verdict.json", "report.html", "summary.json", LIMITS, PATCH, "retrained.onnx", "retrained.pt")
SIMULATED = 108  # draws of the old policy on each simulator


class Options(NamedTuple):
    """Policy that is compared as well, and the largest number of draws for each way."""

    adaptive: Path | None = None  # ONNX file of a policy that needs no diagnosis; None: no such policy
    draws: int = MOST


def close(
    found: Diagnosis,
    rail: RailFindings,
    policy: Path,
    out: Path,
    held_out: Place,
    is_the_robot: bool,
    config: RetrainingConfig,
    spent: Spent,
    options: Options,
    through: Callable[[Closed], Wires | None],
    report_way: Callable[[str], None],
) -> Closed:
    """Compare the ways to use a diagnosis with the old policy, and write all results to `out`.

    Training and flights use the rail limits that campaign or diagnosis show, where those are stricter. The ways are
    compared one after another, those that need no training first.

    Args:
        rail: Rail limits that the campaign shows.
        policy: ONNX file of the old policy.
        out: Existing folder for all results.
        held_out: Held-out robot.
        is_the_robot: The held-out robot was declared to be the campaign's, so the ways are compared on it. Otherwise
            they are compared on the patched simulator.
        spent: Time of earlier steps; receives the time of each step.
        through: Flies the old and the retrained policy on wires, or returns None.
        report_way: Called with a sentence after each way.

    Raises:
        ValueError: No policy can fly this robot, or the retraining is too short; the diagnosis is written first.
        CheckpointError: The policy was not written by training.
        PolicyError: A policy cannot be loaded.
        OSError: A result cannot be written.
    """
    if found.nominal is None:
        raise ValueError("the campaign shows another rig, and policies fly only the arm; use `softarm diagnose`")
    held_out, rail = of_the_nominal_body(held_out, found.nominal), with_diagnosed(rail, found.verdict)
    simulated = [Place(NOMINAL, "the nominal simulator", found.nominal)]
    files.write_text(out / LIMITS, rail.patch())
    # Before the flights, so that the diagnosis survives a refused or interrupted retraining.
    _write_diagnosis(found, out)
    if found.patched is not None:
        model_file.save(found.patched, out / PATCH)
        simulated.append(Place(PATCHED, "the patched simulator", found.patched))
    judged = held_out if is_the_robot else simulated[-1]
    closed = Closed(found, policy, (*simulated, held_out), judged, {}, None, rail, spent)
    with timed(spent, OLD):
        flown = {
            (OLD, place.key): fly(policy, place.robot, rail.patched, min(SIMULATED, options.draws))
            for place in simulated
        }
    closed = replace(closed, flown=flown)
    if found.patched is not None:
        closed = _compared(closed, REPLANNED, Replanning(out / PATCH), out, options, report_way)
    if options.adaptive is not None:
        closed = _compared(closed, ADAPTIVE, options.adaptive, out, options, report_way)
    if found.patched is not None:
        with timed(spent, "retrain"):
            retrained = _retrain(policy, found.patched, out, config, rail.patched.limits.rail)
        closed = _compared(replace(closed, retrained=retrained), NEW, retrained.policy, out, options, report_way)
    if not closed.ways:
        _write(closed := closed.with_task(), out)
    if (wires := through(closed)) is not None:
        closed = replace(closed, wires=wires)
        _write(closed, out)
    return closed


def _compared(
    closed: Closed, name: str, policy: Flown, out: Path, options: Options, report_way: Callable[[str], None]
) -> Closed:
    """Fly a way and the old policy on the judging robot until the decision is clear, and write the results so far."""
    judged, title = closed.judged, TITLES[name]
    known = closed.flown.get((OLD, judged.key), NONE)
    with timed(closed.spent, name), bar(f"flying {title}") as shown:

        def show(draws: int, share: float) -> None:
            shown.report(f"flying {title}, {draws} draws", share)

        config = closed.rail.patched
        old, new = compare(closed.policy, policy, judged.robot, config, options.draws, known, show)
    closed = replace(closed, flown={**closed.flown, (OLD, judged.key): old, (name, judged.key): new}).with_task()
    _write(closed, out)
    report_way(story.sentence(closed, name))
    return closed


def _write_diagnosis(found: Diagnosis, out: Path, further: Sequence[tuple[str, str]] = ()) -> None:
    """Write the report and the verdict."""
    report.write(found, out / "report.html", further=further)
    files.write_text(out / "verdict.json", found.verdict.model_dump_json(indent=1) + "\n")


def _write(closed: Closed, out: Path) -> None:
    """Write the report, the verdict and the summary."""
    _write_diagnosis(closed.diagnosis, out, story.sections(closed))
    files.write_text(out / "summary.json", json.dumps(story.summary(closed), indent=1) + "\n")


def _retrain(policy: Path, model: Model, out: Path, config: RetrainingConfig, limits: RailLimits) -> Retrained:
    """Retrain the policy and show a progress bar."""
    with bar("retraining") as shown:
        name = f"{out.name}/patched-model"
        try:
            return retrain(policy, model, name, out, config, shown.report, limits)
        except ValueError as error:
            kept = f"{out / 'report.html'} and verdict.json hold the diagnosis; start again with another --out"
            raise ValueError(f"{error}. {kept}") from error


def independent(faults: Sequence[str]) -> Place:
    """Return the independent robot with faults. Raises ValueError for an unknown fault or a missing package."""
    if importlib.util.find_spec("mujoco") is None:
        raise ValueError(
            "the independent robot needs the package 'mujoco': pip install 'softarm[mujoco]', or give --robot MODEL"
        )
    title = f"the independent robot ({', '.join(faults) or 'without a fault'})"
    return Place(HELD_OUT, title, with_faults(RobotParameters(), faults), tuple(faults))


def simulated(name: str, model: Model) -> Place:
    """Return a simulated robot with the given model as held-out robot."""
    return Place(HELD_OUT, f"the held-out robot ({name})", model)


def of_the_nominal_body(place: Place, nominal: Model) -> Place:
    """Give the independent robot the arm and the cart of the nominal model; its actuators stay its own.

    Raises:
        ValueError: No policy flies an arm of so many links.
    """
    if nominal.arm.links != len(BODY_NAMES) - 1:
        raise ValueError(
            f"the nominal model has {nominal.arm.links} links; policies fly an arm of {len(BODY_NAMES) - 1} marker sets"
        )
    if isinstance(place.robot, Model):
        return place
    return replace(place, robot=replace(place.robot, body=nominal.arm, cart=nominal.cart))


def policy_file(name: str, is_retrained: bool) -> Path:
    """Return the ONNX file of --policy or --adaptive, given as a path or as the name of a shipped one.

    Args:
        is_retrained: The policy is that of --policy, which is retrained.

    Raises:
        ValueError: The file does not exist, or its policy flies to targets in a shelf.
        PolicyError: The policy cannot be loaded.
        CheckpointError: The policy cannot be retrained.
    """
    option = f"{'--policy' if is_retrained else '--adaptive'} {name}"
    file = Path(name) if name.endswith(".onnx") else MODELS / f"{name}.onnx"
    if not file.is_file():
        shipped = sorted(path.stem for path in MODELS.glob("*.onnx"))
        instead = f"{did_you_mean(name, shipped)}name an .onnx file of `softarm train`, or one of {', '.join(shipped)}"
        raise ValueError(f"{option}: no such file; {instead}")
    # Fail here rather than after minutes of diagnosis.
    if is_retrained:
        load_weights(file)
    if load(file).spec.shelf_depth_m is not None:
        raise ValueError(f"{option}: flies into a shelf, these flights are in free space; name one of the task reach")
    return file


def make_folder(out: Path) -> None:
    """Create the folder of the results. Raises ValueError if it holds results already, OSError if it cannot be made."""
    existing = [name for name in (*FILES, "training") if (out / name).exists()]
    if existing:
        raise ValueError(f"{out} already holds {', '.join(existing)}; name a new --out")
    out.mkdir(parents=True, exist_ok=True)


@contextmanager
def timed(spent: Spent, step: str) -> Iterator[None]:
    """Record the wall and CPU seconds of a step, including child processes."""
    import resource

    def cpu_s() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(u.ru_utime + u.ru_stime for u in used)

    wall, cpu = time.monotonic(), cpu_s()
    yield
    spent[step] = {"wall_s": round(time.monotonic() - wall, 1), "cpu_s": round(cpu_s() - cpu, 1)}
