"""The failsafe table and the mode machine, every mode against every response."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softarm.daemon.control.failsafe import ACKNOWLEDGE, TABLE, Event, Response, markdown
from softarm.daemon.control.modes import ModeMachine
from softarm.daemon.control.records import EStop, Mode


def machine(mode: Mode) -> ModeMachine:
    """Return a machine brought into a mode by real events."""
    made = ModeMachine(arming_ticks=3, braking_ticks=5, settling_ticks=9)
    assert (made.mode, made.estop) == (Mode.DISARMED, EStop.CLEAR)
    if mode is Mode.DISARMED:
        return made
    assert made.arm(()) == ()
    if mode is Mode.ARMING:
        return made
    step(made, devices_armed=True)
    if mode is Mode.STOPPING:
        made.disarm("by test")
    elif mode is Mode.STOPPED:
        step(made, "stop_requested")
    assert made.mode is mode
    return made


def step(
    made: ModeMachine, *names: str, devices_armed: bool = False, at_rest: bool = False, still: bool = False
) -> None:
    made.update([Event(name) for name in names], devices_armed=devices_armed, at_rest=at_rest, still=still)


def names(response: Response) -> list[str]:
    return [name for name, rule in TABLE.items() if rule.response is response]


# Response, and whether the event refuses to arm.
EVENTS = {
    (Response.STOP, True): """
        internal_error not_finite pressure_outside rail_astray rail_disagrees rail_fault rail_outside regulator_fault
        remote_off stop_requested""",
    (Response.SOFT_STOP, True): """
        mocap_clock mocap_frozen mocap_height mocap_jump mocap_missing mocap_reach mocap_stale mocap_two_sources
        pressure_missing pressure_stale rail_link_lost rail_missing rail_not_homed rail_stale rail_too_slow""",
    (Response.SOFT_STOP, False): """
        arming_timeout mocap_mirrored mocap_too_late policy_fault rail_disabled regulator_vented ticks_missed""",
    (Response.WARN, True): "mocap_settling not_recorded stop_not_kept",
    (Response.WARN, False): """
        mocap_body_lost mocap_bridged mocap_late mocap_outlier rail_overrun rail_slow recorder_dropping tick_late""",
}


def test_every_event_has_its_response_and_refuses_to_arm_or_not():
    assert {name: (rule.response, rule.blocks_arming) for name, rule in TABLE.items()} == {
        name: key for key, some in EVENTS.items() for name in some.split()
    }


@pytest.mark.parametrize("name", names(Response.STOP))
@pytest.mark.parametrize("mode", [Mode.ARMING, Mode.ARMED, Mode.STOPPING])
def test_a_stop_ends_every_active_mode_and_latches(mode, name):
    made = machine(mode)
    step(made, name)
    assert made.mode is Mode.STOPPED
    assert made.estop is EStop.ENGAGED
    step(made, "remote_off")
    assert made.last_stop == Event(name).text  # the first cause
    step(made)
    assert made.estop is EStop.LATCHED
    step(made, devices_armed=True, at_rest=True, still=True)
    assert made.mode is Mode.STOPPED


def test_each_stop_and_soft_stop_is_counted_once():
    made = ModeMachine(3, 5, 9)
    assert made.stops == 0
    made.latch("a stop of the daemon before this one")
    assert made.stops == 0
    made.resume(Mode.ARMED, EStop.CLEAR, None)
    for event in ("mocap_stale", "rail_fault", "rail_fault"):
        step(made, event)
    assert made.stops == 2
    made.resume(Mode.ARMED, EStop.CLEAR, None)
    made.disarm("by hand")
    made.disarm("by hand")
    assert made.stops == 3


@pytest.mark.parametrize("name", names(Response.SOFT_STOP))
@pytest.mark.parametrize("mode", [Mode.ARMING, Mode.ARMED])
def test_a_soft_stop_brakes_then_disarms_without_a_latch(mode, name):
    made = machine(mode)
    step(made, name, devices_armed=True)
    assert made.mode is Mode.STOPPING
    step(made)
    assert made.mode is Mode.STOPPING
    step(made, still=True)  # while it turns round the tip is slow, too
    assert made.mode is Mode.STOPPING
    step(made, at_rest=True)
    assert made.mode is Mode.STOPPING
    step(made, at_rest=True, still=True)
    assert made.mode is Mode.DISARMED
    assert made.estop is EStop.CLEAR


@pytest.mark.parametrize("name", names(Response.WARN))
def test_a_warning_changes_nothing(name):
    made = machine(Mode.ARMED)
    step(made, name, devices_armed=True)
    assert made.mode is Mode.ARMED


@pytest.mark.parametrize("name", [n for n in TABLE if n != "stop_requested"])
def test_nothing_but_a_requested_stop_latches_a_disarmed_arm(name):
    made = machine(Mode.DISARMED)
    step(made, name)
    assert made.mode is Mode.DISARMED
    assert made.estop is EStop.CLEAR


@pytest.mark.parametrize("others", [[], *([name] for name in names(Response.STOP) if name != "stop_requested")])
@pytest.mark.parametrize("mode", list(Mode))
def test_a_requested_stop_latches_from_every_mode_whatever_else_is_wrong_before_it(mode, others):
    made = machine(mode)
    step(made, *others, "stop_requested")
    assert (made.mode, made.estop) == (Mode.STOPPED, EStop.ENGAGED)


some_events = st.lists(st.sampled_from(list(TABLE)), max_size=5, unique=True)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(Mode), some_events.flatmap(lambda some: st.tuples(st.just(some), st.permutations(some))))
def test_the_order_of_events_changes_neither_mode_nor_latch(mode, orders):
    one, other = machine(mode), machine(mode)
    step(one, *orders[0])
    step(other, *orders[1])
    assert (one.mode, one.estop) == (other.mode, other.estop)


@pytest.mark.parametrize(("accepted", "mode"), [(False, Mode.STOPPING), (True, Mode.ARMED)])
def test_arming_waits_for_the_devices_and_gives_up_in_time(accepted, mode):
    made = machine(Mode.ARMING)
    for _ in range(3):
        step(made)
        assert made.mode is Mode.ARMING
    step(made, devices_armed=accepted)
    assert made.mode is mode
    assert accepted or "did not accept the arm command" in made.last_stop


def test_arming_ended_by_another_event_is_no_timeout():
    made = machine(Mode.ARMING)
    for _ in range(3):
        step(made)
    step(made, "mocap_stale")
    assert made.last_stop == Event("mocap_stale").text


def test_the_time_for_arming_is_over_once_the_arm_is_armed():
    """A device that switches itself off later is a separate event."""
    made = machine(Mode.ARMED)
    for _ in range(10):
        step(made, devices_armed=False)
    assert made.mode is Mode.ARMED


@pytest.mark.parametrize("mode", [Mode.ARMING, Mode.ARMED])
def test_an_armed_arm_may_be_armed_again_and_disarmed_without_refusal(mode):
    made = machine(mode)
    assert made.arm(()) == ()
    assert made.mode is mode
    made.disarm("by hand")
    assert (made.mode, made.last_stop) == (Mode.STOPPING, "by hand")


def test_resuming_in_the_same_mode_keeps_its_time():
    made = machine(Mode.STOPPING)
    for _ in range(5):
        step(made)
        made.resume(Mode.STOPPING, EStop.CLEAR, "as recorded")
    step(made)
    assert (made.mode, made.last_stop) == (Mode.DISARMED, "as recorded")
    made.resume(Mode.STOPPED, EStop.LATCHED, "as recorded")
    assert (made.mode, made.estop) == (Mode.STOPPED, EStop.LATCHED)


@pytest.mark.parametrize(("rests_in", "ticks"), [(None, 5), *((tick, 9) for tick in range(5))])
def test_a_soft_stop_ends_although_the_cart_never_rests_or_the_arm_keeps_swinging(rests_in, ticks):
    made = machine(Mode.STOPPING)
    for tick in range(ticks):
        step(made, at_rest=tick == rests_in)
        assert made.mode is Mode.STOPPING
    step(made)
    assert made.mode is Mode.DISARMED


def test_each_soft_stop_waits_for_the_cart_again():
    made = machine(Mode.STOPPING)
    step(made, at_rest=True, still=True)
    assert made.arm(()) == ()
    made.disarm("by test")
    for _ in range(6):
        step(made)
    assert made.mode is Mode.DISARMED


@pytest.mark.parametrize("name", [n for n, rule in TABLE.items() if rule.blocks_arming])
def test_a_refusal_to_arm_names_cause_and_remedy(name):
    made = machine(Mode.DISARMED)
    assert TABLE[name].remedy in Event(name).text
    assert made.refusals([Event(name)]) == (Event(name).text,)
    assert made.arm([Event(name)]) == (Event(name).text,)
    assert made.mode is Mode.DISARMED


def test_an_acknowledgement_clears_the_latch_once_the_cause_is_gone():
    made = machine(Mode.ARMED)
    step(made, "remote_off")
    assert any("DI7" in reason for reason in made.acknowledge([Event("remote_off")]))
    assert made.estop is EStop.ENGAGED
    step(made)
    assert made.arm(()) == (f"the emergency stop is latched: make sure that the arm is free, {ACKNOWLEDGE}",)
    assert made.acknowledge(()) == ()
    assert (made.mode, made.estop) == (Mode.DISARMED, EStop.CLEAR)
    assert made.arm(()) == ()


def test_the_page_has_a_table_for_each_response_with_every_event():
    tables = [part.splitlines() for part in markdown().split("## ")[1:]]
    head = ["", "| event | cause | next step | refuses arming |", "|---|---|---|---|"]
    rows = {}
    for lines, title, response in zip(
        tables, ("Stop", "Soft stop", "Warn"), sorted(Response, reverse=True), strict=True
    ):
        assert lines[:4] == [title, *head]
        shown = {line.split("`")[1]: line for line in lines if line.startswith("| `")}
        assert list(shown) == names(response)
        rows |= shown
    assert rows["remote_off"] == (
        f"| `remote_off` | {TABLE['remote_off'].meaning} | release the emergency-stop button, then acknowledge | yes |"
    )
    assert rows["stop_requested"].endswith(", then acknowledge (clears: at once; the latch stays) | yes |")
    assert rows["recorder_dropping"].endswith(" | no |")
    assert markdown().count("|\n\n## ") == 2
