"""`softarm doctor`: what stands between this computer and a flying arm, and what to do about it."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.client import url_of
from softarm.cli.options import FILE, FOLDER, config_option, token_of
from softarm.cli.printing import print_json, print_option
from softarm.cli.words import in_commands
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.daemon.doctor.examination import Patient
    from softarm.daemon.doctor.finding import Finding

COLOURS = {"ok": "green", "warning": "yellow", "problem": "red"}


@click.command()
@config_option
@click.option("--simulated", is_flag=True, help="For `softarm run --simulated`, which has no devices.")
@click.option("--url", envvar="SOFTARM_URL", show_envvar=True, help="A running daemon's (default: as the file says).")
@click.option("--token-file", type=FILE, help="File with the API's token; else $SOFTARM_TOKEN. Not needed on loopback.")
@click.option("--logs", "folder", type=FOLDER, help="Logs of the robot (default: the recorder's folder).")
@print_option
def doctor(
    config_file: Path | None,
    simulated: bool,
    url: str | None,
    token_file: Path | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Examine this computer: software, configuration, devices, policies, scheduling, clocks, disk, limits.

    Of a daemon that runs it asks rates, ages and latency; otherwise it looks whether one could begin. It moves nothing,
    opens no serial port, and connects to the drive only where nobody of this computer does. It takes some seconds.

    Exit code 0 when there is no problem, warnings or not; 1 when there is one.

    \b
    Examples:
      softarm doctor --config softarm.yaml
      softarm doctor --config twin.yaml         beside the daemon that runs by it
      softarm doctor --simulated                can `softarm run --simulated` fly here?
      softarm doctor --json > doctor.json
    """
    from softarm.daemon.doctor import examination, running, settings

    loaded = settings.look(config_file)
    url = url or url_of(loaded.config.api)
    try:
        daemon = running.look(url, token_of(token_file))
    except ValueError as error:
        raise click.BadParameter(f"{error}; e.g. http://127.0.0.1:8080", param_hint="--url") from None
    patient = examination.Patient(loaded, url, daemon, simulated, folder)
    found = _examined(patient, quiet=as_json)
    problems = sum(each.state == "problem" for several in found.values() for each in several)
    if as_json:
        told = [{"part": part} | each._asdict() for part, several in found.items() for each in several]
        print_json({"sound": problems == 0, "findings": told})
    else:
        _say_the_end(found, problems)
    if problems:
        raise SystemExit(1)


def _examined(patient: "Patient", quiet: bool) -> "dict[str, list[Finding]]":
    """Every part's findings, told as they come."""
    from softarm.daemon.doctor.examination import PARTS

    found = {}
    with bar("examining", len(PARTS)) as progress:
        for name, examine in PARTS.items():
            progress.advance(0, f"examining {name}")
            found[name] = list(examine(patient))
            progress.advance()
            if not quiet:
                _say(name, found[name])
    return found


def _say(part: str, findings: "list[Finding]") -> None:
    click.echo(f"\n{part}")
    for each in findings:
        state = click.style(f"{each.state:<8}", fg=COLOURS[each.state], bold=each.state != "ok")
        click.echo(f"  {state} {each.name}: {in_commands(each.figure)}")
        if each.advice:
            click.echo(f"           {'-> ' if each.state != 'ok' else ''}{in_commands(each.advice)}")


def _say_the_end(found: "dict[str, list[Finding]]", problems: int) -> None:
    warnings = sum(each.state == "warning" for several in found.values() for each in several)
    counted = f"{problems} problem{'s' * (problems != 1)}, {warnings} warning{'s' * (warnings != 1)}"
    click.echo(f"\n{counted}: " + ("this does not fly yet" if problems else "nothing stands in the way"))
