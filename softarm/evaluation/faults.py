"""Worst case of policies: the independent robot with one strong fault at a time, from rest and in mid-swing."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import TypedDict

from softarm.common.batch import Work, Workers, run
from softarm.evaluation.entries import Entry, files_of
from softarm.evaluation.robots import with_faults
from softarm.evaluation.runner import fly, load
from softarm.reality.parameters import RobotParameters
from softarm.schemas import flights
from softarm.schemas.config import Config
from softarm.schemas.flights import CART_STARTS_M, Flight

NO_FAULT = "none"
# At least as strong as the exemplars of the effect registry. The first ones are stronger, up to the worst of a bench.
FAULTS = (
    "rail.delay_s=0.09",
    "rail.acceleration_m_s2=2",
    "rail.lag_s=0.1",
    "rail.viscous_n_s_m=15",
    "rail.force_limit_n=8",
    "regulator.dead_time_s=0.15",
    "regulator.flow_limit_kpa_s=40",
    "regulator.ceiling_kpa=12",
    "regulator.gain=-0.3",
    "arm.payload_kg=0.12",
    "arm.muscle_gain=-0.35",
    "arm.saturation_kpa=10",
    "arm.stiffness=0.5",
    "arm.stiffness=-0.35",
    "arm.damping=1",
    "arm.damping=2",
    "arm.torque_offset=2",
    "regulator.deadband_kpa=0.5",
    "regulator.offset_kpa=0.5",
    "regulator.leak_1_s=0.5",
    "pressure_sensor.bias_kpa=1",
    "rail.feed_error=0.05",
    "rail.coulomb_n=2",
    "rail.backlash_m=0.002",
    "arm.friction_nm=0.01",
    "arm.stiffening_1_rad2=0.5",
    "arm.hysteresis=0.3",
    "arm.tilt_rad=0.03",
    "arm.creep=0.3",
    "mocap.latency_s=0.02",
    "mocap.dropout=0.1",
    "mocap.rotation_rad=0.03",
    "mocap.scale=0.02",
    "mocap.offset_y_m=0.01",
    "mocap.noise_m=0.002",
)


class Worst(TypedDict):
    """Results of one policy on one robot."""

    rest: float  # share of the targets that are reached
    swinging: float
    stops: int  # unrequested, of both


def measure(
    entries: Sequence[Entry],
    workers: Workers | None = None,
    config: Config | None = None,
    faults: Sequence[str] = FAULTS,
) -> dict[str, dict[str, Worst]]:
    """Return fault -> policy -> results; several seeds of one policy are several policies.

    Every second of the paper's 54 targets is flown once from rest and once in mid-swing.

    Raises:
        JobsFailed: A policy could not be flown.
    """
    count, every = Counter(entry.name for entry in entries), (NO_FAULT, *faults)
    rows = {entry.name if count[entry.name] == 1 else f"{entry.name}, seed {entry.seed}": entry for entry in entries}
    todo = {f"{name}, {fault}": (entry, fault) for fault in every for name, entry in rows.items()}
    work = Work(partial(_fly, config=config), reads=lambda job: files_of(job[0], config))
    done = run("flying", work, todo, workers).complete()
    return {fault: {name: done[f"{name}, {fault}"] for name in rows} for fault in every}


def lines(found: dict[str, dict[str, Worst]]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return the table: its head, and a row per fault, `rest / mid-swing` in percent and the stops, if any."""
    rows = [(fault, *map(_text, of.values())) for fault, of in found.items()]
    names = found[NO_FAULT]
    strong = [of for fault, of in found.items() if fault != NO_FAULT]
    least = (min(share for of in strong for share in _shares(of[name])) for name in names)
    rows.append(("worst", *(f"{100 * share:.0f}" for share in least)))
    return ("fault", *names), rows


def _shares(worst: Worst) -> tuple[float, float]:
    return worst["rest"], worst["swinging"]


def _text(worst: Worst) -> str:
    stops = f", {worst['stops']} stops" if worst["stops"] else ""
    return " / ".join(f"{100 * share:.0f}" for share in _shares(worst)) + stops


def _fly(job: tuple[Entry, str], config: Config | None) -> Worst:
    entry, fault = job
    robot = with_faults(RobotParameters(), [] if fault == NO_FAULT else [fault])
    policy, size = load(entry.file or entry.name, config), len(CART_STARTS_M)
    # Target k starts at cart position k mod 3.
    numbers = [k * size + k % size for k in range(0, len(flights.TEST_TARGETS), 2)]
    rest, swung = (fly(policy, robot, [of()[k] for k in numbers], config) for of in (flights.grid, flights.swinging))
    stops = sum(flight.stop is not None for flight in (*rest, *swung))
    return Worst(rest=_reached(rest), swinging=_reached(swung), stops=stops)


def _reached(flown: Sequence[Flight]) -> float:
    return sum(flight.reached for flight in flown) / len(flown)
