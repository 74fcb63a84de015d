"""Joints of a MuJoCo model that tracked sites and bodies determine (inverse kinematics)."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softarm.common.words import did_you_mean
from softarm.diagnosis.data import checks, mjcf
from softarm.diagnosis.data.poses import pose_joints
from softarm.diagnosis.data.stage_rules import QUATERNION
from softarm.diagnosis.data.trials import Array, Series, TrialError

# Distance at which an error of an orientation counts as much as one of a position.
LEVER_M = 0.1
# Largest error of the points, as a share of the reach.
MISFIT = 0.02
# Gauss-Newton steps at most, longest step, and last step, rad or m, after which the error is about its square; damping
# of a step, m^2/rad^2.
STEPS_MOST, STEP_MOST, STEP_LEAST, DAMPING = 30, 0.3, 1e-5, 1e-9
# Starts of the search for poses; poses fit alike up to this ratio of their errors, beside an error in m.
STARTS, ALIKE, ALIKE_M = 24, 2.0, 1e-4
# Range in which a joint without a limit is sought, rad or m, and distance by which poses may exceed a limit.
WIDE, BEYOND = np.pi, 0.1
# Distance below which two poses are the same, rad or m.
MET = 1e-3
_TURN = frozenset(each[1:] for each in QUATERNION)


@dataclass(frozen=True, slots=True)
class Point:
    """Tracked site or body."""

    name: str
    number: int
    is_site: bool
    turns: bool  # whether its orientation is tracked
    is_fixed: bool  # whether no joint moves it


@dataclass(frozen=True, slots=True)
class Tracked:
    """Tracked positions [T, P, 3], NaN where a coordinate is not measured, and unit quaternions [T, P, 4]."""

    places: Array
    turns: Array


class Poses(NamedTuple):
    """Poses of the joints that fit the tracked points, of R rows, or R poses for one row."""

    positions: Array  # [R, J], rad or m
    errors_m: Array  # [R], root mean square of all coordinates
    shown: Array  # [R], least motion of the points per motion of the joints, m/rad or 1


class Skeleton:
    """Joints of a model that move tracked sites and bodies, and have no reading of their own.

    Attributes:
        joints: their names.
        units: their units, rad or m.
        points: the tracked points.
        reach_m: largest distance of a moved point from the first joint in the model's zero.
    """

    def __init__(self, path: Path, columns: Collection[str], known: Collection[str] = ()) -> None:
        """Load an MJCF or URDF file.

        Args:
            path: the file.
            columns: NAME_x, NAME_y, NAME_z and NAME_qw to NAME_qz of sites or bodies.
            known: columns of joints and poses that are measured otherwise.

        Raises:
            TrialError: a column belongs to no site or body, or tracked points cannot determine a joint that moves them.
        """
        self._path = path
        self._mujoco, self._model = mjcf.load(path)
        self._data = self._mujoco.MjData(self._model)
        self.points = tuple(self._points(columns))
        model, kinds = self._model, self._mujoco.mjtJoint
        self._moved = [k for k, point in enumerate(self.points) if not point.is_fixed]
        self._jacobians = np.empty((2, len(self._moved), 3, model.nv))
        carriers = {joint for point in self.points for joint in self._carriers(point.number, point.is_site)}
        self._columns = mjcf.columns_of_joints(self._mujoco, model)
        numbers = [j for j in sorted(carriers) if not {*self._columns[j]} <= {*known}]
        self._refuse(carriers, numbers)
        self.joints = tuple(str(model.joint(j).name) for j in numbers)
        turns = model.jnt_type[numbers] == int(kinds.mjJNT_HINGE)
        self.units = tuple("rad" if each else "m" for each in turns)
        self._at, self._dofs = model.jnt_qposadr[numbers], model.jnt_dofadr[numbers]
        self._limited = limited = model.jnt_limited[numbers].astype(bool)
        self._low = np.where(limited, model.jnt_range[numbers, 0], -WIDE)
        self._high = np.where(limited, model.jnt_range[numbers, 1], WIDE)
        self._turns = turns
        self.reach_m = self._reach_m()

    def tracked(self, mocap: Series, where: Path) -> Tracked:
        """Return the readings of the tracked points; raise TrialError if a quaternion's length is not one."""
        lacking, unit = np.full(len(mocap), np.nan), np.tile(np.eye(1, 4), (len(mocap), 1))
        places = [[mocap.columns.get(f"{p.name}_{axis}", lacking) for axis in "xyz"] for p in self.points]
        turns = [
            checks.unit_quaternions(mocap, [p.name + q for q in QUATERNION], str(where)) if p.turns else unit
            for p in self.points
        ]
        turned = np.stack(turns, axis=1)
        return Tracked(np.array(places).transpose(2, 0, 1), turned / np.linalg.norm(turned, axis=2, keepdims=True))

    def coordinates(self, seen: Tracked) -> int:
        """Return how many coordinates of moved points are tracked in a row, at most; an orientation has three."""
        places = int(np.isfinite(seen.places[:, self._moved]).sum(axis=(1, 2)).max())
        return places + 3 * sum(self.points[k].turns for k in self._moved)

    def at_zero(self, point: Point) -> tuple[Array, Array]:
        """Return the position [3], m, and the axes, columns of [3, 3], of a point in the model's zero."""
        self._put(self._model.qpos0, self._model.qpos0[self._at])
        place, axes = self._frame(point)
        return place.copy(), axes.reshape(3, 3).copy()

    def around(self, t_s: Array, known: Iterable[Series], where: Path) -> Array:
        """Return the positions of the model's other joints at some times, qpos [T, nq].

        Raises:
            TrialError: a column is no joint of the model, or has no unit quaternions.
        """
        qpos = np.tile(self._model.qpos0, (len(t_s), 1))
        place = {
            name: int(self._model.jnt_qposadr[j]) + i
            for j, names in self._columns.items()
            for i, name in enumerate(names)
        }
        for series in known:
            for pose in pose_joints(self._mujoco, self._model).values():
                series = pose.continuous(series, where)
            for name, values in series.columns.items():
                if name not in place:
                    raise TrialError(
                        f"{where}: {name} is no joint of the model; {did_you_mean(name, place)}the model has "
                        f"{', '.join(place)}; name the column after its joint"
                    )
                qpos[:, place[name]] = np.interp(t_s, series.t_s, values)
        return qpos

    def followed(self, seen: Tracked, qpos: Array, start: int, near: Array, most_m: float) -> Poses:
        """Return the pose of each row, solved from those of the last two rows, or of the last one that fits.

        Args:
            seen: readings of R rows.
            qpos: positions of the model's other joints, [R, nq].
            start: row to begin at, in both directions.
            near: pose near that of this row, [J].
            most_m: error up to which a row fits.
        """
        found: list[tuple[Array, float, float]] = [(near, 0.0, 0.0)] * len(qpos)
        for rows in (range(start, len(qpos)), range(start, -1, -1)):
            last, change = near, np.zeros_like(near)
            for row in rows:
                found[row] = self._solved(seen.places[row], seen.turns[row], qpos[row], last + change)
                if found[row][1] < most_m and self._is_beyond(found[row][0]) and not self._is_beyond(last):
                    self._mirror_back(found, seen, qpos, [*range(row, start, -rows.step)])
                pose, error_m, _ = found[row]
                last, change = (pose, pose - last) if error_m < most_m else (last, np.zeros_like(near))
        return Poses(*map(np.array, zip(*found, strict=True)))

    def _mirror_back(
        self, found: list[tuple[Array, float, float]], seen: Tracked, qpos: Array, rows: Sequence[int]
    ) -> None:
        """Replace poses that went on mirrored where the points did not show a joint, such as at a stretched elbow.

        Args:
            found: poses, changed in place.
            seen, qpos: see `followed`.
            rows: rows in which to replace them until both meet; the first has a joint beyond its range.
        """
        near = self.poses(seen, qpos, rows[0]).positions[0] if rows else None
        if near is None or self._is_beyond(near):
            return
        for row in rows:
            other = self._solved(seen.places[row], seen.turns[row], qpos[row], near)
            if self.distance(other[0], found[row][0]) < MET:
                return
            found[row], near = other, other[0]

    def _is_beyond(self, pose: Array) -> bool:
        """Return whether a joint is beyond its limit in the model."""
        return bool((self._outside(pose) & self._limited).any())

    def _outside(self, positions: Array) -> NDArray[np.bool_]:
        """Return which joints are outside the range in which they are sought, [..., J]."""
        return ~((positions > self._low - BEYOND) & (positions < self._high + BEYOND))

    def refined(self, seen: Tracked, qpos: Array, near: Array) -> Poses:
        """Return the pose of each row near another one, [R, J]; see `followed`."""
        rows = zip(seen.places, seen.turns, qpos, near, strict=True)
        return Poses(*map(np.array, zip(*(self._solved(*row) for row in rows), strict=True)))

    def poses(self, seen: Tracked, qpos: Array, row: int) -> Poses:
        """Return the poses that fit one row alike, the best one first: those within the joints' ranges, if any are."""
        starts = np.random.default_rng(0).uniform(self._low, self._high, (STARTS, len(self._low)))
        solved = [
            self._solved(seen.places[row], seen.turns[row], qpos[row], start)
            for start in (qpos[row, self._at], *starts)
        ]
        found = Poses(*map(np.array, zip(*sorted(solved, key=lambda each: each[1]), strict=True)))
        turns = np.round((found.positions - (self._low + self._high) / 2) / (2 * np.pi))
        positions = found.positions - np.where(self._turns, 2 * np.pi * turns, 0.0)
        alike = found.errors_m < ALIKE * found.errors_m[0] + ALIKE_M
        within = ~self._outside(positions).any(axis=1)
        chosen = alike & within if np.any(alike & within) else alike
        return Poses(positions[chosen], found.errors_m[chosen], found.shown[chosen])

    def distance(self, one: Array, other: Array) -> float:
        """Return the largest distance of two poses, rad or m."""
        way = one - other
        return float(np.abs(np.where(self._turns, (way + np.pi) % (2 * np.pi) - np.pi, way)).max())

    def hardly_shown(self, seen: Tracked, qpos: Array, row: int, pose: Array) -> list[str]:
        """Return the joints whose common motion moves the tracked points least at a row."""
        _, jacobian = self._errors(seen.places[row], seen.turns[row], qpos[row], pose)
        weakest = np.abs(np.linalg.eigh(jacobian.T @ jacobian)[1][:, 0])
        return [name for name, share in zip(self.joints, weakest, strict=True) if share > 0.3 * weakest.max()]

    def _points(self, columns: Collection[str]) -> Iterator[Point]:
        parts: dict[str, set[str]] = {}
        for column in columns:
            name, _, part = column.rpartition("_")
            if part not in {"x", "y", "z"} | _TURN:
                raise TrialError(
                    f"{self._path}: {column} is no coordinate; name the columns of a site or body NAME_x, NAME_y, "
                    "NAME_z, and NAME_qw to NAME_qz for its orientation"
                )
            parts.setdefault(name, set()).add(part)
        m, kinds = self._model, self._mujoco.mjtObj
        for name, of in parts.items():
            site, body = (self._mujoco.mj_name2id(m, kind, name) for kind in (kinds.mjOBJ_SITE, kinds.mjOBJ_BODY))
            if max(site, body) < 0:
                known = mjcf.places(self._mujoco, m)
                raise TrialError(
                    f"{self._path}: no site or body {name}; {did_you_mean(name, known)}the model has "
                    f"{', '.join(known)}; add a site where the marker is"
                )
            if 0 < len(of & _TURN) < len(_TURN):
                raise TrialError(f"{self._path}: the orientation of {name} needs {name}_qw to {name}_qz; name all four")
            number, is_site = (site, True) if site >= 0 else (body, False)
            yield Point(name, number, is_site, of >= _TURN, not {*self._carriers(number, is_site)})

    def _carriers(self, number: int, is_site: bool) -> Iterator[int]:
        """Return the joints that move a site or body."""
        return mjcf.carriers(self._model, int(self._model.site_bodyid[number]) if is_site else number)

    def _refuse(self, carriers: Collection[int], numbers: Collection[int]) -> None:
        """Raise TrialError if no joint of unknown position moves the points, or one cannot be determined.

        Args:
            carriers: joints that move the points.
            numbers: those of them without a reading of their own.
        """
        model, kinds = self._model, self._mujoco.mjtJoint
        names = ", ".join(point.name for point in self.points)
        if not carriers:
            raise TrialError(f"{self._path}: no joint moves {names}; track a point that moves")
        if not numbers:
            raise TrialError(
                f"{self._path}: every joint that moves {names} has a column of its own; leave `mocap` out, or the "
                "column of a joint that it should determine"
            )
        single = int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE)
        if other := [j for j in numbers if model.jnt_type[j] not in single or not model.joint(j).name]:
            body = model.body(int(model.jnt_bodyid[other[0]])).name
            raise TrialError(
                f"{self._path}: body {body} has a joint without a name, or one that is no hinge or slide; name it, "
                "or write the whole pose under `base`"
            )
        if both := sorted({*numbers} & self._coupled()):
            raise TrialError(
                f"{self._path}: an equality couples {model.joint(both[0]).name} with other joints, which `mocap` "
                "cannot determine; measure the joints with columns of their own under `measured`"
            )

    def _coupled(self) -> set[int]:
        """Return the joints that an equality couples."""
        m, kinds, found = self._model, self._mujoco.mjtEq, set[int]()
        for kind, one, other in zip(m.eq_type, m.eq_obj1id, m.eq_obj2id, strict=True):
            if kind == int(kinds.mjEQ_JOINT):
                found |= {int(one), int(other)} - {-1}
            elif kind in (int(kinds.mjEQ_CONNECT), int(kinds.mjEQ_WELD)):
                found |= {*mjcf.carriers(m, int(one))} ^ {*mjcf.carriers(m, int(other))}
        return found

    def _solved(self, places: Array, turns: Array, qpos: Array, near: Array) -> tuple[Array, float, float]:
        """Return the pose with the least squared error near another, its error, and the least motion of the points."""
        found, damping = near.copy(), DAMPING * np.eye(len(near))
        for _ in range(STEPS_MOST):
            errors, jacobian = self._errors(places, turns, qpos, found)
            step = np.linalg.solve(jacobian.T @ jacobian + damping, jacobian.T @ errors)
            found = found + step * min(1.0, STEP_MOST / max(float(np.abs(step).max()), 1e-300))
            if np.abs(step).max() < STEP_LEAST:
                errors = errors - jacobian @ step
                break
        else:
            errors, jacobian = self._errors(places, turns, qpos, found)
        least = float(np.linalg.eigvalsh(jacobian.T @ jacobian)[0])
        return found, float(np.sqrt(np.mean(errors**2))), float(np.sqrt(max(least, 0.0)))

    def _errors(self, places: Array, turns: Array, qpos: Array, pose: Array) -> tuple[Array, Array]:
        """Return measured minus predicted coordinates at a pose [E], m, and the Jacobian of the predicted [E, J]."""
        self._put(qpos, pose)
        self._mujoco.mj_comPos(self._model, self._data)
        at, (moves, rotates) = np.empty((len(self._moved), 3)), self._jacobians
        turned, turning = [], []
        for k, number in enumerate(self._moved):
            point = self.points[number]
            jacobian = self._mujoco.mj_jacSite if point.is_site else self._mujoco.mj_jacBody
            jacobian(self._model, self._data, moves[k], rotates[k], point.number)
            at[k], axes = self._frame(point)
            if point.turns:
                now, way = np.empty(4), np.empty(3)
                self._mujoco.mju_mat2Quat(now, axes)
                self._mujoco.mju_subQuat(way, turns[number], now)
                turned.append(LEVER_M * (axes.reshape(3, 3) @ way))
                turning.append(LEVER_M * rotates[k])
        errors = places[self._moved] - at
        seen = np.isfinite(errors)
        rows = np.concatenate((moves[seen], *turning))
        return np.concatenate((errors[seen], *turned)), rows[:, self._dofs]

    def _put(self, qpos: Array, pose: Array) -> None:
        """Compute the model's geometry in a pose."""
        self._data.qpos[:] = qpos
        self._data.qpos[self._at] = pose
        self._mujoco.mj_kinematics(self._model, self._data)

    def _frame(self, point: Point) -> tuple[Array, Array]:
        """Return the position [3], m, and the axes [9] of a point in the pose of the data."""
        data = self._data
        at, axes = (data.site_xpos, data.site_xmat) if point.is_site else (data.xpos, data.xmat)
        return at[point.number], axes[point.number]

    def _reach_m(self) -> float:
        """Return the largest distance of a tracked point from the first joint in the model's zero, or LEVER_M."""
        moved = [self.at_zero(point)[0] for point in self.points if not point.is_fixed]
        start = self._data.xanchor[self._model.dof_jntid[self._dofs[0]]]
        return max(LEVER_M, *(float(np.linalg.norm(place - start)) for place in moved))
