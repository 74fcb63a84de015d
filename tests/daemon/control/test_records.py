"""Confirmation of a stop request by its result or by a later tick."""

import pytest

from softarm.daemon.control.records import EStop, Mode, Outputs, RequestResult

ASKED_NS, STOP = 1_000, 7  # when the stop lay in the inbox, and its number


def outputs(t_ns: int, estop: EStop, *results: RequestResult) -> Outputs:
    mode = Mode.DISARMED if estop is EStop.CLEAR else Mode.STOPPED
    return Outputs(t_ns, 1, 0, 0, 0, mode, estop, results=results)


@pytest.mark.parametrize("estop", [EStop.ENGAGED, EStop.LATCHED])
def test_a_later_tick_with_a_stop_confirms_the_request(estop):
    assert outputs(ASKED_NS, estop).has_stopped(STOP, ASKED_NS)  # a flood may have pushed its result out


def test_an_earlier_stop_does_not_confirm_the_request():
    assert not outputs(ASKED_NS - 1, EStop.LATCHED).has_stopped(STOP, ASKED_NS)


def test_the_requests_own_result_confirms_it():
    assert outputs(ASKED_NS - 1, EStop.ENGAGED, RequestResult(STOP, True)).has_stopped(STOP, ASKED_NS)


@pytest.mark.parametrize("result", [RequestResult(STOP + 1, True), RequestResult(STOP, False, ("why",))])
def test_the_result_of_another_request_or_a_refusal_does_not_confirm(result):
    assert not outputs(ASKED_NS - 1, EStop.ENGAGED, result).has_stopped(STOP, ASKED_NS)


def test_a_tick_without_a_stop_does_not_confirm():
    assert not outputs(ASKED_NS + 1, EStop.CLEAR, RequestResult(3, True)).has_stopped(STOP, ASKED_NS)
