"""`softarm twin`: the robot behind its wires, simulated, in a process of its own."""

from pathlib import Path

import click

from softarm.cli.errors import fail
from softarm.cli.options import FILE, flown_model, model_option
from softarm.cli.robots import independent_body


@click.command()
@click.option(
    "--config",
    "config_file",
    type=FILE,
    required=True,
    help="The daemon's own file: the twin answers at the ports that it names.",
)
@model_option
@click.option(
    "--reality", is_flag=True, help="Be the independent robot in MuJoCo, not the simulator (docs/reality.md)."
)
@click.option("--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE", help="Of --reality; again for more.")
def twin(config_file: Path, model_file: Path | None, reality: bool, faults: tuple[str, ...]) -> None:
    """Be the robot until Ctrl-C: serial line, rail axis over TCP, motion capture over Zenoh, in real time.

    \b
    Examples:
      softarm twin --config twin.yaml          then, beside it: softarm run --config twin.yaml
      softarm twin --config twin.yaml --reality --fault rail.delay_s=0.09
    """
    from softarm.daemon.config.configuration import ConfigurationError, load
    from softarm.daemon.shell import realtime
    from softarm.drivers.base import DeviceError
    from softarm.drivers.twin.main import run_twin

    if faults and not reality:
        raise click.UsageError("--fault is for the independent robot: add --reality")
    try:
        config = load(config_file)
        model = flown_model(model_file)
        body = independent_body(model, faults) if reality else None
        # Devices do not wait for other programs either.
        realtime.outrank_other_programs(config.control.realtime_priority)
        run_twin(config, model, lambda text: click.echo(f"softarm twin: {text}"), body)
    except (ConfigurationError, DeviceError) as error:
        fail(str(error))
