"""Flights of the old and the retrained policy on wires: a separate daemon in real time, with a robot that moves.

The devices are those of the configuration, or the twin replaces them. On real devices a stop ends the flights, because
only a person may arm again.
"""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import httpx
import numpy as np

from softarm.common import http
from softarm.common.address import local_url
from softarm.daemon.control.failsafe import TABLE
from softarm.daemon.control.workspace import refusals as not_flown
from softarm.daemon.limits.findings import RailFindings
from softarm.evaluation.closing.outcomes import MANNERS, NEW, OLD, REST, SWINGING, Flights, Paired, better, joined
from softarm.evaluation.closing.outcomes import stops_more as paired_stops
from softarm.evaluation.software_in_the_loop import POLL_S, SoftwareInTheLoop, SoftwareInTheLoopError
from softarm.schemas.config import Config
from softarm.schemas.flights import TEST_TARGETS, counts
from softarm.schemas.goals import Goal

CHAIN = 6  # goals that are judged; one before them sets the arm swinging
LEG_S, FLIGHT_S = 3.0, 2.5  # typical time to settle, and to fly to a goal
LOAD_S = 60.0  # to load and try out a policy
NAMES = {OLD: "close-gap-old", NEW: "close-gap-retrained"}  # in the daemon's configuration
REQUESTED = tuple(TABLE[name].meaning for name in ("stop_requested", "remote_off"))  # stops by a person
_SEED = 18


class Twin(NamedTuple):
    """The twin that replaces the devices, with its options for `softarm twin`."""

    title: str
    options: tuple[str, ...]
    is_the_robot: bool  # declared to be the campaign's robot


@dataclass(frozen=True)
class Wires:
    """Results of flights on wires; goals that only one policy flew are left out."""

    title: str
    is_the_robot: bool
    flown: Mapping[tuple[str, str], Flights]  # policy, manner
    log: str | None
    ended: str | None = None  # why the flights ended early
    ended_by: str | None = None  # the policy that caused an unrequested stop at the end

    def both(self, policy: str) -> Flights:
        """Return a policy's flights from rest and chained."""
        return joined([self.flown[policy, manner] for manner in MANNERS])

    @classmethod
    def unflown(cls, title: str, why: str) -> Self:
        """Return a result without flights, with the reason."""
        return cls(title, False, {(key, manner): joined(()) for key in NAMES for manner in MANNERS}, None, why)

    @property
    def flights(self) -> int:
        """Number of flights of each policy."""
        return int(self.both(OLD).reached.size)

    @property
    def won(self) -> Paired | None:
        """Success of the retrained policy minus that of the old one; None without common flights."""
        return better(self.both(OLD), self.both(NEW)) if self.flights else None

    @property
    def against(self) -> tuple[str, ...]:
        """Reasons against the retrained policy; none unless this is the campaign's robot."""
        if not self.is_the_robot:
            return ()
        found = []
        if self.ended_by == NEW:
            found.append(f"on {self.title} it caused an unrequested stop: {self.ended}")
        if (won := self.won) is not None:
            if won.below:
                found.append(f"on {self.title} it is worse: {won.text}")
            if paired_stops(self.both(OLD), self.both(NEW)).above:
                found.append(f"on {self.title} it causes more unrequested stops")
        return tuple(found)


class _Leg(NamedTuple):
    """Goals without a rest between them; the arm hangs still before the first."""

    manner: str
    lead: Goal | None  # flown first, does not count
    goals: tuple[Goal, ...]


class _Flight(NamedTuple):
    reached: bool
    stop: str | None


class Ended(Exception):
    """The flights ended early; `by` is the policy that caused an unrequested stop."""

    def __init__(self, why: str, by: str | None) -> None:
        super().__init__(why)
        self.by = by


class Bench(SoftwareInTheLoop):
    """The daemon of a configuration with both policies, and the twin if it replaces the devices."""

    def __init__(self, config: Config, policies: Mapping[str, Path], logs: Path, twin: Twin | None) -> None:
        """Prepare the processes; `logs` is the folder of the recordings."""
        flown = {
            NAMES[key]: {"plugin": "onnx", "options": {"model": str(file.resolve())}} for key, file in policies.items()
        }
        settings = config.model_dump(mode="json")
        settings["policies"] |= flown
        settings["control"]["policy"] = NAMES[OLD]
        self._of_twin = twin
        if twin is not None:
            for device, address in (("regulator", "port"), ("rail", "host"), ("rail", "port")):
                del settings["drivers"][device][address]
            # The configured camera plug-in and ROS router belong to the real robot.
            del settings["drivers"]["mocap"], settings["ros"], settings["api"], settings["recorder"]
        elif settings["api"]["port"] == 0:
            del settings["api"]["port"], settings["api"]["stop_port"]
        super().__init__(Path(logs), settings)
        if twin is not None:
            self._twin_options = list(twin.options)
            return
        token = config.api.token_file
        headers = {} if token is None else {"Authorization": f"Bearer {token.read_text(encoding='utf-8').strip()}"}
        self.url = local_url(config.api.host, self.settings["api"]["port"])
        self.client.close()
        self.client = http.client(self.url, headers)

    def start_twin(self) -> None:
        """Start the twin, unless the real devices are used."""
        if self._of_twin is not None:
            super().start_twin()

    def _acknowledge(self, last_stop: str) -> None:
        """Acknowledge a stop of the twin; only a person acknowledges one of the real robot."""
        if self._of_twin is None:
            raise SoftwareInTheLoopError(
                f"an emergency stop is latched ({last_stop}). Remove its cause, then start "
                "`softarm run`, `softarm acknowledge`, and repeat this command"
            )
        super()._acknowledge(last_stop)

    def use(self, policy: str) -> None:
        """Select the old or the retrained policy. Raises SoftwareInTheLoopError."""
        answer = self.client.put("/api/policy", json={"name": NAMES[policy]}, timeout=LOAD_S)
        if answer.status_code != 200:
            raise SoftwareInTheLoopError(f"the {policy} policy was refused: {answer.json()['detail']}")

    def pursue(self, goal: Goal) -> _Flight:
        """Fly to one goal from the current state of the arm."""
        try:
            self.reach(goal)
        except SoftwareInTheLoopError:
            if (status := self.status())["mode"] == "armed":
                raise
            return _Flight(False, str(status["last_stop"]))
        farthest_m = 0.0
        while (status := self.status())["goal"]["state"] == "running" and status["mode"] == "armed":
            farthest_m = max(farthest_m, abs(status["rail_position_m"] or 0.0))
            time.sleep(POLL_S)
        stop = None if status["mode"] == "armed" else str(status["last_stop"])
        return _Flight(stop is None and counts(status["goal"]["state"] == "reached", farthest_m), stop)

    def lay_down(self) -> None:
        """Disarm and wait until the robot has stopped. Raises SoftwareInTheLoopError, httpx.HTTPError."""
        if self.status()["mode"] == "armed":
            self.post("disarm")
        while self.status()["mode"] == "stopping":
            time.sleep(POLL_S)

    def recover(self, why: str, policy: str) -> None:
        """Arm the twin's daemon again after a stop. Raises Ended on real devices, where a person must do that."""
        if self._of_twin is None:
            raise Ended(why, None if any(each in why for each in REQUESTED) else policy)
        deadline = time.monotonic() + 20.0
        while self.status()["mode"] == "stopping" or not self._ready_to_arm():
            if time.monotonic() > deadline:
                raise Ended(f"could not be armed again after: {why}", policy)
            time.sleep(POLL_S)
        self.arm()


def refusals(config: Config, rail: RailFindings) -> list[str]:
    """Return why the devices of a configuration may not be moved: rail limits that are unknown."""
    configured = config.limits.rail.model_fields_set if "limits" in config.model_fields_set else set()
    found = []
    for row in rail.rows:
        if row.advised is None:
            found.append(f"limits.rail.{row.key}: {row.why}; {row.advice}")
        elif row.bound is None and not row.is_too_lax and row.key not in configured:
            found.append(f"limits.rail.{row.key} is neither configured nor measured: {row.why}, or configure it")
    return found


def what_moves(config: Config, name: str, goals: int) -> str:
    """Describe the coming motion for the person who must confirm it."""
    drivers, rail = config.drivers, config.limits.rail
    minutes = 2 * (goals * (LEG_S + FLIGHT_S) + _chains(goals) * LEG_S + (goals + _chains(goals)) * FLIGHT_S) / 60
    return (
        f"The robot of {name} will move, for about {minutes:.0f} min: the cart on the rail at {drivers.rail.host}:"
        f"{drivers.rail.port}, between {rail.position_min_m:g} and {rail.position_max_m:g} m at up to "
        f"{rail.velocity_max_m_s:g} m/s, and the arm by the regulator at {drivers.regulator.port}, up to "
        f"{config.limits.pressure.max_kpa:g} kPa. The old and the retrained policy each fly {goals} goals from rest "
        f"and {goals} chained goals. A stop ends the flights."
    )


def fly(
    config: Config,
    policies: Mapping[str, Path],
    goals: int,
    title: str,
    logs: Path,
    twin: Twin | None,
    on_progress: Callable[[str, float], None],
) -> Wires:
    """Fly the same goals with the old and the retrained policy, in turns, so that a drift affects both.

    Args:
        config: Configuration with the rail limits that the campaign shows.
        goals: Number of goals from rest, and of chained goals.
        title: Name of the robot in the results.
        twin: Twin that replaces the devices, or None to move the robot.

    Raises:
        SoftwareInTheLoopError: The daemon or the twin does not start.
        OSError: A file cannot be written.
    """
    legs = _legs(config, goals)
    found: dict[str, list[list[_Flight]]] = {key: [] for key in policies}
    on_progress("starting the daemon", 0.0)
    ended: Ended | None = None
    with Bench(config, policies, logs, twin) as bench:
        log = bench.status()["recorder"]["log"]
        bench.arm()
        try:
            for number, leg in enumerate(legs):
                for turn, key in enumerate(list(policies)[:: 1 if number % 2 == 0 else -1]):
                    share = (2 * number + turn) / (2 * len(legs))
                    on_progress(f"on the wires, {MANNERS[leg.manner]}, {key} policy", share)
                    found[key].append(list(_fly(bench, leg, key)))
        except Ended as why:
            ended = why
        except (SoftwareInTheLoopError, httpx.HTTPError) as error:
            # Flights before the error still count.
            ended = Ended(str(error) or type(error).__name__, None)
        with contextlib.suppress(SoftwareInTheLoopError, httpx.HTTPError):
            bench.lay_down()
    whole = min(map(len, found.values()))
    flown = {(key, manner): _flights(legs, found[key][:whole], manner) for key in policies for manner in MANNERS}
    is_the_robot = twin is None or twin.is_the_robot
    over = (None, None) if ended is None else (str(ended), ended.by)
    return Wires(title if twin is None else twin.title, is_the_robot, flown, log, *over)


def _fly(bench: Bench, leg: _Leg, policy: str) -> Iterator[_Flight]:
    """Yield a leg's flights that count; a stop of the lead is a stop of the goal after it."""
    bench.use(policy)
    bench.settle()
    led = None if leg.lead is None else bench.pursue(leg.lead)
    for number, goal in enumerate(leg.goals):
        flight = led if number == 0 and led is not None and led.stop is not None else bench.pursue(goal)
        yield flight
        if flight.stop is not None:
            bench.recover(flight.stop, policy)


def _legs(config: Config, goals: int) -> list[_Leg]:
    """Return the legs, those from rest first; the same for every call."""
    space = [goal for goal in TEST_TARGETS if not not_flown(goal, config)]
    if not space:
        raise ValueError("goals.workspace contains none of the 54 test targets: widen it, or omit --config")
    order = [space[which % len(space)] for which in np.random.default_rng(_SEED).permutation(max(goals, len(space)))]
    chosen = order[:goals]
    rest = [_Leg(REST, None, (goal,)) for goal in chosen]
    chained = []
    for first in range(0, goals, CHAIN):
        part = tuple(chosen[first : first + CHAIN])
        lead = next((goal for goal in reversed(order) if goal is not part[0]), None)
        chained.append(_Leg(SWINGING, lead, part))
    return rest + chained


def _chains(goals: int) -> int:
    return -(-goals // CHAIN)


def _flights(legs: Sequence[_Leg], flown: Sequence[Sequence[_Flight]], manner: str) -> Flights:
    """Return the flights of one start condition; a leg is a group."""
    of = [each for leg, each in zip(legs, flown, strict=False) if leg.manner == manner]
    every = [flight for each in of for flight in each]
    groups = [number for number, each in enumerate(of) for _ in each]
    reached = np.array([flight.reached for flight in every], dtype=np.bool_)
    return Flights(reached, tuple(flight.stop for flight in every), np.array(groups, dtype=np.int_))
