"""Resources of processes, and the slopes that show their growth."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest

from softarm.evaluation.soak import growth
from softarm.evaluation.soak.growth import Slope, judge, slope

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


def test_a_child_process_is_counted_until_it_ends():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        assert child.pid in growth.children(os.getpid())
        assert growth.usage_of([os.getpid(), child.pid]).threads > growth.usage_of([os.getpid()]).threads
    finally:
        child.communicate(b"\n")
    with pytest.raises(OSError):
        growth.usage_of([child.pid])


def test_the_size_of_a_folder_is_the_sum_of_its_files(tmp_path):
    (tmp_path / "a").write_bytes(bytes(1_500_000))
    (tmp_path / "b").write_bytes(bytes(500_000))
    assert growth.folder_mb(tmp_path) == 2.0


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


def test_the_interval_covers_the_truth_in_about_95_percent():
    held = 0
    for seed in range(200):
        found = slope(HOURS, 3.0 * HOURS + wandering(seed, 1.0), 0.0)
        held += found.low <= 3.0 <= found.high
    assert 0.85 <= held / 200 <= 0.99


def test_growth_during_the_warm_up_is_no_leak():
    assert slope(HOURS, 100 + 50 * np.minimum(HOURS, 0.2), 2.0).verdict == "flat"


def test_a_run_without_a_whole_warm_up_shows_no_growth_but_may_be_flat():
    """The last ten minutes of every channel are kept: they fill in any daemon."""
    short = HOURS / 40
    assert slope(short, 100 + 300 * np.minimum(short, 1 / 6), 10.0).verdict == "too short to decide"
    assert slope(short, np.full(400, 17.0), 0.5).verdict == "flat"


def test_freed_memory_is_no_leak_and_hides_none():
    busy = np.random.default_rng(0).exponential(5.0, 400)
    assert slope(HOURS, 100 + busy, 2.0, np.min).verdict == "flat"
    assert slope(HOURS, 100 + busy + 8 * HOURS, 2.0, np.min).verdict == "grows"


def test_too_few_samples_are_undecided():
    found = slope(HOURS[:10], HOURS[:10], 2.0)
    assert (math.isnan(found.value), found.verdict) == (True, "too short to decide")
    assert slope([], [], 2.0).verdict == "too short to decide"


def test_only_quantities_that_are_not_flat_are_reported():
    reported = judge({"memory": Slope(5.0, 4.0, 6.0, 2.0), "threads": Slope(0.0, 0.0, 0.0, 0.5)}, "hour")
    assert reported == ["memory grows: 5 per hour (4 to 6), allowed 2"]
