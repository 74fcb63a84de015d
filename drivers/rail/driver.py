"""The rail: an igus dryve D1 in profile velocity mode over Modbus TCP.

One task on the control loop owns the connection. A `write` wakes it: the set-point goes out, then status,
position and velocity are read back. Link loss is the danger, for a drive without a communication watchdog
keeps its last set-point: the first and the last thing said on any link is a stop, one bad answer does not end a link
in operation, and a broken one is replaced at once.
"""

import asyncio
import contextlib
import errno
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from softarm.drivers.base import DeviceError
from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import ControlWord, DriveState, StatusWord, decode_state, next_controlword
from softarm.drivers.rail.dryve_link import EXCHANGE_ERRORS, DryveLink
from softarm.schemas.config import DryveRail
from softarm.schemas.messages import RailReading

POLL_S = 0.04  # status is read this often when no write comes
SET_POINT_S = 0.1  # a set-point older than this is replaced by zero: the loop is dead or stuck
AT_REST_M_S = 0.02  # a swinging arm keeps pulling at a cart that stands
BRAKE_MAX_S = 1.0  # from 1 m/s at 6 m/s^2 it takes 0.17 s
WALK_MAX_S = 2.0  # from switch-on disabled to operation enabled
MODE_MAX_S = 0.5  # 6061h lags 6060h by up to a quarter of a second
CONNECT_S = 1.0
RETRY_S = (0.02, 1.0)  # first and longest pause between attempts to connect
COMPLAINT_S = 2.0  # how long a walk that failed is remembered
STOP_S = 0.8
AGAIN_S = 0.005  # after an exchange that failed in operation; the second in a row ends the link
HALT_TRIES, HALT_AGAIN_S = 20, 0.01  # a drive that refuses to say how it is

_REMEDY = {
    errno.ECONNREFUSED: "switch on 'Modbus TCP Gateway' on the drive's web page (a restart may lose it)",
    errno.EHOSTUNREACH: "check the drive's supply, the cable, and drivers.rail.host",
    errno.ENETUNREACH: "give this host an address in the drive's network, or correct drivers.rail.host",
}
_LINK_ERRORS = (
    OSError,
    EOFError,
    ValueError,
    OverflowError,  # units_per_m makes a number beyond 32 bits
    dryve.DryveMismatch,
    dryve.DryveRefusal,
)
_AT_EASE = (DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED, DriveState.READY, DriveState.FAULT, DriveState.INVALID)


@dataclass(frozen=True, slots=True)
class SetPoint:
    """What the control loop wants, and since when."""

    enable: bool
    velocity_m_s: float
    t_ns: int


@dataclass(frozen=True, slots=True)
class Feedback:
    """What one poll of the drive found."""

    t_ns: int
    state: DriveState
    statusword: int
    position_m: float
    velocity_m_s: float
    error_code: int

    @property
    def remote(self) -> bool:
        """The enable input DI7."""
        return bool(self.statusword & StatusWord.REMOTE)

    @property
    def at_rest(self) -> bool:
        """No speed worth braking."""
        return abs(self.velocity_m_s) < AT_REST_M_S

    def faults(self) -> tuple[str, ...]:
        """The drive's fault in words."""
        if self.state is DriveState.INVALID:
            return (f"{self.state.value} (statusword 0x{self.statusword:04X})",)
        if self.state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            return (f"{dryve.ERROR_CODES.get(self.error_code, 'unknown error')} (0x{self.error_code:04X})",)
        return ()


class DryveRailAxis:
    """A `softarm.drivers.base.RailAxis`; configured by `softarm.schemas.config.DryveRail`.

    The drive is walked into operation only after `write` has turned from disable to enable, and again only
    after the next such turn: nothing that happens on the wire or at the drive sets the cart in motion.
    """

    def __init__(self, config: DryveRail, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._config, self._clock = config, clock
        self._task: asyncio.Task[None] | None = None
        self._stopping = False
        self._written = asyncio.Event()
        self._at_ease = asyncio.Event()  # as far as we know, the drive is out of operation
        self._at_ease.set()
        self._wanted = SetPoint(False, 0.0, clock())
        self._walk_since_ns: int | None = None  # set while enabling is permitted
        self._operating = False  # operation enabled was reached in this walk
        self._last_step: tuple[DriveState, int] | None = None  # the state shown and the controlword it was given
        self._brake_since_ns: int | None = None
        self._reset_asked = False
        self._feedback: Feedback | None = None
        self._reading: RailReading | None = None
        self._link_problem: str | None = self._say("connect", "not connected yet", "wait a second")
        self._unfit: str | None = None
        self._complaint: tuple[int, str] | None = None

    # What the control loop calls

    def start(self) -> None:
        """Connect in a task of the running loop."""
        self._task = asyncio.get_running_loop().create_task(self._run(), name="rail")

    async def stop(self) -> None:
        """Brake, switch the drive off, close. Tries for 0.8 s, over new connections too if need be."""
        self._stopping = True
        self.write(False, 0.0)
        if self._task is None:
            return
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                await self._at_ease.wait()
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    def read(self) -> RailReading | None:
        """See `softarm.drivers.base.RailAxis.read`."""
        return self._reading

    def write(self, enable: bool, velocity_m_s: float) -> None:
        """See `softarm.drivers.base.RailAxis.write`; from the loop's own thread. A velocity of NaN is zero."""
        now_ns = self._clock()
        if enable and not self._wanted.enable:
            self._walk_since_ns, self._complaint, self._operating = now_ns, None, False
        elif not enable:
            self._walk_since_ns = None
        self._wanted = SetPoint(enable, velocity_m_s if math.isfinite(velocity_m_s) else 0.0, now_ns)
        self._written.set()

    def reset_fault(self) -> None:
        """See `softarm.drivers.base.Device.reset_fault`; only a drive in fault, and while disabled, is reset."""
        self._reset_asked = True
        self._written.set()

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        feedback, task = self._feedback, self._task
        if task is not None and task.done() and not self._stopping:
            return self._say("poll", f"the driver ended: {task}", "restart the daemon and report this")
        if self._link_problem is not None or feedback is None:
            return self._link_problem
        if self._unfit is not None:
            return self._unfit
        if feedback.faults():
            remedy = "see to its cause, then acknowledge; an invalid boot state needs a power cycle"
            return self._say("read 6041h", f"the drive reports {', '.join(feedback.faults())}", remedy)
        if not feedback.remote:
            return self._say("read 6041h", "the enable input DI7 is low", "release the hardware e-stop")
        if self._complaint is None:
            return None
        age_s = (self._clock() - self._complaint[0]) / 1e9
        return self._complaint[1] if self._wanted.enable or age_s < COMPLAINT_S else None

    # The task

    async def _run(self) -> None:
        pause_s = RETRY_S[0]
        while True:
            link: DryveLink | None = None
            try:
                host, port = self._config.host, self._config.port
                link = await DryveLink.open(host, port, CONNECT_S, self._config.timeout_s)
                await self._set_up(link)
                pause_s = RETRY_S[0]
                await self._converse(link)
            except _LINK_ERRORS as error:
                self._link_problem = self._explain(error, connected=link is not None)
                if self._walk_since_ns is not None:
                    self._complain("converse", f"the connection was lost ({error})", "disarm, then arm")
            finally:
                self._forbid()
                if link is not None:
                    await link.close()
            await asyncio.sleep(pause_s)
            if self._at_ease.is_set():  # a cart that may be moving is not kept waiting
                pause_s = min(2 * pause_s, RETRY_S[1])

    async def _converse(self, link: DryveLink) -> None:
        """Cycle until the link fails: at once out of operation, at the second failure in a row in it."""
        failed = False
        while True:
            try:
                await self._cycle(link)
            except EXCHANGE_ERRORS:
                if failed or not self._operating_now():
                    raise
                failed = True
                self._written.set()  # the set-point may not have arrived: the newest one goes next
                await asyncio.sleep(AGAIN_S)
            else:
                failed, self._link_problem = False, None

    async def _set_up(self, link: DryveLink) -> None:
        """Bring the drive to rest, whatever went before, then set mode and ramps and read them back."""
        await self._come_to_rest(link)
        await link.write(dryve.MODE, dryve.PROFILE_VELOCITY)
        unfit = await self._mode_not_taken(link)
        ramp = self._units(self._config.acceleration_m_s2)
        quick_stop = self._units(self._config.quick_stop_m_s2)
        for entry, value in (
            (dryve.ACCELERATION, ramp),
            (dryve.DECELERATION, ramp),
            (dryve.QUICK_STOP, quick_stop),
        ):
            await link.write(entry, value)
            actual = await link.read(entry)
            if actual != value:
                unfit = unfit or f"{entry} reads {actual} after {value} was written"
        remedy = "set it on the drive's web page, or correct drivers.rail, and start again; it is not enabled"
        self._unfit = None if unfit is None else self._say("set up", unfit, remedy)

    async def _come_to_rest(self, link: DryveLink) -> None:
        operating = await self._halt(link)
        until_ns = self._clock() + int(BRAKE_MAX_S * 1e9)
        while abs(await link.read(dryve.VELOCITY)) > self._units(AT_REST_M_S) and self._clock() < until_ns:
            await asyncio.sleep(0.01)
        await link.write(dryve.CONTROLWORD, ControlWord.SHUTDOWN if operating else ControlWord.RESET_AND_HALT)

    async def _halt(self, link: DryveLink) -> bool:
        """Whether the drive was in operation; if so it brakes now. While it refuses to say, it is told to stop."""
        for left in reversed(range(HALT_TRIES)):
            try:
                operating = decode_state(await link.read(dryve.STATUSWORD)) is DriveState.OPERATION_ENABLED
                if operating:
                    await link.write(dryve.TARGET_VELOCITY, 0)
                    await link.write(dryve.CONTROLWORD, ControlWord.ENABLE_AND_HALT)
                return operating
            except dryve.DryveRefusal:
                if not left:
                    raise
                await asyncio.sleep(HALT_AGAIN_S)
                with contextlib.suppress(dryve.DryveRefusal):
                    await link.write(dryve.TARGET_VELOCITY, 0)
        raise AssertionError("the last try returns or raises")

    async def _mode_not_taken(self, link: DryveLink) -> str | None:
        until_ns = self._clock() + int(MODE_MAX_S * 1e9)
        while (mode := await link.read(dryve.MODE_DISPLAY)) != dryve.PROFILE_VELOCITY:
            if self._clock() > until_ns:
                return f"{dryve.MODE_DISPLAY} stays at {mode} after {dryve.PROFILE_VELOCITY} was written"
            await asyncio.sleep(0.02)
        return None

    async def _cycle(self, link: DryveLink) -> None:
        """One set-point out (if a new one came), one feedback in, at most one controlword out."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(POLL_S):
                await self._written.wait()
        if self._written.is_set() or self._set_point_age_s() > SET_POINT_S:
            self._written.clear()
            if self._operating_now():
                await link.write(dryve.TARGET_VELOCITY, self._units(self._velocity_m_s()))
        feedback = await self._poll(link)
        self._publish(feedback)
        self._judge(feedback)
        await self._lead(link, feedback)

    def _operating_now(self) -> bool:
        return self._feedback is not None and self._feedback.state is DriveState.OPERATION_ENABLED

    def _set_point_age_s(self) -> float:
        return (self._clock() - self._wanted.t_ns) / 1e9

    def _velocity_m_s(self) -> float:
        """The set-point that may go out: zero unless enabled, permitted and fresh."""
        fresh = self._set_point_age_s() <= SET_POINT_S
        return self._wanted.velocity_m_s if self._walk_since_ns is not None and fresh else 0.0

    async def _poll(self, link: DryveLink) -> Feedback:
        statusword = await link.read(dryve.STATUSWORD)
        position = await link.read(dryve.POSITION)
        t_ns = self._clock()
        velocity = await link.read(dryve.VELOCITY)
        state = decode_state(statusword)
        faulty = state in (DriveState.FAULT, DriveState.FAULT_REACTION)
        return Feedback(
            t_ns=t_ns,
            state=state,
            statusword=statusword,
            position_m=position / self._config.units_per_m - self._config.centre_m,
            velocity_m_s=velocity / self._config.units_per_m,
            error_code=await link.read(dryve.ERROR_CODE) if faulty else 0,
        )

    def _publish(self, feedback: Feedback) -> None:
        self._feedback = feedback
        self._reading = RailReading(
            t_receive_ns=feedback.t_ns,
            position_m=feedback.position_m,
            velocity_m_s=feedback.velocity_m_s,
            enabled=feedback.state is DriveState.OPERATION_ENABLED,
            remote=feedback.remote,
            faults=feedback.faults() + (() if self._unfit is None else (self._unfit,)),
        )
        if feedback.state in _AT_EASE:
            self._at_ease.set()
        else:
            self._at_ease.clear()

    def _judge(self, feedback: Feedback) -> None:
        """Withdraw the permission to enable when the drive does not follow."""
        if self._walk_since_ns is None:
            return
        where = f"'{feedback.state.value}' (statusword 0x{feedback.statusword:04X})"
        if not feedback.remote or feedback.faults() or self._unfit is not None:
            self._forbid()
        elif feedback.state is DriveState.OPERATION_ENABLED:
            self._operating = True
            if self._set_point_age_s() > SET_POINT_S:
                stalled = f"no set-point for {SET_POINT_S} s, so zero was sent"
                self._complain("write 60FFh", stalled, "see what keeps the control loop")
        elif self._operating:
            self._complain("write 60FFh", f"the drive fell back to {where} by itself", "disarm, then arm")
            self._forbid()
        elif self._clock() - self._walk_since_ns > WALK_MAX_S * 1e9:
            remedy = "check DI7, load supply and the drive's web page, then disarm and arm"
            self._complain("enable", f"the drive stays in {where}", remedy)
            self._forbid()

    def _forbid(self) -> None:
        self._walk_since_ns, self._operating = None, False

    def _complain(self, command: str, problem: str, remedy: str) -> None:
        self._complaint = (self._clock(), self._say(command, problem, remedy))

    async def _lead(self, link: DryveLink, feedback: Feedback) -> None:
        """Send the next controlword, once for each state that the drive shows."""
        enable = self._walk_since_ns is not None and not self._stopping
        await self._reset_fault_if_asked(link, feedback)
        braked = feedback.at_rest or self._braking_for_s(feedback, enable) > BRAKE_MAX_S
        word = next_controlword(feedback.state, enable, braked) if feedback.remote else None
        step = None if word is None else (feedback.state, word)
        if word is not None and step != self._last_step:
            if word == ControlWord.ENABLE_OPERATION:
                await link.write(dryve.TARGET_VELOCITY, 0)
            await link.write(dryve.CONTROLWORD, word)
        self._last_step = step

    def _braking_for_s(self, feedback: Feedback, enable: bool) -> float:
        if enable or feedback.state is not DriveState.OPERATION_ENABLED:
            self._brake_since_ns = None
            return 0.0
        self._brake_since_ns = self._brake_since_ns or feedback.t_ns
        return (feedback.t_ns - self._brake_since_ns) / 1e9

    async def _reset_fault_if_asked(self, link: DryveLink, feedback: Feedback) -> None:
        asked, self._reset_asked = self._reset_asked, False
        if asked and feedback.state is DriveState.FAULT and feedback.remote and not self._wanted.enable:
            # Bit 7 acts on its rising edge; the D1 then wants HALT seen before it is walked up again.
            for word in (ControlWord.RESET_AND_HALT, ControlWord.FAULT_RESET, ControlWord.RESET_AND_HALT):
                await link.write(dryve.CONTROLWORD, word)

    # Words and numbers

    def _units(self, metres: float) -> int:
        """Drive units: 60A8h, the same for position, velocity and acceleration."""
        return round(metres * self._config.units_per_m)

    def _say(self, command: str, problem: str, remedy: str) -> str:
        return str(DeviceError(f"{self._config.host}:{self._config.port}", command, problem, remedy))

    def _explain(self, error: Exception, connected: bool) -> str:
        command = "converse" if connected else "connect"
        if isinstance(error, dryve.DryveRefusal):
            return self._say("request", str(error), "see the drive's manual; connecting again")
        if isinstance(error, EOFError):
            remedy = "see that no other master is connected"
            return self._say(command, "the drive closed the connection", remedy)
        if isinstance(error, TimeoutError) and not connected:
            return self._say(command, f"no answer within {CONNECT_S} s", _REMEDY[errno.EHOSTUNREACH])
        number = error.errno if isinstance(error, OSError) else None
        return self._say(command, str(error), _REMEDY.get(number or 0, "check the cable; connecting again"))
