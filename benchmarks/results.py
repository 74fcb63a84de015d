"""Stored results: figures as JSON, with how, where and on which code they were measured.

    python -m benchmarks.results            list the results, with the commits that have changed their code since
    python -m benchmarks.results --check    exit with 1 if a result is older than its code

Each measurement has one file in benchmarks/results/. Its entry `about` holds the revision, the machine, the date and
the command; `transcribed` marks figures copied from a page, whose revision is the commit that last changed the page's
table. DEPENDS holds the paths that the figures depend on. Changed comments, docstrings and layout of Python do not make
a result old.
`python -m tools.render` fills the tables of docs/ from these files.
"""

import ast
import json
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.tables import TABLES
from softarm.common import files
from softarm.common.processes import cores
from softarm.common.revision import CHECKOUT, machine, revision

FOLDER = Path(__file__).parent / "results"

FILE = click.Path(path_type=Path, dir_okay=False)
json_option = click.option("--json", "json_file", type=FILE, help="Write the figures to this file.")

_SCHEMAS = (
    "base",
    "bridge",
    "config",
    "events",
    "flights",
    "goals",
    "log",
    "messages",
    "model",
    "policy",
    "rest",
    "robot",
)
_CONTROL = (
    "softarm/common/braking.py",
    "softarm/daemon/control",
    "softarm/daemon/tick.py",
    *(f"softarm/schemas/{name}.py" for name in _SCHEMAS),
)
_WIRES = (
    *_CONTROL,
    "softarm/common/realtime.py",
    "softarm/daemon/assembly.py",
    "softarm/daemon/runtime",
    "softarm/daemon/stop",
    "softarm/drivers",
)
_API = ("softarm/daemon/access", "softarm/daemon/api")
_SIMULATOR = ("softarm/simulator", "softarm/schemas/model.py", "softarm/schemas/robot.py")
_EVALUATED = "faults", "robots", "runner", "software_in_the_loop", "table", "tests", "through_source"
_FLOWN = "base.py", "mppi", "onnx_graph.py", "onnx_policy.py", "pid.py", "plans.py", "runner.py", "trajectory.py"
_FLIGHTS = (
    *_CONTROL,
    *_SIMULATOR,
    "softarm/daemon/runtime/offline.py",
    "softarm/drivers/bodies",
    *(f"softarm/evaluation/{name}.py" for name in _EVALUATED),
    *(f"softarm/policies/{name}" for name in (*_FLOWN, "models")),
)
_TASK = (*_SIMULATOR, "softarm/common/braking.py", "softarm/training/task")
_TRAINED = "learn", "record/checkpoint.py", "run/recipe.py", "run/session.py"
_TRAINING = (*_TASK, *(f"softarm/training/{name}" for name in _TRAINED))
_PLANNING = (*_TASK, "softarm/training/trajectory")
_ENGINE = tuple(f"softarm/diagnosis/{name}" for name in ("answer", "data", "engine", "diagnose.py"))
# Of the soft arm, whose recordings are read by these modules alone.
_READ = "bags", "checks", "folder", "mcap", "read", "table_files", "trials"
_DIAGNOSIS = (
    *_SIMULATOR,
    *(f"softarm/diagnosis/data/{name}.py" for name in _READ),
    *(f"softarm/diagnosis/{name}" for name in ("answer", "diagnose.py", "engine", "robot")),
)
_ROBOT = "devices", "parameters", "plant", "record", "robot", "sensors"
_REALITY = tuple(f"softarm/reality/{name}.py" for name in _ROBOT)  # the independent soft arm
_EXCITATION = "softarm/schemas/excitation.py"
_BLIND = (*_DIAGNOSIS, _EXCITATION, "validation/blind", *_REALITY)
_CONFIG = "softarm/schemas/config.py"
_ADVERSARY = ("validation/adversary.py", "validation/adversary_batch.py")
_DAEMON = "validation/daemon_process.py"
_REAL_ARM = tuple(f"benchmarks/{name}.py" for name in ("arm_recordings", "pace", "real_arm"))

# Result name, or the part of it before the first hyphen -> the paths whose change may change the figures.
DEPENDS: Mapping[str, tuple[str, ...]] = {
    "adversary": (*_SIMULATOR, "softarm/common/braking.py", "softarm/daemon/control/safety.py", _CONFIG, *_ADVERSARY),
    "adversary-cost": (*_FLIGHTS, *_ADVERSARY),
    "adversary-tick": (
        *_CONTROL,
        *_SIMULATOR,
        "softarm/daemon/runtime/offline.py",
        "softarm/drivers/bodies",
        *_ADVERSARY,
    ),
    "all": (*_FLIGHTS, *_REALITY),
    "blind": _BLIND,
    "bridging": (*_FLIGHTS, *_REALITY, "benchmarks/bridging.py"),
    "card": (*_TRAINING, "benchmarks/card.py"),
    "chained": (*_FLIGHTS, *_REALITY, "validation/chained.py", "validation/outside"),
    "closing": (
        *_FLIGHTS,
        *_DIAGNOSIS,
        "softarm/evaluation/closing",
        _EXCITATION,
        "softarm/schemas/verdict.py",
        *_REALITY,
        "softarm/training",
        "validation/blind/cases.py",
        "validation/closing.py",
    ),
    "dead": (*_WIRES, _DAEMON, "validation/dead_daemon.py", "validation/matrix/faulty_policies.py"),
    "detection": (*_BLIND, "validation/detection.py"),
    "faults": (*_FLIGHTS, *_REALITY),
    "grid": _FLIGHTS,
    "limits": (
        *_FLIGHTS,
        "softarm/daemon/limits",
        "softarm/policies/excite.py",
        "softarm/recordings/rail_motion.py",
        _EXCITATION,
        *_REALITY,
        *_ADVERSARY,
        "validation/limits.py",
    ),
    "loop": (*_WIRES, *_API, "softarm/daemon/logbook", "benchmarks/loop.py"),
    "matrix": (*_WIRES, "softarm/policies", _DAEMON, "validation/matrix"),
    "needs": _PLANNING,
    "planning": (*_PLANNING, "benchmarks/planning.py"),
    "real": (*_ENGINE, "softarm/diagnosis/rigs", *_REAL_ARM),
    "replanning": (*_FLIGHTS, "benchmarks/replanning.py"),
    "servos": (*_ENGINE, "softarm/diagnosis/rigs", "validation/servos"),
    "simulator": (*_SIMULATOR, *(f"benchmarks/{name}.py" for name in ("commands", "mujoco_arm", "simulator"))),
    "stop": (*_WIRES, *_API, _DAEMON, "benchmarks/loop.py", "validation/stop.py"),
    "training": (*_TRAINING, "benchmarks/training.py"),
    "viewers": (
        *_WIRES,
        *_API,
        "softarm/daemon/logbook",
        _DAEMON,
        "benchmarks/loop.py",
        "validation/soak/growth.py",
        "validation/viewers.py",
    ),
}


def depends_on(name: str) -> tuple[str, ...]:
    """Return the paths that a result depends on. Raises KeyError if DEPENDS has no entry for it; add one."""
    return DEPENDS[name] if name in DEPENDS else DEPENDS[name.partition("-")[0]]


def write(file: Path | None, figures: Mapping[str, Any], command: str | None = None) -> None:
    """Write figures and how they were measured.

    Args:
        file: Target, None for none.
        figures: Figures by name.
        command: Command that measured them; this program by default.
    """
    if file is None:
        return
    about = {
        "revision": measured(),
        "machine": {**machine(), "cpu": _cpu(), "cores": cores()},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": command or _command(),
    }
    files.write_text(file, json.dumps({"about": about, **figures}, indent=1) + "\n")


def report(table: str, figures: Mapping[str, Any], file: Path | None) -> None:
    """Print figures as a table of benchmarks/tables.py that needs no other result, and write them as `write` does."""
    write(file, figures)
    click.echo(TABLES[table](lambda _: figures))


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return the median, the 99th and 99.9th percentile, and the maximum of values."""
    p50, p99, p999, top = map(float, np.percentile(values, [50, 99, 99.9, 100]))
    return {"p50": p50, "p99": p99, "p999": p999, "max": top}


def measured(root: Path = CHECKOUT) -> str:
    """Return the revision of the code under test; changed results and pages do not count as changes."""
    aside = [":(exclude)docs", ":(exclude)*.md", f":(exclude){FOLDER.parent.name}/{FOLDER.name}"]
    command = ["git", "diff", "--quiet", "HEAD", "--", ".", *aside]
    same = subprocess.run(command, cwd=root, check=False).returncode == 0
    return revision(root).removesuffix("+changes") if same else revision(root)


def read(name: str) -> dict[str, Any]:
    """Return a stored result by its name."""
    found: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return found


def age(since: str, depends: Sequence[str], root: Path = CHECKOUT) -> int:
    """Return how many commits have changed some paths since a revision.

    Returns 0 if they changed comments, docstrings and layout alone.

    Raises CalledProcessError if the checkout does not have the revision (a shallow clone).
    """
    # softarm/ was at the top level of older revisions.
    paths = [each for path in depends for each in (path, path.removeprefix("softarm/"))]
    changed = _git(root, "diff", "--name-only", "--no-renames", since, "HEAD", "--", *paths).splitlines()
    if all(_code(root, since, path) == _code(root, "HEAD", path) for path in changed):
        return 0
    return int(_git(root, "rev-list", "--count", f"{since}..HEAD", "--", *paths))


def _code(root: Path, commit: str, path: str) -> str | None:
    """Return a file's content at a commit, None if it has no such file; of a module its syntax without docstrings."""
    if not _git(root, "ls-tree", commit, "--", path):
        return None
    text = _git(root, "show", f"{commit}:{path}")
    if not path.endswith(".py"):
        return text
    module = ast.parse(text)
    for node in ast.walk(module):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = node.body[ast.get_docstring(node, clean=False) is not None :]
    return ast.dump(module)


def _git(root: Path, *words: str) -> str:
    """Return what git prints; bytes that are no UTF-8 are kept apart from each other."""
    command = ["git", *words]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, errors="backslashreplace", check=True)
    return done.stdout


def _cpu() -> str:
    """Return the processor's name, or an empty text where the system does not report one."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _command() -> str:
    """Return the command that started this program: a module by its name, a script by its file."""
    spec = sys.modules["__main__"].__spec__
    started = ["python", sys.argv[0]] if spec is None else ["python", "-m", spec.name.removesuffix(".__main__")]
    return shlex.join([*started, *sys.argv[1:]])


@click.command()
@click.option("--check", is_flag=True, help="Exit with 1 if a result is older than its code.")
def main(check: bool) -> None:
    """List the stored results and how many commits their code has changed since.

    \b
    Example:
      python -m benchmarks.results --check
    """
    table = Table("result", "measured", "revision", "commits behind", "command")
    stale = 0
    for file in sorted(FOLDER.glob("*.json")):
        about = read(file.stem)["about"]
        try:
            behind = age(about["revision"], depends_on(file.stem))
        except subprocess.CalledProcessError:
            lacking = f"{file.name}: this checkout lacks revision {about['revision']}"
            raise click.ClickException(f"{lacking}; run `git fetch --unshallow`") from None
        stale += behind > 0
        table.add_row(file.stem, about["date"][:10], about["revision"][:8], str(behind or "-"), about["command"])
    Console(width=None if sys.stdout.isatty() else 200).print(table)
    click.echo(f"{stale} results are older than their code" if stale else "every result is as new as its code")
    raise SystemExit(check and stale > 0)


if __name__ == "__main__":
    main()
