"""Frame of motion capture, which tracked points of the fixed base show."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from softarm.diagnosis.data.skeleton import LEVER_M, MISFIT, Skeleton, Tracked
from softarm.diagnosis.data.stage_rules import QUATERNION
from softarm.diagnosis.data.trials import Array, Series, TrialError

# Least extent of the fixed points across their longest direction, as a share of their extent along it.
BROAD = 0.05


def in_model_frame(skeleton: Skeleton, mocap: Series, where: Path) -> Series:
    """Return tracked coordinates in the model's frame.

    Three fixed points that lie on no line, or one with its orientation, show the frame of motion capture. With fewer,
    coordinates have to be in the model's frame.

    Args:
        skeleton: tracked points.
        mocap: coordinates, m, and quaternions, [T] each.
        where: file, for messages.

    Raises:
        TrialError: the fixed points are not where the model has them, or a point lacks a coordinate to turn it.
    """
    tracked, points = skeleton.tracked(mocap, where), skeleton.points
    whole = [k for k in range(len(points)) if np.isfinite(tracked.places[:, k]).any(axis=0).all()]
    fixed = [k for k in whole if points[k].is_fixed]
    seen = np.concatenate([np.empty((0, 3)), *(_seen(tracked, k, points[k].turns) for k in fixed)])
    known = np.concatenate([np.empty((0, 3)), *(_known(skeleton, k) for k in fixed)])
    if not _shows_a_frame(known):
        return mocap
    turn, _ = Rotation.align_vectors(known - known.mean(axis=0), seen - seen.mean(axis=0))
    shift = known.mean(axis=0) - turn.apply(seen.mean(axis=0))
    error_m, most_m = float(np.sqrt(np.mean((turn.apply(seen) + shift - known) ** 2))), MISFIT * skeleton.reach_m
    if error_m > most_m:
        raise TrialError(
            f"{where}: the fixed points {', '.join(points[k].name for k in fixed)} differ by {error_m:.2g} m from the "
            f"model in the best frame; allowed {most_m:.2g} m: check their unit, that the axes are right-handed, and "
            "that each site is where its marker is"
        )
    if lacking := [point.name for k, point in enumerate(points) if k not in whole]:
        raise TrialError(
            f"{where}: {', '.join(lacking)} lacks a coordinate, so that it cannot be turned into the frame that the "
            "fixed points show; name all three, or leave the fixed points out"
        )
    columns = dict(mocap.columns)
    for k, point in enumerate(points):
        places = turn.apply(tracked.places[:, k]) + shift
        columns |= {f"{point.name}_{axis}": values for axis, values in zip("xyz", places.T, strict=True)}
        if point.turns:
            turned = turn * Rotation.from_quat(tracked.turns[:, k], scalar_first=True)
            quaternions = turned.as_quat(scalar_first=True).T
            columns |= {point.name + part: values for part, values in zip(QUATERNION, quaternions, strict=True)}
    return Series(mocap.t_s, columns)


def _seen(tracked: Tracked, k: int, turns: bool) -> Array:
    """Return where a fixed point is usually tracked, [1, 3] m, with a point on each of its axes if these are known."""
    place = np.nanmedian(tracked.places[:, k], axis=0)
    if not turns:
        return place[None]
    axes = Rotation.from_quat(tracked.turns[:, k], scalar_first=True).as_matrix()
    return np.concatenate((place[None], place + LEVER_M * np.median(axes, axis=0).T))


def _known(skeleton: Skeleton, k: int) -> Array:
    """Return the same points in the model, [1 or 4, 3] m."""
    place, axes = skeleton.at_zero(skeleton.points[k])
    return np.concatenate((place[None], place + LEVER_M * axes.T)) if skeleton.points[k].turns else place[None]


def _shows_a_frame(known: Array) -> bool:
    """Return whether points [F, 3] lie on no line."""
    if len(known) < 3:
        return False
    extent = np.linalg.svd(known - known.mean(axis=0), compute_uv=False)
    return bool(extent[1] > BROAD * extent[0])
