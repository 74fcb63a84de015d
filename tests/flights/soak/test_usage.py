"""What a process has is what the system says of it."""

import os
import subprocess
import sys

import pytest

from softarm.flights.soak import usage

# A process of its own: in one that has run other tests the system takes back and gives again what it likes.
GROWS = """
import socket, threading
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


def test_a_child_is_found_counted_with_its_parent_and_missed_when_it_has_ended():
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        assert child.pid in usage.children(os.getpid())
        assert usage.of([os.getpid(), child.pid]).threads > usage.of([os.getpid()]).threads
    finally:
        child.communicate(b"\n")
    with pytest.raises(OSError):
        usage.of([child.pid])


def test_a_folder_is_as_large_as_its_files(tmp_path):
    (tmp_path / "a").write_bytes(bytes(1_500_000))
    (tmp_path / "b").write_bytes(bytes(500_000))
    assert usage.folder_mb(tmp_path) == 2.0
