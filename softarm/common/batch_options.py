"""Options of commands that run many jobs."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from softarm.common.batch import Workers
from softarm.common.processes import cores


def workers_options(about: str = "") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the options --workers and --ray of a verb that runs many jobs; it receives `workers`, a `Workers`."""
    count = click.option(
        "--workers", "count", type=click.IntRange(min=1), help=f"{about}parallel jobs here.  [default: one per core]"
    )
    address = click.option("--ray", help=f"{about}run on the Ray cluster at this address; 'local' starts one here.")

    def decorate(verb: Callable[..., Any]) -> Callable[..., Any]:
        @count
        @address
        @wraps(verb)
        def with_workers(*args: Any, count: int | None, ray: str | None, **options: Any) -> Any:
            return verb(*args, workers=Workers(count or cores(), ray), **options)

        return with_workers

    return decorate
