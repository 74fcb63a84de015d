"""Trials of the robot side by side on a uniform grid, so that one batch of simulated robots flies them all at once.

Measurements are brought to the grid from their real stamps; commands keep theirs (how late within a step each came).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from softarm.diagnosis.data.trials import Series, Trial, TrialError
from softarm.diagnosis.robot.counts import cameras_clock, mocap_noise
from softarm.schemas.model import Model

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATE_HZ = 60.0
STEP_S = 1 / RATE_HZ
ORDINARY_M = 0.0004  # noise of a mocap that is as it should be
GAP_S = 0.1  # nothing is compared within a longer gap of a channel
SKIPPED_S = 0.5  # at the start, where what went before still shows
CART_CUTOFF_HZ, ARM_CUTOFF_HZ = 15.0, 8.0
AGREES_M = 0.0012  # axis and mocap that tell the cart's way this much alike tell the same
DELAYS_S = np.arange(-0.02, 0.121, 0.005)


@dataclass(frozen=True, slots=True)
class TrialGrid:
    """K trials over T steps; a trial's arrays go on with their last value after its own length."""

    trials: tuple[Trial, ...]
    steps: NDArray[np.int64]  # [K] length of each
    t_s: Array  # [T, K] stamps of the grid
    held: Mask  # [K]
    late_s: Array  # [T, K] when within the step the command came
    cart_velocity_m_s: Array  # [T, K] commanded
    pressure_command_kpa: Array  # [T, K]
    pressure_kpa: Array  # [T, K] the sensor's readings; NaN where there are none
    axis_m: Array  # [T, K] the axis's read-back of the position, its zero as it came
    axis_m_s: Array  # [T, K] and of the velocity
    cart_y_m: Array  # [T, K] as mocap sees it
    cart_z_m: Array
    links_m: Array  # [T, K, 2 n] link ends against the cart as mocap sees both: y of each, then z
    hinge_m: Array  # [T, K] the cart's way, clean enough to drive the arm with
    hinge_m_s: Array
    axis_true: Mask  # [K] whether the way is the axis's own read-back, else it is mocap's
    push_n: Array  # [T, K] the arm's force on the cart, from its measured motion and the model's masses
    push_links_n: Array  # [T, K] of that what the links' motion against the cart makes, as late as mocap is
    tip_m_s2: Array  # [T, K] the tip's acceleration along the rail
    air_m2_s2: Array  # [T, K] the links' speed times velocity along the rail, summed: what quadratic drag works against
    noise_m: float  # of mocap, from frame to frame, beyond what such cameras ordinarily have
    sample: tuple[NDArray[np.int64], NDArray[np.int64]]  # [M] step and trial of every sample, trial after trial

    @property
    def links(self) -> int:
        """Number of links."""
        return int(self.links_m.shape[2]) // 2

    def flat(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """[T, K, ...] to [M, ...]."""
        return values[self.sample]


def on_grid(trials: Sequence[Trial], model: Model) -> TrialGrid:
    """Bring trials to one grid. A channel that a trial lacks is NaN there.

    Raises TrialError for a trial without commands or without anything else, or too short.
    """
    parts = [_part(trial, model) for trial in trials]
    steps = np.array([len(part["t_s"]) for part in parts])
    stacked = {name: _side_by_side([part[name] for part in parts], int(steps.max())) for name in parts[0]}
    sample = (
        np.concatenate([np.arange(round(SKIPPED_S * RATE_HZ), n) for n in steps]),
        np.repeat(np.arange(len(parts)), steps - round(SKIPPED_S * RATE_HZ)),
    )
    held, axis_true = (stacked.pop(name)[0] > 0 for name in ("held", "axis_true"))
    noise = np.array([each[0] for trial in trials if (each := mocap_noise(trial)) is not None])
    beyond = np.sqrt(max(float(np.median(noise)) ** 2 - ORDINARY_M**2, 0.0)) if len(noise) else 0.0
    return TrialGrid(
        trials=tuple(trials),
        steps=steps,
        sample=sample,
        noise_m=float(beyond),
        held=held,
        axis_true=axis_true,
        **stacked,
    )


def _side_by_side(parts: list[Array], steps: int) -> Array:
    """[n_k, ...] of each trial to [T, K, ...], each held on at its end."""
    return np.stack([np.concatenate((p, np.repeat(p[-1:], steps - len(p), axis=0))) for p in parts], axis=1)


def _part(trial: Trial, model: Model) -> dict[str, Array]:
    command = trial.channel("command")
    seen = [trial.channels[name] for name in ("pressure", "rail", "mocap") if name in trial.channels]
    if not seen:
        raise TrialError(f"{trial.source}: has commands and nothing that was measured; add pressure, rail or mocap")
    start, end = max(s.t_s[0] for s in (command, *seen)), min(s.t_s[-1] for s in seen)
    if end - start < 2.0:
        raise TrialError(
            f"{trial.source}: only {max(0.0, end - start):.1f} s are covered by all channels, 2 s or more are needed; "
            "record longer, or leave this trial out"
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
        "held": np.full(len(t), float(held)),
    }
    return part | _poses(trial, t, model, held, part["axis_m"])


def _commands(command: Series, t: Array) -> tuple[Array, Array, Array]:
    """How late in each step its command came, and both commands; of two within a step the second is put off."""
    late, index = np.zeros(len(t)), np.zeros(len(t), dtype=int)
    step, last = -1, max(int(np.searchsorted(command.t_s, t[0] + 1e-9, side="right")) - 1, 0)
    index[:] = last
    for i in range(last + 1, len(command)):
        wanted = (command.t_s[i] - t[0]) / STEP_S
        step = max(step + 1, int(wanted))
        if step >= len(t):
            break
        late[step] = max(0.0, command.t_s[i] - t[step])
        index[step:] = i
    return late, command["cart_velocity"][index], command["pressure"][index]


def _sampled(series: Series | None, column: str, t: Array) -> Array:
    """A column at stamps t, NaN in its gaps and where there is none."""
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
    """What mocap says, and the cart's way that the arm is driven with."""
    n, mocap = model.arm.links, _one_clock(trial.channels.get("mocap"))
    if mocap is not None and (f"link{n}_y" not in mocap.columns or f"link{n + 1}_y" in mocap.columns):
        seen = sum(name.startswith("link") and name.endswith("_y") for name in mocap.columns)
        raise TrialError(f"{trial.source}: mocap sees {seen} links, the model has {n}; name the model of this arm")
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
    """Take the cameras' drift out of the stamps: reception, on the controller's clock, tells it."""
    slope = cameras_clock(mocap)
    if mocap is None or not slope:
        return mocap
    return Series(mocap.t_s + slope * (mocap.t_s - mocap.t_s[0]), mocap.columns)


def _way(cart_y: Array, axis: Array, held: bool) -> tuple[Array, bool]:
    """The cart's way: the axis's read-back where mocap agrees with it but for a scale and a delay."""
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
    """From the arm's motion: `TrialGrid.push_n`, `push_links_n`, the tip's acceleration, `TrialGrid.air_m2_s2`.

    Zero where mocap saw nothing.
    """
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
    """Low-passed without phase; gaps are bridged by straight lines first."""
    seen = np.isfinite(values)
    if not seen.any():
        return np.zeros(len(values))
    steps = np.arange(len(values))
    bridged = np.interp(steps, steps[seen], values[seen])
    sections = butter(4, cutoff_hz, fs=RATE_HZ, output="sos")
    return np.asarray(sosfiltfilt(sections, bridged, padlen=min(len(values) - 1, 60)))
