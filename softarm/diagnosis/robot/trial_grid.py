"""Trials of the robot on one uniform grid, so that one batch of simulated robots covers all of them.

Measurements are interpolated from their stamps; commands keep their lateness within a step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from softarm.diagnosis.data.trials import Series, Trial, TrialError, check_links
from softarm.diagnosis.engine.view import Array
from softarm.diagnosis.robot.counts import cameras_clock, mocap_noise
from softarm.schemas.model import Model

Mask = NDArray[np.bool_]

RATE_HZ = 60.0
STEP_S = 1 / RATE_HZ
ORDINARY_M = 0.0004  # noise of healthy mocap
GAP_S = 0.1  # longer gaps of a channel are not compared
SKIPPED_S = 0.5  # start of a trial that is not compared, since earlier commands still act
CART_CUTOFF_HZ, ARM_CUTOFF_HZ = 15.0, 8.0
AGREES_M = 0.0012  # largest RMS difference of axis and mocap that agree
DELAYS_S = np.arange(-0.02, 0.121, 0.005)


@dataclass(frozen=True, slots=True)
class TrialGrid:
    """Grid of K trials over T steps; a shorter trial repeats its last value."""

    trials: tuple[Trial, ...]
    t_s: Array  # [T, K] stamps of the grid
    held: Mask  # [K]
    late_s: Array  # [T, K] lateness of the command within the step
    cart_velocity_m_s: Array  # [T, K] commanded
    pressure_command_kpa: Array  # [T, K]
    pressure_kpa: Array  # [T, K] readings of the sensor; NaN if missing
    axis_m: Array  # [T, K] read-back of the axis's position
    axis_m_s: Array  # [T, K] read-back of the axis's velocity
    cart_y_m: Array  # [T, K] cart in mocap
    cart_z_m: Array
    links_m: Array  # [T, K, 2 n] link ends relative to the cart in mocap: y of each, then z
    hinge_m: Array  # [T, K] smooth position of the cart, as an input of the arm
    hinge_m_s: Array
    axis_true: Mask  # [K] True if `hinge_m` is the axis's read-back, False if it is mocap's
    push_n: Array  # [T, K] the arm's force on the cart, from its measured motion and the model's masses
    push_links_n: Array  # [T, K] part of it due to the links' motion relative to the cart, as late as mocap
    tip_m_s2: Array  # [T, K] the tip's acceleration along the rail
    air_m2_s2: Array  # [T, K] sum of the links' speed times velocity along the rail, for quadratic drag
    noise_m: float  # noise of mocap beyond ORDINARY_M
    sample: tuple[NDArray[np.int64], NDArray[np.int64]]  # [M] step and trial of every sample, trial after trial

    @property
    def links(self) -> int:
        """Return the number of links."""
        return int(self.links_m.shape[2]) // 2

    def flat(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return values [T, K, ...] as samples [M, ...]."""
        return values[self.sample]


def on_grid(trials: Sequence[Trial], model: Model) -> TrialGrid:
    """Return trials on one grid, with NaN for a missing channel.

    Raises:
        TrialError: a trial has no commands, no measurements, or is too short, or a link was never tracked.
    """
    parts = [_part(trial, model) for trial in trials]
    steps = np.array([len(part["t_s"]) for part in parts])
    stacked = {name: _stacked([part[name] for part in parts], int(steps.max())) for name in parts[0]}
    sample = (
        np.concatenate([np.arange(round(SKIPPED_S * RATE_HZ), n) for n in steps]),
        np.repeat(np.arange(len(parts)), steps - round(SKIPPED_S * RATE_HZ)),
    )
    tracked = np.isfinite(stacked["links_m"]).any(axis=(0, 1))
    if tracked.any() and not tracked.all():
        lost = np.flatnonzero(~tracked)[0] % model.arm.links + 1
        raise TrialError(
            f"{trials[0].source}: no trial has a pose of link{lost}; track each link's end, or leave mocap out"
        )
    axis_true = stacked.pop("axis_true")[0] > 0
    noise = np.array([each[0] for trial in trials if (each := mocap_noise(trial)) is not None])
    beyond = np.sqrt(max(float(np.median(noise)) ** 2 - ORDINARY_M**2, 0.0)) if len(noise) else 0.0
    return TrialGrid(
        trials=tuple(trials),
        sample=sample,
        noise_m=float(beyond),
        held=np.array([trial.rail == "held" for trial in trials]),
        axis_true=axis_true,
        **stacked,
    )


def _stacked(parts: list[Array], steps: int) -> Array:
    """Stack [n_k, ...] of each trial to [T, K, ...], repeating the last value."""
    return np.stack([np.concatenate((p, np.repeat(p[-1:], steps - len(p), axis=0))) for p in parts], axis=1)


def _part(trial: Trial, model: Model) -> dict[str, Array]:
    command = trial.channel("command")
    seen = [trial.channels[name] for name in ("pressure", "rail", "mocap") if name in trial.channels]
    if not seen:
        raise TrialError(f"{trial.source}: has commands but no measurements; add pressure, rail or mocap")
    start, end = max(s.t_s[0] for s in (command, *seen)), min(s.t_s[-1] for s in seen)
    if end - start < 2.0:
        raise TrialError(
            f"{trial.source}: all channels cover only {max(0.0, end - start):.1f} s, at least 2 s are needed; record "
            "longer, or leave this trial out"
        )
    t = start + STEP_S * np.arange(int((end - start) * RATE_HZ) + 1)
    held = trial.rail == "held"
    late, velocity, pressure = _commands(command, t)
    part = {
        "t_s": t,
        "late_s": late,
        "cart_velocity_m_s": np.zeros_like(t) if held else velocity,
        "pressure_command_kpa": pressure,
        "pressure_kpa": _sampled(trial.channels.get("pressure"), "pressure", t),
        "axis_m": _sampled(trial.channels.get("rail"), "position", t),
        "axis_m_s": _sampled(trial.channels.get("rail"), "velocity", t),
    }
    return part | _poses(trial, t, model, held, part["axis_m"])


def _commands(command: Series, t: Array) -> tuple[Array, Array, Array]:
    """Return each step's lateness and both commands; a second command within a step moves to the next."""
    late, index = np.zeros(len(t)), np.zeros(len(t), dtype=int)
    step, last = -1, max(int(np.searchsorted(command.t_s, t[0] + 1e-9, side="right")) - 1, 0)
    index[:] = last
    for i in range(last + 1, len(command)):
        step = max(step + 1, int((command.t_s[i] - t[0]) / STEP_S))
        if step >= len(t):
            break
        late[step] = max(0.0, command.t_s[i] - t[step])
        index[step:] = i
    return late, command["cart_velocity"][index], command["pressure"][index]


def _sampled(series: Series | None, column: str, t: Array) -> Array:
    """Return a column at stamps t, with NaN in gaps and without the column."""
    if series is None or column not in series.columns:
        return np.full(len(t), np.nan)
    seen = np.isfinite(series[column])
    stamps, values = series.t_s[seen], series[column][seen]
    if len(stamps) < 4:
        return np.full(len(t), np.nan)
    after = np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1)
    found = np.asarray(CubicSpline(stamps, values)(t))
    found[(stamps[after] - stamps[after - 1] > GAP_S) | (t < stamps[0]) | (t > stamps[-1])] = np.nan
    return found


def _poses(trial: Trial, t: Array, model: Model, held: bool, axis: Array) -> dict[str, Array]:
    """Return mocap's poses and the motion of the cart, by field of `TrialGrid`."""
    n, mocap = model.arm.links, _one_clock(trial.channels.get("mocap"))
    if mocap is not None:
        check_links(trial, n)
    cart_y, cart_z = (_sampled(mocap, f"cart_{part}", t) for part in ("y", "z"))
    ends = [_sampled(mocap, f"link{i}_{part}", t) for part in ("y", "z") for i in range(1, n + 1)]
    links = np.stack(ends, axis=1) - np.repeat(np.stack((cart_y, cart_z), axis=1), n, axis=1)
    way, axis_true = _way(cart_y, axis, held)
    push, own, tip, air = _push(links, way, model)
    return {
        "cart_y_m": cart_y,
        "cart_z_m": cart_z,
        "links_m": links,
        "hinge_m": way,
        "hinge_m_s": np.gradient(way, STEP_S, edge_order=2),
        "axis_true": np.full(len(t), float(axis_true)),
        "push_n": push,
        "push_links_n": own,
        "tip_m_s2": tip,
        "air_m2_s2": air,
    }


def _one_clock(mocap: Series | None) -> Series | None:
    """Return mocap with stamps corrected for the drift of the cameras' clock."""
    slope = cameras_clock(mocap)
    if mocap is None or not slope:
        return mocap
    return Series(mocap.t_s + slope * (mocap.t_s - mocap.t_s[0]), mocap.columns)


def _way(cart_y: Array, axis: Array, held: bool) -> tuple[Array, bool]:
    """Return the cart's position, and whether it is the axis's: mocap must agree but for scale and delay."""
    if held:
        level = np.nanmedian(axis) if np.isfinite(axis).any() else np.nanmedian(cart_y)
        return np.full(len(axis), level if np.isfinite(level) else 0.0), True
    if not np.isfinite(cart_y).any():
        return _smooth(axis, CART_CUTOFF_HZ), True
    if not np.isfinite(axis).any():
        return _smooth(cart_y, CART_CUTOFF_HZ), False
    seen, best, late = _smooth(cart_y, CART_CUTOFF_HZ), np.inf, 0.0
    read_back = _smooth(axis, CART_CUTOFF_HZ)
    inner = slice(12, -12)
    steps = np.arange(len(read_back))
    for delay in DELAYS_S:
        moved = np.interp(steps - delay / STEP_S, steps, read_back)
        regressors = np.stack((moved, np.ones(len(moved))), axis=1)[inner]
        left = seen[inner] - regressors @ np.linalg.lstsq(regressors, seen[inner], rcond=None)[0]
        if (rms := float(np.sqrt(np.mean(left**2)))) < best:
            best, late = rms, float(delay)
    if best < AGREES_M:
        return read_back, True
    return np.interp(steps + late / STEP_S, steps, seen), False


def _push(links: Array, way: Array, model: Model) -> tuple[Array, Array, Array, Array]:
    """Return `push_n`, `push_links_n`, `tip_m_s2` and `air_m2_s2` of `TrialGrid`; zero without mocap."""
    n, still = model.arm.links, np.zeros(len(way))
    if not np.isfinite(links[:, :n]).any():
        return still, still, still, still
    masses = np.asarray(model.arm.link_mass_kg)
    smooth = np.stack([_smooth(column, ARM_CUTOFF_HZ) for column in links.T], axis=1)
    cart = _smooth(way, ARM_CUTOFF_HZ)[:, None]
    centres = []
    for ends, hinge in ((smooth[:, :n] + cart, cart), (smooth[:, n:], 0 * cart)):
        centres.append((np.concatenate((hinge, ends[:, :-1]), axis=1) + ends) / 2)
    rates = [np.gradient(each, STEP_S, axis=0) for each in centres]
    push = -np.gradient(rates[0], STEP_S, axis=0) @ masses
    carried = -masses.sum() * np.gradient(np.gradient(cart[:, 0], STEP_S), STEP_S)
    tip = np.gradient(np.gradient(smooth[:, n - 1] + cart[:, 0], STEP_S), STEP_S)
    return push, push - carried, tip, (np.hypot(*rates) * rates[0]).sum(axis=1)


def _smooth(values: Array, cutoff_hz: float) -> Array:
    """Return zero-phase low-passed values, with gaps interpolated linearly."""
    seen = np.isfinite(values)
    if not seen.any():
        return np.zeros(len(values))
    steps = np.arange(len(values))
    bridged = np.interp(steps, steps[seen], values[seen])
    sections = butter(4, cutoff_hz, fs=RATE_HZ, output="sos")
    return np.asarray(sosfiltfilt(sections, bridged, padlen=min(len(values) - 1, 60)))
