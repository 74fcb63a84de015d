"""One simulated flight as an object: result, table, and a page with the arm and charts."""

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from softarm.common import files
from softarm.daemon.config import configuration
from softarm.daemon.control import workspace
from softarm.daemon.control.records import Tick
from softarm.daemon.logbook import logs
from softarm.daemon.logbook.ticks import TickFile
from softarm.evaluation.notebook import needs
from softarm.policies import registry
from softarm.policies.base import Policy, PolicySpec
from softarm.recordings import log_file, player, tables
from softarm.reporting.document import framed
from softarm.schemas.config import Config
from softarm.schemas.config import Policy as ConfiguredPolicy
from softarm.schemas.flights import Flight, Scenario
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

AFTER_S = 1.0  # recorded after the goal's end
HEIGHT_PX = 1330  # of the frame in a notebook: arm and charts without scrolling
R = TypeVar("R")


@dataclass(frozen=True, eq=False, repr=False)
class RecordedFlight:
    """One flight to one target, recorded from the goal's first tick until a second after its end."""

    goal: Goal
    result: Flight
    policy: PolicySpec
    config: Config
    ticks: Sequence[Tick]
    began_ns: int  # wall-clock time of the first tick

    @property
    def reached(self) -> bool:
        """Return whether the tip came within the success radius of the target, with the cart inside its limits."""
        return self.result.reached

    @property
    def closest_m(self) -> float:
        """Return the tip's smallest distance to the target, m; infinity if the tip was never seen."""
        closest = self.result.status.closest_m
        return math.inf if closest is None else closest

    @property
    def reason(self) -> str | None:
        """Return why the target was not reached, or None if it was."""
        return self.result.stop or self.result.status.reason

    @cached_property
    def table(self) -> Any:
        """Return a `pyarrow.Table` with one row per tick and the columns of `softarm logs export`.

        Units are in the names, such as `observed_tip_y_m`; `t_s` counts from the first tick. With pandas installed,
        `table.to_pandas()` returns a data frame.

        Raises:
            ModuleNotFoundError: pyarrow is not installed.
        """
        with needs("diagnosis"):
            return tables.arrow(self._read(tables.ticks))

    def save(self, path: Path | str) -> None:
        """Write the page with arm, charts and events as one HTML file, as `softarm logs view` does.

        Raises:
            ValueError: The file's name does not end in .html.
            OSError: The file cannot be written.
        """
        if Path(path).suffix != ".html":
            raise ValueError(f"{path}: a flight is saved as a page; name a file that ends in .html, such as swing.html")
        files.write_text(path, self._page)

    def __repr__(self) -> str:
        end = "reached" if self.reached else f"not reached ({self.reason or 'the cart left its limits'})"
        return f"<{self._title}: {end}, {self.result.status.time_s:.2f} s, closest {self.closest_m:.3f} m>"

    def _repr_html_(self) -> str:
        return framed(self._page, self._title, HEIGHT_PX)

    @property
    def _title(self) -> str:
        return f"{self.policy.name} to ({self.goal.y_m:g}, {self.goal.z_m:g}) m"

    @cached_property
    def _page(self) -> str:
        return self._read(lambda log: player.page(log, log.entries()))

    def _read(self, read: Callable[[logs.TickLog], R]) -> R:
        """Write the ticks as a log, and return what a function reads from it."""
        with TemporaryDirectory(prefix="softarm-") as folder:
            path = Path(folder) / self._title  # the name of the file is the page's heading
            with path.open("wb") as file:
                live = TickFile(file)
                live.head(self.config, self.policy, self.ticks[0][0].t_ns, self.began_ns)
                for tick in self.ticks:
                    live.write(tick)
                live.flush()
            log_file.finish(path)
            return read(logs.read(path))


@needs("sim")
def fly(
    policy: str | Path,
    target: Sequence[float],
    *,
    model: Model | str | Path | None = None,
    start: float = 0.0,
    config: Config | str | Path | None = None,
    seed: int = 0,
) -> RecordedFlight:
    """Fly a policy to one target with the daemon's control tick on a simulated robot, faster than real time.

    Args:
        policy: Name of a policy (`softarm policy list`), or an .onnx file.
        target: Target of the tip, (y, z), m.
        model: Robot to simulate: a shipped name such as `no-delay`, a model file, or a `Model`; default: seed.
        start: Position of the cart, m; the arm hangs at rest.
        config: Configuration of the daemon, a YAML file or a `Config`; default: all default values.
        seed: Seed of the noise and dropouts of a model with `mocap` effects.

    Raises:
        PolicyError: The policy is unknown or cannot be loaded.
        ModelFileError: The model is missing or invalid.
        ConfigurationError: The configuration is missing or invalid.
        ValueError: Target, start or seed is not allowed, the policy takes no target, or the model has another number
            of links.
        RuntimeError: The control loop does not arm.
        ModuleNotFoundError: The extra `sim` is not installed.
    """
    settings = config if isinstance(config, Config) else Config() if config is None else configuration.load(config)
    goal = _goal(target, settings)
    _check_start(start, settings)
    if seed < 0:
        raise ValueError(f"seed {seed}: allowed are whole numbers from 0; omit it for 0")
    loaded = _load(policy, settings)
    for text in workspace.warnings(goal, loaded.spec.name, loaded.spec.trained):
        warnings.warn(text, stacklevel=3)
    from softarm.daemon.runtime.offline import Lockstep
    from softarm.drivers.bodies.simulated import SimulatedBody

    ticks: list[Tick] = []
    body = SimulatedBody(_model(model), seed)
    lockstep = Lockstep(settings, loaded, record=lambda *tick: ticks.append(tick), body=body)
    lockstep.arm()
    if (shelf_m := Scenario(goal, start, depth_m=loaded.spec.shelf_depth_m).shelf_m) is not None:
        body.simulator.place_shelf(*shelf_m)
    lockstep.place(start)
    ticks.clear()  # the arming
    began_ns = time.time_ns()
    result = lockstep.pursue(goal)
    for _ in range(round(AFTER_S * settings.control.rate_hz)):
        lockstep.tick()
    return RecordedFlight(goal, result, loaded.spec, settings, tuple(ticks), began_ns)


def _goal(target: Sequence[float], config: Config) -> Goal:
    """Return the reach goal of a target; raise ValueError with the allowed range if the daemon refuses it."""
    try:
        y_m, z_m = (float(number) for number in target)
    except (TypeError, ValueError):
        raise ValueError(f"target {target!r}: give two numbers, y and z in m, such as (-0.2, 0.65)") from None
    goal = Goal("reach", y_m, z_m)
    if refused := workspace.refusals(goal, config):
        raise ValueError(f"target ({y_m:g}, {z_m:g}): {refused[0]}; for example (-0.2, 0.65)")
    return goal


def _load(policy: str | Path, config: Config) -> Policy:
    """Load a policy that moves to targets, by its name or its .onnx file."""
    name, configured = str(policy), config.policies
    if name.endswith(".onnx"):
        name = Path(policy).stem
        configured = {name: ConfiguredPolicy(plugin="onnx", options={"model": str(policy)})}
    loaded = registry.load(name, configured)
    if not loaded.spec.needs_target:
        raise ValueError(f"policy '{name}': does not move to targets; choose one that does, such as 'reach'")
    return loaded


def _check_start(start: float, config: Config) -> None:
    rail = config.limits.rail
    if not rail.position_min_m <= start <= rail.position_max_m:
        allowed = f"{rail.position_min_m:g}..{rail.position_max_m:g} m (limits.rail)"
        raise ValueError(f"start {start:g} is outside the rail limits; allowed {allowed}; omit it for the middle")


def _model(model: Model | str | Path | None) -> Model:
    """Return the robot's model, and warn of effects that the control loop cannot simulate."""
    if model is None:
        return Model()
    from softarm.simulator import model_file

    found = model if isinstance(model, Model) else model_file.load(model)
    if clock := [name for name in found.effects if name.startswith("clock.")]:
        warnings.warn(f"{', '.join(clock)}: not simulated, since the real control loop runs here", stacklevel=4)
    return found
