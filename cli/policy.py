"""`softarm policy`: who moves the arm."""

import click

from softarm.cli.remote import Remote, remote


@click.group()
def policy() -> None:
    """List the policies that the daemon has, choose one.

    \b
    Examples:
      softarm policy list
      softarm policy use reach-wide
    """


@policy.command("list")
@remote
def list_(daemon: Remote) -> None:
    """List the policies by name; * marks the one in use.

    \b
    Example:
      softarm policy list
    """
    answer = daemon.get("/api/policies")
    width = max((len(entry["name"]) for entry in answer["policies"]), default=0)
    for entry in answer["policies"]:
        mark = "*" if entry["name"] == answer["active"] else " "
        click.echo(f"{mark} {entry['name']:<{width}}  {entry['description']}")


@policy.command()
@click.argument("name")
@remote
def use(daemon: Remote, name: str) -> None:
    """Have another policy move the arm from the next goal on.

    \b
    Example:
      softarm policy use pid
    """
    daemon.request("PUT", "/api/policy", {"name": name})
    click.echo(f"using {name}")
