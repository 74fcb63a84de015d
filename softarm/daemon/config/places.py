"""Files that the daemon keeps outside its logs."""

import os
import re
from collections.abc import Mapping
from pathlib import Path

from softarm.schemas.config import Config


def latch_path(config: Config, environment: Mapping[str, str] = os.environ) -> Path:
    """Return the file of the emergency stop's latch: in the service's state directory, otherwise next to the logs.

    The axis names the file: a robot has one axis, whichever configuration and port its daemon uses.
    """
    directory = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    rail = config.drivers.rail
    name = re.sub(r"[^A-Za-z0-9.-]", "_", f"stop-{rail.host}-{rail.port}")
    return (Path(directory) if directory else config.recorder.directory) / f"{name}.json"
