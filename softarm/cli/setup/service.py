"""`softarm service`: install the daemon as a systemd service."""

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared.console import FILE, load_config
from softarm.cli.shared.errors import fail

if TYPE_CHECKING:
    from softarm.daemon.install.plan import System
    from softarm.daemon.install.steps import Step


@click.group()
def service() -> None:
    """Install the daemon as a systemd service that starts with this computer.

    \b
    Examples:
      softarm service install --dry-run
      sudo /opt/softarm/.venv/bin/softarm service install
    """


@service.command()
@click.option("--config", "config_file", type=FILE, help="Copied to /etc/softarm/softarm.yaml unless that exists.")
@click.option("--user", default="softarm", show_default=True, help="User of the daemon; created if missing.")
@click.option("--root", default=Path("/"), type=click.Path(path_type=Path), help="Only write files under this folder.")
@click.option("--dry-run", is_flag=True, help="Show every file and command without changing anything.")
@click.option("--uninstall", is_flag=True, help="Remove the unit and the udev rule; keep configuration and logs.")
def install(config_file: Path | None, user: str, root: Path, dry_run: bool, uninstall: bool) -> None:
    """Install or update the unit, the udev rule, the system user, the configuration and the folder of logs.

    The unit runs the environment of this command. An existing configuration is kept and its differences are shown; logs
    are kept, too. The service is enabled but not started or restarted, because an arm may be moving.

    \b
    Examples:
      softarm service install --dry-run
      sudo /opt/softarm/.venv/bin/softarm service install --config softarm.yaml
      sudo /opt/softarm/.venv/bin/softarm service install --uninstall
    """
    from softarm.daemon.install import here, plan

    if not re.fullmatch(r"[a-z_][a-z0-9_-]{0,31}", user):
        raise click.BadParameter(
            f"{user!r} is not a valid user name; allowed: small letters, digits, - and _", param_hint="--user"
        )
    if os.geteuid() != 0 and root == Path("/") and not dry_run:
        fail("root is required: put `sudo` before this command's full path, or use --dry-run or --root FOLDER")
    system = here.look(root)
    steps = list(plan.uninstall(system, user) if uninstall else _installing(system, config_file, user, dry_run))
    for step in steps:
        click.echo(f"{'would ' if dry_run and step.kind != 'keep' else ''}{step.text}")
        if dry_run:
            click.echo("".join(f"    {line}\n" for line in step.shown), nl=False)
        else:
            step.carry_out()
    _print_next(system, steps, dry_run, uninstall)


def _installing(system: "System", config_file: Path | None, user: str, dry_run: bool) -> "list[Step]":
    """Return the steps of an installation whose unit and configuration are valid."""
    from softarm.daemon.config import configuration
    from softarm.daemon.install import here, plan

    if (unseen := plan.hidden()) and system.is_this:
        text = (
            f"{unseen[0]}: hidden from the service (ProtectHome=, PrivateTmp=); create an environment elsewhere: "
            "`python3 -m venv /opt/softarm/.venv`, `pip install` softarm there, and install with its `softarm`"
        )
        click.echo(text, err=True) if dry_run else fail(text)
    path = system.place(plan.CONFIGURATION)
    file = config_file or configuration.EXAMPLE
    config = load_config(file)
    installed = load_config(path) if path.exists() else None
    if lost := plan.hidden(plan.named_files(installed or config)):
        fail(f"{path if installed else file}: names {lost[0]}, hidden from the service; move it into /etc/softarm")
    command = plan.program()
    if wrong := here.verify(plan.unit_text(command, user, installed or config)):
        fail(f"systemd rejects the unit: {wrong}")
    wanted = plan.Wanted(file.read_text(encoding="utf-8"), config, config_file is not None, installed)
    return list(plan.install(system, command, user, wanted))


def _print_next(system: "System", steps: "list[Step]", dry_run: bool, uninstall: bool) -> None:
    """Print the steps that remain for a person."""
    if dry_run:
        click.echo("nothing was changed: --dry-run")
    elif uninstall or not system.is_this:
        click.echo("done")
    elif not system.booted:
        click.echo("done; systemd is not running: after the next boot, `systemctl enable --now softarmd`")
    elif any(step.kind == "write" for step in steps):
        click.echo("next: `systemctl restart softarmd` once the arm is disarmed; then `softarm doctor`")
    else:
        click.echo("nothing had to be changed")
