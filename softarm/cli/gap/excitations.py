"""Choice of an excitation by a verdict, and the commands to run after it."""

import shlex
from pathlib import Path

import click

from softarm.cli.shared.errors import fail


def print_next(logs: list[Path], plan: Path | None) -> None:
    """Print the commands that analyse the recordings."""
    if not logs:
        return
    recorded = shlex.join(map(str, logs))
    if plan is not None:
        new = plan.with_name(f"{plan.stem}-next.json")
        click.echo(f"next: softarm diagnose {recorded} --json {shlex.quote(str(new))}")
        click.echo(f"(to use all data, also name the recordings behind {plan}, before {recorded})")
        return
    click.echo(f"next: softarm identify {recorded} --out model.yaml")
    if len(logs) > 1:
        click.echo(f"or:   softarm diagnose {recorded} --report report.html")


def planned(plan: Path) -> str:
    """Return the excitation that a verdict asks for next; end the command with a sentence if there is none."""
    from pydantic import ValidationError

    from softarm.schemas.verdict import Verdict

    try:
        verdict = Verdict.model_validate_json(plan.read_bytes())
    except OSError as error:
        fail(f"{plan}: cannot be read ({error.strerror}); name a file that `softarm diagnose --json` wrote")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"]))
        fail(f"{plan}: {f'{where}: ' if where else ''}{first['msg']}; name a file that `softarm diagnose --json` wrote")
    if verdict.next_experiment is None:
        fail(f"{plan}: asks for no next experiment; name an excitation, `softarm excite --list` shows them")
    for effect, expected in verdict.next_experiment.expect.items():
        click.echo(f"if {effect}: {expected}")
    return verdict.next_experiment.excitation
