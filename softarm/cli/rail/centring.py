"""Samples, texts and changes of `softarm rail centre`."""

import select
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.rail.sources import Source
from softarm.cli.shared.errors import fail
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.drivers.rail.commissioning.centre import Centre, Sample
    from softarm.schemas.config import Config

POLL_S = 0.05


def pushed(source: Source, seconds: float | None) -> "list[Sample]":
    """Collect samples while a person pushes the cart from end to end, until Enter or for a given time."""
    if seconds is None and not sys.stdin.isatty():
        fail("no terminal to press Enter on: give the duration with --seconds")
    until_ns = None if seconds is None else source.clock() + round(seconds * 1e9)
    samples: list[Sample] = []
    with bar("push the cart", None) as progress:
        while source.clock() < until_ns if until_ns is not None else not _enter():
            if (sample := source.sample()) is not None:
                samples.append(sample)
                axis = [each.axis_m for each in samples]
                mocap = "not seen" if sample.mocap_m is None else f"{sample.mocap_m:+.3f} m"
                progress.show(
                    text=f"axis {sample.axis_m:.4f} m, motion capture {mocap}; so far {max(axis) - min(axis):.3f} m"
                )
            source.pause(POLL_S)
    return samples


def _enter() -> bool:
    ready, _, _ = select.select([sys.stdin], [], [], 0.0)
    return bool(ready and sys.stdin.readline())


def report_centre(found: "Centre", config: "Config", file: Path, write: bool) -> None:
    """Print the findings and, if requested, write them into the configuration."""
    for sentence in found.found:
        click.echo(sentence)
    if found.problems:
        fail("\n".join((*found.problems, "nothing was written")))
    if not found.values:
        click.echo(f"{file}: drivers.rail is correct and was not changed")
        return
    for key, value in found.values.items():
        click.echo(
            f"drivers.rail.{key}: {str(value).lower() if isinstance(value, bool) else f'{value:.10g}'}"
            f"  (is {str(getattr(config.drivers.rail, key)).lower()})"
        )
    if "reversed" in found.values:
        click.echo(
            "or motion capture's y axis is the wrong way round: with pressure the arm bends towards -y. Look first."
        )
    if write:
        _write(found, file)
    else:
        click.echo(f"nothing was written; repeat with --write to change {file}")


def _write(found: "Centre", file: Path) -> None:
    from softarm.cli.shared.options import write
    from softarm.daemon.config.edit import with_values

    text = with_values(file.read_text(encoding="utf-8"), file, ("drivers", "rail"), found.values)
    write(file, text)
    click.echo(
        f"next: restart the daemon; `softarm doctor --config {file}` shows the distance between axis and cameras"
    )
