"""A log of ticks during writing."""

from collections.abc import Mapping
from typing import BinaryIO

from softarm.common import revision
from softarm.daemon.logbook import ticks
from softarm.daemon.logbook.thinning import Tick
from softarm.policies.base import PolicySpec
from softarm.recordings.channels import EVENT
from softarm.recordings.live import LiveFile, LogMessage
from softarm.schemas import log as names
from softarm.schemas.config import Config
from softarm.schemas.events import Entry

# Packages whose versions are recorded.
PACKAGES = ("numpy", "onnxruntime", "pyserial", "eclipse-zenoh", "pydantic", "mcap", "fastapi", "uvicorn")


class TickFile(LiveFile):
    """Live file of ticks with the metadata that a reader needs."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file, ticks.CHANNELS)
        self._splitter = ticks.Splitter()

    def head(
        self,
        config: Config,
        policy: PolicySpec | None,
        monotonic_ns: int,
        wall_ns: int,
        run: Mapping[str, str] | None = None,
    ) -> None:
        """Write the log's metadata: configuration, software, clocks, run and policy."""
        self.note(names.CONFIGURATION, {"json": config.model_dump_json()})
        self.note(names.SOFTWARE, {**revision.software(PACKAGES), names.FORMAT_KEY: str(names.FORMAT)})
        self.note(names.MACHINE, revision.machine())
        self.note(
            names.CLOCK,
            {
                "monotonic_ns": str(monotonic_ns),
                "wall_ns": str(wall_ns),
                "wall_minus_monotonic_ns": str(wall_ns - monotonic_ns),
            },
        )
        if run is not None:
            self.note(names.RUN, run)
        if policy is not None:
            self.policy(policy)
        self.flush()

    def write(self, tick: Tick) -> tuple[LogMessage, ...]:
        """Write a tick completely and return its messages, or raise EncodingError."""
        messages = self._splitter.split(*tick)
        for message in messages:
            self.add(message)
        return messages

    def entry(self, entry: Entry) -> None:
        """Write an entry of the event history."""
        self.add(LogMessage(EVENT.topic, entry.t_ns, entry.t_ns, EVENT.encode(entry)))

    def policy(self, spec: PolicySpec) -> None:
        """Note the policy of the following ticks."""
        self.note(names.POLICY, {"name": spec.name, "description": spec.description, "sha256": spec.sha256 or ""})
