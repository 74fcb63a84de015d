"""Mode machine of the daemon: disarmed, arming, armed, stopping, stopped, and the latch of the emergency stop."""

from collections.abc import Sequence

from softarm.daemon.control.failsafe import ACKNOWLEDGE, Event, Response
from softarm.daemon.control.records import EStop, Mode

# Events after which nothing holds the cart: a soft stop does not wait for it.
AXIS_LOST = ("rail_stale", "rail_link_lost")


class ModeMachine:
    """The five modes and the latch of the emergency stop. Pure: it counts time in ticks."""

    def __init__(self, arming_ticks: int, braking_ticks: int, settling_ticks: int) -> None:
        """Create a disarmed machine.

        Args:
            arming_ticks: Longest time that arming may take.
            braking_ticks: A soft stop ends after this time if the cart never comes to rest.
            settling_ticks: A soft stop ends after this time even if the arm still swings.
        """
        self._arming_ticks = arming_ticks
        self._braking_ticks = braking_ticks
        self._settling_ticks = settling_ticks
        self._ticks = 0  # in the current mode
        self._rested = False  # the cart has been at rest in the current mode
        self.mode = Mode.DISARMED
        self.estop = EStop.CLEAR
        self.last_stop: str | None = None
        self.stops = 0  # soft stops included; each has set `last_stop`

    def _go(self, mode: Mode) -> None:
        self.mode = mode
        self._ticks, self._rested = 0, False

    def _leave(self, mode: Mode, why: str) -> None:
        self.last_stop, self.stops = why, self.stops + 1
        self._go(mode)

    def _causes(self, events: Sequence[Event]) -> tuple[Event, ...]:
        """Return the events that stop the arm or keep it stopped; while disarmed only a requested stop counts."""
        stops = tuple(event for event in events if event.rule.response is Response.STOP)
        asked_for = any(event.name == "stop_requested" for event in stops)
        return stops if asked_for or self.mode is not Mode.DISARMED else ()

    def update(self, events: Sequence[Event], *, devices_armed: bool, at_rest: bool, still: bool) -> None:
        """Change the mode by this tick's events; the severest response wins.

        `devices_armed` is about drive and regulator, `at_rest` about the cart, `still` about the arm.
        """
        self._ticks += 1
        self._rested |= at_rest
        causes = self._causes(events)
        if causes:
            if self.mode is not Mode.STOPPED:
                self._leave(Mode.STOPPED, causes[0].text)
            self.estop = EStop.ENGAGED
        elif self.mode is Mode.STOPPED:
            self.estop = EStop.LATCHED
        else:
            self._soft(events, devices_armed, (at_rest and still) or any(e.name in AXIS_LOST for e in events))

    def _soft(self, events: Sequence[Event], devices_armed: bool, over: bool) -> None:
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
        """Return the longest time that a soft stop may still last."""
        return self._settling_ticks if self._rested else self._braking_ticks

    def arm(self, events: Sequence[Event]) -> tuple[str, ...]:
        """Begin to arm; return the refusals, or nothing if arming began."""
        if self.mode in (Mode.ARMED, Mode.ARMING) and not self._causes(events):
            return ()
        if refusals := self.refusals(events):
            return refusals
        self._go(Mode.ARMING)
        return ()

    def disarm(self, why: str) -> None:
        """Brake, vent and switch off; never refused."""
        if self.mode in (Mode.ARMED, Mode.ARMING):
            self._leave(Mode.STOPPING, why)

    def acknowledge(self, events: Sequence[Event]) -> tuple[str, ...]:
        """Release the latch unless a cause is still active; return the refusals.

        The caller sends a fault reset to the devices in both cases.
        """
        if causes := self._causes(events):
            return (
                *(f"the cause is still active: {cause.text}" for cause in causes),
                "a fault reset was sent to the devices: acknowledge again once the cause is gone",
            )
        if self.estop is not EStop.CLEAR:
            self.estop = EStop.CLEAR
            self._go(Mode.DISARMED)
        return ()

    def latch(self, why: str) -> None:
        """Start stopped and latched: the previous daemon ended in an emergency stop."""
        self._go(Mode.STOPPED)
        self.estop, self.last_stop = EStop.LATCHED, why

    def resume(self, mode: Mode, estop: EStop, last_stop: str | None) -> None:
        """Take over the state of a recorded tick."""
        if mode is not self.mode:
            self._go(mode)
        self.estop, self.last_stop = estop, last_stop

    def refusals(self, events: Sequence[Event]) -> tuple[str, ...]:
        """Return the reasons for which arming would be refused now."""
        reasons = [e.text for e in events if e.rule.blocks_arming]
        if self.estop is not EStop.CLEAR:
            reasons.append(f"the emergency stop is latched: make sure that the arm is free, {ACKNOWLEDGE}")
        if self.mode is Mode.STOPPING:
            reasons.append("the arm is still stopping: try again when it hangs still")
        return tuple(reasons)
