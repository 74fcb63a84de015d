"""Adapts the packaged systemd unit to the environment it is installed from."""

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from softarm.common.revision import PACKAGE
from softarm.schemas.config import Config

UNIT, RULE = PACKAGE / "systemd" / "softarmd.service", PACKAGE / "systemd" / "99-softarm.rules"
CONFIGURATION = Path("/etc/softarm/softarm.yaml")
STATE = Path("/var/lib/softarm")
HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # from the unit: ProtectHome=, PrivateTmp=


def program(interpreter: Path | None = None) -> tuple[str, ...]:
    """Return the unit's command for `softarm`: the script next to an interpreter, else the module."""
    interpreter = interpreter or Path(sys.executable)
    script = interpreter.with_name("softarm")
    return (str(script),) if script.is_file() else (str(interpreter), "-m", "softarm.cli.main")


def hidden(places: tuple[str, ...] | None = None) -> list[str]:
    """Return the folders the daemon is loaded from that the unit's sandbox hides."""
    if places is None:
        places = (sys.executable, os.path.realpath(sys.executable), sys.prefix, sys.base_prefix, str(PACKAGE))
    return [each for each in dict.fromkeys(places) if any(Path(each).is_relative_to(top) for top in HIDDEN)]


def named_files(config: Config) -> tuple[str, ...]:
    """Return the files that a configuration names: tokens and files in the options of policies."""
    tokens = (config.api.token_file, config.api.view_token_file, config.api.stop_token_file)
    options = (str(value) for policy in config.policies.values() for value in policy.options.values())
    return (*(str(each) for each in tokens if each), *(each for each in options if each.startswith("/")))


def unit(command: tuple[str, ...], user: str, config: Config) -> str:
    """Return the unit's text for a command, a user and a configuration."""
    text = UNIT.read_text(encoding="utf-8")
    started = " ".join(map(_quoted, (*command, "run", "--config", str(CONFIGURATION))))
    text = _with(text, "ExecStart", started)
    text = _with(text, "Documentation", f"file://{PACKAGE / 'docs' / 'operate' / 'service.md'}")
    text = _with(_with(text, "User", user), "Group", user)
    if "/ttyUSB" in os.path.realpath(config.drivers.regulator.port):  # a USB adapter instead of a Teensy
        text = text.replace("DeviceAllow=char-ttyACM rw\n", "DeviceAllow=char-ttyACM rw\nDeviceAllow=char-ttyUSB rw\n")
    for folder in log_folders(config):
        if not folder.is_relative_to(STATE):
            text = text.replace(
                "ProtectSystem=strict\n", f"ProtectSystem=strict\nReadWritePaths={_quoted(str(folder))}\n"
            )
    return text


def log_folders(config: Config) -> Iterator[Path]:
    """Yield the folder of the service's logs; a relative recorder.directory is below the state folder."""
    if config.recorder.enabled:
        yield STATE / config.recorder.directory


def _with(text: str, key: str, value: str) -> str:
    text, found = re.subn(rf"(?m)^{key}=.*$", lambda _: f"{key}={value}", text)
    assert found == 1, key
    return text


def _quoted(word: str) -> str:
    """Quote a word for systemd, which expands % and $ and splits at blanks."""
    word = word.replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if re.search(r"\s", word) else word
