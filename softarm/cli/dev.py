"""`softarm dev`: tools of softarm's makers."""

import click

from softarm.cli.gap.blind import blind
from softarm.cli.learn.checkpoint import export
from softarm.cli.learn.plan import plan
from softarm.cli.learn.soak import soak
from softarm.cli.verbs import Verbs


@click.group(cls=Verbs)
def dev() -> None:
    """Measure the diagnosis and the daemon, and write policy files: tools of softarm's makers.

    \b
    Examples:
      softarm dev soak --hours 1
      softarm dev export runs/reach-1/best.pt --out my-reach.onnx
    """


for verb in (blind, export, plan, soak):
    dev.add_command(verb)
