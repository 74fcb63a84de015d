"""`softarm evaluate`: the paper's 54 targets through the daemon's own tick, on the simulated robot."""

from pathlib import Path

import click

from cli.options import config_option, flown_model, json_option, model_option


@click.command()
@click.option("--policy", default="reach", show_default=True, help="Name, as `softarm policy list` shows it.")
@json_option
@config_option
@model_option
def evaluate(policy: str, json_file: Path | None, config_file: Path | None, model_file: Path | None) -> None:
    """Fly the 54 test targets from rest at cart positions 0, 0.1 and 0.2 m, in lockstep at 1200 Hz.

    Observer, policy, safety filter and failsafe are the daemon's own; only the devices are simulated.

    \b
    Examples:
      softarm evaluate --policy reach --json reach.json
      softarm evaluate --policy pid
    """
    import json

    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from cli.errors import fail
    from daemon import configuration, evaluation
    from policies.base import PolicyError
    from schemas.config import Config

    console = Console()
    try:
        config = configuration.load(config_file) if config_file else Config()
        model = flown_model(model_file)
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task(f"flying {policy}", total=evaluation.FLIGHTS)
            result = evaluation.evaluate(policy, config, model, lambda: progress.advance(task))
    except (configuration.ConfigurationError, PolicyError) as error:
        fail(str(error))
    success = result["success"]
    rows = (("z <= 0.70 m", success["in_range"]), ("z > 0.70 m", success["above"]), ("all", success["all"]))
    table = Table("targets", "reached", title=f"{policy}: 54 targets x 3 cart starts")
    for label, share in rows:
        table.add_row(label, f"{100 * share:.1f} %")
    console.print(table)
    console.print(
        f"highest tip {result['max_tip_z_m']:.3f} m, farthest cart {result['max_cart_m']:.3f} m, "
        f"{result['real_time_factor']:.0f}x real time"
    )
    if json_file is not None:
        json_file.write_text(json.dumps(result, indent=1) + "\n")
        console.print(f"wrote {json_file}")
