"""Plans the steps from the present state of a system to an installed service. Pure."""

import os
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from softarm.common.quantity import shown
from softarm.common.revision import PACKAGE
from softarm.daemon.config.configuration import differences
from softarm.daemon.install.steps import Step, folder, keep, remove, run, write
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


def unit_text(command: tuple[str, ...], user: str, config: Config) -> str:
    """Return the unit's text for a command, a user and a configuration."""
    text = UNIT.read_text(encoding="utf-8")
    started = " ".join(map(_quoted, (*command, "run", "--config", str(CONFIGURATION))))
    text = _with(text, "ExecStart", started)
    text = _with(text, "Documentation", f"file://{PACKAGE / 'docs' / 'operate' / 'service.md'}")
    text = _with(_with(text, "User", user), "Group", user)
    if "/ttyUSB" in os.path.realpath(config.drivers.regulator.port):  # a USB adapter instead of a Teensy
        text = text.replace("DeviceAllow=char-ttyACM rw\n", "DeviceAllow=char-ttyACM rw\nDeviceAllow=char-ttyUSB rw\n")
    for written in written_folders(config):
        if not written.is_relative_to(STATE):
            text = text.replace(
                "ProtectSystem=strict\n", f"ProtectSystem=strict\nReadWritePaths={_quoted(str(written))}\n"
            )
    return text


def written_folders(config: Config) -> Iterator[Path]:
    """Yield the folder of the service's logs, and that of its reports unless it lies in the state folder.

    Relative directories are below the state folder.
    """
    if config.recorder.enabled:
        yield STATE / config.recorder.directory
    if not (reports := STATE / config.api.reports).is_relative_to(STATE):
        yield reports


def _with(text: str, key: str, value: str) -> str:
    text, found = re.subn(rf"(?m)^{key}=.*$", lambda _: f"{key}={value}", text)
    assert found == 1, key
    return text


def _quoted(word: str) -> str:
    """Quote a word for systemd, which expands % and $ and splits at blanks."""
    word = word.replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if re.search(r"\s", word) else word


UNIT_PATH = Path("/etc/systemd/system/softarmd.service")
RULE_PATH = Path("/etc/udev/rules.d/99-softarm.rules")
GROUP = "dialout"  # group of the serial device


@dataclass(frozen=True, slots=True)
class System:
    """Installed state of the system, and what may be done."""

    root: Path  # / for this system; files only for another folder
    read: Callable[[Path], str | None]  # returns a file's text, or None
    is_folder: Callable[[Path], bool]
    users: frozenset[str]
    members: frozenset[str]  # of the group
    groups: frozenset[str]
    booted: bool  # systemd runs here

    @property
    def is_this(self) -> bool:
        """Return whether this is the running system."""
        return self.root == Path("/")

    def place(self, path: Path) -> Path:
        """Return the path below the system's root."""
        return self.root / path.relative_to("/")


@dataclass(frozen=True, slots=True)
class Wanted:
    """The configuration for the service."""

    text: str
    config: Config  # that the text says
    asked_for: bool  # False for the packaged one
    installed: Config | None = None  # the one that is there


def install(system: System, command: tuple[str, ...], user: str, wanted: Wanted) -> Iterator[Step]:
    """Yield the steps to a service that runs `command`."""
    if system.is_this:
        yield from _user(system, user)
    config = wanted.installed or wanted.config
    for needed in (STATE, *written_folders(config)):
        if system.is_folder(path := system.place(needed)):
            yield keep(path, "its content stays")
        else:
            yield folder(path, user if system.is_this else None)
    yield from _configuration(system, wanted)
    unit = _file(system, UNIT_PATH, unit_text(command, user, config))
    rule = _file(system, RULE_PATH, RULE.read_text(encoding="utf-8"))
    yield from (unit, rule)
    if system.is_this and rule.kind == "write":
        yield from (run("udevadm", "control", "--reload"), run("udevadm", "trigger", "--subsystem-match=tty"))
    if system.is_this and system.booted:
        if unit.kind == "write":
            yield run("systemctl", "daemon-reload")
        yield run("systemctl", "enable", "softarmd")


def _user(system: System, user: str) -> Iterator[Step]:
    if GROUP not in system.groups:
        yield run("groupadd", "--system", GROUP)
    if user not in system.users:
        home = ("--home-dir", str(STATE), "--shell", "/usr/sbin/nologin")
        yield run("useradd", "--system", "--user-group", *home, "--groups", GROUP, user)
    elif user not in system.members:
        yield run("usermod", "--append", "--groups", GROUP, user)


def _configuration(system: System, wanted: Wanted) -> Iterator[Step]:
    """Keep an existing configuration; write a different requested one next to it."""
    path = system.place(CONFIGURATION)
    if wanted.installed is None:
        yield write(path, wanted.text, system.read(path))
        return
    differing = differences(wanted.installed, wanted.config)
    different = [f"{key.name}: {_text(here)}, not {_text(new)}" for key, here, new in differing]
    if not different:
        yield keep(path, "it has the requested values" if wanted.asked_for else "it has the default values")
    elif wanted.asked_for:
        yield keep(path, f"it was changed and stays; the requested one is written next to it: {'; '.join(different)}")
        yield _file(system, CONFIGURATION.with_name(f"{path.name}.new"), wanted.text)
    else:
        yield keep(path, f"it was changed and stays: {'; '.join(different)}")


def _text(value: object) -> str:
    return str(value) if isinstance(value, dict) else shown(value)


def _file(system: System, path: Path, text: str) -> Step:
    """Return a step that writes the file, or keeps it if it is up to date."""
    place = system.place(path)
    before = system.read(place)
    return keep(place, "it is up to date") if before == text else write(place, text, before)


def uninstall(system: System, user: str) -> Iterator[Step]:
    """Yield the steps that remove unit and rule; configuration, logs and user stay."""
    if system.is_this and system.booted and system.read(UNIT_PATH) is not None:
        yield run("systemctl", "disable", "--now", "softarmd")
    removed = [path for path in (UNIT_PATH, RULE_PATH) if system.read(system.place(path)) is not None]
    yield from (remove(system.place(path)) for path in removed)
    if system.is_this and system.booted and UNIT_PATH in removed:
        yield run("systemctl", "daemon-reload")
    if system.is_this and RULE_PATH in removed:
        yield run("udevadm", "control", "--reload")
    for path in (CONFIGURATION.parent, STATE):
        yield keep(system.place(path), f"configuration and logs stay; delete them with `rm -r {system.place(path)}`")
    if system.is_this and user in system.users:
        yield keep(STATE, f"the user {user} stays; delete it with `userdel {user}`")
