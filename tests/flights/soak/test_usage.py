"""What a process has is what the system says of it."""

import gc
import os
import socket
import subprocess
import sys
import threading

import pytest

from softarm.flights.soak import usage


def test_descriptors_threads_and_memory_are_counted():
    gc.collect()  # what earlier tests left may go meanwhile
    before = usage.of([os.getpid()])
    release, sockets = threading.Event(), socket.socketpair()
    thread = threading.Thread(target=release.wait)
    thread.start()
    block = b"x" * 50_000_000
    during = usage.of([os.getpid()])
    release.set()
    thread.join()
    for one in sockets:
        one.close()
    assert during.descriptors == before.descriptors + 2
    assert during.threads == before.threads + 1
    assert during.memory_mb - before.memory_mb == pytest.approx(len(block) / 1024**2, rel=0.2)
    assert during.cpu_s >= before.cpu_s > 0


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
