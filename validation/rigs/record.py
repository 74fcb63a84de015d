"""Recorder of rigs: writes tables and a stage.yaml, as an owner would, to one folder and the truth to another.

Every trial runs in parallel lanes: with all faults, nominal, without faults, and without each single fault. The
noise-free difference between the recorded lane and another one measures how clearly a fault is visible.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from validation.rigs import excitation
from validation.rigs.cart import Controller, cart
from validation.rigs.case import RigCase
from validation.rigs.follower import DEFAULTS, INNER_SHARE, LONGER_SHARE, axis, chamber
from validation.rigs.laws import Array, arrivals, coloured, held
from validation.rigs.links import swing
from validation.rigs.presets import Plant, Rig, damping_of, mass_of, moments_of

Lane = dict[str, float | tuple[float, ...]]
# Time between the starts of two trials.
PAUSE_S = 30.0
# Lead time of a recording with a single slow motion, in time scales of the rig.
LEAD_PACES = 8.0
# Time over which freely moving variants are compared, in time scales of the rig; shorter for rigs with motors.
FREE_PACES: Mapping[Plant, float] = {"cart": 4.0, "arm": 4.0, "cart-pendulum": 8.0, "pendulum": 20.0}
# Delay of a command on its bus, and the mean of its jitter, as shares of a sample.
BUS_SHARE, JITTER_SHARE = 0.4, 0.03


@dataclass(frozen=True, slots=True)
class Run:
    """One trial: stamped columns in base units, and the noise-free signals of each variant."""

    kind: str
    sent_s: Array
    sent: dict[str, Array]  # inputs by column
    stamps_s: Array
    clean: Array  # [variants, samples, columns]; variants: as recorded, nominal, without faults, without each fault
    measured: Array  # [samples, columns]


def write(case: RigCase, data: Path, truths: Path) -> dict[str, Any]:
    """Write `data/NAME` (stage.yaml and CSV files) and `truths/NAME.json`, and return the truth."""
    folder = data / case.name
    folder.mkdir(parents=True, exist_ok=True)
    truths.mkdir(parents=True, exist_ok=True)
    runs, noise_rms = record(case)
    truth = case.truth | _strengths(case, runs, noise_rms)
    tables = [_write_run(case.rig, run, folder, number) for number, run in enumerate(runs, 1)]
    (folder / "stage.yaml").write_text(yaml.safe_dump(_stage(case.rig, tables), sort_keys=False), encoding="utf-8")
    (truths / f"{case.name}.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return truth


def record(case: RigCase) -> tuple[list[Run], float]:
    """Return every trial of a case, and the RMS of its noise and rounding in base units; deterministic."""
    random = np.random.default_rng((case.seed, 3))
    rig = case.rig
    known = nominal(rig)
    healthy = _healthy(rig, known, random)
    patches = [c.settings for c in case.causes]
    lanes: list[Lane] = [_with(healthy, patches), known, healthy]
    lanes += [_with(healthy, [p for p in patches if p is not left]) for left in patches]
    durations = [float(random.uniform(*rig.duration_s)) for _ in case.excitations]
    simulate = {"tracking": _follow, "driven_mass": _drive}.get(rig.kind, _swing)
    plain = simulate(case, lanes, durations, random)
    noise = _Noise.draw(rig, random)
    return [replace(run, measured=noise.on(run, random)) for run in plain], noise.rms


def _one(lane: Lane, name: str) -> float:
    """Return a scalar parameter of a lane, 0 if it is not given."""
    return float(np.ravel(lane.get(name, 0.0))[0])


def _with(base: Lane, patches: Sequence[Mapping[str, float | tuple[float, ...]]]) -> Lane:
    out = dict(base)
    for name, value in ((n, v) for patch in patches for n, v in patch.items()):
        # Errors add up; a parameter with its own size (a lag, a limit) is replaced.
        out[name] = _one(out, name) + float(np.ravel(value)[0]) if name in _ADDED else value
    return out


_ADDED = frozenset({"gain", "offset", "load", "delay_s", "late_s", "bias", "tilt_rad", "moment", "strength", "force_n"})


def nominal(rig: Rig) -> Lane:
    """Return the parameters of a rig as in its stage.yaml."""
    if rig.kind == "tracking":
        return {"lag_s": rig.pace_s, "delay_s": BUS_SHARE / rig.rate_hz} | dict(rig.parameters)
    if rig.kind == "driven_mass":
        return {"delay_s": BUS_SHARE / rig.rate_hz} | dict(rig.parameters)
    return {"viscous_nm_s": damping_of(rig)} | dict(rig.parameters)


def _healthy(rig: Rig, nominal: Lane, random: np.random.Generator) -> Lane:
    """Return the rig without faults: its parameters have the small errors of a well-kept model."""
    out = dict(nominal)
    if rig.kind == "tracking":
        out["lag_s"] = rig.pace_s * (1 + _nearly(0.01, random))
        out["gain"] = _nearly(0.002, random)
        out["offset"] = _nearly(0.001, random) * rig.reach
        if rig.plant == "chamber":
            out["lag_down_s"] = rig.pace_s * (1 + _nearly(0.015, random))
    elif rig.kind == "driven_mass":
        out["mass_kg"] = mass_of(rig) * (1 + _nearly(0.004, random))
        out["gain"] = _nearly(0.003, random)
        out["slope_rad"] = _nearly(2e-4, random)
    else:
        for name, sigma in (("mass_kg", 0.003), ("inertia_kg_m2", 0.01), ("centre_m", 0.001)):
            values = np.ravel(nominal[name])
            out[name] = tuple(float(v) for v in values * (1 + np.array([_nearly(sigma, random) for _ in values])))
        kept = 1 + _nearly(0.1, random)
        out["viscous_nm_s"] = tuple(kept * joint for joint in damping_of(rig))
        out["friction_nm"] = tuple(1e-5 * joint for joint in moments_of(rig))
        out["tilt_rad"], out["bias_rad"] = _nearly(1e-3, random), _nearly(1e-3, random)
    return out


def _nearly(sigma: float, random: np.random.Generator) -> float:
    """Return a normal error, limited to 1.5 sigma."""
    return float(np.clip(random.normal(0, sigma), -1.5 * sigma, 1.5 * sigma))


def _stamps(rig: Rig, duration_s: float, random: np.random.Generator) -> tuple[Array, Array]:
    """Return the times of commands and readings, with jitter and a few lost readings."""
    step = 1 / rig.rate_hz
    count = round(duration_s * rig.rate_hz)
    sent = step * (np.arange(count) + np.abs(random.normal(0, 0.02, count)))
    stamps = sent if rig.one_file else step * (np.arange(count) + 0.3 + random.normal(0, 0.02, count))
    kept = random.random(count) > random.uniform(0.0, 0.004)
    kept[:2] = True
    return sent, np.asarray(stamps[kept])


def _clean(times_s: Array, fine: Array, stamps_s: Array, late_s: ArrayLike = 0.0, bias: ArrayLike = 0.0) -> Array:
    """Return simulated signals [N, variants] at the stamps [variants, samples], with sensor delay and bias of each."""
    late, offset = (np.broadcast_to(each, fine.shape[1]) for each in (late_s, bias))
    return np.stack(
        [np.interp(stamps_s - s, times_s, signal) + b for signal, s, b in zip(fine.T, late, offset, strict=True)]
    )


def _follow(case: RigCase, lanes: Sequence[Lane], durations: Sequence[float], random: np.random.Generator) -> list[Run]:
    rig, k = case.rig, len(case.excitations)
    quickest = min(_one(lane, "lag_s") for lane in lanes)
    dt = min(quickest * INNER_SHARE / 2.5, 1e-3)
    lead = LEAD_PACES * rig.pace_s if len(set(case.excitations)) == 1 else 0.0
    steps = round((max(durations) + lead) / dt)
    fine_t = dt * np.arange(steps) - lead
    commands, received = [], np.empty((steps, len(lanes) * k))
    for trial, (kind, duration) in enumerate(zip(case.excitations, durations, strict=True)):
        sent, stamps = _stamps(rig, duration, random)
        before = -np.arange(1, round(lead * rig.rate_hz) + 1)[::-1] / rig.rate_hz
        whole = np.concatenate((before, sent))
        shape = excitation.signal(kind, whole - whole[0] + np.arange(len(whole)) * 1e-12, rig.pace_s, random)
        values = rig.centre + rig.reach * shape
        commands.append((sent, values[len(before) :], stamps))
        queue = np.random.default_rng((case.seed, 4, trial)).integers(2**31)
        # All variants have the same jitter.
        for v, lane in enumerate(lanes):
            arrived = arrivals(
                whole,
                _one(lane, "delay_s"),
                JITTER_SHARE / rig.rate_hz,
                np.random.default_rng(queue),
            )
            received[:, v * k + trial] = held(fine_t, arrived, values)
    clock = np.tile(PAUSE_S * np.arange(k), len(lanes))
    plant = [{n: _one(lane, n) for n in lane if n in DEFAULTS} for lane in lanes for _ in range(k)]
    if rig.plant == "chamber":
        fine = chamber(received, plant, clock, dt)
    else:
        fine = axis(received, plant, clock, dt, rig.plant == "velocity axis")
    late, bias = ([_one(lane, n) for lane in lanes] for n in ("late_s", "bias"))
    runs = []
    times = dt * np.arange(1, steps + 1)
    for trial, (sent, values, stamps) in enumerate(commands):
        clean = _clean(times, fine[:, trial::k], stamps + lead, late, bias)[:, :, None]
        runs.append(Run(case.excitations[trial], sent, {"command": values}, stamps, clean, clean[0]))
    return runs


def _smooth(shape: Array, step_s: float, time_s: float, times: int) -> Array:
    """Return a path that a body can follow: the shape after a number of equal lags, at rest at first."""
    kept = math.exp(-step_s / time_s)
    out = shape
    for _ in range(times):
        out = np.asarray(lfilter([1 - kept], [1, -kept], out, axis=0, zi=kept * out[:1])[0])
    return out


def _drive(case: RigCase, lanes: Sequence[Lane], durations: Sequence[float], random: np.random.Generator) -> list[Run]:
    rig, k = case.rig, len(case.excitations)
    each = max(1, math.ceil(1 / (rig.rate_hz * min(rig.pace_s / 60, 1e-3))))
    dt = 1 / (rig.rate_hz * each)
    steps = (round(max(durations) * rig.rate_hz) + 1) * each
    t = dt * np.arange(steps)
    shape = np.stack([excitation.signal(kind, t, rig.pace_s, random) for kind in case.excitations], axis=1)
    path = rig.reach * _smooth(shape, dt, 0.25 * rig.pace_s, 3)
    mass = mass_of(rig)
    controller = Controller(mass, 2.5 / rig.pace_s, 6 * mass * rig.reach / rig.pace_s**2, rig.quantum)
    clock = np.tile(PAUSE_S * np.arange(k), len(lanes))
    plant = [{n: _one(lane, n) for n in lane} for lane in lanes for _ in range(k)]
    fine, asked = cart(path, plant, clock, dt, each, controller, FREE_PACES[rig.plant] * rig.pace_s)
    runs = []
    for trial, duration in enumerate(durations):
        count = round(duration * rig.rate_hz)
        sent = each * dt * np.arange(count)
        _, stamps = _stamps(rig, duration, random)
        stamps = sent if rig.one_file else np.maximum(stamps, 0.0)
        clean = _clean(t, fine[:, trial::k], stamps)[:, :, None]
        runs.append(Run(case.excitations[trial], sent, {"force": asked[:count, trial]}, stamps, clean, clean[0]))
    return runs


def _swing(case: RigCase, lanes: Sequence[Lane], durations: Sequence[float], random: np.random.Generator) -> list[Run]:
    rig, k = case.rig, len(case.excitations)
    n = np.size(rig.parameters["mass_kg"])
    each = max(1, math.ceil(1 / (rig.rate_hz * 2e-3)))
    dt = 1 / (rig.rate_hz * each)
    counts = [round(d * rig.rate_hz) for d in durations]
    steps = max(counts) * each + each
    base, motors = None, None
    start: Array = np.zeros((k, n))
    way: Array = np.zeros((0, k))
    if rig.plant == "pendulum":
        sizes = {"small swing": 0.1, "medium swing": 0.4, "large swing": 1.0}
        size = np.array([sizes[kind] for kind in case.excitations]) * rig.reach * random.uniform(0.8, 1.1, k)
        start = size[:, None] * random.choice((-1.0, 1.0), (k, 1)) * np.linspace(1.0, random.uniform(0.3, 1.0), n)
    half_t = dt / 2 * np.arange(2 * steps + 1)
    if rig.plant == "cart-pendulum":
        shape = np.stack([excitation.signal(kind, half_t, rig.pace_s, random) for kind in case.excitations], axis=1)
        way = rig.reach * _smooth(shape, dt / 2, 0.3 * rig.pace_s, 5)
        base = np.gradient(np.gradient(way, dt / 2, axis=0), dt / 2, axis=0)
    if rig.plant == "arm":
        motors = _Motors(rig, case.excitations, dt * np.arange(steps), each, random)
        start = motors.path[0]
    plant = [dict(lane) for lane in lanes for _ in range(k)]
    clock = np.tile(PAUSE_S * np.arange(k), len(lanes))
    fine = swing(start, plant, clock, dt, steps, k, base, motors, FREE_PACES[rig.plant] * rig.pace_s)
    runs = []
    for trial, duration in enumerate(durations):
        sent, stamps = _stamps(rig, duration, random)
        stamps = np.maximum(stamps, 0.0)
        times = dt * np.arange(steps)
        clean = np.stack([_clean(times, fine[:, trial::k, j], stamps) for j in range(n)], axis=2)
        inputs: dict[str, Array] = {}
        if motors is not None:
            sent = each * dt * np.arange(counts[trial])
            asked = np.stack(motors.asked)[: counts[trial], trial]
            inputs = {f"torque{j + 1}": asked[:, j] for j in range(n)}
        if base is not None:
            rough = random.normal(0, 2e-4 * rig.reach, len(sent))
            inputs = {"position": np.interp(sent, half_t, way[:, trial]) + rough}
        runs.append(Run(case.excitations[trial], sent, inputs, stamps, clean, clean[0]))
    return runs


class _Motors:
    """Recording controller of an arm: leads the joints along paths and stores the torques."""

    def __init__(
        self, rig: Rig, excitations: Sequence[str], t_s: Array, each: int, random: np.random.Generator
    ) -> None:
        n = np.size(rig.parameters["mass_kg"])
        shape = np.stack(
            [
                np.stack(
                    [excitation.signal(kind, t_s, rig.pace_s * (1 + 0.3 * j), random) for kind in excitations], axis=1
                )
                for j in range(n)
            ],
            axis=2,
        )
        self.path: Array = rig.centre + rig.reach * _smooth(shape, t_s[1] - t_s[0], 0.3 * rig.pace_s, 3)
        self._each = each
        self._stiff = moments_of(rig)[0] * np.array([2.5, 0.8])[:n]
        self._damp = self._stiff * np.array([0.12, 0.1])[:n]
        self._weight = np.array(moments_of(rig))
        self.asked: list[Array] = []

    def __call__(self, step: int, q: Array, v: Array) -> Array:
        """Return the torques, N m [K, n]; they change at every sample."""
        if step % self._each == 0:
            joint, rate = q.copy(), v.copy()
            joint[:, 1:] -= q[:, :-1]
            rate[:, 1:] -= v[:, :-1]
            path = self.path[step]
            weight = self._weight * np.sin(np.cumsum(path, axis=1))
            self.asked.append(self._stiff * (path - joint) - self._damp * rate + weight)
        return self.asked[-1]


@dataclass(frozen=True, slots=True)
class _Noise:
    """Noise of a rig's sensor, in base units."""

    white: float
    slow: float
    corner_hz: float
    quantum: float

    @classmethod
    def draw(cls, rig: Rig, random: np.random.Generator) -> "_Noise":
        # Encoders have less noise than pressure and rate sensors.
        share = {"tracking": 1.0, "driven_mass": 0.1, "pendulum": 0.4, "chain": 0.4}[rig.kind] * rig.reach
        white = float(random.uniform(1e-3, 4e-3)) * share
        return cls(white, float(random.uniform(3e-4, 1.2e-3)) * share, float(random.uniform(0.5, 4.0)), rig.quantum)

    @property
    def rms(self) -> float:
        return math.sqrt(self.white**2 + self.slow**2 + self.quantum**2 / 12)

    def on(self, run: Run, random: np.random.Generator) -> Array:
        """Return noisy, rounded readings of the recorded variant [samples, columns]."""
        clean, step_s = run.clean[0], float(np.median(np.diff(run.stamps_s)))
        out = clean + random.normal(0, self.white, clean.shape)
        for column in range(clean.shape[1]):
            out[:, column] += coloured(len(clean), step_s, self.slow, self.corner_hz, random)
        return np.asarray(np.round(out / self.quantum) * self.quantum if self.quantum > 0 else out)


def _strengths(case: RigCase, runs: Sequence[Run], noise_rms: float) -> dict[str, Any]:
    """Return the visibility of each fault: its RMS effect over the RMS of noise and model error."""

    def rms(one: int, other: int) -> float:
        return math.sqrt(float(np.mean(np.concatenate([np.ravel(r.clean[one] - r.clean[other]) ** 2 for r in runs]))))

    off = rms(2, 1)
    shows = {c.fault: rms(0, 3 + i) / math.hypot(noise_rms, off) for i, c in enumerate(case.causes)}
    return {"floor": noise_rms, "off_nominal": off, "shows": shows, "clarity": min(shows.values(), default=math.inf)}


def _write_run(rig: Rig, run: Run, folder: Path, number: int) -> dict[str, Any]:
    name, channels = f"trial-{number}", _channels(rig)
    sent = {n: x / (rig.command_worth if rig.kind != "chain" else 1.0) for n, x in run.sent.items()}
    seen = {n: run.measured[:, i] / rig.measured_worth for i, n in enumerate(channels["measured"])}
    if rig.one_file and run.sent:
        # One row per reading, with the newest command.
        row = np.maximum(np.searchsorted(run.sent_s, run.stamps_s + 1e-9, side="right") - 1, 0)
        _table(folder / f"{name}.csv", {"time": run.stamps_s} | {n: x[row] for n, x in sent.items()} | seen)
        files = dict.fromkeys(channels, f"{name}.csv")
    else:
        _table(folder / f"{name}-measured.csv", {"time": run.stamps_s} | seen)
        files = {"measured": f"{name}-measured.csv"}
        for channel in list(channels)[:-1]:
            _table(folder / f"{name}-{channel}.csv", {"time": run.sent_s} | sent)
            files[channel] = f"{name}-{channel}.csv"
    return {"name": name, "kind": run.kind, "files": files}


def _table(file: Path, columns: Mapping[str, Array]) -> None:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(file, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.8g")


def _channels(rig: Rig) -> dict[str, dict[str, tuple[str, str]]]:
    """Return the channels of stage.yaml, inputs first: each column's source and unit by its name."""
    command, links = rig.command_unit, range(1, np.size(rig.parameters.get("mass_kg", 1.0)) + 1)
    tracked = {"command": {"command": ("command", command)}}
    inputs: dict[str, dict[str, tuple[str, str]]] = {
        "cart": {"force": {"force" if command == "N" else "current": ("force", command)}},
        "pendulum": {},
        "arm": {"torque": {f"torque{j}": (f"torque{j}", "N m") for j in links}},
        "cart-pendulum": {"base": {"position": ("position", "m")}},
    }.get(rig.plant, tracked)
    if rig.kind in ("pendulum", "chain"):
        seen = [f"angle{j}" for j in links]
    else:
        seen = ["velocity" if rig.plant == "velocity axis" else "pressure" if rig.plant == "chamber" else "position"]
    return inputs | {"measured": {name: (name, rig.measured_unit) for name in seen}}


def _stage(rig: Rig, tables: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the contents of stage.yaml."""
    time = {"source": "time", "unit": "s"}
    channels = {
        channel: {
            "time": time,
            "columns": {n: {"source": source, "unit": unit} for n, (source, unit) in columns.items()},
        }
        for channel, columns in _channels(rig).items()
    }
    out: dict[str, Any] = {"name": rig.name, "kind": rig.kind}
    if rig.kind in ("pendulum", "chain"):
        out["links"] = np.size(rig.parameters["mass_kg"])
    return out | {"channels": channels, "model": stage_model(rig), "trials": tables}


def stage_model(rig: Rig) -> dict[str, Any]:
    """Return the nominal parameters by their keys in stage.yaml."""
    if rig.kind == "tracking":
        # Two loops have two lags: the longer one is the lag; the shorter one, the bus and its jitter are the delay.
        longer = rig.pace_s * LONGER_SHARE
        late = rig.pace_s - longer + (BUS_SHARE + JITTER_SHARE) / rig.rate_hz
        model: dict[str, Any] = {"lag_s": round(longer, 6), "delay_s": round(late, 6)}
        if rig.command_unit != rig.measured_unit:
            model["gain"] = rig.command_worth / rig.measured_worth
        return model
    if rig.kind == "driven_mass":
        motor = {"A": 1.0, "mA": 1e3}.get(rig.command_unit)
        gain = {} if motor is None else {"gain": rig.command_worth * motor}
        return {"mass_kg": rig.parameters["mass_kg"], "delay_s": round(BUS_SHARE / rig.rate_hz, 6)} | gain
    model = {
        name: list(np.ravel(rig.parameters[name]).tolist())
        for name in ("mass_kg", "centre_m", "inertia_kg_m2", "length_m")
    }
    return model | {"damping_nm_s_rad": [float(f"{joint:.6g}") for joint in damping_of(rig)]}
