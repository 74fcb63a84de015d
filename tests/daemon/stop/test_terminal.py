"""Emergency stop by a key, on a pseudo-terminal."""

import os
import signal
import termios
import threading

import pytest

from softarm.daemon.stop.terminal import StopKey


@pytest.fixture
def terminal():
    """Yield the keyboard's end and the daemon's end of a pseudo-terminal."""
    typist, ours = os.openpty()
    yield typist, ours
    os.close(typist)  # ends a thread that still waits for a key
    for thread in threading.enumerate():
        if thread.name == "stop key":
            thread.join(10)
    os.close(ours)


@pytest.mark.parametrize("typed", [b" ", b"s", b"S", b"xyz s\n"])
def test_space_and_s_stop_without_enter(terminal, typed):
    typist, ours = terminal
    stopped = threading.Event()
    with StopKey(stopped.set, ours):
        os.write(typist, typed)
        assert stopped.wait(5)


def test_other_keys_do_not_stop(terminal):
    typist, ours = terminal
    pressed, last = [], threading.Event()

    def press():
        pressed.append(True)
        last.set()

    with StopKey(press, ours):
        os.write(typist, b"abcdef\n\x1b[A")
        os.write(typist, b" ")
        assert last.wait(5)
    assert len(pressed) == 1


def test_the_terminal_is_restored_and_the_key_works_again_after_a_suspension(terminal):
    _, ours = terminal
    before = termios.tcgetattr(ours)
    with StopKey(lambda: None, ours):
        assert not termios.tcgetattr(ours)[3] & (termios.ICANON | termios.ECHO)
        assert termios.tcgetattr(ours)[3] & termios.ISIG  # Ctrl-C ends the daemon as ever
        termios.tcsetattr(ours, termios.TCSANOW, before)  # as a shell does after Ctrl-Z
        os.kill(os.getpid(), signal.SIGCONT)
        assert not termios.tcgetattr(ours)[3] & termios.ICANON
    assert termios.tcgetattr(ours) == before


def test_without_a_terminal_no_key_is_read():
    read, write = os.pipe()
    os.write(write, b" ")
    with StopKey(lambda: pytest.fail("a pipe is no terminal"), read):
        pass
    assert os.read(read, 1) == b" "
    os.close(read)
    os.close(write)
