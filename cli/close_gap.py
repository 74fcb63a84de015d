"""`softarm close-gap`: from recordings of a robot to a policy that was trained on what they showed."""

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from softarm.cli.options import FILE

if TYPE_CHECKING:
    from rich.console import Console

    from softarm.diagnosis.gap.result import Diagnosis
    from softarm.flights.many import Place
    from softarm.schemas.goals import Goal
    from softarm.schemas.model import Model
    from softarm.training.run.retrain import Retrained, RetrainingConfig

FOLDER = click.Path(path_type=Path, file_okay=False)
FILES = ("verdict.json", "report.html", "summary.json", "patched-model.yaml", "retrained.onnx", "retrained.pt")
REALITY = "reality"


@click.command("close-gap")
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--out", type=FOLDER, required=True, help="Folder for everything that comes out.")
@click.option("--policy", default="reach-robust", show_default=True, help="To train on: a shipped name or .onnx file.")
@click.option("--model", "model_file", type=FILE,
              help="Nominal simulator (default: the campaign's model.yaml, else seed).")  # fmt: skip
@click.option("--robot", default=REALITY, show_default=True,
              help="Held-back robot to prove it on: `reality`, the independent one, or a model.")  # fmt: skip
@click.option("--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE",
              help="What is wrong with the independent robot; again for more.")  # fmt: skip
@click.option("--seconds", type=click.FloatRange(1, 86400), help="Of retraining, at most.  [default: 120]")
def close_gap(
    campaign: Path,
    out: Path,
    policy: str,
    model_file: Path | None,
    robot: str,
    faults: tuple[str, ...],
    seconds: float | None,
) -> None:
    """Diagnose CAMPAIGN, patch the simulator, train the policy on in it, and fly old and new.

    Both fly the paper's 54 targets from three cart positions, by the daemon's own tick, on the nominal simulator, the
    patched one and a held-back robot. Leaves verdict.json, report.html, summary.json, and, when an effect was named,
    patched-model.yaml and the retrained policy (.onnx, .pt). A robot that is declared (--fault, --robot MODEL) counts
    as the campaign's own: its flights are the verdict's success_real.

    \b
    Examples:
      softarm close-gap campaign --out closed
      softarm close-gap campaign --out closed --fault regulator.dead_time_s=0.06 --fault arm.payload_kg=0.03
      softarm close-gap campaign --out closed --robot other-robot.yaml --seconds 60
    """
    from dataclasses import replace

    from rich.console import Console

    from softarm.cli.errors import fail
    from softarm.diagnosis.trials import TrialError
    from softarm.policies.base import PolicyError
    from softarm.simulator.model_file import ModelFileError
    from softarm.training.run.checkpoint import CheckpointError
    from softarm.training.run.retrain import RetrainingConfig

    if faults and robot != REALITY:
        raise click.UsageError("--fault is for the independent robot: leave --robot out, or put it into that model")
    recipe = RetrainingConfig() if seconds is None else replace(RetrainingConfig(), seconds=seconds)
    try:
        held_back = _held_back(robot, faults)
        file = _policy_file(policy)
        _make_folder(out)
        run(campaign, out, file, model_file, held_back, bool(faults) or robot != REALITY, recipe, Console())
    except (TrialError, ModelFileError, CheckpointError, PolicyError, ValueError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename}: cannot be written ({error.strerror}); name another --out")


def run(
    campaign: Path,
    out: Path,
    policy: Path,
    model_file: Path | None,
    held_back: "Place",
    is_the_robot: bool,
    recipe: "RetrainingConfig",
    console: "Console",
    targets: "Sequence[Goal] | None" = None,
    processes: int | None = None,
) -> None:
    """The verb with everything named. Raises TrialError, ModelFileError, CheckpointError, PolicyError, ValueError."""
    from softarm.common.processes import bar
    from softarm.diagnosis import report
    from softarm.diagnosis.from_files import diagnose_files
    from softarm.flights.closing import story as closing_story
    from softarm.flights.closing import summary as closing
    from softarm.flights.evaluation import CART_STARTS_M
    from softarm.flights.many import Place, fly_all
    from softarm.schemas.goals import TEST_TARGETS
    from softarm.simulator import model_file as files
    from softarm.training.run.warm_start import load_weights

    load_weights(policy)  # before minutes of work
    targets, spent = targets or TEST_TARGETS, dict[str, dict[str, float]]()
    with _timed(spent, "diagnose"), bar("reading") as shown:
        found = diagnose_files([campaign], model_file, tell=shown.tell, warn=lambda text: click.echo(text, err=True))
    if found.nominal is None:
        raise ValueError(f"{campaign}: is of another rig, for which there is no policy; `softarm diagnose` is its verb")
    held_back = _of_the_nominal_body(held_back, found.nominal)
    for line in report.answer(found):
        console.print(line, markup=False, highlight=False)
    places = [Place(closing.NOMINAL, "the nominal simulator", model=found.nominal)]
    retrained: Retrained | None = None
    flown_policies = {closing.OLD: policy}
    if found.patched is not None:
        if clock := [name for name in found.patched.effects if name.startswith("clock.")]:
            click.echo(
                f"{', '.join(clock)}: trained with, not flown; the control loop that flies is the real one", err=True
            )
        files.save(found.patched, out / "patched-model.yaml")
        places.append(Place(closing.PATCHED, "the patched simulator", model=found.patched))
        with _timed(spent, "retrain"):
            retrained = _retrain(policy, found.patched, out, recipe, console)
        flown_policies[closing.NEW] = retrained.policy
    places.append(held_back)
    with _timed(spent, "fly"), _bar(console) as moving:
        total = len(places) * len(flown_policies) * len(targets) * len(CART_STARTS_M)
        task = moving.add_task("flying old and new" if retrained else "flying", total=total)
        flown = fly_all(flown_policies, places, targets, lambda flights: moving.advance(task, flights), processes)
    found = closing.with_task(found, flown, is_the_robot)
    story = closing_story.story(found, policy.stem, places, flown, retrained, targets)
    report.write(found, out / "report.html", story=story)
    (out / "verdict.json").write_text(found.verdict.model_dump_json(indent=1) + "\n", encoding="utf-8")
    robot = held_back.title
    told = closing.summary(found, policy, places, flown, retrained, robot, spent, targets)
    (out / "summary.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    _show(found, told, places, closing_story.sentence(places, flown, retrained), out, console)


def _retrain(policy: Path, model: "Model", out: Path, recipe: "RetrainingConfig", console: "Console") -> "Retrained":
    """Behind a bar."""
    from softarm.training.run.retrain import retrain

    with _bar(console) as moving:
        task = moving.add_task("retraining", total=1.0)
        return retrain(policy, model, f"{out.name}/patched-model", out, recipe,
                       lambda text, share: moving.update(task, description=text, completed=share))  # fmt: skip


def _held_back(robot: str, faults: Sequence[str]) -> "Place":
    """Raises ValueError for faults or packages that there are none of; ends the command for a model that is none."""
    from softarm.cli.options import flown_model
    from softarm.flights.closing.summary import HELD_BACK
    from softarm.flights.many import Place, with_faults
    from softarm.reality.parameters import RobotParameters

    if robot != REALITY:
        return Place(HELD_BACK, f"the held-back robot ({robot})", model=flown_model(Path(robot)))
    try:
        import mujoco  # noqa: F401
    except ModuleNotFoundError:
        raise ValueError(
            "the independent robot needs the package 'mujoco': pip install 'softarm[mujoco]', or give --robot MODEL"
        ) from None
    title = f"the independent robot ({', '.join(faults) or 'without a fault'})"
    return Place(HELD_BACK, title, parameters=with_faults(RobotParameters(), faults))


def _of_the_nominal_body(place: "Place", nominal: "Model") -> "Place":
    """The independent robot has the arm and the cart that the nominal model says; its actuators are its own.

    Raises ValueError for an arm that it cannot be.
    """
    from dataclasses import replace

    from softarm.schemas.messages import BODY_NAMES

    if nominal.arm.links != len(BODY_NAMES) - 1:
        raise ValueError(
            f"the nominal model has {nominal.arm.links} links; policies fly an arm of {len(BODY_NAMES) - 1} marker sets"
        )
    if place.parameters is None:
        return place
    return replace(place, parameters=replace(place.parameters, body=nominal.arm, cart=nominal.cart))


def _policy_file(name: str) -> Path:
    """The file of a policy: its own name, or a shipped one. Raises ValueError when there is none."""
    from softarm.policies.base import MODELS

    file = Path(name) if name.endswith(".onnx") else MODELS / f"{name}.onnx"
    if not file.is_file():
        shipped = ", ".join(sorted(path.stem for path in MODELS.glob("*.onnx")))
        raise ValueError(f"--policy {name}: is not there; name an .onnx file of `softarm train`, or one of {shipped}")
    return file


def _make_folder(out: Path) -> None:
    """Raises ValueError when results are there already, OSError when it cannot be made."""
    there = [name for name in (*FILES, "training") if (out / name).exists()]
    if there:
        raise ValueError(f"{out} holds {', '.join(there)} already; name a new --out")
    out.mkdir(parents=True, exist_ok=True)


@contextmanager
def _timed(spent: dict[str, dict[str, float]], step: str) -> Iterator[None]:
    """Note wall and CPU seconds of a step, child processes with it."""
    import resource

    def cpu_s() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(u.ru_utime + u.ru_stime for u in used)

    wall, cpu = time.monotonic(), cpu_s()
    yield
    spent[step] = {"wall_s": round(time.monotonic() - wall, 1), "cpu_s": round(cpu_s() - cpu, 1)}


def _bar(console: "Console") -> Any:
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True)


def _show(
    found: "Diagnosis", told: dict[str, Any], places: Sequence["Place"], sentence: str, out: Path, console: "Console"
) -> None:
    """A row a robot, what came of it, where it stands."""
    from rich.table import Table

    from softarm.pages.numbers import percent

    table = Table("flown on", *(["old policy", "retrained", "gained", "lost"] if told["retrained"] else ["policy"]))
    for place in places:
        row = told["success"][place.key]
        both = [str(row[key]) for key in ("gained", "lost") if key in row]
        table.add_row(place.title, *(percent(row[name]["all"]) for name in ("old", "new") if name in row), *both)
    console.print(table)
    console.print(sentence, markup=False, highlight=False)
    spent = told["spent"].items()
    console.print(", ".join(f"{step} {t['wall_s']:.0f} s ({t['cpu_s']:.0f} s of CPU)" for step, t in spent))
    written = ", ".join(name for name in FILES if (out / name).exists())
    console.print(f"wrote {written} to {out}", soft_wrap=True, highlight=False)
    for warning in found.verdict.warnings:
        click.echo(f"warning: {warning}", err=True)
