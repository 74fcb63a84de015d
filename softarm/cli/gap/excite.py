"""`softarm excite`: play excitations on the robot or a simulated one, and record them."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from softarm.cli.operate.twin import independent_body
from softarm.cli.shared.completion import excitations
from softarm.cli.shared.console import FILE, FOLDER, config_option, flown_model, load_config, model_option, prepared
from softarm.cli.shared.errors import fail, failing, leaves
from softarm.common.processes import bar

if TYPE_CHECKING:
    from softarm.schemas.goals import GoalStatus


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=excitations)
@config_option
@click.option("--simulated", is_flag=True, help="Use a robot simulated in this process, as fast as possible.")
@click.option("--reality", is_flag=True, help="Use the independent robot in MuJoCo (docs/reference/reality.md).")
@click.option(
    "--fault", "faults", multiple=True, metavar="GROUP.QUANTITY=VALUE", help="Fault of --reality; repeatable."
)
@model_option
@click.option("--plan", type=FILE, help="Play the next experiment of this verdict.json.")
@click.option("--logs", type=FOLDER, help="Folder for recordings (default: the configuration's recorder.directory).")
@click.option("--list", "show", is_flag=True, help="List all excitations.")
def excite(
    names: tuple[str, ...],
    config_file: Path | None,
    simulated: bool,
    reality: bool,
    faults: tuple[str, ...],
    model_file: Path | None,
    plan: Path | None,
    logs: Path | None,
    show: bool,
) -> None:
    """Play the excitations NAME and record each: the arm is armed, moves, and is disarmed again.

    The daemon's own safety filter, failsafe and recorder run. Its API answers, so `softarm stop` works. Before an
    excitation that moves the cart, the cart moves to the middle of the rail.

    \b
    Examples:
      softarm excite --list
      softarm excite seed --config softarm.yaml        on the robot, about half a minute
      softarm excite seed rail-steps both --config softarm.yaml --logs campaign
      softarm excite rail-chirp --simulated            on a simulated robot
      softarm excite seed --reality --fault arm.payload_kg=0.03     on the independent robot
      softarm excite --plan verdict.json --config softarm.yaml    the next experiment of `softarm diagnose`
    """
    from softarm.daemon.play import length_s, play, play_simulated
    from softarm.daemon.runtime.devices import real_devices
    from softarm.schemas.excitation import EXCITATIONS

    if show:
        for excitation in EXCITATIONS.values():
            click.echo(f"{excitation.name:20s} {excitation.duration_s:5.1f} s  {excitation.description}")
        return
    if plan is not None:
        if names:
            raise click.UsageError("NAME or --plan, not both")
        names = (_planned(plan),)
    if not names:
        raise click.UsageError("no excitation named: `softarm excite --list` shows all")
    if config_file is None and not (simulated or reality):
        raise click.UsageError("no robot chosen: use --config FILE for real devices, --simulated, or --reality")
    if model_file is not None and not (simulated or reality):
        raise click.UsageError("--model is for a simulated robot: add --simulated or --reality")
    if faults and not reality:
        raise click.UsageError("--fault is for the independent robot: add --reality")
    stopped = "" if simulated or reality else "the cart was braked, the muscle vented, the drive is off; "
    leaves(f"{stopped}recordings are kept; the last one is incomplete")
    with failing(RuntimeError):
        config = load_config(config_file) if simulated or reality else prepared(config_file, wires=True)
        if logs is not None:
            recorder = config.recorder.model_copy(update={"directory": logs})
            config = config.model_copy(update={"recorder": recorder})
        lengths_s = [length_s(config, name) for name in names]  # refuses unknown names before the first one plays
        model = flown_model(model_file)
        recorded = []
        for name, total_s in zip(names, lengths_s, strict=True):
            body = independent_body(model, faults) if reality else None
            with bar(f"playing {name}", total_s) as shown:
                if simulated or reality:
                    status, log = play_simulated(config, name, model, shown.show, body)
                else:
                    status, log = play(config, name, real_devices(config), shown.show)
            _report(name, status, log)
            recorded.append(log)
    _print_next([log for log in recorded if log is not None], plan)


def _report(name: str, status: "GoalStatus", log: Path | None) -> None:
    """Print the result of an excitation; end the command with a sentence if it was not completed."""
    if status.state != "reached":
        fail(f"{name} was not completed: {status.state}, {status.reason}; its recording so far is {log}")
    click.echo(f"played {name}, {status.time_s:.1f} s; recorded {log}" if log else f"played {name}; nothing recorded")


def _print_next(logs: list[Path], plan: Path | None) -> None:
    """Print the commands that analyse the recordings."""
    if not logs:
        return
    recorded = shlex.join(map(str, logs))
    if plan is not None:
        new = plan.with_name(f"{plan.stem}-next.json")
        click.echo(f"next: softarm diagnose {recorded} --json {shlex.quote(str(new))}")
        click.echo(f"(to use all data, also name the recordings behind {plan}, before {recorded})")
        return
    click.echo(f"next: softarm identify {recorded} --out model.yaml")
    if len(logs) > 1:
        click.echo(f"or:   softarm diagnose {recorded} --report report.html")


def _planned(plan: Path) -> str:
    """Return the excitation that a verdict asks for next; end the command with a sentence if there is none."""
    from pydantic import ValidationError

    from softarm.schemas.excitation import EXCITATIONS
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
    name, expect = verdict.next_experiment.excitation, verdict.next_experiment.expect
    if name not in EXCITATIONS:
        # Without an expectation the name states that none separates the effects.
        problem = f"no excitation {name!r}; record the motion of another rig by hand" if expect else name
        fail(f"{plan}: {problem}, or name an excitation of the robot: `softarm excite --list` shows all")
    for effect, expected in expect.items():
        click.echo(f"if {effect}: {expected}")
    return name
