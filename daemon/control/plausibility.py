"""Can a frame of motion capture be true? Each is judged beside the ones before it, on its own stamps. Pure.

A frame that cannot is left out: neither flown by nor counted towards a goal. One by itself is a warning, a few close
together are the event that says what is wrong with the source.
"""

import math
from collections import Counter, deque
from collections.abc import Iterator
from typing import NamedTuple

from softarm.daemon.control.failsafe import Event
from softarm.daemon.control.workspace import HINGE_Z_M
from softarm.schemas.messages import MocapFrame, Pose
from softarm.schemas.model import Arm

CART, TIP = 0, -1  # places in MocapFrame.bodies
WINDOW = 32  # frames that are remembered: a tip that jumps in every tenth is found
FEW = 3  # implausible frames of one kind among them that are no accident
FUTURE_NS = 5_000_000  # clock noise that a capture stamp may be ahead of the frame's reception
HEIGHT_TOLERANCE_M = 0.05  # of the hinge: what is further off misses every target
REACH_MIN_M, REACH_MAX_M = 0.15, 1.15 * sum(Arm().link_length_m)  # tip from hinge; swings: 0.36 to 0.445
TIP_MAX_M_S, TIP_MAX_M_S2 = 8.0, 150.0  # swings reach 5.1 and 63, at the cameras' full rate and at a quarter of it
CART_MAX_M_S, CART_MAX_M_S2 = 2.0, 60.0  # 1.2 and 22
NOISE_M = 0.03  # that is no jump
SAME_FRAMES = 3  # with not one digit changed, where cameras have noise
MEANWHILE_M = 0.01  # that the cart moves under a tip that is shown where it was
AXIS_MEANWHILE_M = 0.05  # that the axis moves: a camera may be late
IN_MOTION_M_S = 0.3  # from which no tip stops dead


def is_usable(frame: MocapFrame) -> bool:
    """The cart and the tip are seen, and every number of theirs is one."""
    return all(
        body.tracked and math.isfinite(body.y_m) and math.isfinite(body.z_m)
        for body in (frame.bodies[CART], frame.bodies[TIP])
    )


class _Same(NamedTuple):
    """A body that is shown at one place, and since when."""

    pose: Pose
    frames: int = 1
    cart_y_m: float = 0.0  # as it was first shown there
    axis_m: float | None = None
    speed_m_s: float = 0.0  # at which it came there


class Plausibility:
    """Judges frames, and remembers what it found in the last `WINDOW` of them."""

    def __init__(self) -> None:
        self._verdicts: deque[str | None] = deque(maxlen=WINDOW)
        self._details: dict[str, str] = {}  # of the newest of each kind
        self._before: MocapFrame | None = None  # the newest usable one, plausible or not
        self._good: deque[MocapFrame] = deque(maxlen=2)  # the newest plausible ones
        self._same: dict[int, _Same] = {}

    def accepts(self, frame: MocapFrame, axis_m: float | None) -> bool:
        """Take note of a usable frame; whether it can be true. axis_m: where the axis is by its own read-back."""
        found = next(self._implausible(frame, axis_m), None)
        self._verdicts.append(found[0] if found else None)
        self._before = frame
        if found:
            self._details[found[0]] = found[1]
            return False
        self._good.append(frame)
        return True

    def events(self) -> Iterator[Event]:
        """What the last frames amount to."""
        for name, frames in sorted(Counter(verdict for verdict in self._verdicts if verdict).items()):
            detail = self._details[name]
            if frames >= FEW:
                yield Event(name, f"{detail}; {frames} of the last {len(self._verdicts)} frames")
            else:
                yield Event("mocap_outlier", detail)

    def _implausible(self, frame: MocapFrame, axis_m: float | None) -> Iterator[tuple[str, str]]:
        cart, tip = frame.bodies[CART], frame.bodies[TIP]
        ahead_ns = frame.t_capture_ns - frame.t_receive_ns
        if ahead_ns > FUTURE_NS:
            yield "mocap_clock", f"{ahead_ns / 1e6:.0f} ms ahead"
        if self._before is not None and frame.sequence <= self._before.sequence:
            yield "mocap_two_sources", f"frame {frame.sequence} came after frame {self._before.sequence}"
        if abs(cart.z_m - HINGE_Z_M) > HEIGHT_TOLERANCE_M:
            yield "mocap_height", f"the cart at z {cart.z_m:.3f} m, the hinge is at {HINGE_Z_M:.3f} m"
        reach_m = math.hypot(tip.y_m - cart.y_m, tip.z_m - cart.z_m)
        if not REACH_MIN_M <= reach_m <= REACH_MAX_M:
            yield "mocap_reach", f"{reach_m:.3f} m from the cart, the arm allows {REACH_MIN_M} to {REACH_MAX_M:.3f} m"
        yield from self._jumped(frame)
        yield from self._frozen(frame, axis_m)

    def _jumped(self, frame: MocapFrame) -> Iterator[tuple[str, str]]:
        """Faster than a body can be or, after two frames that tell its velocity, than it can have become."""
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
                yield "mocap_jump", f"the {name} by {far_m * 1e3:.0f} mm in {step_s * 1e3:.0f} ms"

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
            seen = f"the {name} at one place to the last digit in {same.frames} frames"
            if axis_moved_m > AXIS_MEANWHILE_M:
                yield "mocap_frozen", f"{seen}, while the axis moved {axis_moved_m * 1e3:.0f} mm"
            elif moved_m > MEANWHILE_M:
                yield "mocap_frozen", f"{seen}, while the cart moved {moved_m * 1e3:.0f} mm"
            elif place == TIP and same.speed_m_s > IN_MOTION_M_S:
                yield "mocap_frozen", f"{seen}, out of a swing at {same.speed_m_s:.1f} m/s"

    def _speed_m_s(self, frame: MocapFrame, place: int) -> float:
        if not self._good or (step_s := _seconds(self._good[-1], frame)) <= 0.0:
            return 0.0
        before, after = self._good[-1].bodies[place], frame.bodies[place]
        return math.hypot(after.y_m - before.y_m, after.z_m - before.z_m) / step_s


def _seconds(before: MocapFrame, after: MocapFrame) -> float:
    return (after.t_capture_ns - before.t_capture_ns) * 1e-9
