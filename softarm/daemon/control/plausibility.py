"""Plausibility of motion capture frames, judged by their own stamps and the frames before them. Pure.

An implausible frame is left out: no policy and no goal uses it. A single one is a warning; several within a short time
raise the event that names the fault of the source.
"""

import math
from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

from softarm.daemon.control.failsafe import Event
from softarm.daemon.control.workspace import HINGE_Z_M
from softarm.schemas.messages import CAPTURE_AHEAD_MAX_NS, MocapFrame, Pose
from softarm.schemas.model import Arm

CART, TIP = 0, -1  # indices into MocapFrame.bodies
WINDOW = 32  # frames remembered: finds a tip that jumps in every tenth frame
FEW = 3  # implausible frames of one kind in the window that raise their event
HEIGHT_TOLERANCE_M = 0.05  # of the hinge: a larger error misses every target
REACH_MIN_M, REACH_MAX_M = 0.15, 1.15 * sum(Arm().link_length_m)  # tip from hinge; swings: 0.36 to 0.445
TIP_MAX_M_S, TIP_MAX_M_S2 = 8.0, 150.0  # swings reach 5.1 and 63, at the cameras' full rate and at a quarter of it
CART_MAX_M_S, CART_MAX_M_S2 = 2.0, 60.0  # swings reach 1.2 and 22
NOISE_M = 0.03  # a smaller step is no jump
SAME_FRAMES = 3  # equal to the last digit, although cameras have noise
MEANWHILE_M = 0.01  # movement of the cart under a repeated tip pose
AXIS_MEANWHILE_M = 0.05  # movement of the axis under a repeated pose: a camera may be late
IN_MOTION_M_S = 0.3  # a tip at this speed cannot stop within a frame


def is_usable(frame: MocapFrame) -> bool:
    """Return whether the cart and the tip are tracked and their positions are finite."""
    return all(
        body.tracked and math.isfinite(body.y_m) and math.isfinite(body.z_m)
        for body in (frame.bodies[CART], frame.bodies[TIP])
    )


class _Same(NamedTuple):
    """A pose that a body has repeated."""

    pose: Pose
    frames: int = 1
    cart_y_m: float = 0.0  # of the first of these frames
    axis_m: float | None = None
    speed_m_s: float = 0.0  # before the first of these frames


class Plausibility:
    """Judge of motion capture frames, with the verdicts on the last `WINDOW` frames."""

    def __init__(self) -> None:
        self._verdicts: deque[str | None] = deque(maxlen=WINDOW)
        self._details: dict[str, str] = {}  # newest detail of each kind
        self._before: MocapFrame | None = None  # newest usable frame, plausible or not
        self._good: deque[MocapFrame] = deque(maxlen=2)  # newest plausible frames
        self._same: dict[int, _Same] = {}

    def accepts(self, frame: MocapFrame, axis_m: float | None) -> bool:
        """Judge a usable frame and return whether it is plausible; `axis_m` is the axis read-back."""
        found = next(self._implausible(frame, axis_m), None)
        self._verdicts.append(found[0] if found else None)
        self._before = frame
        if found:
            self._details[found[0]] = found[1]
            return False
        self._good.append(frame)
        return True

    def events(self) -> Iterator[Event]:
        """Yield the events that the last frames raise."""
        for name, frames in sorted(Counter(verdict for verdict in self._verdicts if verdict).items()):
            detail = self._details[name]
            if frames >= FEW:
                yield Event(name, f"{detail}; {frames} of the last {len(self._verdicts)} frames")
            else:
                yield Event("mocap_outlier", detail)

    def _implausible(self, frame: MocapFrame, axis_m: float | None) -> Iterator[tuple[str, str]]:
        cart, tip = frame.bodies[CART], frame.bodies[TIP]
        if frame.from_another_clock:
            ahead_s, allowed_s = (frame.t_capture_ns - frame.t_receive_ns) / 1e9, CAPTURE_AHEAD_MAX_NS / 1e9
            yield "mocap_clock", f"{ahead_s:.3f} s ahead of CLOCK_MONOTONIC, allowed {allowed_s:g} s"
        if self._before is not None and frame.sequence <= self._before.sequence:
            yield "mocap_two_sources", f"frame {frame.sequence} arrived after frame {self._before.sequence}"
        if abs(cart.z_m - HINGE_Z_M) > HEIGHT_TOLERANCE_M:
            yield "mocap_height", f"the cart at z {cart.z_m:.3f} m, the hinge is at {HINGE_Z_M:.3f} m"
        reach_m = math.hypot(tip.y_m - cart.y_m, tip.z_m - cart.z_m)
        if not REACH_MIN_M <= reach_m <= REACH_MAX_M:
            yield "mocap_reach", f"{reach_m:.3f} m from the cart, the arm allows {REACH_MIN_M} to {REACH_MAX_M:.3f} m"
        yield from self._jumped(frame)
        yield from self._frozen(frame, axis_m)

    def _jumped(self, frame: MocapFrame) -> Iterator[tuple[str, str]]:
        """Find steps beyond the highest velocity or, once the velocity is known, beyond the highest acceleration."""
        if not self._good:
            return
        last = self._good[-1]
        step_s = _seconds(last, frame)
        if step_s <= 0.0:
            return
        for name, place, top_m_s, top_m_s2 in (
            ("tip", TIP, TIP_MAX_M_S, TIP_MAX_M_S2),
            ("cart", CART, CART_MAX_M_S, CART_MAX_M_S2),
        ):
            from_m, to_m = last.bodies[place], frame.bodies[place]
            dy_m, dz_m = to_m.y_m - from_m.y_m, to_m.z_m - from_m.z_m
            off_m, allowed_m = math.hypot(dy_m, dz_m), top_m_s * step_s
            if len(self._good) == 2 and off_m <= allowed_m + NOISE_M:
                first_m, before_s = self._good[0].bodies[place], _seconds(self._good[0], last)
                share = step_s / before_s
                off_m = math.hypot(dy_m - (from_m.y_m - first_m.y_m) * share, dz_m - (from_m.z_m - first_m.z_m) * share)
                allowed_m = 0.5 * top_m_s2 * (before_s + step_s) * step_s
            if off_m > allowed_m + NOISE_M:
                far_m = math.hypot(dy_m, dz_m)
                yield "mocap_jump", f"the {name} moved {far_m * 1e3:.0f} mm in {step_s * 1e3:.0f} ms"

    def _frozen(self, frame: MocapFrame, axis_m: float | None) -> Iterator[tuple[str, str]]:
        cart_y_m = frame.bodies[CART].y_m
        for place in (TIP, CART):
            pose, same = frame.bodies[place], self._same.get(place)
            if same is None or pose[:2] != same.pose[:2]:
                self._same[place] = _Same(pose, 1, cart_y_m, axis_m, self._speed_m_s(frame, place))
            else:
                self._same[place] = same._replace(frames=same.frames + 1)
        for name, place in (("tip", TIP), ("cart", CART)):
            same = self._same[place]
            if same.frames < SAME_FRAMES:
                continue
            axis_moved_m = 0.0 if axis_m is None or same.axis_m is None else abs(axis_m - same.axis_m)
            moved_m = abs(cart_y_m - same.cart_y_m)
            seen = f"the {name} has the same pose to the last digit in {same.frames} frames"
            if axis_moved_m > AXIS_MEANWHILE_M:
                yield "mocap_frozen", f"{seen}, while the axis moved {axis_moved_m * 1e3:.0f} mm"
            elif moved_m > MEANWHILE_M:
                yield "mocap_frozen", f"{seen}, while the cart moved {moved_m * 1e3:.0f} mm"
            elif place == TIP and same.speed_m_s > IN_MOTION_M_S:
                yield "mocap_frozen", f"{seen}, after a swing at {same.speed_m_s:.1f} m/s"

    def _speed_m_s(self, frame: MocapFrame, place: int) -> float:
        if not self._good or (step_s := _seconds(self._good[-1], frame)) <= 0.0:
            return 0.0
        before, after = self._good[-1].bodies[place], frame.bodies[place]
        return math.hypot(after.y_m - before.y_m, after.z_m - before.z_m) / step_s


def _seconds(before: MocapFrame, after: MocapFrame) -> float:
    return (after.t_capture_ns - before.t_capture_ns) * 1e-9
