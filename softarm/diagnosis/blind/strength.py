"""Strength of the weakest form of every cause next to the nuisances: `python -m softarm.diagnosis.blind.strength`.

A robot with nuisances flies the same commands with and without the cause. The RMS change in a signal of the cause's
stage is compared with the RMS change from other nuisances in that stage. Prints the table of docs/evidence/blind.md.
"""

import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from softarm.common import files
from softarm.common.processes import as_they_come, cores
from softarm.diagnosis.blind import pages
from softarm.diagnosis.blind.imperfections import (
    KNOWN,
    UNKNOWN,
    UNKNOWNS,
    Variant,
    draw_nuisances,
    given,
    stage_of,
    variants_of,
)
from softarm.diagnosis.data import folder
from softarm.diagnosis.data.trials import Series, Trial
from softarm.reality.parameters import RobotParameters
from softarm.reality.record import SETTLE_S, record
from softarm.schemas.excitation import EXCITATIONS

Signals = Mapping[str, NDArray[np.float64]]

# Stage -> groups of the robot's parameters that belong to it.
_OWN = {
    "pressure": ("regulator", "pressure_sensor"),
    "rail": ("rail", "cart"),
    "arm": ("body", "arm"),
    "mocap": ("mocap", "clock"),
    "clock": ("clock",),
}
OTHERS = 4
_GRID_HZ = 120.0
_SEED = 7


def signals(trial: Trial, duration_s: float) -> dict[str, Signals]:
    """Return the signals of each stage by name: values on a common grid, or a statistic of the stamps."""
    mocap, rail, gauge, command = (trial.channels[n] for n in ("mocap", "rail", "pressure", "command"))
    grid = np.arange(SETTLE_S + 0.1, SETTLE_S + duration_s - 0.1, 1 / _GRID_HZ)

    def on_grid(series: Series, column: str) -> NDArray[np.float64]:
        return np.asarray(np.interp(grid, series.t_s, series[column]))

    poses = {name: on_grid(mocap, name) for name in mocap.columns if name != "t_receive"}
    angles = [poses[f"link{i}_angle"] for i in range(1, 6)]
    positions = [values for name, values in poses.items() if name.endswith(("_y", "_z"))]
    slip = poses["cart_y"] - on_grid(rail, "position")
    steps = np.diff(command.t_s)
    return {
        "pressure": {"gauge (kPa)": on_grid(gauge, "pressure")},
        "rail": {
            "read-back speed (m/s)": on_grid(rail, "velocity"),
            "cart in mocap (m)": poses["cart_y"],
            "cart less read-back (m)": slip,
        },
        "arm": {"link angles (rad)": np.concatenate(angles)},
        "mocap": {
            "places (m)": np.concatenate(positions),
            "cart's height (m)": poses["cart_z"],
            "cart less read-back (m)": slip,
            "scatter (m)": np.array([np.std(np.diff(mocap["cart_z"]))]),
            "frames lost (-)": np.array([1 - len(mocap) / 120.0 / (mocap.t_s[-1] - mocap.t_s[0])]),
        },
        "clock": {
            "spread of ticks (s)": np.array([np.median(np.abs(steps - np.median(steps)))]),
            "ticks lost (-)": np.array([np.mean(steps > 0.05)]),
            "stamps gained (-)": -np.polyfit(mocap.t_s, mocap["t_receive"] - mocap.t_s, 1)[:1],
        },
    }


def fly(robot: RobotParameters, stage: str) -> dict[str, Signals]:
    """Return a robot's signals under the excitation of a stage."""
    flight = "rail-steps" if stage == "rail" else "both"
    excitation = EXCITATIONS[flight]
    with tempfile.TemporaryDirectory() as place:
        there = Path(place) / flight
        record(excitation.at, there, excitation.duration_s, robot, _SEED, kind=flight)
        return signals(folder.read(there), excitation.duration_s)


def rms(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the RMS of the difference of two signals."""
    return float(np.sqrt(np.mean((one - other) ** 2)))


def jobs() -> Iterator[tuple[str, Variant]]:
    """Yield every cause with each of its variants."""
    for name in (*KNOWN, *(UNKNOWN + name for name in UNKNOWNS)):
        for variant in variants_of(name):
            yield name, variant


def _fly_weakest(job: tuple[str, Variant]) -> dict[str, Signals]:
    name, variant = job
    robot, _ = given(_healthy(_SEED), variant, [knob.weakest for knob in variant])
    return fly(robot, stage_of(name))


def _fly_other(job: tuple[str, int]) -> dict[str, Signals]:
    """Fly the healthy robot with the nuisances of another seed in one stage."""
    stage, seed = job
    other = _healthy(seed)
    return fly(replace(_healthy(_SEED), **{group: getattr(other, group) for group in _OWN[stage]}), stage)


def _healthy(seed: int) -> RobotParameters:
    return draw_nuisances(RobotParameters(), np.random.default_rng(seed))


def _ranges(variant: Variant) -> str:
    """Describe the ranges from which a variant is drawn."""
    sign = {"set": "", "add": "+", "times": "x "}
    both = {"set": "", "add": "±", "times": "x or / "}
    return ", ".join(
        f"`{path}` {both[knob.how] if knob.either_way else sign[knob.how]}"
        + (f"{knob.low:g}" if knob.low == knob.high else f"{knob.low:g} .. {knob.high:g}")
        for knob in variant
        for path in knob.paths
    )


def measure() -> list[dict[str, str | float | None]]:
    """Fly every cause and variant in parallel and return a row for each.

    A row describes the weakest form in its clearest signal; RMS values are in the signal's unit. The ratio is None if
    the nuisances do not change the signal.
    """
    seeds = range(_SEED, _SEED + 1 + OTHERS)
    healthy = dict(as_they_come(_fly_other, [(stage, seed) for stage in _OWN for seed in seeds], cores()))
    same = {stage: healthy[stage, _SEED] for stage in _OWN}
    others = {stage: [healthy[stage, seed] for seed in seeds[1:]] for stage in _OWN}
    weakest = dict(as_they_come(_fly_weakest, list(jobs()), cores()))
    rows = []
    for name, variant in jobs():
        stage = stage_of(name)
        by_cause = {s: rms(values, same[stage][stage][s]) for s, values in weakest[name, variant][stage].items()}
        usual = {
            s: float(np.sqrt(np.mean([rms(other[stage][s], same[stage][stage][s]) ** 2 for other in others[stage]])))
            for s in by_cause
        }
        ratio = {s: by_cause[s] / usual[s] if usual[s] else (np.inf if by_cause[s] else 0.0) for s in by_cause}
        best = max(by_cause, key=lambda s: (ratio[s], by_cause[s]))
        shown = ratio[best] if np.isfinite(ratio[best]) else None
        about = {"cause": name, "drawn": _ranges(variant), "signal": best}
        rows.append({**about, "changes": by_cause[best], "nuisances": usual[best], "ratio": shown})
    return rows


@click.command()
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), help="Write the figures here.")
def main(json_file: Path | None) -> None:
    """Fly every cause and print the table of strengths."""
    rows = measure()
    click.echo(pages.strength(rows), nl=False)
    if json_file is not None:
        files.write_text(json_file, json.dumps({"causes": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
