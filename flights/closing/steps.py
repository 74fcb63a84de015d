"""From a diagnosis to a policy that was trained on what it showed: patch, retrain, fly old and new, write it down."""

import importlib.util
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from softarm.common import files
from softarm.common.processes import bar
from softarm.common.words import did_you_mean
from softarm.daemon.limits.findings import RailFindings
from softarm.diagnosis import report
from softarm.diagnosis.engine.result import Diagnosis
from softarm.flights.closing import story, summary
from softarm.flights.closing.closed import Closed, Place
from softarm.flights.closing.diagnosed import with_diagnosed
from softarm.flights.closing.fly import Flown, Replanning, fly_all
from softarm.flights.closing.outcomes import HELD_BACK, NEW, NOMINAL, OLD, PATCHED, REPLANNED
from softarm.flights.closing.wires import Wires
from softarm.flights.robots import with_faults
from softarm.policies.base import MODELS
from softarm.reality.parameters import RobotParameters
from softarm.schemas.config import RailLimits
from softarm.schemas.flights import TEST_TARGETS
from softarm.schemas.goals import Goal
from softarm.schemas.messages import BODY_NAMES
from softarm.schemas.model import Model
from softarm.simulator import model_file
from softarm.training.run.retrain import Retrained, RetrainingConfig, retrain
from softarm.training.run.warm_start import load_weights

LIMITS, PATCH = "limits-patch.yaml", "patched-model.yaml"
FILES = ("verdict.json", "report.html", "summary.json", LIMITS, PATCH, "retrained.onnx", "retrained.pt")
Spent = dict[str, dict[str, float]]  # step -> wall_s, cpu_s


def close(
    found: Diagnosis,
    rail: RailFindings,
    policy: Path,
    out: Path,
    held_back: Place,
    is_the_robot: bool,
    config: RetrainingConfig,
    spent: Spent,
    targets: Sequence[Goal] = TEST_TARGETS,
    processes: int | None = None,
    replanned: bool = True,
    through: Callable[[Closed], Wires | None] = lambda closed: None,
) -> Closed:
    """Patch the nominal simulator, train the policy on in it, fly old and new; all that is known ends up in `out`.

    Trained and flown with the limits that campaign or diagnosis show of the rail, where those are stricter.
    is_the_robot: the held-back robot was declared to be the campaign's, so its flights are the verdict's success_real.
    replanned: `mppi` on the patched model flies too. through: flies through wires what has been flown already, if it
    does. What the steps take is added to `spent`. Raises ValueError for a robot that no policy flies, CheckpointError
    for a policy that training did not write, PolicyError, OSError, and what `through` raises.
    """
    if found.nominal is None:
        raise ValueError("the campaign is of another rig, for which there is no policy; `softarm diagnose` is its verb")
    held_back, rail = of_the_nominal_body(held_back, found.nominal), with_diagnosed(rail, found.verdict)
    places = [Place(NOMINAL, "the nominal simulator", found.nominal)]
    files.write_text(out / LIMITS, rail.patch())  # beside the model that it belongs to, from the first
    policies: dict[str, Flown] = {OLD: policy}
    retrained: Retrained | None = None
    if found.patched is not None:
        model_file.save(found.patched, out / PATCH)
        places.append(Place(PATCHED, "the patched simulator", found.patched))
        with timed(spent, "retrain"):
            retrained = _retrain(policy, found.patched, out, config, rail.patched.limits.rail)
        policies[NEW] = retrained.policy
        if replanned:
            policies[REPLANNED] = Replanning(out / PATCH)
    places.append(held_back)
    robots = {place.key: place.robot for place in places}
    pairs = [(name, key) for key in robots for name in policies if (name, key) != (REPLANNED, NOMINAL)]
    with timed(spent, "fly"), bar("flying") as shown:
        flown = fly_all(policies, robots, pairs, targets, rail.patched, shown.tell, processes)
    closed = Closed(found, policy, tuple(places), flown, retrained, tuple(targets), rail, is_the_robot).with_task()
    _write(closed, out, spent)  # whatever becomes of a robot that moves
    if (wires := through(closed)) is not None:
        closed = replace(closed, wires=wires)
        _write(closed, out, spent)
    return closed


def _write(closed: Closed, out: Path, spent: Spent) -> None:
    """The report, the verdict and the summary."""
    report.write(closed.diagnosis, out / "report.html", story=story.sections(closed))
    files.write_text(out / "verdict.json", closed.diagnosis.verdict.model_dump_json(indent=1) + "\n")
    files.write_text(out / "summary.json", json.dumps(summary.summary(closed, spent), indent=1) + "\n")


def _retrain(policy: Path, model: Model, out: Path, config: RetrainingConfig, limits: RailLimits) -> Retrained:
    """Behind a bar."""
    with bar("retraining") as shown:
        name = f"{out.name}/patched-model"
        return retrain(policy, model, name, out, config, shown.tell, limits)


def independent(faults: Sequence[str]) -> Place:
    """The independent robot, with its faults. Raises ValueError for faults or packages that there are none of."""
    if importlib.util.find_spec("mujoco") is None:
        raise ValueError(
            "the independent robot needs the package 'mujoco': pip install 'softarm[mujoco]', or give --robot MODEL"
        )
    title = f"the independent robot ({', '.join(faults) or 'without a fault'})"
    return Place(HELD_BACK, title, with_faults(RobotParameters(), faults), tuple(faults))


def simulated(name: str, model: Model) -> Place:
    """The simulator with a model that stands for the robot."""
    return Place(HELD_BACK, f"the held-back robot ({name})", model)


def of_the_nominal_body(place: Place, nominal: Model) -> Place:
    """The independent robot has the arm and the cart that the nominal model says; its actuators are its own.

    Raises ValueError for an arm that it cannot be.
    """
    if nominal.arm.links != len(BODY_NAMES) - 1:
        raise ValueError(
            f"the nominal model has {nominal.arm.links} links; policies fly an arm of {len(BODY_NAMES) - 1} marker sets"
        )
    if isinstance(place.robot, Model):
        return place
    return replace(place, robot=replace(place.robot, body=nominal.arm, cart=nominal.cart))


def policy_file(name: str) -> Path:
    """The file of a policy: its own name, or a shipped one.

    Raises ValueError when there is none, CheckpointError when it cannot be trained on.
    """
    file = Path(name) if name.endswith(".onnx") else MODELS / f"{name}.onnx"
    if not file.is_file():
        shipped = sorted(path.stem for path in MODELS.glob("*.onnx"))
        instead = f"{did_you_mean(name, shipped)}name an .onnx file of `softarm train`, or one of {', '.join(shipped)}"
        raise ValueError(f"--policy {name}: is not there; {instead}")
    load_weights(file)  # to know it before minutes of work
    return file


def make_folder(out: Path) -> None:
    """Raises ValueError when results are there already, OSError when it cannot be made."""
    there = [name for name in (*FILES, "training") if (out / name).exists()]
    if there:
        raise ValueError(f"{out} holds {', '.join(there)} already; name a new --out")
    out.mkdir(parents=True, exist_ok=True)


@contextmanager
def timed(spent: Spent, step: str) -> Iterator[None]:
    """Note wall and CPU seconds of a step, child processes with it."""
    import resource

    def cpu_s() -> float:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(u.ru_utime + u.ru_stime for u in used)

    wall, cpu = time.monotonic(), cpu_s()
    yield
    spent[step] = {"wall_s": round(time.monotonic() - wall, 1), "cpu_s": round(cpu_s() - cpu, 1)}
