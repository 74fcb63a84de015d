"""The packaged unit, made to fit the environment it is installed from."""

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from softarm.common.revision import ROOT
from softarm.schemas.config import Config

UNIT, RULE = ROOT / "systemd" / "softarmd.service", ROOT / "systemd" / "99-softarm.rules"
CONFIGURATION = Path("/etc/softarm/softarm.yaml")
STATE = Path("/var/lib/softarm")
HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # from the unit: ProtectHome=, PrivateTmp=


def program(interpreter: Path | None = None) -> tuple[str, ...]:
    """How the unit starts `softarm`: the script beside an interpreter (default: this one), else the module."""
    interpreter = interpreter or Path(sys.executable)
    script = interpreter.with_name("softarm")
    return (str(script),) if script.is_file() else (str(interpreter), "-m", "softarm.cli.main")


def hidden(places: tuple[str, ...] | None = None) -> list[str]:
    """Of the places that the daemon is loaded from (default: this interpreter's), those that the unit cannot see."""
    if places is None:
        places = (sys.executable, os.path.realpath(sys.executable), sys.prefix, sys.base_prefix, str(ROOT))
    return [each for each in dict.fromkeys(places) if any(Path(each).is_relative_to(top) for top in HIDDEN)]


def named_files(config: Config) -> tuple[str, ...]:
    """Files that a configuration has the daemon read: tokens, and what stands in the options of policies."""
    tokens = (config.api.token_file, config.api.view_token_file, config.api.stop_token_file)
    options = (str(value) for policy in config.policies.values() for value in policy.options.values())
    return (*(str(each) for each in tokens if each), *(each for each in options if each.startswith("/")))


def unit(command: tuple[str, ...], user: str, config: Config) -> str:
    """The unit's text for a program, a user, and the folder that a configuration writes logs to."""
    text = UNIT.read_text(encoding="utf-8")
    started = " ".join(map(_quoted, (*command, "run", "--config", str(CONFIGURATION))))
    text = _with(text, "ExecStart", started)
    text = _with(text, "Documentation", f"file://{ROOT / 'docs' / 'service.md'}")
    text = _with(_with(text, "User", user), "Group", user)
    if "/ttyUSB" in os.path.realpath(config.drivers.regulator.port):  # of an adapter, no Teensy's own
        text = text.replace("DeviceAllow=char-ttyACM rw\n", "DeviceAllow=char-ttyACM rw\nDeviceAllow=char-ttyUSB rw\n")
    for folder in log_folders(config):
        if not folder.is_relative_to(STATE):
            text = text.replace(
                "ProtectSystem=strict\n", f"ProtectSystem=strict\nReadWritePaths={_quoted(str(folder))}\n"
            )
    return text


def log_folders(config: Config) -> Iterator[Path]:
    """Where the service writes logs; a relative recorder.directory lies in its state folder."""
    if config.recorder.enabled:
        yield STATE / config.recorder.directory


def _with(text: str, key: str, value: str) -> str:
    text, found = re.subn(rf"(?m)^{key}=.*$", lambda _: f"{key}={value}", text)
    assert found == 1, key
    return text


def _quoted(word: str) -> str:
    """As systemd reads it: % and $ stand for themselves, a blank splits no word."""
    word = word.replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if re.search(r"\s", word) else word
