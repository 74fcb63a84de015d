"""Compare the diagnosis with mujoco.sysid on one campaign: processor time, and held-out error.

Both use the same recordings, the same inputs (measured pressure and cart for the arm, commands for the regulator) and
the same split: one kind of excitation is held out, everything is fitted on the others, and the held-out trials are then
simulated, pressure stage and arm separately. mujoco.sysid fits a given list of parameters (benchmarks/mujoco_sysid.py);
the diagnosis has no list, and only the effects that it names enter its simulator.

    python -m benchmarks.diagnosis --json FILE

Needs the extras diagnosis and mujoco, and mujoco[sysid] for the baseline; without it the rest is measured.
"""

import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import click
import mujoco
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks import mujoco_sysid, results
from softarm.common.processes import bar, cores
from softarm.diagnosis.blind import cases, make
from softarm.diagnosis.blind.imperfections import draw_nuisances
from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.robot.shrink import point_between
from softarm.diagnosis.robot.trial_grid import TrialGrid, on_grid
from softarm.diagnosis.robot.views import robot_views
from softarm.reality.parameters import RobotParameters
from softarm.schemas.excitation import EXCITATIONS
from softarm.schemas.model import Model
from softarm.schemas.verdict import Verdict
from softarm.simulator import model_file

T = TypeVar("T")
SEED = 20
DEAD_TIME_S, PAYLOAD_KG = 0.06, 0.03  # faults of the generated campaign
HELD_OUT = ("seed", "rail-chirp", "both")  # muscle only, cart only, both
COMPARED = ("pressure", "arm")
SHOWN = {"pressure": (1.0, "kPa"), "arm": (1e3, "mm")}
Squares = dict[str, list[NDArray[np.float64]]]  # stage -> squared residuals in the unit of the stage


@dataclass(frozen=True, slots=True)
class Effort:
    """Wall and processor time of a call, over all threads."""

    wall_s: float
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Side:
    """Figures of one of the two programs."""

    whole: Effort  # on all trials
    folds: Sequence[Effort]  # with one kind held out each
    nominal: Mapping[str, float]  # stage -> held-out RMS of the nominal model
    held_out: Mapping[str, float]  # stage -> held-out RMS after the fit
    found: Mapping[str, Any]  # on all trials


def measured(work: Callable[[], T]) -> tuple[T, Effort]:
    """Return the result of a call and its effort."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, Effort(time.perf_counter() - wall, time.process_time() - cpu)


def make_campaign(folder: Path) -> Path:
    """Record eight trials of an independent robot with a late regulator and a payload."""
    random = np.random.default_rng(SEED)
    robot = draw_nuisances(RobotParameters(), random)
    robot = replace(
        robot,
        regulator=replace(robot.regulator, dead_time_s=DEAD_TIME_S),
        arm=replace(robot.arm, payload_kg=PAYLOAD_KG),
    )
    flights = tuple(
        cases.PlannedTrial(f"trial-{i}", name, not EXCITATIONS[name].moves_rail, int(random.integers(2**31)))
        for i, name in enumerate(cases.PROGRAMME, 1)
    )
    case = cases.Case("campaign", "two", (), robot, Model(), flights, ())
    return folder / make.write_case(case, folder)


def split(trials: Sequence[Trial], kind: str) -> tuple[list[Trial], list[Trial]]:
    """Return the trials of other kinds and those of this kind."""
    return [t for t in trials if t.kind != kind], [t for t in trials if t.kind == kind]


def ours(trials: Sequence[Trial], kinds: Sequence[str], model: Model, advance: Callable[[str], None]) -> Side:
    """Run the diagnosis on all trials and with each kind held out."""
    before, after = _empty(), _empty()
    folds = []
    for kind in kinds:
        advance(f"diagnosis without {kind}")
        known, left_out = split(trials, kind)
        diagnosed, effort = measured(lambda known=known: diagnose(known, model))  # type: ignore[misc]
        folds.append(effort)
        point = point_between(model, diagnosed.patched or model)
        for view in robot_views(on_grid(left_out, model), model):
            if view.stage in COMPARED:
                for squares, gap in zip((before, after), view.gap([{}, point]), strict=True):
                    squares[view.stage].append(_squares(gap))
    advance("diagnosis on every trial")
    diagnosed, whole = measured(lambda: diagnose(trials, model))
    return Side(whole, folds, _rms(before), _rms(after), _said(diagnosed.verdict))


def baseline(trials: Sequence[Trial], kinds: Sequence[str], model: Model, advance: Callable[[str], None]) -> Side:
    """Run mujoco.sysid on all trials and with each kind held out."""
    before, after = _empty(), _empty()
    folds = []
    stages = [stage(model) for stage in mujoco_sysid.FITTED]
    for kind in kinds:
        advance(f"mujoco.sysid without {kind}")
        known, left_out = split(trials, kind)
        found, effort = measured(lambda known=known: _fitted(stages, on_grid(known, model)))  # type: ignore[misc]
        folds.append(effort)
        for stage in (each for each in stages if each.name in found):
            for _, trial in mujoco_sysid.every_recorded(stage, on_grid(left_out, model)):
                for squares, values in ((before, stage.nominal()), (after, found[stage.name].values)):
                    squares[stage.name].append(_squares(trial.measured - stage.predict(values, trial)))
    advance("mujoco.sysid on every trial")
    found, whole = measured(lambda: _fitted(stages, on_grid(trials, model)))
    return Side(whole, folds, _rms(before), _rms(after), {name: asdict(each) for name, each in found.items()})


def _fitted(stages: Sequence[mujoco_sysid.SysidStage], shown: TrialGrid) -> dict[str, mujoco_sysid.Fitted]:
    recorded = {stage: [each for _, each in mujoco_sysid.every_recorded(stage, shown)] for stage in stages}
    return {stage.name: stage.fit(each) for stage, each in recorded.items() if each}


def _said(verdict: Verdict) -> dict[str, Any]:
    effects = [
        {
            "name": e.name,
            "parameters": {name: p.model_dump() for name, p in e.parameters.items()},
            "confidence": e.confidence,
            "equivalents": e.equivalents,
        }
        for e in verdict.effects
    ]
    return {"verdict": verdict.verdict, "stage": verdict.where.stage, "effects": effects}


def _empty() -> Squares:
    return {stage: [] for stage in COMPARED}


def _squares(gap: NDArray[np.floating]) -> NDArray[np.float64]:
    return np.asarray(np.square(gap[np.isfinite(gap)], dtype=np.float64))


def _rms(squares: Squares) -> dict[str, float]:
    return {stage: float(np.sqrt(np.concatenate(parts).mean())) for stage, parts in squares.items() if parts}


def compare(folder: Path, kinds: Sequence[str]) -> dict[str, Any]:
    """Compare both programs on one campaign and return all figures.

    Raises:
        TrialError: The campaign cannot be used.
    """
    trials = read_all([folder])
    model = model_file.load(folder / "model.yaml") if (folder / "model.yaml").is_file() else Model()
    _check(folder, {trial.kind for trial in trials}, kinds)
    load, installed = os.getloadavg()[0], mujoco_sysid.is_installed()
    with bar("reading", (len(kinds) + 1) * (1 + installed), done=-1) as shown:

        def advance(what: str) -> None:
            shown.advance(text=what)

        our_side = ours(trials, kinds, model, advance)
        their_side = baseline(trials, kinds, model, advance) if installed else None
    result: dict[str, Any] = {
        "trials": [{"name": t.name, "kind": t.kind, "seconds": t.duration_s} for t in trials],
        "seconds": sum(t.duration_s for t in trials),
        "held_out": list(kinds),
        "units": {"pressure": "kPa", "arm": "m"},
        "diagnosis": asdict(our_side),
        "mujoco_sysid": None,
        "cores": cores(),
        "load_average": {"before": load, "after": os.getloadavg()[0]},
        "mujoco_version": mujoco.__version__,
    }
    if their_side is not None:
        result["mujoco_sysid"] = asdict(their_side) | _given(trials, model)
        result["ratios"] = _ratios(our_side, their_side)
    return result


def _check(folder: Path, known: set[str], kinds: Sequence[str]) -> None:
    if lacking := [kind for kind in kinds if kind not in known]:
        raise TrialError(f"{folder}: has no {', '.join(lacking)}; --hold-out takes {', '.join(sorted(known))}")
    if len(known) < 2:
        raise TrialError(f"{folder}: has one kind of excitation, nothing can be left out; fly more (softarm excite)")


def _given(trials: Sequence[Trial], model: Model) -> dict[str, Any]:
    """Return the parameters given to mujoco.sysid, and the error of its step."""
    stages = [stage(model) for stage in mujoco_sysid.FITTED]
    recorded = [each for _, each in mujoco_sysid.every_recorded(mujoco_sysid.SysidArm(model), on_grid(trials, model))]
    return {
        "given": {stage.name: dict(stage.bounds) for stage in stages},  # start, low, high
        "step_hz": mujoco_sysid.STEP_HZ,
        "step_error_m": mujoco_sysid.step_error_m(model, recorded) if recorded else None,
    }


def _ratios(one: Side, other: Side) -> dict[str, float]:
    """Return mujoco.sysid over the diagnosis; above 1 the diagnosis is faster or more accurate."""
    errors = {f"held_out_{s}": other.held_out[s] / one.held_out[s] for s in one.held_out if s in other.held_out}
    return {"wall": other.whole.wall_s / one.whole.wall_s, "cpu": other.whole.cpu_s / one.whole.cpu_s} | errors


def show(result: Mapping[str, Any], console: Console) -> None:
    """Print the table and the findings of both programs."""
    table = Table("", "wall s", "CPU s", *(f"{stage} {SHOWN[stage][1]}, before / held out" for stage in COMPARED))
    for name in ("diagnosis", "mujoco_sysid"):
        if side := result[name]:
            effort = (f"{side['whole'][each]:.0f}" for each in ("wall_s", "cpu_s"))
            table.add_row(name.replace("_", "."), *effort, *(_pair(side, stage) for stage in COMPARED))
    if ratios := result.get("ratios"):
        errors = (f"{ratios[key]:.2f}" if (key := f"held_out_{stage}") in ratios else "-" for stage in COMPARED)
        table.add_row("ratio", f"{ratios['wall']:.2f}", f"{ratios['cpu']:.2f}", *errors)
    console.print(table)
    said = result["diagnosis"]["found"]
    sides = [name for name in ("diagnosis", "mujoco_sysid") if result[name]]
    refits = {name.replace("_", "."): sum(fold["cpu_s"] for fold in result[name]["folds"]) for name in sides}
    console.print("refits for what is held out: " + ", ".join(f"{n} {s:.0f} s of CPU" for n, s in refits.items()))
    console.print(f"{result['seconds']:.0f} s of recordings, held out in turn: {', '.join(result['held_out'])}")
    console.print(f"diagnosis: {said['verdict']}: " + ("; ".join(_words(e) for e in said["effects"]) or "no effect"))
    if result["mujoco_sysid"] is None:
        console.print('mujoco.sysid is not installed, its row is left out: pip install "mujoco[sysid]"')
        return
    for stage, fitted in result["mujoco_sysid"]["found"].items():
        values = ", ".join(f"{name} {value:.4g}" for name, value in fitted["values"].items())
        work = f"{fitted['iterations']} iterations, {fitted['simulations']} simulations of every trial"
        console.print(f"mujoco.sysid, {stage}, {work}: {values}")


def _pair(side: Mapping[str, Any], stage: str) -> str:
    scale = SHOWN[stage][0]
    if stage not in side["held_out"]:
        return "-"
    return f"{scale * side['nominal'][stage]:.3g} / {scale * side['held_out'][stage]:.3g}"


def _words(effect: Mapping[str, Any]) -> str:
    values = (f"{name} {p['value']:.3g} {p['unit']}" for name, p in effect["parameters"].items())
    return f"{effect['name']} ({', '.join(values)})"


@click.command()
@click.option("--campaign", type=click.Path(path_type=Path, exists=True, file_okay=False), help="By default, one made.")
@click.option("--hold-out", "kinds", multiple=True, help=f"Kinds of excitation; by default {', '.join(HELD_OUT)}.")
@results.json_option
def main(campaign: Path | None, kinds: tuple[str, ...], json_file: Path | None) -> None:
    """Compare the diagnosis with mujoco.sysid.

    \b
    Examples:
      python -m benchmarks.diagnosis --json diagnosis.json
      python -m benchmarks.diagnosis --campaign campaign --hold-out seed
    """
    console = Console(soft_wrap=True)
    with tempfile.TemporaryDirectory() as scratch:
        if campaign is None:
            with console.status("flying eight trials of the independent robot"):
                campaign = make_campaign(Path(scratch))
        try:
            result = compare(campaign, kinds or HELD_OUT)
        except (TrialError, model_file.ModelFileError) as error:
            raise click.ClickException(str(error)) from None
    if json_file is not None:
        results.write(json_file, result)
    show(result, console)


if __name__ == "__main__":
    main()
