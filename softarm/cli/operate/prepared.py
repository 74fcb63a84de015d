"""Start-up checks of a configuration, for verbs that start a daemon."""

from pathlib import Path
from typing import TYPE_CHECKING

from softarm.cli.shared.errors import fail

if TYPE_CHECKING:
    from softarm.schemas.config import Config


def prepared(file: Path | None, wires: bool, port: int | None = None) -> "Config":
    """Return a configuration that a daemon can start with; end the command with all problems otherwise.

    Args:
        file: The YAML file; None for the default values.
        wires: The robot is behind real interfaces, not simulated in this process.
        port: Port of the API, instead of the file's.
    """
    from softarm.daemon.runtime import preflight

    found = preflight.look(file, wires, port=port)
    if found.problems:
        fail("\n".join(found.problems))
    return found.config
