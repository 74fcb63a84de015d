"""Master of a dryve D1 in profile velocity mode; it follows the set-points that the daemon sends.

The danger is a lost connection: a drive without a communication watchdog keeps its last set-point. Therefore the first
and last message on every connection is a stop, one bad answer does not end a connection in operation, and a broken one
is replaced at once. The daemon may also be lost: a set-point expires after `hold_s`, the permission to move after
`time_to_live_s`, and the drive is disabled when the daemon hangs up.

The master runs in a process of its own (`process.py`), which imports as little as possible.
"""

import select
import socket
import time
from collections.abc import Callable

from softarm.drivers.rail import dryve
from softarm.drivers.rail.cia402 import ControlWord, DriveState
from softarm.drivers.rail.drive import Drive
from softarm.drivers.rail.dryve_link import EXCHANGE_ERRORS, LINK_ERRORS, describe_error
from softarm.drivers.rail.enabling import Enabling
from softarm.drivers.rail.feedback import Feedback
from softarm.drivers.rail.orders import Orders
from softarm.drivers.rail.pair import DaemonLine, HungUp, Reading, Report
from softarm.drivers.rail.settings import Settings

# How long a past failure is reported while the drive is not requested.
PAST_S = 2.0


class Problems:
    """Problems of the connection, of the drive's configuration, and the newest past failure."""

    def __init__(self, settings: Settings, clock: Callable[[], int]) -> None:
        self.connection: str | None
        self.configuration: str | None = None
        self._where, self._clock = f"{settings.host}:{settings.port}", clock
        self._past: tuple[int, str] | None = None
        self.connection = self._sentence("connect", "not connected yet", "wait a second")

    def connection_failed(self, error: Exception, connected: bool) -> None:
        """Report one of `dryve_link.LINK_ERRORS` until an exchange succeeds."""
        self.connection = self._sentence(*describe_error(error, connected, then="; connecting again"))

    def configured(self, difference: str | None) -> None:
        """Report a setting that the drive did not accept; None if it accepted all."""
        remedy = "set it on the drive's web page, or correct drivers.rail, then restart; the drive is not enabled"
        self.configuration = None if difference is None else self._sentence("configure", difference, remedy)

    def failed(self, command: str, problem: str, remedy: str) -> None:
        """Report a failure for a while, and as long as the drive is requested."""
        self._past = (self._clock(), self._sentence(command, problem, remedy))

    def clear_failure(self) -> None:
        """Forget the past failure."""
        self._past = None

    def current(self, feedback: Feedback | None, enable: bool) -> str | None:
        """Return the gravest problem as a sentence, or None; `enable` is whether the daemon requests operation."""
        if self.connection is not None or feedback is None:
            return self.connection
        if self.configuration is not None:
            return self.configuration
        if feedback.faults():
            remedy = "remove the cause, then acknowledge; an invalid boot state needs a power cycle"
            return self._sentence("read 6041h", f"the drive reports {', '.join(feedback.faults())}", remedy)
        if not feedback.remote:
            return self._sentence("read 6041h", "the enable input DI7 is low", "release the hardware e-stop")
        if self._past is None:
            return None
        age_s = (self._clock() - self._past[0]) / 1e9
        return self._past[1] if enable or age_s < PAST_S else None

    def _sentence(self, command: str, problem: str, remedy: str) -> str:
        # The format of `softarm.drivers.base.DeviceError`, which is slow to import.
        return f"{self._where}: {command}: {problem}; {remedy}"


# Interval of the polls while no set-point arrives.
POLL_S = 0.04
# First and longest pause between attempts to connect.
RETRY_S = (0.02, 1.0)
# How long a drive that may move is retried after the daemon has hung up.
SHUT_DOWN_S = 2.0
# Pause after a failed exchange in operation; a second failure in a row ends the connection.
SECOND_TRY_S = 0.005
# Requests of the homing status until a drive without an answer counts as one that does not report it.
HOMED_TRIES = 3
# Window of the reported cycle times.
CYCLES_NS = 1_000_000_000


class Master:
    """Control of the drive until the daemon hangs up. `Orders` decides how long the daemon's set-points are valid.

    The drive is enabled only while that is permitted: no event on the line, at the drive, in the daemon or in this
    process sets the cart in motion.
    """

    def __init__(
        self,
        settings: Settings,
        daemon: socket.socket,
        may_move: bool,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Prepare to control the drive, which `may_move` without a master; `daemon` is the end of the socket pair."""
        self._settings, self._clock = settings, clock
        self._daemon = DaemonLine(daemon)
        self._drive = Drive(settings, self._wait, self._attend)
        self._orders = Orders(settings.hold_s, settings.time_to_live_s)
        self._enabling = Enabling()
        self._problems = Problems(settings, clock)
        self._acknowledged: int | None = None
        self._reset_requested = False
        self._new_set_point = False
        self._out_of_operation = not may_move
        self._feedback: Feedback | None = None
        self._homed: bool | None = None
        self._unanswered = 0  # requests of the homing status
        self._reading: Reading | None = None
        # End and duration of each cycle of the last second, ns.
        self._cycles: list[tuple[int, int]] = []

    def run(self) -> None:
        """Control the drive until the daemon hangs up, then disable it, trying for `SHUT_DOWN_S`."""
        try:
            self._serve()
        except HungUp:
            self._shut_down()
        finally:
            self._close()

    def _serve(self) -> None:
        pause_s = RETRY_S[0]
        while True:
            try:
                self._drive.open()
                self._drive.bring_to_rest()
                self._problems.configured(self._drive.configure_velocity_mode())
                pause_s = RETRY_S[0]
                self._communicate()
            except LINK_ERRORS as error:
                self._problems.connection_failed(error, self._drive.connected)
                if self._orders.permitted_since_ns is not None:
                    self._problems.failed("communicate", f"the connection was lost ({error})", "disarm, then arm")
                self._forbid()
                self._close()
            self._attend(pause_s)
            # The pause grows only while the cart cannot be moving.
            if self._out_of_operation:
                pause_s = min(2 * pause_s, RETRY_S[1])

    def _shut_down(self) -> None:
        """Brake and disable the drive after the daemon has gone, reconnecting if necessary."""
        self._forbid()
        self._out_of_operation &= not self._drive.is_halting
        until_s = time.monotonic() + SHUT_DOWN_S
        while not self._out_of_operation and time.monotonic() < until_s:
            try:
                self._drive.open()
                self._drive.stop()
                self._drive.bring_to_rest()
                self._out_of_operation = True
            except LINK_ERRORS as error:
                self._problems.connection_failed(error, self._drive.connected)
                self._close()
                self._attend(RETRY_S[0])

    def _close(self) -> None:
        self._drive.close()
        self._feedback, self._enabling.last_step = None, None
        self._reset_requested = False  # by somebody who has not seen what the drive reports next

    # The daemon's side

    def _attend(self, seconds: float, line: socket.socket | None = None, events: int = 0, work: bool = False) -> bool:
        """Serve the daemon for a time, and return early when `line` is ready (True) or a cycle is due (`work`).

        While this waits for an answer of the drive on `line`, a stop that falls due is sent without delay.
        Raises HungUp.
        """
        until_s = time.monotonic() + seconds
        while True:
            if line is not None and self._stop_is_due():
                self._drive.stop()
            if self._daemon.report_due_in_s <= 0:
                self._report()
            left_s = 0.0 if work and (self._new_set_point or self._stop_is_due()) else until_s - time.monotonic()
            poll = select.poll()
            if not self._daemon.closed:
                poll.register(self._daemon, select.POLLIN)
            if line is not None:
                poll.register(line, events)
            ready = {number for number, _ in poll.poll(1e3 * max(0.0, min(left_s, self._due_in_s())))}
            if self._daemon.fileno() in ready:
                self._receive()
            if line is not None and line.fileno() in ready:
                return True
            if left_s <= 0:
                return False

    def _wait(self, line: socket.socket, events: int, seconds: float) -> bool:
        return self._attend(seconds, line, events)

    def _stop_is_due(self) -> bool:
        """Return whether the drive has a velocity that is no longer allowed."""
        return self._drive.target != 0 and self._velocity() == 0

    def _due_in_s(self) -> float:
        """Return the time until a report is due or the set-point in force expires."""
        due_s, now_ns = self._daemon.report_due_in_s, self._clock()
        if self._drive.target != 0 and self._orders.is_valid(now_ns):
            due_s = min(due_s, self._orders.valid_for_ns(now_ns) * 1e-9)
        return max(0.0, due_s)

    def _receive(self) -> None:
        """Accept all waiting set-points. Raises HungUp."""
        while (set_point := self._daemon.receive()) is not None:
            self._expire(set_point.t_ns)
            if self._orders.accept(set_point, self._clock()):
                self._problems.clear_failure()
                self._enabling.restart()
            self._reset_requested |= self._acknowledged not in (None, set_point.acknowledged)
            self._acknowledged, self._new_set_point = set_point.acknowledged, True

    def _expire(self, now_ns: int) -> None:
        if self._orders.expire(now_ns):
            stalled = f"no set-point for {self._settings.time_to_live_s:g} s, so the drive is disabled"
            self._problems.failed("write 60FFh", stalled, "find what delayed the control loop, then disarm and arm")

    def _report(self) -> None:
        problem = self._problems.current(self._feedback, self._orders.enable)
        self._daemon.send(Report(self._orders.number, self._out_of_operation, self._reading, problem))

    # The drive's side

    def _communicate(self) -> None:
        """Cycle until an exchange fails; in operation, until two fail in a row."""
        failed = False
        while True:
            self._attend(POLL_S, work=True)
            began_ns = self._clock()
            try:
                self._cycle()
            except EXCHANGE_ERRORS:
                if failed or not self._is_operating():
                    raise
                failed = True
                # The set-point may not have arrived: send the newest one again.
                self._new_set_point = True
                self._attend(SECOND_TRY_S)
            else:
                failed, self._problems.connection = False, None
            self._count_cycle(began_ns)

    def _cycle(self) -> None:
        """Send the set-point if it is new or none is valid, poll the drive, and send at most one controlword."""
        self._expire(self._clock())
        if self._new_set_point or not self._orders.is_valid(self._clock()):
            self._new_set_point = False
            if self._is_operating():
                self._drive.set_velocity(self._velocity())
            else:
                self._drive.target = 0
        feedback = self._drive.poll(self._clock)
        self._update_homed(feedback)
        self._judge(feedback)
        self._publish(feedback)
        self._lead(feedback)

    def _update_homed(self, feedback: Feedback) -> None:
        """Ask on a new connection, after a fall to switch-on disabled, and while the drive reports no zero.

        One missing answer says nothing: only a drive that never answers has no such report.
        """
        if not self._settings.asks_homed or not feedback.out_of_operation:
            return
        fell = feedback.state is DriveState.SWITCH_ON_DISABLED
        if self._feedback is None or (fell and self._feedback.state is not feedback.state):
            self._homed, self._unanswered = None, 0
        if self._homed is False or (self._homed is None and self._unanswered < HOMED_TRIES):
            self._homed = self._drive.read_homed()
            self._unanswered += self._homed is None

    def _is_operating(self) -> bool:
        return self._feedback is not None and self._feedback.state is DriveState.OPERATION_ENABLED

    def _velocity(self) -> int:
        """Return the velocity that may be sent now, in drive units."""
        return self._settings.velocity_units(self._orders.velocity_m_s(self._clock()))

    def _publish(self, feedback: Feedback) -> None:
        times_ns = sorted(duration_ns for _, duration_ns in self._cycles) or [0]
        configuration = self._problems.configuration
        self._feedback = feedback
        self._reading = Reading(
            t_ns=feedback.t_ns,
            position_m=feedback.position_m,
            velocity_m_s=feedback.velocity_m_s,
            enabled=feedback.state is DriveState.OPERATION_ENABLED,
            remote=feedback.remote,
            cycle_p50_ns=times_ns[len(times_ns) // 2],
            cycle_max_ns=times_ns[-1],
            faults=feedback.faults() + (() if configuration is None else (configuration,)),
            homed=self._homed,
        )
        self._out_of_operation = feedback.out_of_operation
        self._report()

    def _count_cycle(self, began_ns: int) -> None:
        now_ns = self._clock()
        recent = [cycle for cycle in self._cycles if cycle[0] > now_ns - CYCLES_NS]
        self._cycles = [*recent, (now_ns, now_ns - began_ns)]

    def _judge(self, feedback: Feedback) -> None:
        """Withdraw the permission to move when the drive does not follow."""
        since_ns = self._orders.permitted_since_ns
        if since_ns is None:
            return
        unfit = self._problems.configuration is not None or self._homed is False
        if not feedback.remote or feedback.faults() or unfit:
            self._forbid()
            return
        failure = self._enabling.failure(feedback, self._clock() - since_ns)
        if failure is not None:
            self._problems.failed(*failure)
            self._forbid()

    def _forbid(self) -> None:
        self._orders.forbid()
        self._enabling.restart()

    def _lead(self, feedback: Feedback) -> None:
        """Reset a fault on request, and send the next controlword once for each state that the drive shows."""
        self._reset_fault_on_request(feedback)
        step = self._enabling.next_step(feedback, enable=self._orders.permitted_since_ns is not None)
        if step is not None and step != self._enabling.last_step:
            link = self._drive.link
            if step.controlword == ControlWord.ENABLE_OPERATION:
                link.write(dryve.TARGET_VELOCITY, 0)
            # Until the next feedback the drive may be in operation.
            self._out_of_operation = False
            link.write(dryve.CONTROLWORD, step.controlword)
        self._enabling.last_step = step

    def _reset_fault_on_request(self, feedback: Feedback) -> None:
        """Reset the fault of a drive that is not requested."""
        requested, self._reset_requested = self._reset_requested, False
        if requested and feedback.state is DriveState.FAULT and feedback.remote and not self._orders.enable:
            self._drive.reset_fault()
