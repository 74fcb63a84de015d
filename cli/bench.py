"""`softarm bench`: measurements, side by side with a peer where there is one."""

from pathlib import Path

import click

from softarm.cli.options import json_option, model_option


@click.group()
def bench() -> None:
    """Measure the control loop, the simulator or the training.

    \b
    Examples:
      softarm bench loop --seconds 60 --json loop.json
      softarm bench simulator --json simulator.json
      softarm bench train --json train.json
    """


@bench.command()
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(5, 3600), help="For each part.")
@json_option
@model_option
def loop(seconds: float, json_file: Path | None, model_file: Path | None) -> None:
    """Punctuality of the loop on the twin, alone and with the API hammered.

    \b
    Example:
      softarm bench loop --seconds 60 --json loop.json
    """
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    import softarm.benchmarks.loop as measurement
    from softarm.cli.errors import fail
    from softarm.cli.rig import RigError

    console = Console()
    try:
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("ticking", total=1.0)
            result = measurement.run(
                seconds, json_file, lambda share: progress.update(task, completed=share), model_file
            )
    except RigError as error:
        fail(str(error))
    table = Table("p50 / p99 / max", *result)
    for label, name in (
        ("compute (ms)", "compute_ms"),
        ("lateness (ms)", "lateness_ms"),
        ("lateness of a bare loop beside it (ms)", "bare_loop_lateness_ms"),
        ("sensor to command (ms)", "sensor_to_command_ms"),
    ):
        table.add_row(label, *("{p50:.2f} / {p99:.2f} / {max:.2f}".format(**part[name]) for part in result.values()))
    for label, name in (("ticks", "ticks"), ("missed ticks", "missed_ticks"), ("ticks with a policy", "policy_ticks")):
        table.add_row(label, *(str(part[name]) for part in result.values()))
    console.print(table)


@bench.command()
@json_option
@click.option("--quick", is_flag=True, help="A few seconds, to see that it runs; the figures are rough.")
def simulator(json_file: Path | None, quick: bool) -> None:
    """Control steps a second against MuJoCo's rollout at equal accuracy, in one run on this machine.

    \b
    Example:
      softarm bench simulator --json simulator.json
    """
    import softarm.benchmarks.simulator as measurement

    measurement.run(json_file, quick)


@bench.command()
@json_option
@click.option("--seed", "seeds", type=click.IntRange(min=0), multiple=True, help="Again for more.  [default: 1 to 5]")
@click.option("--frames", type=click.IntRange(min=1), help="Give a seed up after so many control steps of its robots.")
def train(json_file: Path | None, seeds: tuple[int, ...], frames: int | None) -> None:
    """Wall time from a run's start to the paper's 94/50/80 %, held over three more evaluations; beside rl_games.

    \b
    Example:
      softarm bench train --json train.json
    """
    import softarm.benchmarks.training as measurement

    result = measurement.run(json_file, seeds or measurement.SEEDS, frames or measurement.FRAMES_MOST, click.echo)
    theirs = result["rl_games_steps_per_s"]
    beside = "" if theirs is None else f"; rl_games, the seed's settings: {theirs:,.0f}"
    click.echo(f"control steps of single robots a second: {result['steps_per_s']:,.0f}{beside}")
