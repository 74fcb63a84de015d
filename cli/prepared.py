"""A configuration that a daemon starts with here and now."""

from pathlib import Path
from typing import TYPE_CHECKING

from softarm.cli.errors import fail

if TYPE_CHECKING:
    from softarm.schemas.config import Config


def prepared(file: Path | None, wires: bool) -> "Config":
    """Read it, the defaults without a file. Ends the command with all that would keep the daemon from starting.

    wires: the robot's, else it is simulated in this process.
    """
    from softarm.daemon.shell import preflight

    found = preflight.look(file, wires)
    if found.problems:
        fail("\n".join(found.problems))
    return found.config
