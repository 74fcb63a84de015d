"""`softarm twin`: simulate the robot behind its real interfaces, with faults, in a separate process."""

import asyncio
from pathlib import Path

import click

from softarm.cli.operate.robots import faulty_body, list_faults, wire_fault
from softarm.cli.shared import completion
from softarm.cli.shared.interrupt import INTERRUPTED, leaves
from softarm.cli.shared.options import FILE, flown_model, load_config, model_option
from softarm.cli.shared.printing import print_json, print_option, waiting
from softarm.cli.verbs import Verbs

config = click.option("--config", "config_file", type=FILE, help="The daemon's configuration, which names the ports.")
LIST = "list"


@click.group(cls=Verbs, invoke_without_command=True)
@config
@model_option
@click.option("--reality", is_flag=True, help="Simulate the independent robot in MuJoCo (docs/reference/reality.md).")
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME[=VALUE]",
    shell_complete=completion.faults,
    help="Fault from the start; may be repeated; `list` shows all, with --reality those of that robot.",
)
@click.pass_context
def twin(
    context: click.Context, config_file: Path | None, model_file: Path | None, reality: bool, faults: tuple[str, ...]
) -> None:
    """Simulate the robot behind its real interfaces (serial line, TCP, Zenoh) in real time until Ctrl-C.

    A fault of an interface is one word (mocap_freeze). A fault of the robot has a dot: an effect of the simulator
    (rail.delay=0.09), or with --reality a quantity of that robot (rail.delay_s=0.09).

    \b
    Examples:
      softarm twin --config twin.yaml          then, in another terminal: softarm run --config twin.yaml
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
        raise click.UsageError("no ports given: use --config FILE (`softarm config new --twin` writes one)")
    _simulate(config_file, model_file, reality, faults)


def _simulate(config_file: Path, model_file: Path | None, reality: bool, faults: tuple[str, ...]) -> None:
    from softarm.common import realtime
    from softarm.drivers.twin.main import run_twin

    leaves("the simulated robot has ended; a connected daemon stops and reports it")
    config = load_config(config_file)
    on_wires = [wire_fault(text) for text in faults if "." not in text.partition("=")[0]]
    model = flown_model(model_file)
    body = faulty_body(model, reality, tuple(text for text in faults if "." in text.partition("=")[0]))
    # Real devices do not wait for other programs of this computer.
    realtime.outrank_other_programs(config.control.realtime_priority)
    ended = asyncio.run(run_twin(config, body, on_wires, lambda text: click.echo(f"softarm twin: {text}")))
    if ended + 128 == INTERRUPTED:
        raise KeyboardInterrupt


@twin.command()
@click.argument("name", metavar="NAME[=VALUE]", shell_complete=completion.faults)
@click.option(
    "--config", "config_file", type=FILE, required=True, help="The configuration that the twin was started with."
)
@print_option
def fault(name: str, config_file: Path, as_json: bool) -> None:
    """Switch on a fault of an interface while the twin runs; `clear` ends all of them. The daemon must run, too.

    Faults of the robot itself are set at the start: `softarm twin --fault`.

    \b
    Examples:
      softarm twin fault list --config twin.yaml
      softarm twin fault mocap_freeze=1.5 --config twin.yaml
      softarm twin fault mocap_drop_body=link3 --config twin.yaml
      softarm twin fault clear --config twin.yaml
    """
    from softarm.drivers.twin.cameras import switch

    if name == LIST:
        list_faults(reality=None)
        return
    message, endpoint = wire_fault(name), load_config(config_file).drivers.mocap.endpoint
    with waiting(f"contacting the twin at {endpoint}"):
        state = switch(endpoint, message)
    if as_json:
        print_json(state)
    else:
        click.echo(f"active faults: {', '.join(state['faults']) or 'none'}")
