"""`softarm policy`: list the policies and choose one."""

from pathlib import Path
from typing import Any

import click

from softarm.cli.shared.client import Remote, remote
from softarm.cli.shared.completion import policies
from softarm.cli.shared.console import FILE, load_config, print_json, print_option, waiting
from softarm.cli.shared.errors import Unreachable

LOADING_S = 125.0  # the daemon stops loading a policy after 120 s


@click.group()
def policy() -> None:
    """List the available policies or choose one.

    \b
    Examples:
      softarm policy list
      softarm policy use reach-wide
    """


@policy.command("list")
@click.option(
    "--config", "config_file", type=FILE, help="List without a daemon: installed, shipped, and those of this file."
)
@print_option
@remote
def list_(daemon: Remote, config_file: Path | None, as_json: bool) -> None:
    """List the policies by name; * marks the active one. Without a daemon, list those of this machine.

    \b
    Examples:
      softarm policy list
      softarm policy list --config softarm.yaml
      softarm policy list --json
    """
    try:
        answer = _here(config_file) if config_file is not None else daemon.get("/api/policies")
    except Unreachable:
        click.echo(f"no daemon answers at {daemon.url}: showing the policies of this machine", err=True)
        answer = _here(None)
    if as_json:
        print_json(answer)
        return
    width = max((len(entry["name"]) for entry in answer["policies"]), default=0)
    for entry in answer["policies"]:
        mark = "*" if entry["name"] == answer["active"] else " "
        target = f"  (needs no target: {daemon.command('goal run')})" if entry["needs_target"] is False else ""
        click.echo(f"{mark} {entry['name']:<{width}}  {entry['description']}{target}")


def _here(config_file: Path | None) -> dict[str, Any]:
    """Return the list that a daemon with this configuration would give; its initial policy is the active one."""
    from softarm.daemon.api.endpoints.policies import policy_answer
    from softarm.policies import registry
    from softarm.schemas.rest import PoliciesAnswer

    config = load_config(config_file)
    entries = registry.available(config.policies).values()
    active = config.control.policy if config_file is not None else None
    return PoliciesAnswer(active=active, policies=tuple(map(policy_answer, entries))).model_dump(mode="json")


@policy.command()
@click.argument("name", shell_complete=policies)
@remote
def use(daemon: Remote, name: str) -> None:
    """Use another policy from the next goal on. The daemon tests it first, which may take a minute.

    \b
    Example:
      softarm policy use pid
    """
    with waiting(f"the daemon tests {name}"):
        daemon.request("PUT", "/api/policy", {"name": name}, LOADING_S)
    click.echo(f"using {name}")
