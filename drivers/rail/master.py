"""The drive's master: leads a dryve D1 in profile velocity mode by the set-points that the daemon sends.

Link loss is the danger, for a drive without a communication watchdog keeps its last set-point: the first and the last
thing said on any link is a stop, one bad answer does not end a link in operation, and a broken one is replaced at once.
So is the loss of the daemon: a set-point is good for `hold_s`, permission to move for `time_to_live_s`, and a daemon
that has hung up is answered by a drive that is switched off. Runs in a process of its own (`process.py`), which imports
next to nothing.
"""

import contextlib
import select
import socket
import time
from collections.abc import Callable

from softarm.drivers.rail import dryve, pair
from softarm.drivers.rail.cia402 import ControlWord, DriveState, next_controlword
from softarm.drivers.rail.dryve_link import CONNECT_S, EXCHANGE_ERRORS, LINK_ERRORS, DryveLink, explained
from softarm.drivers.rail.feedback import AT_REST_M_S, Feedback, homed, poll
from softarm.drivers.rail.orders import Orders
from softarm.drivers.rail.pair import Reading, Report
from softarm.drivers.rail.rest import BRAKE_MAX_S, come_to_rest
from softarm.drivers.rail.settings import Settings

POLL_S = 0.04  # status is read this often when no set-point comes
BEAT_S = 0.05  # the daemon hears at least this often that we live
WALK_MAX_S = 2.0  # from switch-on disabled to operation enabled
RETRY_S = (0.02, 1.0)  # first and longest pause between attempts to connect
COMPLAINT_S = 2.0  # how long a walk that failed is remembered
PART_S = 2.0  # how long a drive that may move is tried for once the daemon has hung up
AGAIN_S = 0.005  # after an exchange that failed in operation; the second in a row ends the link
CYCLES_NS = 1_000_000_000  # the cycle's time is told over so long


class HungUp(Exception):
    """The daemon has closed its end, or is no more."""


class Master:
    """Leads the drive until the daemon hangs up. What the daemon wants, and how long it is believed: `Orders`.

    The drive is walked into operation only while that is permitted: nothing that happens on the wire, at the drive, to
    the daemon or to this process sets the cart in motion.
    """

    def __init__(
        self,
        settings: Settings,
        daemon: socket.socket,
        may_move: bool,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """`daemon`: our end of the pair; `may_move`: the drive may be in operation, with nobody who leads it."""
        self._settings, self._daemon, self._clock = settings, daemon, clock
        daemon.setblocking(False)
        self._orders = Orders(settings.hold_s, settings.time_to_live_s)
        self._acknowledged: int | None = None  # as the newest set-point has it
        self._reset_asked = False
        self._news = False  # a set-point came that was not yet passed on
        self._hung_up = False
        self._told_s = 0.0  # when the daemon was told last
        self._link: DryveLink | None = None
        self._target = 0  # the velocity that the drive was told last, in its units
        self._at_ease = not may_move  # as far as we know, the drive is out of operation
        self._operating = False  # operation enabled was reached since permission was given
        self._last_step: tuple[DriveState, int] | None = None  # the state shown and the controlword it was given
        self._brake_since_ns: int | None = None
        self._feedback: Feedback | None = None
        self._homed: bool | None = None  # as the drive said last; None: it does not say
        self._reading: Reading | None = None
        self._cycles: list[tuple[int, int]] = []  # when each of the last second ended, and how long it took; ns
        self._link_problem: str | None = self._say("connect", "not connected yet", "wait a second")
        self._unfit: str | None = None
        self._complaint: tuple[int, str] | None = None

    def run(self) -> None:
        """Until the daemon hangs up, and the drive is off or could not be reached for `PART_S`."""
        try:
            self._serve()
        except HungUp:
            self._part()
        finally:
            self._close()

    def _serve(self) -> None:
        pause_s = RETRY_S[0]
        while True:
            try:
                self._open()
                self._set_up()
                pause_s = RETRY_S[0]
                self._converse()
            except LINK_ERRORS as error:
                self._link_problem = self._explain(error)
                if self._orders.permitted_since_ns is not None:
                    self._complain("converse", f"the connection was lost ({error})", "disarm, then arm")
                self._forbid()
                self._close()
            self._attend(pause_s)
            if self._at_ease:  # a cart that may be moving is not kept waiting
                pause_s = min(2 * pause_s, RETRY_S[1])

    def _part(self) -> None:
        """Nobody leads us any more: brake and switch off on the link that there is, else on new ones."""
        self._forbid()
        until_s = time.monotonic() + PART_S
        while not self._at_ease and time.monotonic() < until_s:
            try:
                self._open()
                self._say_stop()
                self._come_to_rest()
                self._at_ease = True
            except LINK_ERRORS as error:
                self._link_problem = self._explain(error)
                self._close()
                self._attend(RETRY_S[0])

    # The daemon's end

    def _attend(self, seconds: float, line: socket.socket | None = None, events: int = 0, work: bool = False) -> bool:
        """See to the daemon for so long; until `line`, if there is one, is ready (then True), or until there is `work`.

        What is waited for on `line` is an answer: a stop that falls due meanwhile does not wait for it.
        Raises HungUp.
        """
        until_s = time.monotonic() + seconds
        while True:
            if line is not None and self._stop_is_due():
                self._say_stop()
            self._report_in_time()
            left_s = 0.0 if work and self._has_work() else until_s - time.monotonic()
            poll = select.poll()
            if not self._hung_up:
                poll.register(self._daemon, select.POLLIN)
            if line is not None:
                poll.register(line, events)
            ready = {number for number, _ in poll.poll(1e3 * max(0.0, min(left_s, self._due_in_s())))}
            if self._daemon.fileno() in ready:
                self._hear()
            if line is not None and line.fileno() in ready:
                return True
            if left_s <= 0:
                return False

    def _wait(self, line: socket.socket, events: int, seconds: float) -> bool:
        return self._attend(seconds, line, events)

    def _has_work(self) -> bool:
        return self._news or self._stop_is_due()

    def _stop_is_due(self) -> bool:
        """The drive was told to move, and that is no longer what is wanted, permitted or fresh."""
        return self._target != 0 and self._velocity() == 0

    def _due_in_s(self) -> float:
        """Until a report is due, or the set-point in force is too old."""
        beat_s = self._told_s + BEAT_S - time.monotonic()
        now_ns = self._clock()
        holds = self._target != 0 and self._orders.holds(now_ns)
        return max(0.0, min(beat_s, self._orders.holds_for_ns(now_ns) * 1e-9 if holds else beat_s))

    def _hear(self) -> None:
        """All that the daemon has said. Raises HungUp."""
        while True:
            try:
                set_point = pair.decode_set_point(self._daemon.recv(pair.PACKET_MAX))
            except BlockingIOError:
                return
            except (OSError, ValueError):  # nothing: the other end is closed
                self._hung_up = True
                raise HungUp from None
            self._lapse(set_point.t_ns)
            if self._orders.take(set_point, self._clock()):
                self._complaint, self._operating = None, False
            self._reset_asked |= self._acknowledged not in (None, set_point.acknowledged)
            self._acknowledged, self._news = set_point.acknowledged, True

    def _lapse(self, now_ns: int) -> None:
        if self._orders.lapse(now_ns):
            stalled = f"no set-point for {self._settings.time_to_live_s:g} s, so the drive is switched off"
            self._complain("write 60FFh", stalled, "see what kept the control loop, then disarm and arm")

    def _report_in_time(self) -> None:
        if time.monotonic() - self._told_s >= BEAT_S:
            self._report()

    def _report(self) -> None:
        report = Report(self._orders.number, self._at_ease, self._reading, self._problem())
        with contextlib.suppress(OSError):  # it is gone, which is heard elsewhere, or hangs, and its line is full
            self._daemon.send(pair.encode_report(report))
        self._told_s = time.monotonic()

    # The link

    def _open(self) -> None:
        if self._link is None:
            address = (self._settings.host, self._settings.port)
            self._link = DryveLink.open(address, self._wait, CONNECT_S, self._settings.timeout_s)

    def _close(self) -> None:
        link, self._link = self._link, None
        self._target, self._feedback, self._last_step = 0, None, None
        if link is not None:
            link.close()

    @property
    def _drive(self) -> DryveLink:
        if self._link is None:
            raise EOFError("there is no connection")
        return self._link

    def _say_stop(self) -> None:
        self._target = 0
        self._drive.stop()

    def _set_up(self) -> None:
        """Bring the drive to rest, whatever went before, then set mode and ramps and read them back."""
        self._come_to_rest()
        drive = self._drive
        unfit = drive.configure_mode(dryve.PROFILE_VELOCITY, self._attend)
        ramp = self._settings.units(self._settings.acceleration_m_s2)
        quick_stop = self._settings.units(self._settings.quick_stop_m_s2)
        for entry, value in (
            (dryve.ACCELERATION, ramp),
            (dryve.DECELERATION, ramp),
            (dryve.QUICK_STOP, quick_stop),
        ):
            untaken = drive.configure(entry, value)
            unfit = unfit or untaken
        remedy = "set it on the drive's web page, or correct drivers.rail, and start again; it is not enabled"
        self._unfit = None if unfit is None else self._say("set up", unfit, remedy)

    def _come_to_rest(self) -> None:
        come_to_rest(self._drive, self._settings.units(AT_REST_M_S), self._attend)

    # The conversation

    def _converse(self) -> None:
        """Cycle until the link fails: at once out of operation, at the second failure in a row in it."""
        failed = False
        while True:
            self._attend(POLL_S, work=True)
            began_ns = self._clock()
            try:
                self._cycle()
            except EXCHANGE_ERRORS:
                if failed or not self._operating_now():
                    raise
                failed = True
                self._news = True  # the set-point may not have arrived: the newest one goes next
                self._attend(AGAIN_S)
            else:
                failed, self._link_problem = False, None
            self._count_cycle(began_ns)

    def _cycle(self) -> None:
        """One set-point out (if there is a new one, or none in force), one feedback in, at most one controlword out."""
        self._lapse(self._clock())
        if self._news or not self._orders.holds(self._clock()):
            self._news = False
            self._target = self._velocity() if self._operating_now() else 0
            if self._operating_now():
                self._drive.write(dryve.TARGET_VELOCITY, self._target)
        feedback = poll(self._drive, self._settings, self._clock)
        self._ask_whether_homed(feedback)
        self._judge(feedback)
        self._publish(feedback)
        self._lead(feedback)

    def _ask_whether_homed(self, feedback: Feedback) -> None:
        """What makes a drive forget its zero shows: a new connection, or a fall to 40h. And when it says no, again."""
        if not self._settings.asks_homed or not feedback.at_ease:
            return
        fell = feedback.state is DriveState.SWITCH_ON_DISABLED
        if self._feedback is None or self._homed is False or (fell and self._feedback.state is not feedback.state):
            self._homed = homed(self._drive)

    def _operating_now(self) -> bool:
        return self._feedback is not None and self._feedback.state is DriveState.OPERATION_ENABLED

    def _velocity(self) -> int:
        """The set-point that may go out now, in the drive's units."""
        return self._settings.velocity_units(self._orders.velocity_m_s(self._clock()))

    def _publish(self, feedback: Feedback) -> None:
        times_ns = sorted(took_ns for _, took_ns in self._cycles) or [0]
        self._feedback = feedback
        self._reading = Reading(
            t_ns=feedback.t_ns,
            position_m=feedback.position_m,
            velocity_m_s=feedback.velocity_m_s,
            enabled=feedback.state is DriveState.OPERATION_ENABLED,
            remote=feedback.remote,
            cycle_p50_ns=times_ns[len(times_ns) // 2],
            cycle_max_ns=times_ns[-1],
            faults=feedback.faults() + (() if self._unfit is None else (self._unfit,)),
            homed=self._homed,
        )
        self._at_ease = feedback.at_ease
        self._report()

    def _count_cycle(self, began_ns: int) -> None:
        now_ns = self._clock()
        self._cycles = [cycle for cycle in self._cycles if cycle[0] > now_ns - CYCLES_NS] + [
            (now_ns, now_ns - began_ns)
        ]

    def _judge(self, feedback: Feedback) -> None:
        """Withdraw the permission to enable when the drive does not follow."""
        since_ns = self._orders.permitted_since_ns
        if since_ns is None:
            return
        where = f"'{feedback.state.value}' (statusword 0x{feedback.statusword:04X})"
        if not feedback.remote or feedback.faults() or self._unfit is not None or self._homed is False:
            self._forbid()
        elif feedback.state is DriveState.OPERATION_ENABLED:
            self._operating = True
        elif self._operating:
            self._complain("write 60FFh", f"the drive fell back to {where} by itself", "disarm, then arm")
            self._forbid()
        elif self._clock() - since_ns > WALK_MAX_S * 1e9:
            remedy = "check DI7, load supply and the drive's web page, then disarm and arm"
            self._complain("enable", f"the drive stays in {where}", remedy)
            self._forbid()

    def _forbid(self) -> None:
        self._orders.forbid()
        self._operating = False

    def _lead(self, feedback: Feedback) -> None:
        """Send the next controlword, once for each state that the drive shows."""
        enable = self._orders.permitted_since_ns is not None
        self._reset_fault_if_asked(feedback)
        braked = feedback.at_rest or self._braking_for_s(feedback, enable) > BRAKE_MAX_S
        word = next_controlword(feedback.state, enable, braked) if feedback.remote else None
        step = None if word is None else (feedback.state, word)
        if word is not None and step != self._last_step:
            if word == ControlWord.ENABLE_OPERATION:
                self._drive.write(dryve.TARGET_VELOCITY, 0)
            self._at_ease = False  # until it shows where it went
            self._drive.write(dryve.CONTROLWORD, word)
        self._last_step = step

    def _braking_for_s(self, feedback: Feedback, enable: bool) -> float:
        if enable or feedback.state is not DriveState.OPERATION_ENABLED:
            self._brake_since_ns = None
            return 0.0
        self._brake_since_ns = self._brake_since_ns or feedback.t_ns
        return (feedback.t_ns - self._brake_since_ns) / 1e9

    def _reset_fault_if_asked(self, feedback: Feedback) -> None:
        """Only a drive in fault is reset, and only while disabled."""
        asked, self._reset_asked = self._reset_asked, False
        if asked and feedback.state is DriveState.FAULT and feedback.remote and not self._orders.enable:
            # Bit 7 acts on its rising edge; the D1 then wants HALT seen before it is walked up again.
            for word in (ControlWord.RESET_AND_HALT, ControlWord.FAULT_RESET, ControlWord.RESET_AND_HALT):
                self._drive.write(dryve.CONTROLWORD, word)

    # Words and numbers

    def _problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        feedback = self._feedback
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
        return self._complaint[1] if self._orders.enable or age_s < COMPLAINT_S else None

    def _complain(self, command: str, problem: str, remedy: str) -> None:
        self._complaint = (self._clock(), self._say(command, problem, remedy))

    def _say(self, command: str, problem: str, remedy: str) -> str:
        """As `softarm.drivers.base.DeviceError` puts it."""
        return f"{self._settings.host}:{self._settings.port}: {command}: {problem}; {remedy}"

    def _explain(self, error: Exception) -> str:
        return self._say(*explained(error, connected=self._link is not None, then="; connecting again"))
