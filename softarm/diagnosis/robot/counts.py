"""Effects measured without simulation: from stamps, from noise, and from the observation's velocities.

Each is estimated in every trial; the error of the other trials' estimate is its held-out gap.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import stdtrit

from softarm.diagnosis.data.trials import Series, Trial
from softarm.diagnosis.engine.view import Array
from softarm.schemas.model import Model
from softarm.simulator.effects import REGISTRY, find, value

# Values of a well-kept robot; a smaller effect is not named.
TOLERANCE = {
    "clock.jitter": 0.0012,
    "clock.missed_ticks": 0.015,
    "clock.drift": 0.0003,  # quartz keeps 50 ppm
    "mocap.dropout": 0.02,
    "mocap.noise": 0.0005,
}
FEW = 5  # smallest number of events for a share
HALF_NORMAL_STD = 0.6028  # standard deviation over sigma
SKEWED = 0.5
MEDIAN_WIDER = 1.2533  # the error of a median over that of a mean
SLOPE_FRAMES = 5  # over which a velocity is averaged
VELOCITY_RATIO_MAX = 0.75  # largest error of one way to compute velocities, relative to the other
VELOCITY_FLOOR_M_S = 0.03


@dataclass(frozen=True, slots=True)
class Count:
    """Effect measured on all trials."""

    name: str
    parameter: str  # empty for an effect that is on or off
    unit: str
    before: float  # RMS error of the nominal model over trials
    after: float  # RMS error of the other trials' estimate
    floor: float
    named: bool
    nominal: float = 0.0
    value: float = 0.0  # pooled
    low: float = 0.0  # 95 % interval over trials, Student's t
    high: float = 0.0
    present: bool = True  # False: the model has it and the robot does not

    @property
    def stage(self) -> str:
        """Return the effect's stage."""
        return REGISTRY[self.name].stage

    @property
    def shrink(self) -> float:
        """Return the share of the gap that the estimate removes."""
        return 1 - self.after / self.before if self.before > 0 else 0.0


def counts(trials: Sequence[Trial], model: Model) -> tuple[Count, ...]:
    """Return the effects that the trials show; an effect without its channel is left out."""
    found = []
    for name, parameter, estimate in (
        ("clock.jitter", "sigma", _jitter),
        ("clock.missed_ticks", "share", _missed),
        ("clock.drift", "rate", _drift),
        ("mocap.dropout", "share", _dropped),
        ("mocap.noise", "sigma", mocap_noise),
    ):
        pairs = [each for trial in trials if (each := estimate(trial)) is not None]
        if pairs:
            values, events = (np.array(column) for column in zip(*pairs, strict=True))
            found.append(_pooled(name, parameter, model, values, float(events.sum())))
    if (velocities := _velocities(trials, model)) is not None:
        found.append(velocities)
    return tuple(found)


def _pooled(name: str, parameter: str, model: Model, values: Array, events: float) -> Count:
    nominal, floor = value(model, name, parameter), TOLERANCE[name]
    robust, trials = name in ("clock.jitter", "mocap.noise"), len(values)
    pooled = float(np.median(values) if robust else values.mean())
    error = (MEDIAN_WIDER if robust else 1.0) * float(np.std(values, ddof=1)) / np.sqrt(trials) if trials > 1 else 0.0
    half = float(stdtrit(trials - 1, 0.975)) * error if trials > 1 else abs(pooled)
    others = [np.delete(values, i).mean() for i in range(len(values))] if len(values) > 1 else [pooled]
    before = float(np.sqrt(np.mean((values - nominal) ** 2)))
    after = float(np.sqrt(np.mean((values - others) ** 2)))
    named = abs(pooled - nominal) > floor and events >= FEW and after < 0.7 * before
    about, low = find(f"{name}.{parameter}")[1], pooled - half
    if name == "mocap.noise":
        named = named and pooled > 1.8 * nominal
    else:
        low = max(about.low, low)
    return Count(name, parameter, about.unit, before, after, floor, named, nominal, pooled, low, pooled + half)


def _grid(t: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the residuals of stamps from a regular series, and each stamp's number in it."""
    period = float(np.median(np.diff(t)))
    number = np.concatenate(([0], np.cumsum(np.maximum(np.rint(np.diff(t) / period), 1)))).astype(np.int64)
    slope, offset = np.polyfit(number, t, 1)
    return t - slope * number - offset, number


def _jitter(trial: Trial) -> tuple[float, float] | None:
    """Return the jitter of a trial's ticks, s, by the half normal distribution if it is skewed, and the ticks."""
    t = trial.channels["command"].t_s if "command" in trial.channels else np.zeros(0)
    if len(t) < 30:
        return None
    left, _ = _grid(t)
    spread = float(np.std(left))
    skew = float(np.mean(left**3)) / spread**3 if spread > 1e-6 else 0.0
    return spread / (HALF_NORMAL_STD if skew > SKEWED else 1.0), float(len(t))


def _missed(trial: Trial) -> tuple[float, float] | None:
    if "command" not in trial.channels or len(trial.channels["command"]) < 30:
        return None
    _, number = _grid(trial.channels["command"].t_s)
    missing = number[-1] + 1 - len(number)
    return float(missing / (number[-1] + 1)), float(missing)


def cameras_clock(mocap: Series | None) -> float | None:
    """Return the drift of the reception clock against the capture clock, s/s, from the quickest frames.

    It is 0 within the jitter, and None for too few stamps.
    """
    if mocap is None or "t_receive" not in mocap.columns or len(mocap) < 100:
        return None
    behind = mocap["t_receive"] - mocap.t_s
    span = mocap.t_s[-1] - mocap.t_s[0]
    parts = np.array_split(np.arange(len(behind)), 20)
    quickest = np.array([behind[p].min() for p in parts])
    at = np.array([mocap.t_s[p[np.argmin(behind[p])]] for p in parts]) - mocap.t_s[0]
    slope, offset = np.polyfit(at, quickest, 1)
    spread = np.std(quickest - slope * at - offset)
    return 0.0 if abs(slope) * span < max(3 * spread, 2e-5) else float(slope)


def _drift(trial: Trial) -> tuple[float, float] | None:
    gained = cameras_clock(trial.channels.get("mocap"))
    if gained is None:
        return None
    return -gained / (1 + gained), float(FEW if gained else 0)


def _dropped(trial: Trial) -> tuple[float, float] | None:
    """Return the share of frames that are missing or repeat the one before, and their number."""
    mocap = trial.channels.get("mocap")
    if mocap is None or len(mocap) < 60:
        return None
    _, number = _grid(mocap.t_s)
    poses = np.stack([mocap[c] for c in mocap.columns if c != "t_receive"], axis=1)
    repeated = int((np.diff(poses, axis=0) == 0).all(axis=1).sum())
    missing = number[-1] + 1 - len(number) + repeated
    return float(missing / (number[-1] + 1)), float(missing)


def mocap_noise(trial: Trial) -> tuple[float, float] | None:
    """Return the noise of the pose that moves least, m, from third differences, and the frames."""
    mocap = trial.channels.get("mocap")
    if mocap is None or len(mocap) < 60:
        return None
    usual = float(np.median(np.diff(mocap.t_s)))
    regular = np.abs(np.diff(mocap.t_s) - usual) < 0.3 * usual
    run = regular[:-2] & regular[1:-1] & regular[2:]
    third = [np.abs(np.diff(mocap[f"{body}_{part}"], n=3))[run] for body in ("cart", "link1") for part in ("y", "z")]
    spreads = [1.4826 * float(np.nanmedian(each)) / np.sqrt(20.0) for each in third if np.isfinite(each).any()]
    return (min(spreads), float(len(mocap))) if spreads and run.any() else None


def _velocities(trials: Sequence[Trial], model: Model) -> Count | None:
    """Return whether the observation's velocities are differences over a tick."""
    errors = np.array([each for trial in trials if (each := _velocity_errors(trial)) is not None])
    if not len(errors):
        return None
    name = "observation.finite_difference"
    modelled = name in model.effects
    differenced, true = np.sqrt((errors**2).mean(axis=0))
    before, after = (differenced, true) if modelled else (true, differenced)
    named = after < VELOCITY_RATIO_MAX * before and before > VELOCITY_FLOOR_M_S
    left = float(min(after, before))
    return Count(name, "", "m/s", float(before), left, VELOCITY_FLOOR_M_S, bool(named), present=not modelled)


def _velocity_errors(trial: Trial) -> tuple[float, float] | None:
    """Return the RMS errors of the observed tip velocities, as differences over a tick and as true slopes."""
    mocap, seen = trial.channels.get("mocap"), trial.channels.get("observation")
    columns = mocap.columns if mocap is not None else ()
    last = sum(name.startswith("link") and name.endswith("_y") for name in columns)
    if mocap is None or seen is None or not last or len(seen) < 30:
        return None
    newest = np.searchsorted(mocap["t_receive"], seen.t_s + 1e-9, side="right") - 1
    ok = newest >= 0
    errors_d, errors_t = [], []
    for part in ("y", "z"):
        place, stamps = mocap[f"link{last}_{part}"], mocap.t_s
        finite = np.isfinite(place)
        if np.count_nonzero(finite) < SLOPE_FRAMES:
            return None
        slope = _slope(Series(stamps[finite], {"x": place[finite]}))
        now, before = newest[1:], newest[:-1]
        good = ok[1:] & ok[:-1] & (now > before) & np.isfinite(place[now]) & np.isfinite(place[before])
        step = stamps[now] - stamps[before]
        difference = (place[now] - place[before]) / np.where(step > 0, step, np.inf)
        observed = seen[f"tip_v{part}"][1:]
        errors_d.append((observed - difference)[good])
        errors_t.append((observed - slope(stamps[now]))[good])
    if not sum(map(len, errors_d)):
        return None
    return tuple(float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in (errors_d, errors_t))  # type: ignore[return-value]


def _slope(series: Series) -> CubicSpline:
    """Return the derivative of a motion, averaged over some frames."""
    kernel = np.ones(SLOPE_FRAMES) / SLOPE_FRAMES
    smooth = np.convolve(series["x"], kernel, mode="same")
    smooth[:2], smooth[-2:] = series["x"][:2], series["x"][-2:]
    return CubicSpline(series.t_s, smooth).derivative()
