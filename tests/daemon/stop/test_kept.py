"""A stop that a hung control loop does not carry out is kept for the next daemon, from any sender."""

import threading
import time

import pytest

from softarm.daemon.control.records import EStop, Mode, Outputs
from softarm.daemon.stop.kept import HUNG, KeptInbox


@pytest.mark.parametrize("is_hung", [True, False])
def test_a_stop_without_a_later_tick_is_kept(monkeypatch, is_hung):
    monkeypatch.setattr("softarm.daemon.stop.kept.ANSWER_S", 0.01)
    looked, kept = threading.Semaphore(0), []
    began_ns = time.monotonic_ns()

    def snapshot():
        looked.release()
        t_ns = began_ns if is_hung else time.monotonic_ns()
        return Outputs(t_ns, 1, 0, 0, 0, Mode.ARMED, EStop.CLEAR)

    inbox = KeptInbox(snapshot, kept.append)
    inbox.start()
    inbox.post("arm")
    assert [post.request.kind for post in inbox.take()] == ["arm"]
    for _ in range(2):  # the second stop is watched as well
        inbox.post("stop")
        assert looked.acquire(timeout=10)
    inbox.stop()
    inbox._thread.join()
    assert kept == ([HUNG, HUNG] if is_hung else [])
