"""`softarm policy`: who moves the arm."""

from pathlib import Path
from typing import Any

import click

from softarm.cli.completion import policies
from softarm.cli.errors import Unreachable, fail
from softarm.cli.options import FILE
from softarm.cli.printing import print_json, print_option, waiting
from softarm.cli.remote import Remote, remote
from softarm.cli.verbs import Verbs

Json = dict[str, Any]
LOADING_S = 125.0  # the daemon gives a policy up after 120


@click.group(cls=Verbs)
def policy() -> None:
    """List the policies there are, choose one.

    \b
    Examples:
      softarm policy list
      softarm policy use reach-wide
    """


@policy.command("list")
@click.option(
    "--config", "config_file", type=FILE, help="Ask no daemon: what is installed and shipped here, and of this file."
)
@print_option
@remote
def list_(daemon: Remote, config_file: Path | None, as_json: bool) -> None:
    """List the policies by name; * marks the one in use. Where no daemon answers, those of this machine.

    \b
    Examples:
      softarm policy list
      softarm policy list --config softarm.yaml
      softarm policy list --json
    """
    try:
        answer = _here(config_file) if config_file is not None else daemon.get("/api/policies")
    except Unreachable:
        click.echo(f"no daemon answers at {daemon.url}: these are installed or shipped on this machine", err=True)
        answer = _here(None)
    if as_json:
        print_json(answer)
        return
    width = max((len(entry["name"]) for entry in answer["policies"]), default=0)
    for entry in answer["policies"]:
        mark = "*" if entry["name"] == answer["active"] else " "
        target = "  (needs no target: `softarm goal run`)" if entry["needs_target"] is False else ""
        click.echo(f"{mark} {entry['name']:<{width}}  {entry['description']}{target}")


def _here(config_file: Path | None) -> Json:
    """As a daemon of that configuration would list them; the one that it begins with is in use."""
    from softarm.daemon.api.endpoints.policies import policy_answer
    from softarm.daemon.config import configuration
    from softarm.policies import registry
    from softarm.schemas.config import Config
    from softarm.schemas.rest import PoliciesAnswer

    try:
        config = configuration.load(config_file) if config_file is not None else Config()
    except configuration.ConfigurationError as error:
        fail(str(error))
    entries = registry.available(config.policies).values()
    active = config.control.policy if config_file is not None else None
    return PoliciesAnswer(active=active, policies=tuple(map(policy_answer, entries))).model_dump(mode="json")


@policy.command()
@click.argument("name", shell_complete=policies)
@remote
def use(daemon: Remote, name: str) -> None:
    """Have another policy move the arm from the next goal on. It is tried out first, which may take a minute.

    \b
    Example:
      softarm policy use pid
    """
    with waiting(f"the daemon tries {name} out"):
        daemon.request("PUT", "/api/policy", {"name": name}, LOADING_S)
    click.echo(f"using {name}")
