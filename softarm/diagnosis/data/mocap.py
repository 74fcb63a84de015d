"""Positions of a MuJoCo model's joints from motion capture of its sites and bodies."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softarm.diagnosis.data.checks import GAP_FACTOR, GAP_MIN_S
from softarm.diagnosis.data.mocap_frame import in_model_frame
from softarm.diagnosis.data.skeleton import MISFIT, Poses, Skeleton
from softarm.diagnosis.data.stage_file import Stage
from softarm.diagnosis.data.trials import Series, TrialError
from softarm.schemas.trial import Column, TableChannel

# Rows of a recording in which a pose is sought without one beside it.
ROWS = 6
# Share of the rows in which the points may be further off than MISFIT, and distance from which two poses differ, rad
# or m.
LOST, APART = 0.05, 0.05
# Least motion of the points per motion of the joints: of the usual row as a share of the reach, of a row as a share of
# the usual one.
UNDETERMINED, NEARLY = 1e-3, 0.3
# Delay of motion capture beside other readings: rows that show it, steps of the search, step of the difference
# quotient, least and largest result, s, and ratio of the squared errors with and without it below which it counts.
LATE_ROWS, LATE_STEPS, LATE_NUDGE_S, LATE_LEAST_S, LATE_MOST_S, LATE_RATIO = 200, 4, 0.002, 1e-4, 0.2, 0.9


def skeleton_of(stage: Stage, base: Path) -> Skeleton | None:
    """Return the joints that motion capture determines, or None for a stage without; base: the data folder."""
    channels = stage.about.channels
    if "mocap" not in channels:
        return None
    known = [name for channel in ("measured", "base") if channel in channels for name in channels[channel].columns]
    return Skeleton(stage.file(str(stage.about.model["mjcf"]), base), channels["mocap"].columns, known)


def with_joints(stage: Stage, skeleton: Skeleton | None) -> Stage:
    """Return a stage whose measured joints include those that its tracked points determine, if it has any."""
    if skeleton is None:
        return stage
    about = stage.about
    channels = {name: channel for name, channel in about.channels.items() if name != "mocap"}
    units = zip(skeleton.joints, skeleton.units, strict=True)
    joints = {name: Column(source="mocap", unit=unit) for name, unit in units}
    encoders = channels.pop("measured").columns if "measured" in channels else {}
    measured = TableChannel(time=about.channels["mocap"].time, columns={**joints, **encoders})
    return replace(stage, about=about.model_copy(update={"channels": {"measured": measured, **channels}}))


def positions(skeleton: Skeleton, mocap: Series, known: Sequence[Series], where: Path) -> tuple[Series, list[str]]:
    """Return the positions of a skeleton's joints with the stamps of motion capture, and warnings.

    Stamps are corrected if the tracked points show that they are late or early beside the other readings. Left out are
    rows near a pose in which the points hardly show a joint's motion, rows in a gap of the other readings, and a few
    rows that fit no pose.

    Args:
        skeleton: joints and tracked points.
        mocap: tracked coordinates, m, and quaternions, in the model's frame if no fixed points show another one.
        known: positions of other joints, and poses.
        where: file, for messages.

    Raises:
        TrialError: the points do not fit the model, fit several poses, or do not determine a joint.
    """
    warnings, most_m, mocap = list[str](), MISFIT * skeleton.reach_m, in_model_frame(skeleton, mocap, where)
    mocap, poses, found = _fitted(skeleton, mocap, known, where)
    if late_s := _late_s(skeleton, mocap, known, found, where):
        names = ", ".join(name for series in known for name in series.columns)
        warnings.append(
            f"{where}: the tracked points are {1e3 * abs(late_s):.1f} ms {'late' if late_s > 0 else 'early'} beside "
            f"{names}; their stamps are corrected: stamp all devices with one clock, at the time of measurement"
        )
        mocap, poses, found = _fitted(skeleton, Series(mocap.t_s - late_s, mocap.columns), known, where)
    best, lost = poses.positions[0], found.errors_m > most_m
    if lost.mean() > LOST:
        raise TrialError(
            f"{where}: the tracked points differ by {np.median(found.errors_m[lost]):.2g} m from the model in its best "
            f"poses in {lost.mean():.0%} of the rows; allowed {most_m:.2g} m: check their unit, that origin and axes "
            "are those of the model (many systems have y upwards; three tracked points of the base would show it), and "
            "that each site is where its marker is"
        )
    if others := [pose for pose in poses.positions if skeleton.distance(pose, best) > APART]:
        two = " or ".join(", ".join(f"{x:.2f}" for x in pose) for pose in (best, others[0]))
        raise TrialError(
            f"{where}: several poses fit the tracked points: {', '.join(skeleton.joints)} may be at {two}; track a "
            "point on a link between, or give the joints their `range` in the model"
        )
    if lost.any():
        warnings.append(
            f"{where}: in {lost.sum()} rows, first at {mocap.t_s[lost][0]:.3f} s, the tracked points differ by more "
            f"than {most_m:.2g} m from every pose of the model; they are left out: mark lost points by `missing`"
        )
    keep = ~lost & (found.shown > NEARLY * np.median(found.shown))
    return Series(mocap.t_s[keep], dict(zip(skeleton.joints, found.positions[keep].T, strict=True))), warnings


def _fitted(skeleton: Skeleton, mocap: Series, known: Sequence[Series], where: Path) -> tuple[Series, Poses, Poses]:
    """Return the rows beside which the other readings are known, the poses that fit one of them, and that of each.

    Raises:
        TrialError: the points do not determine a joint.
    """
    for series in known:
        mocap = _beside(series, mocap, where)
    seen, qpos = skeleton.tracked(mocap, where), skeleton.around(mocap.t_s, known, where)
    most_m = MISFIT * skeleton.reach_m
    looked = [(skeleton.poses(seen, qpos, int(row)), int(row)) for row in np.linspace(0, len(mocap) - 1, ROWS)]
    poses, clear = max(looked, key=lambda each: (each[0].errors_m[0] < most_m, each[0].shown[0]))
    best = poses.positions[0]
    if np.median([each.shown[0] for each, _ in looked]) < UNDETERMINED * skeleton.reach_m:
        names = skeleton.hardly_shown(seen, qpos, clear, best)
        raise TrialError(
            f"{where}: the tracked points do not show the position of {', '.join(names)}; track more points on the "
            "links behind these joints, or the orientation of the last one (NAME_qw to NAME_qz)"
        )
    return mocap, poses, skeleton.followed(seen, qpos, clear, best, most_m)


def _late_s(skeleton: Skeleton, mocap: Series, known: Sequence[Series], found: Poses, where: Path) -> float:
    """Return how late the tracked points are beside the other readings, s; 0 if they do not show it.

    More coordinates than unknown joints show it: Newton's method finds the delay with the smallest error.

    Args:
        skeleton: joints and tracked points.
        mocap: tracked coordinates, [T].
        known: positions of other joints, and poses.
        found: pose of each row without a delay.
        where: file, for messages.
    """
    if not known:
        return 0.0
    rows = np.unique(np.linspace(0, len(mocap) - 1, LATE_ROWS).astype(int))
    seen, near = skeleton.tracked(mocap.kept(np.isin(np.arange(len(mocap)), rows)), where), found.positions[rows]
    if skeleton.coordinates(seen) <= len(skeleton.joints):
        return 0.0

    def squared(late_s: float) -> float:
        qpos = skeleton.around(mocap.t_s[rows] - late_s, known, where)
        return float(np.mean(skeleton.refined(seen, qpos, near).errors_m ** 2))

    late_s, before = 0.0, squared(0.0)
    for _ in range(LATE_STEPS):
        below, at, above = (squared(late_s + each) for each in (-LATE_NUDGE_S, 0.0, LATE_NUDGE_S))
        if (bend := below - 2 * at + above) <= 0:
            return 0.0
        late_s = float(np.clip(late_s + LATE_NUDGE_S * (below - above) / (2 * bend), -LATE_MOST_S, LATE_MOST_S))
    return late_s if LATE_LEAST_S < abs(late_s) < LATE_MOST_S and squared(late_s) < LATE_RATIO * before else 0.0


def joined(tracked: Series, encoders: Series, where: Path) -> Series:
    """Return the joints of both series with the stamps of the slower one, between which the other is interpolated."""
    slow, fast = sorted((tracked, encoders), key=lambda series: -np.median(np.diff(series.t_s)))
    slow = _beside(fast, slow, where)
    between = {name: np.interp(slow.t_s, fast.t_s, values) for name, values in fast.columns.items()}
    return Series(slow.t_s, {**slow.columns, **between})


def _beside(other: Series, series: Series, where: Path) -> Series:
    """Return the rows of a series that lie in no gap of another one; raise TrialError if there are none."""
    keep: NDArray[np.bool_] = np.zeros(len(series), bool)
    if len(other) > 1:
        steps = np.diff(other.t_s)
        after = np.clip(np.searchsorted(other.t_s, series.t_s), 1, len(steps))
        keep = steps[after - 1] <= max(GAP_FACTOR * float(np.median(steps)), GAP_MIN_S)
        keep &= (series.t_s >= other.t_s[0]) & (series.t_s <= other.t_s[-1])
    if not keep.any():
        raise TrialError(
            f"{where}: motion capture and {', '.join(other.columns)} have no time in common; give them stamps of one "
            "clock"
        )
    return series.kept(keep)
