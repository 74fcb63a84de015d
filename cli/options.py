"""Parameter types and options that several verbs share."""

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from softarm.cli.completion import models
from softarm.cli.errors import fail
from softarm.common import files

if TYPE_CHECKING:
    from softarm.schemas.model import Model

FILE = click.Path(path_type=Path, dir_okay=False)
INPUT = click.Path(path_type=Path)
FOLDER = click.Path(path_type=Path, file_okay=False)

json_option = click.option("--json", "json_file", type=FILE, help="Write the results to this file.")
config_option = click.option("--config", "config_file", type=FILE, help="The YAML file; default values without.")
model_option = click.option(
    "--model",
    "model_file",
    type=FILE,
    shell_complete=models,
    help="Model of the robot: a file, or a shipped name such as no-delay (default: seed).",
)


def typed() -> list[str]:
    """What of the running verb's arguments and options stood on its command line, by the names that people type."""
    context = click.get_current_context()
    parameters = ((each, context.get_parameter_source(each.name or "")) for each in context.command.params)
    return [
        each.human_readable_name if isinstance(each, click.Argument) else each.opts[0]
        for each, source in parameters
        if source is ParameterSource.COMMANDLINE
    ]


def load_model(file: Path) -> "Model":
    """A model by its file or shipped name. Ends the command with a sentence when there is none, or it is not sound."""
    from softarm.simulator import model_file

    try:
        return model_file.load(file)
    except model_file.ModelFileError as error:
        fail(str(error))


def flown_model(file: Path | None) -> "Model | None":
    """The model of a robot that the real loop flies; None without a file. Says what it cannot show.

    Ends the command with a sentence when there is no such model, or it is not this robot's.
    """
    from softarm.schemas.messages import BODY_NAMES

    if file is None:
        return None
    model = load_model(file)
    if model.arm.links != len(BODY_NAMES) - 1:
        fail(f"{file}: has {model.arm.links} links; the daemon flies an arm of {len(BODY_NAMES) - 1} marker sets")
    clock = [name for name in model.effects if name.startswith("clock.")]
    if clock:
        click.echo(f"{', '.join(clock)}: not simulated here, the control loop that flies is the real one", err=True)
    return model


def write_json(file: Path | None, data: object) -> None:
    """Write what --json asks for, and say so. Ends the command with a sentence when it cannot be written."""
    if file is not None:
        write(file, json.dumps(data, indent=1) + "\n")


def write(file: Path, text: str) -> None:
    """Write a file, and say so. Ends the command with a sentence when it cannot be written."""
    write_bytes(file, text.encode())


def write_bytes(file: Path, content: bytes) -> None:
    """Write a file, and say so, as `write` does."""
    try:
        files.write_bytes(file, content)
    except OSError as error:
        fail(f"{error.filename}: cannot be written ({error.strerror}); name another place")
    click.echo(f"wrote {file}")


def check_places(*places: Path | None) -> None:
    """Before minutes of work: can the results be put there? Ends the command with a sentence where not."""
    for file in places:
        if file is not None and not file.parent.is_dir():
            fail(f"{file}: there is no folder {file.parent}; make it, or name another place")


def token_of(file: Path | None) -> str | None:
    """The API's token: the file's, else $SOFTARM_TOKEN."""
    if file is None:
        return os.environ.get("SOFTARM_TOKEN")
    try:
        return file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        fail(f"--token-file {file}: cannot be read ({error}); name the file of the daemon's api.token_file")
