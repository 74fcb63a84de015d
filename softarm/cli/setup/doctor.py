"""`softarm doctor`: check this computer before a flight and print the remedy for each problem."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.client import url_of
from softarm.cli.shared.console import (
    FOLDER,
    config_option,
    print_json,
    print_option,
    token_of,
    token_option,
    url_option,
)
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.common.finding import Finding
    from softarm.daemon.doctor.examination import Target

COLOURS = {"ok": "green", "warning": "yellow", "problem": "red"}


@click.command()
@config_option
@click.option("--simulated", is_flag=True, help="Check for `softarm run --simulated`, which has no devices.")
@url_option
@token_option
@click.option("--logs", "folder", type=FOLDER, help="Folder of the robot's logs (default: recorder.directory).")
@print_option
def doctor(
    config_file: Path | None,
    simulated: bool,
    url: str | None,
    token_file: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Check this computer: software, configuration, devices, policies, scheduling, clocks, disk, limits.

    With a running daemon it reads rates, ages and latency; otherwise it checks whether a daemon can start. It moves
    nothing and opens no serial port. It connects to the drive only if no other program here does. It takes seconds.

    Exit code 0 without problems, even with warnings; 1 with problems.

    \b
    Examples:
      softarm doctor --config softarm.yaml
      softarm doctor --config twin.yaml         while a daemon runs with this file
      softarm doctor --simulated                for `softarm run --simulated`
      softarm doctor --json > doctor.json
    """
    from softarm.common.finding import State
    from softarm.daemon.doctor import examination, running

    config, mistakes = examination.configuration(config_file, wires=not simulated)
    own_token = None if url or mistakes else config.api.token_file
    url = url or url_of(config.api)
    try:
        daemon = running.look(url, token_of(token_file) or token_of(own_token))
    except ValueError as error:
        raise click.BadParameter(f"{error}; e.g. http://127.0.0.1:8080", param_hint="--url") from None
    target = examination.Target(config_file, config, mistakes, url, daemon, simulated, folder)
    found = _examine(target, quiet=as_json)
    states = Counter(each.state for several in found.values() for each in several)
    problems, warnings = states[State.PROBLEM], states[State.WARNING]
    if as_json:
        findings = [
            {"part": part, "name": each.name, "state": each.state, "figure": each.figure, "advice": each.advice}
            for part, several in found.items()
            for each in several
        ]
        print_json({"sound": problems == 0, "findings": findings})
    else:
        counted = f"{problems} problem{'s' * (problems != 1)}, {warnings} warning{'s' * (warnings != 1)}"
        click.echo(f"\n{counted}: " + ("not ready to fly" if problems else "ready to fly"))
    if problems:
        raise SystemExit(1)


def _examine(target: "Target", quiet: bool) -> "dict[str, list[Finding]]":
    """Return the findings of every part, and print them as they arrive unless `quiet`."""
    from softarm.daemon.doctor.examination import PARTS

    found = {}
    with bar("examining", len(PARTS)) as progress:
        for name, examine in PARTS.items():
            progress.advance(0, f"examining {name}")
            found[name] = list(examine(target))
            progress.advance()
            if not quiet and found[name]:
                _print_part(name, found[name])
    return found


def _print_part(part: str, findings: "list[Finding]") -> None:
    click.echo(f"\n{part}")
    for each in findings:
        state = click.style(f"{each.state:<8}", fg=COLOURS[each.state], bold=each.state != "ok")
        click.echo(f"  {state} {each.name}: {each.figure}")
        if each.advice:
            click.echo(f"           {'-> ' if each.state != 'ok' else ''}{each.advice}")
