"""Measured motion of the arm and its inputs, on their stamps and, filtered, on a uniform grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from softarm.diagnosis.data.trials import Array, Series, Trial, TrialError, check_links

CUTOFF_HZ = 8.0  # zero-phase filter; the arm swings below 4 Hz
CART_CUTOFF_HZ = 15.0  # the drive moves faster than the arm swings
GAP_S = 0.1  # longer gaps are not compared
SETTLE_S = 1.0  # time after a gap that is not compared, since the input in it is unknown
EDGE_S = 0.3  # the filter is inaccurate at both ends
FRAMES_MIN = 60
NOISE_MIN_M, NOISE_MIN_RAD = 2e-5, 2e-4  # smallest noise that weights assume


@dataclass(frozen=True, slots=True)
class Motion:
    """Measured motion of an arm: N frames with every link tracked."""

    name: str
    t_s: Array  # [N] of capture
    signals: Array  # [N, 3 n] link ends against the hinge (y of each, then z, m), then absolute link angles (rad)
    noise: Array  # [3 n] standard deviation of each, from frame to frame
    cart_m: Array  # [N] along the rail, filtered; constant when it was held
    pressure_kpa: Array  # [N] at the stamps
    start: Array  # [2 n] absolute link angles (rad) at the start, and their rates (rad/s): a first guess
    compared: NDArray[np.bool_]  # [N] False in gaps and for SETTLE_S after them

    @property
    def angles_rad(self) -> Array:
        """Return the absolute link angles, rad, [N, n]: the direction from each joint to the next."""
        return directions(self.signals[:, : 2 * self.signals.shape[1] // 3])


def directions(ends_m: Array) -> Array:
    """Return each link's absolute angle, rad [..., n], from y, then z of the ends against the hinge, m [..., 2 n]."""
    n = ends_m.shape[-1] // 2
    steps_y = np.diff(ends_m[..., :n], axis=-1, prepend=0.0)
    steps_z = np.diff(ends_m[..., n:], axis=-1, prepend=0.0)
    return np.asarray(np.arctan2(steps_y, -steps_z))


@dataclass(frozen=True, slots=True)
class Derivatives:
    """Low-passed motion on a uniform grid with fourth-order differences; M samples away from edges and gaps."""

    t_s: Array  # [M]
    angles_rad: Array  # [M, n] absolute
    rates_rad_s: Array
    accelerations_rad_s2: Array
    cart_m_s2: Array  # [M]
    pressure_kpa: Array  # [M]


def measured(trial: Trial, links: int) -> Motion:
    """Return the arm's motion in a trial.

    Raises:
        TrialError: mocap or pressure is missing or too short.
    """
    mocap, pressure = trial.channel("mocap"), trial.channel("pressure")
    check_links(trial, links)
    signals = np.stack([mocap[f"link{i}_{part}"] for part in ("y", "z", "angle") for i in range(1, links + 1)], axis=1)
    cart = np.stack((mocap["cart_y"], mocap["cart_z"]), axis=1)
    # Outside the pressure's stamps the input is unknown.
    inside = (mocap.t_s >= pressure.t_s[0]) & (mocap.t_s <= pressure.t_s[-1])
    if (rail := trial.channels.get("rail")) is not None and trial.rail == "free":
        inside &= (mocap.t_s >= rail.t_s[0]) & (mocap.t_s <= rail.t_s[-1])
    good = np.isfinite(signals).all(axis=1) & np.isfinite(cart).all(axis=1) & inside
    if good.sum() < FRAMES_MIN:
        raise TrialError(
            f"{trial.source}: {good.sum()} frames show every link and the pressure, at least {FRAMES_MIN} are needed; "
            + ("; ".join(trial.warnings) or "record longer, or check the markers")
        )
    t = mocap.t_s[good]
    cart_y = _cart(t, cart[good, 0], trial)
    signals = signals[good]
    signals[:, :links] -= cart_y[:, None]
    signals[:, links : 2 * links] -= np.median(cart[good, 1])
    # The zero of a rigid body is arbitrary: use the links' directions.
    signals[:, 2 * links :] -= np.median(signals[:, 2 * links :] - directions(signals[:, : 2 * links]), axis=0)
    start = np.concatenate((np.mean(directions(signals[t <= t[0] + 0.05, : 2 * links]), axis=0), np.zeros(links)))
    return Motion(
        trial.name,
        t,
        signals,
        _noise(signals),
        cart_y,
        np.interp(t, pressure.t_s, pressure["pressure"]),
        start,
        _compared(t, pressure),
    )


def _cart(t: Array, y: Array, trial: Trial) -> Array:
    """Return the hinge's position along the rail, m, [N], smooth enough for differences; y: from mocap, [N].

    It is constant if the cart was held. Otherwise it is the axis's read-back in mocap's zero and scale, or filtered
    mocap if the two disagree.
    """
    if trial.rail == "held":
        return np.full(len(t), np.median(y))
    rail = trial.channels.get("rail")
    if rail is not None and len(rail) > 2 and rail.t_s[0] <= t[0] and t[-1] <= rail.t_s[-1]:
        axis = np.asarray(CubicSpline(rail.t_s, rail["position"])(t))
        scale = np.polyfit(axis, y, 1)[0] if np.ptp(axis) > 0.02 else 1.0
        seen = scale * axis + np.mean(y - scale * axis)
        noise = float(_spread(y[:, None])[0])
        if abs(scale - 1) < 0.05 and np.sqrt(np.mean((y - seen) ** 2)) < 1.5 * max(noise, NOISE_MIN_M):
            return seen
    grid = uniform(t)
    return np.asarray(np.interp(t, grid, _low_pass(CubicSpline(t, y)(grid), grid, CART_CUTOFF_HZ)))


def _noise(signals: Array) -> Array:
    """Return the standard deviation of the noise, from third differences."""
    spread = _spread(signals)
    n = signals.shape[1] // 3
    lengths, angles = np.median(spread[: 2 * n]), np.median(spread[2 * n :])
    return np.repeat((max(float(lengths), NOISE_MIN_M), max(float(angles), NOISE_MIN_RAD)), (2 * n, n))


def _spread(signals: Array) -> Array:
    third = np.abs(np.diff(signals, n=3, axis=0))
    return np.asarray(1.4826 * np.median(third, axis=0) / np.sqrt(20.0))


def _compared(t: Array, pressure: Series) -> NDArray[np.bool_]:
    """Return which frames are neither in a gap of a channel nor within SETTLE_S after one."""
    ok = np.ones(len(t), dtype=bool)
    for stamps in (t, pressure.t_s):
        for at in np.flatnonzero(np.diff(stamps) > GAP_S):
            ok &= (t < stamps[at]) | (t > stamps[at + 1] + SETTLE_S)
    return ok


def derivatives(motion: Motion) -> Derivatives:
    """Return fourth-order central differences of the low-passed motion ([P] SM-B) at the frames' mean rate.

    Everything, the pressure included, passes the same zero-phase filter, so that torques stay comparable.
    """
    t = uniform(motion.t_s)
    h = t[1] - t[0]
    angles = _low_pass(CubicSpline(motion.t_s, motion.angles_rad)(t), t)
    cart = CubicSpline(motion.t_s, motion.cart_m)(t)
    pressure = _low_pass(np.interp(t, motion.t_s, motion.pressure_kpa), t)
    edge = max(2, round(EDGE_S / h))
    keep = np.interp(t, motion.t_s, motion.compared.astype(float)) == 1.0
    keep[:edge] = keep[-edge:] = False
    rates, accelerations = differences(angles, h)
    _, cart_acceleration = differences(cart, h)
    return Derivatives(t[keep], angles[keep], rates[keep], accelerations[keep], cart_acceleration[keep], pressure[keep])


def differences(values: Array, step_s: float) -> tuple[Array, Array]:
    """Return the first and second derivative along axis 0, fourth order; the two rows at each end are zero."""
    first, second = np.zeros_like(values), np.zeros_like(values)
    a, b, c, d, e = (values[k : len(values) - 4 + k] for k in range(5))
    first[2:-2] = (a - 8 * b + 8 * d - e) / (12 * step_s)
    second[2:-2] = (-a + 16 * b - 30 * c + 16 * d - e) / (12 * step_s**2)
    return first, second


def uniform(t: Array) -> Array:
    """Return uniform stamps at the usual rate."""
    step = float(np.median(np.diff(t)))
    return np.linspace(t[0], t[-1], max(2, round((t[-1] - t[0]) / step) + 1))


def _low_pass(values: Array, t: Array, cutoff_hz: float = CUTOFF_HZ) -> Array:
    rate_hz = 1 / (t[1] - t[0])
    cutoff = min(cutoff_hz, 0.4 * rate_hz)
    sections = butter(4, cutoff, fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=min(len(t) - 1, round(rate_hz))))
