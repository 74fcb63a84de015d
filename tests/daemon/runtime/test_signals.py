"""A daemon ends on a signal at any instant."""

import subprocess
import sys

import pytest

# The signal comes just before, while and after the main thread begins to wait.
PROGRAM = """
import signal, threading
from softarm.daemon.assembly import wait_for
for turn in range(1000):
    stop = threading.Event()
    signal.signal(signal.SIGALRM, lambda *_: stop.set())
    signal.setitimer(signal.ITIMER_REAL, 1e-5 + turn % 50 * 1e-6)
    wait_for(stop, 1e-4)
print("every time")
"""


@pytest.mark.slow
def test_a_signal_at_any_instant_ends_the_wait():
    ended = subprocess.run([sys.executable, "-c", PROGRAM], check=False, capture_output=True, text=True, timeout=60)
    assert ended.stdout == "every time\n", ended.stderr
