"""Atomic writing of files, also after errors and kills."""

import errno
import hashlib
import os
import stat
import threading

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from softarm.common import files


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text(), st.binary())
def test_a_written_file_is_read_back_without_leftovers(tmp_path, text, content):
    files.write_text(tmp_path / "a.txt", text)
    files.write_bytes(tmp_path / "a.bin", content)
    assert (tmp_path / "a.txt").read_bytes() == text.encode()  # line ends stay what they are
    assert (tmp_path / "a.bin").read_bytes() == content
    assert sorted(os.listdir(tmp_path)) == ["a.bin", "a.txt"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_failed_write_keeps_the_old_file_without_a_draft(tmp_path, error):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(error), files.replacing(path) as file:  # noqa: PT012 - it must fail inside
        file.write(b"half of the n")
        raise error
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_text("x")
    files.write_text(tmp_path / "ours", "x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o755])
def test_a_replaced_file_keeps_its_permissions(tmp_path, mode):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(mode)
    files.write_text(path, "new")
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_a_link_stays_a_link_to_the_new_content(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "disk" / "a.txt")
    files.write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "disk" / "a.txt").read_text() == "new"


def test_a_pipe_is_written_into_and_stays_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    received = []
    listener = threading.Thread(target=lambda: received.append((tmp_path / "pipe").read_bytes()), daemon=True)
    listener.start()
    files.write_text(tmp_path / "pipe", "new")
    listener.join(timeout=10)
    assert received == [b"new"]
    assert (tmp_path / "pipe").is_fifo()


def test_an_error_names_the_file_and_not_its_draft(tmp_path):
    (tmp_path / "file").touch()
    for place in ("no", "file"):
        with pytest.raises(OSError, match="directory") as raised:
            files.write_text(tmp_path / place / "a.txt", "new")
        assert raised.value.filename == str(tmp_path / place / "a.txt")
    with pytest.raises(OSError, match="No space left") as raised, files.replacing(tmp_path / "full.txt"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert raised.value.filename == str(tmp_path / "full.txt")


def test_the_digest_of_a_folder_covers_names_and_contents_but_not_its_own_name(tmp_path):
    for name in ("one", "other"):
        (tmp_path / name / "inside").mkdir(parents=True)
        (tmp_path / name / "inside" / "a").write_text("text")
    before = files.sha256_of(tmp_path / "one")
    assert files.sha256_of(tmp_path / "other") == before
    assert files.sha256_of(tmp_path / "one" / "inside" / "a") == hashlib.sha256(b"text").hexdigest()
    (tmp_path / "one" / "inside" / "a").rename(tmp_path / "one" / "inside" / "b")
    assert files.sha256_of(tmp_path / "one") != before
