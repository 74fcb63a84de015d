"""`softarm twin`: the robot behind its wires, simulated, in a process of its own; and what is to be wrong with it."""

from pathlib import Path

import click

from softarm.cli import completion
from softarm.cli.errors import fail
from softarm.cli.interrupt import INTERRUPTED, leaves
from softarm.cli.options import FILE, flown_model, model_option
from softarm.cli.printing import print_json, print_option, waiting
from softarm.cli.robots import faulty_body, list_faults, wire_fault
from softarm.cli.verbs import Verbs

config = click.option("--config", "config_file", type=FILE, help="The daemon's own file: it names the ports.")
LIST = "list"


@click.group(cls=Verbs, invoke_without_command=True)
@config
@model_option
@click.option(
    "--reality", is_flag=True, help="Be the independent robot in MuJoCo, not the simulator (docs/reality.md)."
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME[=VALUE]",
    shell_complete=completion.faults,
    help="What is wrong from the start; `list` shows them, with --reality its own; again for more.",
)
@click.pass_context
def twin(
    context: click.Context, config_file: Path | None, model_file: Path | None, reality: bool, faults: tuple[str, ...]
) -> None:
    """Be the robot until Ctrl-C: serial line, rail axis over TCP, motion capture over Zenoh, in real time.

    A fault of its wires is one word (mocap_freeze), one of the robot has a dot: an effect of the simulator
    (rail.delay=0.09), or with --reality a quantity of that robot (rail.delay_s=0.09).

    \b
    Examples:
      softarm twin --config twin.yaml          then, beside it: softarm run --config twin.yaml
      softarm twin --fault list
      softarm twin --config twin.yaml --fault arm.payload=0.05 --fault serial_garbage
      softarm twin --config twin.yaml --reality --fault rail.delay_s=0.09
      softarm twin fault mocap_freeze=1 --config twin.yaml          while it runs
    """
    if context.invoked_subcommand is not None:
        return
    if LIST in faults:
        list_faults(reality)
        return
    if config_file is None:
        raise click.UsageError("which ports? --config FILE, the daemon's own (`softarm config new --twin` writes one)")
    _be(config_file, model_file, reality, faults)


def _be(config_file: Path, model_file: Path | None, reality: bool, faults: tuple[str, ...]) -> None:
    from softarm.daemon.config.configuration import ConfigurationError, load
    from softarm.daemon.shell import realtime
    from softarm.drivers.base import DeviceError
    from softarm.drivers.twin.main import run_twin

    leaves("the robot is gone; a daemon that was connected stops and says so")
    try:
        config = load(config_file)
        on_wires = [wire_fault(text) for text in faults if "." not in text.partition("=")[0]]
        model = flown_model(model_file)
        body = faulty_body(model, reality, tuple(text for text in faults if "." in text.partition("=")[0]))
        # Devices do not wait for other programs either.
        realtime.outrank_other_programs(config.control.realtime_priority)
        ended = run_twin(config, None, lambda text: click.echo(f"softarm twin: {text}"), body, on_wires)
    except (ConfigurationError, DeviceError) as error:
        fail(str(error))
    if ended + 128 == INTERRUPTED:
        raise KeyboardInterrupt


@twin.command()
@click.argument("name", metavar="NAME[=VALUE]", shell_complete=completion.faults)
@click.option("--config", "config_file", type=FILE, required=True, help="The daemon's own file, which the twin has.")
@print_option
def fault(name: str, config_file: Path, as_json: bool) -> None:
    """Switch a fault of the wires on while the twin runs; `clear` ends all of them. The daemon has to run, too.

    Faults of the robot itself are its own from the start: `softarm twin --fault`.

    \b
    Examples:
      softarm twin fault list --config twin.yaml
      softarm twin fault mocap_freeze=1.5 --config twin.yaml
      softarm twin fault mocap_drop_body=link3 --config twin.yaml
      softarm twin fault clear --config twin.yaml
    """
    from softarm.daemon.config.configuration import ConfigurationError, load
    from softarm.drivers.base import DeviceError
    from softarm.drivers.twin.remote import switch

    if name == LIST:
        list_faults(reality=None)
        return
    try:
        message, endpoint = wire_fault(name), load(config_file).drivers.mocap.endpoint
        with waiting(f"asking the twin behind {endpoint}"):
            state = switch(endpoint, message)
    except (ConfigurationError, DeviceError) as error:
        fail(str(error))
    if as_json:
        print_json(state)
    else:
        click.echo(f"now wrong: {', '.join(state['faults']) or 'nothing that lasts'}")
