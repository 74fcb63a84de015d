"""What an excitation was chosen by, and what comes after it."""

import shlex
from pathlib import Path

import click

from softarm.cli.errors import fail


def tell_next(logs: list[Path], plan: Path | None) -> None:
    """The commands that make something of the recordings."""
    if not logs:
        return
    recorded = shlex.join(map(str, logs))
    if plan is not None:
        anew = plan.with_name(f"{plan.stem}-next.json")  # the old verdict stays until its recordings are told anew
        click.echo(f"next: softarm diagnose {recorded} --json {shlex.quote(str(anew))}")
        click.echo(
            f"(named before {recorded}, the recordings that {plan} came from count as well: together they decide)"
        )
        return
    click.echo(f"next: softarm identify {recorded} --out model.yaml")
    if len(logs) > 1:
        click.echo(f"or:   softarm diagnose {recorded} --report report.html")


def planned(plan: Path) -> str:
    """The excitation that a verdict asks for next. Ends the command with a sentence where there is none."""
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
