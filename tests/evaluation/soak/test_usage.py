"""Resources of a process agree with the system's figures."""

import os
import subprocess
import sys

import pytest

from softarm.evaluation.soak import usage

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
        before = usage.of([child.pid])
        child.stdin.write("\n")
        child.stdin.flush()
        assert child.stdout.readline() == "grown\n"
        after = usage.of([child.pid])
    finally:
        child.communicate("\n")
    assert after.descriptors == before.descriptors + 2
    assert after.threads == before.threads + 1
    assert after.memory_mb - before.memory_mb == pytest.approx(50_000_000 / 1024**2, rel=0.2)
    assert after.cpu_s >= before.cpu_s > 0


def test_a_child_process_is_counted_until_it_ends():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        assert child.pid in usage.children(os.getpid())
        assert usage.of([os.getpid(), child.pid]).threads > usage.of([os.getpid()]).threads
    finally:
        child.communicate(b"\n")
    with pytest.raises(OSError):
        usage.of([child.pid])


def test_the_size_of_a_folder_is_the_sum_of_its_files(tmp_path):
    (tmp_path / "a").write_bytes(bytes(1_500_000))
    (tmp_path / "b").write_bytes(bytes(500_000))
    assert usage.folder_mb(tmp_path) == 2.0
