"""Selector with accurate time-outs for any number of descriptors."""

import selectors
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing

import pytest

from softarm.daemon.runtime.wakeup import PunctualSelector

READY_S = 5.0  # never waited for when the code is right


@pytest.fixture
def selector() -> Iterator[PunctualSelector]:
    selector = PunctualSelector()
    yield selector
    selector.close()


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    near, far = socket.socketpair()
    yield near, far
    near.close()
    far.close()


def test_a_time_out_is_not_rounded_up_to_a_millisecond(selector: PunctualSelector) -> None:
    shortest_s = min(lasted_s(selector, 0.0002) for _ in range(200))
    assert 0.0002 <= shortest_s < 0.0006
    assert selector.select(1e-12) == []


def lasted_s(selector: PunctualSelector, timeout_s: float) -> float:
    began_ns = time.monotonic_ns()
    assert selector.select(timeout_s) == []
    return (time.monotonic_ns() - began_ns) * 1e-9


def test_a_timer_that_ran_out_does_not_wake_the_next_wait(
    selector: PunctualSelector, pair: tuple[socket.socket, socket.socket]
) -> None:
    near, far = pair
    assert selector.select(0.0001) == []
    assert lasted_s(selector, 0.02) >= 0.02
    selector.register(near, 1, "mine")
    selector._set_timer(1)
    far.send(b"!")
    for timeout_s in (None, READY_S, 0.0, -1.0):
        [(key, _)] = selector.select(timeout_s)
        assert key.data == "mine"


def test_descriptors_above_1023_are_waited_for(many_descriptors: Callable[[], AbstractContextManager[None]]) -> None:
    with many_descriptors(), closing(PunctualSelector()) as selector:
        near, far = socket.socketpair()
        with near, far:
            assert near.fileno() > 1023
            selector.register(near, selectors.EVENT_READ, "mine")
            far.send(b"!")
            assert [key.data for key, _ in selector.select(READY_S)] == ["mine"]
