"""`softarm twin`: simulate the robot behind its real interfaces, with faults, in a separate process."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.shared import completion
from softarm.cli.shared.console import (
    FILE,
    WIDE,
    flown_model,
    load_config,
    model_option,
    print_json,
    print_option,
    print_table,
    typed,
    waiting,
)
from softarm.cli.shared.errors import INTERRUPTED, fail, failing, leaves

if TYPE_CHECKING:
    from softarm.drivers.bodies.base import Body
    from softarm.schemas.model import Model

config = click.option("--config", "config_file", type=FILE, help="The daemon's configuration, which names the ports.")
LIST = "list"


@click.group(invoke_without_command=True)
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
        if options := typed():
            verb = f"softarm twin {context.invoked_subcommand}"
            raise click.UsageError(f"{options[0]} goes without a verb, or after it: `{verb} --help` lists its options")
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
    of_robot = tuple(text for text in faults if "." in text.partition("=")[0])
    on_wires = [wire_fault(text) for text in faults if text not in of_robot]
    model = flown_model(model_file)
    body = independent_body(model, of_robot) if reality else simulated_body(model, of_robot)
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


def independent_body(model: "Model | None", faults: tuple[str, ...]) -> "Body":
    """Return the independent robot; end the command with a sentence if MuJoCo is missing or a fault is invalid."""
    try:
        from softarm.drivers.bodies.independent import IndependentBody
        from softarm.evaluation.robots import with_faults
        from softarm.reality.parameters import of_model
        from softarm.schemas.model import Model

        return IndependentBody(with_faults(of_model(model or Model()), faults))
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        fail("--reality needs the package 'mujoco': pip install 'softarm[mujoco]'")
    except ValueError as error:
        fail(f"--reality: {error}")


def simulated_body(model: "Model | None", faults: tuple[str, ...]) -> "Body":
    """Return the simulator's robot with faults; end the command if a fault is invalid."""
    from softarm.drivers.bodies.simulated import SimulatedBody
    from softarm.evaluation.robots import with_effects
    from softarm.schemas.model import Model

    with failing(ValueError):
        return SimulatedBody(with_effects(model or Model(), faults))


def wire_fault(text: str) -> bytes:
    """Return a fault of the twin's wires as the message for the twin; end the command with a sentence if unknown."""
    from softarm.drivers.twin.faults import message

    try:
        return message(text)
    except ValueError as error:
        fail(f"{error}; `softarm twin --fault list` describes each fault")


def list_faults(reality: bool | None) -> None:
    """Print the faults of the wires, and those of the independent or the simulated robot unless reality is None."""
    from softarm.drivers.twin.faults import described

    columns = ("fault", "VALUE", "meaning")
    print_table(columns, described(), "faults of the wires", WIDE)
    if reality:
        print_table(columns, _independent(), "faults of the independent robot (--reality)", WIDE)
    elif reality is not None:
        print_table(columns, _simulated(), "faults of the simulated robot", WIDE)


def _independent() -> list[tuple[str, str, str]]:
    from softarm.reality.parameters import GROUPS, RobotParameters, of

    robot = RobotParameters()
    groups = {name: type(part) for name in robot.__dataclass_fields__ if type(part := getattr(robot, name)) in GROUPS}
    return [
        (f"{group}.{name}", str(each), each.meaning)
        for group, kind in groups.items()
        for name, each in of(kind).items()
    ]


def _simulated() -> list[tuple[str, str, str]]:
    from softarm.simulator.effects import REGISTRY

    rows = []
    for name, effect in REGISTRY.items():
        rows += [(name, "" if effect.parameters else "takes none", effect.meaning)]
        rows += [(f"  .{p.name}", f"{p}; {p.exemplar:g} without", p.meaning) for p in effect.parameters]
    return rows
