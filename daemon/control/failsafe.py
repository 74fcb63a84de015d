"""What may go wrong and what is done about it: one table, and the machine that carries it out.

The page docs/failsafe.md and the API's "why can I not arm" are made from this table.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

from softarm.daemon.control.records import ActiveEvent, EStop, Mode


class Response(IntEnum):
    """What an event does to an armed robot, mildest first."""

    WARN = 0  # shown and logged
    SOFT_STOP = 1  # brake, vent, hold the cart until the arm is still, then disarmed; a person arms again
    STOP = 2  # the same at once, drive off, latched until acknowledged


@dataclass(frozen=True, slots=True)
class Rule:
    """One line of the table."""

    response: Response
    blocks_arming: bool
    meaning: str
    remedy: str  # the next step
    clears: str = "when the cause is gone"


TABLE: dict[str, Rule] = {
    "stop_requested": Rule(
        Response.STOP,
        True,
        "somebody asked for an emergency stop",
        "make sure the arm is free, then POST /api/acknowledge",
        "at once; the latch stays",
    ),
    "remote_off": Rule(
        Response.STOP,
        True,
        "the drive's enable input (DI7) is low: the emergency-stop circuit is open",
        "release the emergency-stop button, then POST /api/acknowledge",
    ),
    "internal_error": Rule(
        Response.STOP,
        True,
        "the control loop itself failed",
        "keep the log, report the error, restart the service",
        "never: restart the service",
    ),
    "rail_fault": Rule(
        Response.STOP,
        True,
        "the drive reports a fault",
        "clear the cause at the drive, then POST /api/acknowledge",
    ),
    "regulator_fault": Rule(
        Response.STOP,
        True,
        "the pressure regulator reports a fault",
        "check its supply and wiring, then POST /api/acknowledge",
    ),
    "rail_outside": Rule(
        Response.STOP,
        True,
        "the cart is outside the rail limits",
        "with the drive off, push the cart back inside by hand, then POST /api/acknowledge",
    ),
    "rail_astray": Rule(
        Response.STOP,
        True,
        "the cart does not do what the drive was told",
        "see that nothing holds the cart and that the belt and the drive's mode are right, then POST /api/acknowledge",
    ),
    "rail_disagrees": Rule(
        Response.STOP,
        True,
        "the axis and motion capture disagree on where the cart is",
        "end the daemon and home the axis (`softarm rail home`), find its middle (`softarm rail centre`), or "
        "re-calibrate the motion capture frame, then POST /api/acknowledge",
    ),
    "pressure_outside": Rule(
        Response.STOP,
        True,
        "the measured pressure is outside its limits",
        "check the supply and the regulator's range, then POST /api/acknowledge",
    ),
    "not_finite": Rule(
        Response.STOP,
        True,
        "a sensor sent something that is not a number",
        "look at the named device's log, then POST /api/acknowledge",
    ),
    "mocap_missing": Rule(
        Response.SOFT_STOP,
        True,
        "no usable motion capture frame has come",
        "start the bridge; check that cart and tip are tracked",
    ),
    "mocap_stale": Rule(
        Response.SOFT_STOP,
        True,
        "the newest usable motion capture frame is too old",
        "check the bridge, and that cart and tip are in view",
    ),
    "mocap_clock": Rule(
        Response.SOFT_STOP,
        True,
        "motion capture frames are stamped in the future",
        "stamp frames with CLOCK_MONOTONIC of this host; check the bridge's clock sync",
    ),
    "mocap_two_sources": Rule(
        Response.SOFT_STOP,
        True,
        "motion capture frames are not counted up: two bridges publish at once",
        "stop one of them, or give it another drivers.mocap.key",
    ),
    "mocap_height": Rule(
        Response.SOFT_STOP,
        True,
        "motion capture shows the cart at a wrong height",
        "calibrate the frame: z is 0 at the floor; check which marker set is called cart",
    ),
    "mocap_reach": Rule(
        Response.SOFT_STOP,
        True,
        "motion capture shows the tip where the arm cannot be",
        "check the frame's scale and axes, and which marker set is called link5",
    ),
    "mocap_jump": Rule(
        Response.SOFT_STOP,
        True,
        "motion capture shows jumps that no body makes",
        "look for swapped marker sets, reflections, or a second bridge",
    ),
    "mocap_frozen": Rule(
        Response.SOFT_STOP,
        True,
        "motion capture repeats a pose of something that moves",
        "restart the bridge: it publishes poses that it no longer sees",
    ),
    "mocap_mirrored": Rule(
        Response.SOFT_STOP,
        False,
        "motion capture shows the cart moving the other way",
        "turn the frame's y axis round, or the axis's (drivers.rail.reversed): `softarm rail centre` tells more",
    ),
    "mocap_too_late": Rule(
        Response.SOFT_STOP,
        False,
        "motion capture shows where the robot was too long ago",
        "speed up cameras, tracking and network, or raise failsafe.mocap_late_max_s",
    ),
    "mocap_bridged": Rule(
        Response.WARN,
        False,
        "the cameras see nothing, and what they saw last is carried on by a model",
        "check the bridge, and that cart and tip are in view",
    ),
    "mocap_late": Rule(
        Response.WARN,
        False,
        "motion capture is late",
        "speed up cameras, tracking and network, or train policies for it (softarm diagnose measures it)",
    ),
    "mocap_outlier": Rule(
        Response.WARN,
        False,
        "a motion capture frame that cannot be true was left out",
        "nothing for one by itself; the log has it",
    ),
    "mocap_settling": Rule(
        Response.WARN,
        True,
        "motion capture has only just come up",
        "wait for it",
    ),
    "mocap_body_lost": Rule(
        Response.WARN,
        False,
        "a marker set is not tracked",
        "check its markers and the cameras",
    ),
    "pressure_missing": Rule(
        Response.SOFT_STOP,
        True,
        "the pressure regulator has not answered",
        "check its cable and port",
    ),
    "pressure_stale": Rule(
        Response.SOFT_STOP,
        True,
        "the pressure reading is too old",
        "check the regulator's cable and port",
    ),
    "regulator_vented": Rule(
        Response.SOFT_STOP,
        False,
        "the regulator vented by itself: commands did not reach it in time",
        "check the cable and the load of this computer, then arm again",
    ),
    "rail_missing": Rule(
        Response.SOFT_STOP,
        True,
        "the axis has not answered",
        "check the drive's address and its gateway",
    ),
    "rail_stale": Rule(
        Response.SOFT_STOP,
        True,
        "the axis reading is too old",
        "check the network to the drive",
    ),
    "rail_not_homed": Rule(
        Response.SOFT_STOP,
        True,
        "the drive says that it is not homed: where it says the cart is means nothing",
        "end the daemon, then `softarm rail home`",
    ),
    "rail_link_lost": Rule(
        Response.SOFT_STOP,
        True,
        "the process that leads the drive ended or hung; a new one stops the drive first",
        "look at the service's log for why, then arm again",
    ),
    "rail_too_slow": Rule(
        Response.SOFT_STOP,
        True,
        "the drive answers so slowly that set-points reach it later than the safety filter counts on",
        "look for what slows the network or the drive, or measure limits.rail.latency_s anew",
    ),
    "rail_slow": Rule(
        Response.WARN,
        False,
        "a cycle of questions and answers with the drive took longer than a tick",
        "look for what else uses its network; limits.rail.latency_s has to cover this",
    ),
    "rail_disabled": Rule(
        Response.SOFT_STOP,
        False,
        "the drive switched itself off",
        "look at the drive's status, then arm again",
    ),
    "rail_overrun": Rule(
        Response.WARN,
        False,
        "the cart passed its soft limit by more than it can on the robot that limits.rail describes",
        "lower limits.rail.braking_m_s2 or raise latency_s: `softarm check CONFIG --logs FOLDER` says to what",
    ),
    "policy_fault": Rule(
        Response.SOFT_STOP,
        False,
        "the policy failed",
        "choose another with PUT /api/policy, or mend it",
        "at once",
    ),
    "arming_timeout": Rule(
        Response.SOFT_STOP,
        False,
        "drive or regulator did not take the arm command in time",
        "look at their status, then arm again",
        "at once",
    ),
    "ticks_missed": Rule(
        Response.SOFT_STOP,
        False,
        "the control loop fell behind",
        "take load off this computer, then arm again",
        "at once",
    ),
    "tick_late": Rule(
        Response.WARN,
        False,
        "a control tick was skipped",
        "take load off this computer",
        "at once",
    ),
    "not_recorded": Rule(
        Response.WARN,
        True,
        "no log is being written",
        "mend that and recording goes on by itself, or set recorder.arm_without_log: true",
    ),
    "stop_not_kept": Rule(
        Response.WARN,
        True,
        "an emergency stop would not outlive a restart of the daemon",
        "mend that; the file is tried again every second",
    ),
    "recorder_dropping": Rule(
        Response.WARN,
        False,
        "the recorder lost messages",
        "check the disk's speed and free space; the service's log says what could not be written",
    ),
}


UNHEARD = ("rail_stale", "rail_link_lost")  # of an axis that was heard once, or nothing would be armed


@dataclass(frozen=True, slots=True)
class Event:
    """Something of the table that holds in this tick, with its numbers."""

    name: str
    detail: str = ""

    @property
    def rule(self) -> Rule:
        """Its line in the table."""
        return TABLE[self.name]

    @property
    def text(self) -> str:
        """What is wrong and what to do, in one sentence."""
        detail = f" ({self.detail})" if self.detail else ""
        return f"{self.rule.meaning}{detail}: {self.rule.remedy}"

    def active(self) -> ActiveEvent:
        """As the snapshot shows it."""
        return ActiveEvent(self.name, self.rule.response.name.lower(), self.text)


class ModeMachine:
    """The five modes and the latch of the emergency stop. Pure: time is counted in ticks."""

    def __init__(self, arming_ticks: int, braking_ticks: int, settling_ticks: int) -> None:
        self._arming_ticks = arming_ticks
        self._braking_ticks = braking_ticks  # after which a soft stop ends if the cart has never come to rest
        self._settling_ticks = settling_ticks  # after which it ends even if the arm still swings
        self._ticks = 0  # in the present mode
        self._rested = False  # in the present mode
        self.mode = Mode.DISARMED
        self.estop = EStop.CLEAR
        self.last_stop: str | None = None
        self.stops = 0  # so far, soft ones included; each has set `last_stop`

    def _go(self, mode: Mode) -> None:
        self.mode = mode
        self._ticks, self._rested = 0, False

    def _leave(self, mode: Mode, why: str) -> None:
        self.last_stop, self.stops = why, self.stops + 1
        self._go(mode)

    def _causes(self, events: Iterable[Event]) -> tuple[Event, ...]:
        """What of a tick's events stops the arm, or keeps it stopped; of one that is off, a person's stop alone."""
        stops = tuple(event for event in events if event.rule.response is Response.STOP)
        asked_for = any(event.name == "stop_requested" for event in stops)
        return stops if asked_for or self.mode is not Mode.DISARMED else ()

    def update(self, events: Iterable[Event], *, devices_armed: bool, at_rest: bool, still: bool) -> None:
        """Answer this tick's events; the severest wins. `at_rest` is the cart, `still` the arm.

        A cart whose axis is not heard is held by nobody: a soft stop does not wait for it.
        """
        self._ticks += 1
        self._rested |= at_rest
        events = tuple(events)
        causes = self._causes(events)
        if causes:
            if self.mode is not Mode.STOPPED:
                self._leave(Mode.STOPPED, causes[0].text)
            self.estop = EStop.ENGAGED
        elif self.mode is Mode.STOPPED:
            self.estop = EStop.LATCHED
        else:
            self._soft(events, devices_armed, (at_rest and still) or any(e.name in UNHEARD for e in events))

    def _soft(self, events: tuple[Event, ...], devices_armed: bool, over: bool) -> None:
        softs = [e for e in events if e.rule.response is Response.SOFT_STOP]
        if self.mode is Mode.ARMING and not softs and not devices_armed and self._ticks > self._arming_ticks:
            softs = [Event("arming_timeout", f"{self._ticks} ticks")]
        if softs and self.mode in (Mode.ARMING, Mode.ARMED):
            self._leave(Mode.STOPPING, softs[0].text)
        elif self.mode is Mode.ARMING and devices_armed:
            self._go(Mode.ARMED)
        elif self.mode is Mode.STOPPING and (over or self._ticks > self._stopping_ticks):
            self._go(Mode.DISARMED)

    @property
    def _stopping_ticks(self) -> int:
        """A soft stop lasts no longer."""
        return self._settling_ticks if self._rested else self._braking_ticks

    def arm(self, events: Sequence[Event]) -> tuple[str, ...]:
        """Begin to arm, under this tick's events; returns why not."""
        if self.mode in (Mode.ARMED, Mode.ARMING) and not self._causes(events):
            return ()
        if refusals := self.refusals(events):
            return refusals
        self._go(Mode.ARMING)
        return ()

    def disarm(self, why: str) -> None:
        """Brake, vent and switch off; always taken."""
        if self.mode in (Mode.ARMED, Mode.ARMING):
            self._leave(Mode.STOPPING, why)

    def acknowledge(self, events: Sequence[Event]) -> tuple[str, ...]:
        """Free the latch if none of this tick's events is a cause of it; returns why not.

        The caller sends a fault reset to the devices either way.
        """
        if causes := self._causes(events):
            return (
                *(f"the cause is still there: {cause.text}" for cause in causes),
                "a fault reset was sent to the devices: acknowledge again once the cause is gone",
            )
        if self.estop is not EStop.CLEAR:
            self.estop = EStop.CLEAR
            self._go(Mode.DISARMED)
        return ()

    def latch(self, why: str) -> None:
        """Stand as the daemon before this one ended: stopped, until that is acknowledged."""
        self._go(Mode.STOPPED)
        self.estop, self.last_stop = EStop.LATCHED, why

    def resume(self, mode: Mode, estop: EStop, last_stop: str | None) -> None:
        """Stand where a recorded tick left off."""
        if mode is not self.mode:
            self._go(mode)
        self.estop, self.last_stop = estop, last_stop

    def refusals(self, events: Iterable[Event]) -> tuple[str, ...]:
        """Why arming would be refused now."""
        reasons = [e.text for e in events if e.rule.blocks_arming]
        if self.estop is not EStop.CLEAR:
            reasons.append("the emergency stop is latched: POST /api/acknowledge first")
        if self.mode is Mode.STOPPING:
            reasons.append("the arm is still stopping: try again when it hangs still")
        return tuple(reasons)


LATCH = """\
## The latch outlives the daemon

What stopped the robot is kept in a file. A daemon that is started again, after a crash, a kill or a restart of the
service, begins `stopped` and latched, with the old reason, until `POST /api/acknowledge`. A file that cannot be read
counts as a stop.

The file, `stop-HOST-PORT.json`, is named after the axis (`drivers.rail`): it is the robot's, whichever configuration
is run. It lies in the service's `/var/lib/softarm`, otherwise in `recorder.directory`; `softarm check` names it. A
robot that is simulated in the daemon's own process begins anew with it, and keeps none.

It is written by a thread of its own once the tick that stopped has ended: a few milliseconds after the stop is
answered it outlives a kill, and once the disk has it, a power cut. It is there before anything can stop and is
overwritten in place, which a full disk cannot refuse. While writing fails, or takes longer than 1 s, arming is refused
(`stop_not_kept`). A daemon that ends with nothing stopped removes it.
"""


def page() -> str:
    """docs/failsafe.md, made from the table: `python -m softarm.daemon.control.failsafe > docs/failsafe.md`."""
    answers = {
        Response.WARN: "shown and logged, nothing stops",
        Response.SOFT_STOP: "brake, vent and hold the cart until the arm is still, then disarmed; a person arms again",
        Response.STOP: "drive off and vented at once, latched until `POST /api/acknowledge`",
    }
    lines = ["# What may go wrong, and what is done about it", ""]
    lines += [
        "Made from the table in `daemon/control/failsafe.py`; edit that, then run",
        "`python -m softarm.daemon.control.failsafe`.",
        "",
    ]
    for response in sorted(answers, reverse=True):
        lines += [f"## {response.name.lower().replace('_', ' ')}: {answers[response]}", ""]
        lines += ["| event | what is wrong | next step | refuses arming | clears |", "|---|---|---|---|---|"]
        lines += [
            f"| `{name}` | {rule.meaning} | {rule.remedy} | {'yes' if rule.blocks_arming else 'no'} | {rule.clears} |"
            for name, rule in TABLE.items()
            if rule.response is response
        ]
        lines.append("")
    lines.append(LATCH)
    return "\n".join(lines)


if __name__ == "__main__":
    print(page(), end="")
