"""Parameter types and options that several verbs share."""

from pathlib import Path

import click

FILE = click.Path(path_type=Path, dir_okay=False)

json_option = click.option("--json", "json_file", type=FILE, help="Write the results to this file.")
config_option = click.option("--config", "config_file", type=FILE, help="The YAML file; default values without.")
model_option = click.option(
    "--model",
    "model_file",
    type=FILE,
    help="Model of the robot: a file, or a shipped name such as no-delay (default: seed).",
)
