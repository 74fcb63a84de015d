"""`softarm twin`: the robot behind its wires, simulated, in a process of its own."""

from pathlib import Path

import click

from cli.options import FILE, flown_model, model_option


@click.command()
@click.option("--config", "config_file", type=FILE, required=True,
              help="The daemon's own file: the twin answers at the ports that it names.")  # fmt: skip
@model_option
def twin(config_file: Path, model_file: Path | None) -> None:
    """Be the robot until Ctrl-C: serial line, rail axis over TCP, motion capture over Zenoh, in real time.

    \b
    Example:
      softarm twin --config twin.yaml          then, beside it: softarm run --config twin.yaml
    """
    from cli.errors import fail
    from daemon import realtime
    from daemon.configuration import ConfigurationError, load
    from drivers.base import DeviceError
    from drivers.twin.main import run_twin

    try:
        config = load(config_file)
        model = flown_model(model_file)
        # Devices do not wait for other programs either.
        realtime.outrank_other_programs(config.control.realtime_priority)
        run_twin(config, model, lambda text: click.echo(f"softarm twin: {text}"))
    except (ConfigurationError, DeviceError) as error:
        fail(str(error))
