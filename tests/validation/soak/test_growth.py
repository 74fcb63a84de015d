"""Resources of processes, and the slopes that show their growth."""

import subprocess
import sys

import numpy as np
import pytest

from validation.soak import growth
from validation.soak.growth import slope

# A process of its own: in one that has run other tests the system takes back and gives again what it likes.
GROWS = """
import socket, threading, time
while time.process_time() < 0.05:  # the system counts processor time in steps of 10 ms
    pass
print("small", flush=True)
input()
sockets, block = socket.socketpair(), b"x" * 50_000_000
threading.Thread(target=input).start()
print("grown", flush=True)
"""


def test_descriptors_threads_and_memory_are_counted():
    child = subprocess.Popen([sys.executable, "-c", GROWS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout.readline() == "small\n"
        before = growth.usage_of([child.pid])
        child.stdin.write("\n")
        child.stdin.flush()
        assert child.stdout.readline() == "grown\n"
        after = growth.usage_of([child.pid])
    finally:
        child.communicate("\n")
    assert after.descriptors == before.descriptors + 2
    assert after.threads == before.threads + 1
    assert after.memory_mb - before.memory_mb == pytest.approx(50_000_000 / 1024**2, rel=0.2)
    assert after.cpu_s >= before.cpu_s > 0


HOURS = np.linspace(0.0, 2.0, 400)


def wandering(seed, size):
    """Noise whose neighbours are alike."""
    return np.convolve(np.random.default_rng(seed).normal(0, size, 430), np.ones(31) / 31, "valid")


@pytest.mark.parametrize("seed", range(5))
def test_a_leak_grows_and_noise_is_flat(seed):
    assert slope(HOURS, 100 + 8 * HOURS + wandering(seed, 1.0), 2.0).verdict == "grows"
    assert slope(HOURS, 100 + wandering(seed, 1.0), 2.0).verdict == "flat"
    an_hour = 0.49 * HOURS
    assert slope(an_hour, 100 + 16 * an_hour + wandering(seed, 1.0), 2.0).verdict == "grows"
