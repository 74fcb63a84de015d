"""`softarm dev export`: a checkpoint of a training run as an ONNX policy."""

from pathlib import Path

import click

from softarm.cli.shared.interrupt import NOTHING, leaves
from softarm.cli.shared.options import FILE
from softarm.cli.shared.printing import waiting


@click.command(short_help="Write a checkpoint as an ONNX policy.")
@click.argument("checkpoint", type=FILE)
@click.option("--out", type=FILE, required=True, help="The ONNX file to write.")
def export(checkpoint: Path, out: Path) -> None:
    """Write the policy of a training checkpoint (latest.pt or best.pt) as an ONNX file that describes itself.

    \b
    Example:
      softarm dev export runs/reach-1/best.pt --out my-reach.onnx
    """
    leaves(NOTHING)
    with waiting(f"reading {checkpoint}"):
        from softarm.training.record.export import export_checkpoint

        export_checkpoint(checkpoint, out)
    click.echo(f"wrote {out}")
