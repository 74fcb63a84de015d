"""Failsafe table: every event with its response, how it clears and what the operator does.

The page docs/reference/failsafe.md and the API's arming refusals are generated from the table.
"""

from dataclasses import dataclass
from enum import IntEnum

from softarm.daemon.control.records import ActiveEvent


class Response(IntEnum):
    """Response of an armed robot to an event, mildest first."""

    WARN = 0  # shown and logged
    SOFT_STOP = 1  # brake, vent, hold the cart until the arm is still, then disarm; a person arms again
    STOP = 2  # vent and switch the drive off at once; latched until acknowledged


USUALLY = "when the cause is gone"


@dataclass(frozen=True, slots=True)
class Rule:
    """One line of the failsafe table."""

    response: Response
    blocks_arming: bool
    meaning: str
    remedy: str  # the next step
    clears: str


def _stop(meaning: str, remedy: str, clears: str = USUALLY) -> Rule:
    return Rule(Response.STOP, True, meaning, remedy, clears)


def _soft_stop(meaning: str, remedy: str, *, blocks_arming: bool = True, clears: str = USUALLY) -> Rule:
    return Rule(Response.SOFT_STOP, blocks_arming, meaning, remedy, clears)


def _warning(meaning: str, remedy: str, *, blocks_arming: bool = False, clears: str = USUALLY) -> Rule:
    return Rule(Response.WARN, blocks_arming, meaning, remedy, clears)


# What an operator does after an emergency stop, once the cause is gone.
ACKNOWLEDGE = "then run `softarm acknowledge` or press Acknowledge on the dashboard"

TABLE: dict[str, Rule] = {
    "stop_requested": _stop(
        "an emergency stop was requested",
        f"make sure that the arm is free, {ACKNOWLEDGE}",
        clears="at once; the latch stays",
    ),
    "remote_off": _stop(
        "the emergency-stop circuit is open: the drive's enable input (DI7) is low",
        f"release the emergency-stop button, {ACKNOWLEDGE}",
    ),
    "internal_error": _stop(
        "the control loop failed",
        "keep the log, report the error and restart the service",
        clears="never: restart the service",
    ),
    "rail_fault": _stop("the drive reports a fault", f"clear the cause at the drive, {ACKNOWLEDGE}"),
    "regulator_fault": _stop("the pressure regulator reports a fault", f"check its supply and wiring, {ACKNOWLEDGE}"),
    "rail_outside": _stop(
        "the cart is outside the rail limits", f"with the drive off, push the cart back inside by hand, {ACKNOWLEDGE}"
    ),
    "rail_astray": _stop(
        "the cart does not follow the drive's set-points",
        f"check that nothing blocks the cart, and check the belt and the drive's operating mode, {ACKNOWLEDGE}",
    ),
    "rail_disagrees": _stop(
        "the axis and motion capture report different cart positions",
        "end the daemon and home the axis (`softarm rail home`), find its middle (`softarm rail centre`) or "
        f"calibrate the motion capture frame again, {ACKNOWLEDGE}",
    ),
    "pressure_outside": _stop(
        "the measured pressure is outside its limits", f"check the supply and the regulator's range, {ACKNOWLEDGE}"
    ),
    "not_finite": _stop("a sensor sent NaN or infinity", f"check the log of the named device, {ACKNOWLEDGE}"),
    "mocap_missing": _soft_stop(
        "no usable motion capture frame has arrived", "start the bridge; check that cart and tip are tracked"
    ),
    "mocap_stale": _soft_stop(
        "motion capture has stopped: the newest usable frame is too old",
        "check the bridge, and check that the cameras see cart and tip",
    ),
    "mocap_clock": _soft_stop(
        "motion capture frames are stamped in the future",
        "stamp frames with this computer's CLOCK_MONOTONIC (docs/reference/wires.md)",
    ),
    "mocap_two_sources": _soft_stop(
        "the sequence number of motion capture frames does not rise: two bridges publish at once",
        "stop one bridge, or give it another drivers.mocap.key",
    ),
    "mocap_height": _soft_stop(
        "motion capture reports the cart at a wrong height",
        "calibrate the frame: z is 0 at the floor; check which marker set is named cart",
    ),
    "mocap_reach": _soft_stop(
        "motion capture reports the tip where the arm cannot reach",
        "check the frame's scale and axes; check which marker set is named link5",
    ),
    "mocap_jump": _soft_stop(
        "motion capture poses jump farther than a body can move",
        "check for swapped marker sets, reflections or a second bridge",
    ),
    "mocap_frozen": _soft_stop(
        "motion capture repeats the pose of a moving body",
        "restart the bridge: it publishes poses that the cameras no longer see",
    ),
    "mocap_mirrored": _soft_stop(
        "motion capture and the axis report opposite directions",
        "reverse the y axis of the motion capture frame or of the drive (drivers.rail.reversed); `softarm "
        "rail centre` shows which",
        blocks_arming=False,
    ),
    "mocap_too_late": _soft_stop(
        "motion capture latency is too high",
        "speed up cameras, tracking and network, or raise failsafe.mocap_late_max_s",
        blocks_arming=False,
    ),
    "mocap_bridged": _warning(
        "motion capture dropout: the pose is estimated", "check the bridge, and check that the cameras see cart and tip"
    ),
    "mocap_late": _warning(
        "motion capture latency is high",
        "speed up cameras, tracking and network, or train policies for it (`softarm diagnose` measures it)",
    ),
    "mocap_outlier": _warning(
        "an implausible motion capture frame was left out", "no action for a single frame; the log has it"
    ),
    "mocap_settling": _warning(
        "motion capture has just started", "wait until enough frames have arrived", blocks_arming=True
    ),
    "mocap_body_lost": _warning("a marker set is not tracked", "check its markers and the cameras"),
    "pressure_missing": _soft_stop("the pressure regulator has not answered", "check its cable and port"),
    "pressure_stale": _soft_stop("the pressure reading is too old", "check the regulator's cable and port"),
    "regulator_vented": _soft_stop(
        "the regulator vented by itself: commands did not arrive in time",
        "check the cable and the load of this computer, then arm again",
        blocks_arming=False,
    ),
    "rail_missing": _soft_stop("the axis has not answered", "check the drive's address and its gateway"),
    "rail_stale": _soft_stop("the axis reading is too old", "check the network to the drive"),
    "rail_not_homed": _soft_stop(
        "the drive is not homed: its position has no meaning", "end the daemon, then run `softarm rail home`"
    ),
    "rail_link_lost": _soft_stop(
        "the process that controls the drive ended or hung; a new one stops the drive first",
        "find the reason in the service's log, then arm again",
    ),
    "rail_too_slow": _soft_stop(
        "the drive answers too slowly: set-points arrive later than the safety filter assumes",
        "find what slows the network or the drive, or measure limits.rail.latency_s again",
    ),
    "rail_slow": _warning(
        "an exchange with the drive took longer than a tick",
        "find other users of its network; limits.rail.latency_s must cover this delay",
    ),
    "rail_disabled": _soft_stop(
        "the drive switched itself off", "check the drive's status, then arm again", blocks_arming=False
    ),
    "rail_overrun": _warning(
        "the cart passed its soft limit by more than limits.rail allows for",
        "lower limits.rail.braking_m_s2 or raise latency_s: `softarm check CONFIG --logs FOLDER` shows the values",
    ),
    "policy_fault": _soft_stop(
        "the policy failed",
        "choose another policy (`softarm policy use NAME`, or Policies on the dashboard) or repair it",
        blocks_arming=False,
        clears="at once",
    ),
    "arming_timeout": _soft_stop(
        "the drive or the regulator did not accept the arm command in time",
        "check their status, then arm again",
        blocks_arming=False,
        clears="at once",
    ),
    "ticks_missed": _soft_stop(
        "the control loop fell behind",
        "reduce the load of this computer, then arm again",
        blocks_arming=False,
        clears="at once",
    ),
    "tick_late": _warning("a control tick was skipped", "reduce the load of this computer", clears="at once"),
    "not_recorded": _warning(
        "no log is being written",
        "remove the cause (recording resumes by itself), or set recorder.arm_without_log: true",
        blocks_arming=True,
    ),
    "stop_not_kept": _warning(
        "an emergency stop would be lost if the daemon restarted",
        "remove the cause; the file is written again every second",
        blocks_arming=True,
    ),
    "recorder_dropping": _warning(
        "the recorder lost messages", "check the disk's speed and free space; the service's log names the messages"
    ),
}


@dataclass(frozen=True, slots=True)
class Event:
    """An event of the table that is active in this tick, with its numbers."""

    name: str
    detail: str = ""

    @property
    def rule(self) -> Rule:
        """Return the event's line in the table."""
        return TABLE[self.name]

    @property
    def text(self) -> str:
        """Return the cause, its numbers and the next step."""
        detail = f" ({self.detail})" if self.detail else ""
        return f"{self.rule.meaning}{detail}: {self.rule.remedy}"

    def active(self) -> ActiveEvent:
        """Return the event as the snapshot shows it."""
        return ActiveEvent(self.name, self.rule.response.name.lower(), self.text)


def markdown() -> str:
    """Return the tables of docs/reference/failsafe.md; `python -m softarm.daemon.control.failsafe` prints them."""
    lines: list[str] = []
    for response in sorted(Response, reverse=True):
        lines += [f"## {response.name.capitalize().replace('_', ' ')}", ""]
        lines += ["| event | cause | next step | refuses arming |", "|---|---|---|---|"]
        lines += [_row(name, rule) for name, rule in TABLE.items() if rule.response is response]
        lines.append("")
    return "\n".join(lines)


def _row(name: str, rule: Rule) -> str:
    """Return an event's line of the page."""
    step = rule.remedy.replace(ACKNOWLEDGE, "then acknowledge")
    if rule.clears != USUALLY:
        step += f" (clears: {rule.clears.partition(':')[0]})"
    return f"| `{name}` | {rule.meaning} | {step} | {'yes' if rule.blocks_arming else 'no'} |"


if __name__ == "__main__":
    print(markdown(), end="")
