"""Confirmation of a stop request by its result or by a later tick."""

import pytest

from softarm.daemon.control.records import EStop, Mode, Outputs, RequestResult

ASKED_NS, STOP = 1_000, 7  # when the stop lay in the inbox, and its number


@pytest.mark.parametrize(
    ("t_ns", "estop", "result", "stopped"),
    [
        # A flood may have pushed the request's own result out.
        (ASKED_NS, EStop.ENGAGED, None, True),
        (ASKED_NS, EStop.LATCHED, None, True),
        (ASKED_NS - 1, EStop.LATCHED, None, False),
        (ASKED_NS - 1, EStop.ENGAGED, RequestResult(STOP, True), True),
        (ASKED_NS - 1, EStop.ENGAGED, RequestResult(STOP + 1, True), False),
        (ASKED_NS - 1, EStop.ENGAGED, RequestResult(STOP, False, ("why",)), False),
        (ASKED_NS + 1, EStop.CLEAR, RequestResult(3, True), False),
    ],
)
def test_a_stop_is_confirmed_by_a_later_stop_or_by_its_own_result(t_ns, estop, result, stopped):
    results = () if result is None else (result,)
    outputs = Outputs(t_ns, 1, 0, 0, 0, Mode.STOPPED, estop, results=results)
    assert outputs.has_stopped(STOP, ASKED_NS) is stopped
