"""When may a stop be answered as done? By its result, or by a later tick that holds one."""

import pytest

from softarm.daemon.control.records import EStop, Mode, Outputs, RequestResult

ASKED_NS, STOP = 1_000, 7  # when the stop lay in the inbox, and its number


def outputs(t_ns: int, estop: EStop, *results: RequestResult) -> Outputs:
    mode = Mode.DISARMED if estop is EStop.CLEAR else Mode.STOPPED
    return Outputs(t_ns, 1, 0, 0, 0, mode, estop, results=results)


@pytest.mark.parametrize("estop", [EStop.ENGAGED, EStop.LATCHED])
def test_a_tick_that_began_after_it_was_asked_for_and_holds_a_stop_is_enough(estop):
    assert outputs(ASKED_NS, estop).has_stopped(STOP, ASKED_NS)  # a flood may have pushed its result out


def test_a_stop_from_before_is_not_this_one():
    assert not outputs(ASKED_NS - 1, EStop.LATCHED).has_stopped(STOP, ASKED_NS)


def test_its_own_result_is_enough_in_the_very_tick_that_it_slipped_into():
    assert outputs(ASKED_NS - 1, EStop.ENGAGED, RequestResult(STOP, True)).has_stopped(STOP, ASKED_NS)


@pytest.mark.parametrize("result", [RequestResult(STOP + 1, True), RequestResult(STOP, False, ("why",))])
def test_anothers_result_or_a_refusal_is_not(result):
    assert not outputs(ASKED_NS - 1, EStop.ENGAGED, result).has_stopped(STOP, ASKED_NS)


def test_a_tick_without_a_stop_has_not():
    assert not outputs(ASKED_NS + 1, EStop.CLEAR, RequestResult(3, True)).has_stopped(STOP, ASKED_NS)
