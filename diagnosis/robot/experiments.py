"""What to fly next: the excitation on which the explanations that fit the data alike would come apart."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.engine.view import Point
from softarm.diagnosis.robot.views import FLOOR_KPA, FLOOR_M_S
from softarm.schemas.excitation import EXCITATIONS, Excitation
from softarm.schemas.model import Model
from softarm.schemas.robot import CONTROL_PERIOD_S
from softarm.schemas.verdict import NextExperiment
from softarm.simulator.effects import value
from softarm.simulator.simulator import Simulator

# Channel -> unit and what counts as a difference.
CHANNELS = {
    "pressure": ("kPa", FLOOR_KPA),
    "cart velocity": ("m/s", FLOOR_M_S),
    "tip y": ("m", 0.004),
    "tip z": ("m", 0.003),
}
NOTHING = 0.5  # floors: explanations that no excitation separates by more are not worth a flight


def splitting(model: Model, explanations: Mapping[str, Point]) -> NextExperiment | None:
    """The excitation that separates the closest pair of explanations best, simulated from commands alone.

    Every explanation stands with the parameters that it was fitted with on all the data at hand.
    """
    names = tuple(explanations)
    if len(names) < 2:
        return None
    best: tuple[float, str, NDArray[np.float64]] | None = None
    for name, excitation in EXCITATIONS.items():
        seen = _fly(model, excitation, [{}, *explanations.values()])  # [T, P, channels]
        floors = np.array([floor for _, floor in CHANNELS.values()])
        apart = min(
            float(np.sqrt((((seen[:, i] - seen[:, j]) / floors) ** 2).mean(axis=0)).max())
            for i, j in combinations(range(1, len(names) + 1), 2)
        )
        if best is None or apart > best[0]:
            best = apart, name, seen
    assert best is not None
    if best[0] < NOTHING:
        return None
    return NextExperiment(excitation=best[1], separates=names, expect=_expected(names, best[2]))


def repeated(kind: str) -> NextExperiment:
    """For what no known effect explains: does it come again under the same commands?"""
    excitation = kind if kind in EXCITATIONS else "both"
    return NextExperiment(
        excitation=excitation,
        separates=("structure", "chance"),
        expect={
            "structure": "flown five times, the residual is the same each time: an effect that nobody has named yet",
            "chance": "flown five times, the residual differs each time: the robot does not repeat itself",
        },
    )


def _expected(names: tuple[str, ...], seen: NDArray[np.float64]) -> dict[str, str]:
    """What each explanation shows where they are furthest apart."""
    floors = np.array([floor for _, floor in CHANNELS.values()])
    spread = np.ptp(seen[:, 1:], axis=1) / floors
    t, c = np.unravel_index(int(np.argmax(spread)), spread.shape)
    channel, (unit, _) = list(CHANNELS.items())[c]
    when = f"at {t * CONTROL_PERIOD_S:.1f} s"
    return {
        name: f"{channel} {seen[t, 1 + i, c] - seen[t, 0, c]:+.3g} {unit} against nominal {when}"
        for i, name in enumerate(names)
    }


def _fly(model: Model, excitation: Excitation, points: list[Point]) -> NDArray[np.float64]:
    paths = sorted({path for point in points for path in point if not path.startswith(("mocap.", "rail.encoder"))})
    overrides = {}
    for path in paths:
        effect, _, parameter = path.rpartition(".")
        nominal = value(model, effect, parameter)
        overrides[path] = np.array([point.get(path, nominal) for point in points])
    simulator = Simulator(model, len(points), overrides=overrides)
    seen = []
    for tick in range(round(excitation.duration_s / CONTROL_PERIOD_S)):
        tip = simulator.tip_m()
        seen.append(
            np.stack((simulator.pressure_reading_kpa, simulator.cart_velocity_m_s, tip[:, 0], tip[:, 1]), axis=1)
        )
        simulator.step(*excitation.at(tick * CONTROL_PERIOD_S), CONTROL_PERIOD_S)
    return np.asarray(seen, dtype=np.float64)
