"""`softarm bench`: measurements, side by side with a peer where there is one."""

from pathlib import Path

import click

from cli.options import json_option, model_option


@click.group()
def bench() -> None:
    """Measure the control loop or the simulator.

    \b
    Examples:
      softarm bench loop --seconds 60 --json loop.json
      softarm bench simulator --json simulator.json
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

    import benchmarks.loop as measurement
    from cli.errors import fail
    from cli.rig import RigError

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
    import benchmarks.simulator as measurement

    measurement.run(json_file, quick)
