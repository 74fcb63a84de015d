"""A rig recorded as its owner would: tables and a stage.yaml in one folder, the truth in another.

Every trial runs in lanes side by side: as it is, as its owner believes it to be, without its faults, without each of
them. What the recorded lane shows beyond the others, before any noise, says how clearly each fault can be seen.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.signal import lfilter

from softarm.reality.rigs import excitation
from softarm.reality.rigs.cart import Held, cart
from softarm.reality.rigs.case import RigCase
from softarm.reality.rigs.follower import INNER_SHARE, NAMES, axis, chamber
from softarm.reality.rigs.laws import Array, arrivals, coloured, heard
from softarm.reality.rigs.links import swing
from softarm.reality.rigs.presets import Plant, Rig, damping_of, mass_of, moments_of

Lane = dict[str, float | tuple[float, ...]]
PAUSE_S = 30.0  # between the starts of two trials
LEAD_PACES = 8.0  # of a rig's time, before a recording of one slow motion begins
# Of a rig's time: over which what swings or rolls freely is compared; shorter where motors push it about.
FREE_PACES: Mapping[Plant, float] = {"cart": 4.0, "arm": 4.0, "cart-pendulum": 8.0, "pendulum": 20.0}
BUS_SHARE, JITTER_SHARE = 0.4, 0.03  # of a sample: what a command takes on its bus, and on the mean beyond that
_SENSING = ("delay_s", "late_s", "bias")  # numbers that no plant has


@dataclass(frozen=True, slots=True)
class Run:
    """One trial: stamped columns in house units, and what is clean by variant."""

    kind: str
    sent_s: Array
    sent: dict[str, Array]  # what goes in, by column
    stamps_s: Array
    clean: Array  # [variants, samples, columns]: as recorded, believed, sound, without each fault
    measured: Array  # [samples, columns]


def write(case: RigCase, data: Path, truths: Path) -> dict[str, Any]:
    """Write `data/NAME` (stage.yaml and CSV files) and `truths/NAME.json`; returns the truth.

    Raises ValueError for truths inside the data folder.
    """
    folder = data / case.name
    if data.resolve() in (truths.resolve(), *truths.resolve().parents):
        raise ValueError(f"{truths}: lies inside {data}, which is handed to the tool; name a place outside of it")
    folder.mkdir(parents=True, exist_ok=True)
    truths.mkdir(parents=True, exist_ok=True)
    runs, floor = record(case)
    truth = case.truth | _strengths(case, runs, floor)
    tables = [_write_run(case.rig, run, folder, number) for number, run in enumerate(runs, 1)]
    (folder / "stage.yaml").write_text(yaml.safe_dump(_stage(case.rig, tables), sort_keys=False), encoding="utf-8")
    (truths / f"{case.name}.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return truth


def record(case: RigCase) -> tuple[list[Run], float]:
    """Every trial of a case, and the RMS of its noise and rounding, in house units. Deterministic."""
    random = np.random.default_rng((case.seed, 3))
    rig = case.rig
    believed = _believed(rig)
    sound = _off_nominal(rig, believed, random)
    patches = [c.settings for c in case.causes]
    lanes: list[Lane] = [_with(sound, patches), believed, sound]
    lanes += [_with(sound, [p for p in patches if p is not left]) for left in patches]
    durations = [float(random.uniform(*rig.duration_s)) for _ in case.told]
    if rig.kind == "tracking":
        plain = _follow(case, lanes, durations, random)
    elif rig.kind == "driven_mass":
        plain = _drive(case, lanes, durations, random)
    else:
        plain = _swing(case, lanes, durations, random)
    noise = _Noise.draw(rig, random)
    runs = [_noisy(run, noise, random) for run in plain]
    return runs, noise.rms


def _one(lane: Lane, name: str, otherwise: float = 0.0) -> float:
    """A lane's number that has no joints."""
    return float(np.ravel(lane.get(name, otherwise))[0])


def _with(base: Lane, patches: Sequence[Mapping[str, float | tuple[float, ...]]]) -> Lane:
    out = dict(base)
    for name, value in ((n, v) for patch in patches for n, v in patch.items()):
        # What a rig has and is off by adds up; sizes of their own (a lag, a limit) replace.
        out[name] = _one(out, name) + float(np.ravel(value)[0]) if name in _ADDED else value
    return out


_ADDED = frozenset({"gain", "offset", "load", "delay_s", "late_s", "bias", "tilt_rad", "moment", "strength", "force_n"})


def _believed(rig: Rig) -> Lane:
    """The numbers of a rig as in its stage.yaml."""
    if rig.kind == "tracking":
        return {"lag_s": rig.pace_s, "delay_s": BUS_SHARE / rig.rate_hz} | dict(rig.numbers)
    if rig.kind == "driven_mass":
        return {"delay_s": BUS_SHARE / rig.rate_hz} | dict(rig.numbers)
    return {"viscous_nm_s": damping_of(rig)} | dict(rig.numbers)


def _off_nominal(rig: Rig, believed: Lane, random: np.random.Generator) -> Lane:
    """The rig as it is when nothing is wrong: what a well-kept model is off by."""
    out = dict(believed)
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
            values = np.ravel(believed[name])
            out[name] = tuple(float(v) for v in values * (1 + np.array([_nearly(sigma, random) for _ in values])))
        kept = 1 + _nearly(0.1, random)
        out["viscous_nm_s"] = tuple(kept * joint for joint in damping_of(rig))
        out["friction_nm"] = tuple(1e-5 * joint for joint in moments_of(rig))
        out["tilt_rad"], out["bias_rad"] = _nearly(1e-3, random), _nearly(1e-3, random)
    return out


def _nearly(sigma: float, random: np.random.Generator) -> float:
    """About nought: nobody keeps a model well that is off by more than half as much again."""
    return float(np.clip(random.normal(0, sigma), -1.5 * sigma, 1.5 * sigma))


def _stamps(rig: Rig, duration_s: float, random: np.random.Generator) -> tuple[Array, Array]:
    """When commands are sent and readings taken: never quite on time, some readings lost."""
    step = 1 / rig.rate_hz
    count = round(duration_s * rig.rate_hz)
    sent = step * (np.arange(count) + np.abs(random.normal(0, 0.02, count)))
    stamps = sent if rig.one_file else step * (np.arange(count) + 0.3 + random.normal(0, 0.02, count))
    kept = random.random(count) > random.uniform(0.0, 0.004)
    kept[:2] = True
    return sent, np.asarray(stamps[kept])


def _clean(
    fine: Array, lanes: Sequence[int], late_s: Sequence[float], bias: Sequence[float], t: Array, dt: float
) -> Array:
    """[variants, samples] of fine[N, L] at the stamps, as old and as wrong as each variant's sensor makes it."""
    times = dt * np.arange(1, len(fine) + 1)
    return np.stack(
        [np.interp(t - late, times, fine[:, lane]) + b for lane, late, b in zip(lanes, late_s, bias, strict=True)]
    )


def _follow(case: RigCase, lanes: Sequence[Lane], durations: Sequence[float], random: np.random.Generator) -> list[Run]:
    rig, k = case.rig, len(case.told)
    quickest = min(_one(lane, "lag_s") for lane in lanes)
    dt = min(quickest * INNER_SHARE / 2.5, 1e-3)
    lead = LEAD_PACES * rig.pace_s if len(set(case.told)) == 1 else 0.0
    steps = round((max(durations) + lead) / dt)
    fine_t = dt * np.arange(steps) - lead
    told, heard_by = [], np.empty((steps, len(lanes) * k))
    for trial, (kind, duration) in enumerate(zip(case.told, durations, strict=True)):
        sent, stamps = _stamps(rig, duration, random)
        before = -np.arange(1, round(lead * rig.rate_hz) + 1)[::-1] / rig.rate_hz
        whole = np.concatenate((before, sent))
        shape = excitation.told(kind, whole - whole[0] + np.arange(len(whole)) * 1e-12, rig.pace_s, random)
        values = rig.centre + rig.reach * shape
        told.append((sent, values[len(before) :], stamps))
        queue = np.random.default_rng((case.seed, 4, trial)).integers(2**31)
        for v, lane in enumerate(lanes):  # each variant's queue is late alike
            arrived = arrivals(
                whole,
                _one(lane, "delay_s"),
                JITTER_SHARE / rig.rate_hz,
                np.random.default_rng(queue),
            )
            heard_by[:, v * k + trial] = heard(fine_t, arrived, values)
    clock = np.tile(PAUSE_S * np.arange(k), len(lanes))
    plant = [{n: _one(lane, n) for n in lane if n in NAMES} for lane in lanes for _ in range(k)]
    if rig.plant == "chamber":
        fine = chamber(heard_by, plant, clock, dt)
    else:
        fine = axis(heard_by, plant, clock, dt, rig.plant == "velocity axis")
    late, bias = ([_one(lane, n) for lane in lanes] for n in ("late_s", "bias"))
    runs = []
    for trial, (sent, values, stamps) in enumerate(told):
        of = [v * k + trial for v in range(len(lanes))]
        clean = _clean(fine, of, late, bias, stamps + lead, dt)[:, :, None]
        runs.append(Run(case.told[trial], sent, {"command": values}, stamps, clean, clean[0]))
    return runs


def _smooth(shape: Array, step_s: float, time_s: float, times: int) -> Array:
    """A path that a body can follow: so many lags in series, at rest at first."""
    kept = math.exp(-step_s / time_s)
    out = shape
    for _ in range(times):
        out = np.asarray(lfilter([1 - kept], [1, -kept], out, axis=0, zi=kept * out[:1])[0])
    return out


def _drive(case: RigCase, lanes: Sequence[Lane], durations: Sequence[float], random: np.random.Generator) -> list[Run]:
    rig, k = case.rig, len(case.told)
    each = max(1, math.ceil(1 / (rig.rate_hz * min(rig.pace_s / 60, 1e-3))))
    dt = 1 / (rig.rate_hz * each)
    steps = (round(max(durations) * rig.rate_hz) + 1) * each
    t = dt * np.arange(steps)
    shape = np.stack([excitation.told(kind, t, rig.pace_s, random) for kind in case.told], axis=1)
    path = rig.reach * _smooth(shape, dt, 0.25 * rig.pace_s, 3)
    mass = mass_of(rig)
    held = Held(mass, 2.5 / rig.pace_s, 6 * mass * rig.reach / rig.pace_s**2, rig.quantum)
    clock = np.tile(PAUSE_S * np.arange(k), len(lanes))
    plant = [{n: _one(lane, n) for n in lane} for lane in lanes for _ in range(k)]
    fine, asked = cart(path, plant, clock, dt, each, held, FREE_PACES[rig.plant] * rig.pace_s)
    runs = []
    for trial, duration in enumerate(durations):
        count = round(duration * rig.rate_hz)
        sent = each * dt * np.arange(count)
        _, stamps = _stamps(rig, duration, random)
        stamps = sent if rig.one_file else np.maximum(stamps, 0.0)
        of = [v * k + trial for v in range(len(lanes))]
        clean = _clean(fine, of, [0.0] * len(lanes), [0.0] * len(lanes), stamps, dt)[:, :, None]
        runs.append(Run(case.told[trial], sent, {"force": asked[:count, trial]}, stamps, clean, clean[0]))
    return runs


def _swing(case: RigCase, lanes: Sequence[Lane], durations: Sequence[float], random: np.random.Generator) -> list[Run]:
    rig, k = case.rig, len(case.told)
    n = np.size(rig.numbers["mass_kg"])
    each = max(1, math.ceil(1 / (rig.rate_hz * 2e-3)))
    dt = 1 / (rig.rate_hz * each)
    counts = [round(d * rig.rate_hz) for d in durations]
    steps = max(counts) * each + each
    base, motors = None, None
    start: Array = np.zeros((k, n))
    way: Array = np.zeros((0, k))
    if rig.plant == "pendulum":
        sizes = {"small swing": 0.1, "medium swing": 0.4, "large swing": 1.0}
        size = np.array([sizes[kind] for kind in case.told]) * rig.reach * random.uniform(0.8, 1.1, k)
        start = size[:, None] * random.choice((-1.0, 1.0), (k, 1)) * np.linspace(1.0, random.uniform(0.3, 1.0), n)
    half_t = dt / 2 * np.arange(2 * steps + 1)
    if rig.plant == "cart-pendulum":
        shape = np.stack([excitation.told(kind, half_t, rig.pace_s, random) for kind in case.told], axis=1)
        way = rig.reach * _smooth(shape, dt / 2, 0.3 * rig.pace_s, 5)
        base = np.gradient(np.gradient(way, dt / 2, axis=0), dt / 2, axis=0)
    if rig.plant == "arm":
        motors = _Motors(rig, case.told, dt * np.arange(steps), each, random)
        start = motors.path[0]
    plant = [dict(lane) for lane in lanes for _ in range(k)]
    clock = np.tile(PAUSE_S * np.arange(k), len(lanes))
    fine = swing(start, plant, clock, dt, steps, k, base, motors, FREE_PACES[rig.plant] * rig.pace_s)
    runs = []
    for trial, duration in enumerate(durations):
        sent, stamps = _stamps(rig, duration, random)
        stamps = np.maximum(stamps, 0.0)
        at = [v * k + trial for v in range(len(lanes))]
        times = dt * np.arange(steps)
        clean = np.stack(
            [np.stack([np.interp(stamps, times, fine[:, lane, j]) for j in range(n)], axis=1) for lane in at]
        )
        goes_in: dict[str, Array] = {}
        if motors is not None:
            sent = each * dt * np.arange(counts[trial])
            asked = np.stack(motors.asked)[: counts[trial], trial]
            goes_in = {f"torque{j + 1}": asked[:, j] for j in range(n)}
        if base is not None:
            rough = random.normal(0, 2e-4 * rig.reach, len(sent))
            goes_in = {"position": np.interp(sent, half_t, way[:, trial]) + rough}
        runs.append(Run(case.told[trial], sent, goes_in, stamps, clean, clean[0]))
    return runs


class _Motors:
    """Whoever records an arm leads its joints along paths by a controller, and writes down the torques."""

    def __init__(self, rig: Rig, told: Sequence[str], t_s: Array, each: int, random: np.random.Generator) -> None:
        n = np.size(rig.numbers["mass_kg"])
        shape = np.stack(
            [
                np.stack([excitation.told(kind, t_s, rig.pace_s * (1 + 0.3 * j), random) for kind in told], axis=1)
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
        """[K, n] N m, new at every sample."""
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
    """Of a rig's sensor, house units."""

    white: float
    slow: float
    corner_hz: float
    quantum: float

    @classmethod
    def draw(cls, rig: Rig, random: np.random.Generator) -> "_Noise":
        # Encoders are good; gauges and rates are not.
        share = {"tracking": 1.0, "driven_mass": 0.1, "pendulum": 0.4, "chain": 0.4}[rig.kind] * rig.reach
        white = float(random.uniform(1e-3, 4e-3)) * share
        return cls(white, float(random.uniform(3e-4, 1.2e-3)) * share, float(random.uniform(0.5, 4.0)), rig.quantum)

    @property
    def rms(self) -> float:
        return math.sqrt(self.white**2 + self.slow**2 + self.quantum**2 / 12)

    def on(self, clean: Array, step_s: float, random: np.random.Generator) -> Array:
        """What the sensor says of [samples, columns]."""
        out = clean + random.normal(0, self.white, clean.shape)
        for column in range(clean.shape[1]):
            out[:, column] += coloured(len(clean), step_s, self.slow, self.corner_hz, random)
        return np.asarray(np.round(out / self.quantum) * self.quantum if self.quantum > 0 else out)


def _noisy(run: Run, noise: _Noise, random: np.random.Generator) -> Run:
    step = float(np.median(np.diff(run.stamps_s)))
    return Run(run.kind, run.sent_s, run.sent, run.stamps_s, run.clean, noise.on(run.clean[0], step, random))


def _strengths(case: RigCase, runs: Sequence[Run], floor: float) -> dict[str, Any]:
    """How clearly each fault shows: RMS that it changes, over the noise and what a well-kept model is off by."""

    def rms(one: int, other: int) -> float:
        return math.sqrt(float(np.mean(np.concatenate([np.ravel(r.clean[one] - r.clean[other]) ** 2 for r in runs]))))

    off = rms(2, 1)
    shows = {c.fault: rms(0, 3 + i) / math.hypot(floor, off) for i, c in enumerate(case.causes)}
    return {"floor": floor, "off_nominal": off, "shows": shows, "clarity": min(shows.values(), default=math.inf)}


def _write_run(rig: Rig, run: Run, folder: Path, number: int) -> dict[str, Any]:
    name = f"trial-{number}"
    sent = {n: x / (rig.command_worth if rig.kind != "chain" else 1.0) for n, x in run.sent.items()}
    seen = {n: run.measured[:, i] / rig.measured_worth for i, n in enumerate(_columns(rig))}
    if rig.one_file and run.sent:
        # A row a reading: with it the newest command.
        row = np.maximum(np.searchsorted(run.sent_s, run.stamps_s + 1e-9, side="right") - 1, 0)
        _table(folder / f"{name}.csv", {"time": run.stamps_s} | {n: x[row] for n, x in sent.items()} | seen)
        files = dict.fromkeys((*_inputs(rig), "measured"), f"{name}.csv")
    else:
        _table(folder / f"{name}-measured.csv", {"time": run.stamps_s} | seen)
        files = {"measured": f"{name}-measured.csv"}
        for channel in _inputs(rig):
            _table(folder / f"{name}-{channel}.csv", {"time": run.sent_s} | sent)
            files[channel] = f"{name}-{channel}.csv"
    return {"name": name, "kind": run.kind, "files": files}


def _table(file: Path, columns: Mapping[str, Array]) -> None:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(file, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.8g")


def _columns(rig: Rig) -> list[str]:
    """What is measured, by the names that a stage.yaml has for it."""
    if rig.kind in ("pendulum", "chain"):
        return [f"angle{i}" for i in range(1, np.size(rig.numbers["mass_kg"]) + 1)]
    return ["velocity" if rig.plant == "velocity axis" else "pressure" if rig.plant == "chamber" else "position"]


def _inputs(rig: Rig) -> tuple[str, ...]:
    """The channels beside `measured`."""
    return {
        "tracking": ("command",), "driven_mass": ("force",), "pendulum": (),
        "chain": ("base",) if rig.plant == "cart-pendulum" else ("torque",),
    }[rig.kind]  # fmt: skip


def _stage(rig: Rig, tables: list[dict[str, Any]]) -> dict[str, Any]:
    """stage.yaml: what the owner knows."""
    time = {"source": "time", "unit": "s"}
    channels: dict[str, Any] = {}
    for channel in _inputs(rig):
        if channel == "command":
            columns = {"command": {"source": "command", "unit": rig.command_unit}}
        elif channel == "force":
            name = "force" if rig.command_unit == "N" else "current"
            columns = {name: {"source": "force", "unit": rig.command_unit}}
        elif channel == "base":
            columns = {"position": {"source": "position", "unit": "m"}}
        else:
            columns = {f"torque{j}": {"source": f"torque{j}", "unit": "N m"} for j in (1, 2)}
        channels[channel] = {"time": time, "columns": columns}
    seen = {name: {"source": name, "unit": rig.measured_unit} for name in _columns(rig)}
    channels["measured"] = {"time": time, "columns": seen}
    out: dict[str, Any] = {"name": rig.name, "kind": rig.kind}
    if rig.kind in ("pendulum", "chain"):
        out["links"] = len(seen)
    return out | {"channels": channels, "model": stage_model(rig), "trials": tables}


def stage_model(rig: Rig) -> dict[str, Any]:
    """The owner's numbers, by the keys of a stage.yaml."""
    if rig.kind == "tracking":
        # Two loops are two lags: the longer is called the lag, the shorter one a delay, with the bus and its jitter.
        longer = rig.pace_s * (1 + math.sqrt(1 - 4 * INNER_SHARE)) / 2
        late = rig.pace_s - longer + (BUS_SHARE + JITTER_SHARE) / rig.rate_hz
        model: dict[str, Any] = {"lag_s": round(longer, 6), "delay_s": round(late, 6)}
        if rig.command_unit != rig.measured_unit:
            model["gain"] = rig.command_worth / rig.measured_worth
        return model
    if rig.kind == "driven_mass":
        motor = {"A": 1.0, "mA": 1e3}.get(rig.command_unit)
        gain = {} if motor is None else {"gain": rig.command_worth * motor}
        return {"mass_kg": rig.numbers["mass_kg"], "delay_s": round(BUS_SHARE / rig.rate_hz, 6)} | gain
    model = {
        name: list(np.ravel(rig.numbers[name]).tolist())
        for name in ("mass_kg", "centre_m", "inertia_kg_m2", "length_m")
    }
    return model | {"damping_nm_s_rad": [float(f"{joint:.6g}") for joint in damping_of(rig)]}
