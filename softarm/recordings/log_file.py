"""Summary of a log: its header, its size and its end."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from mcap.records import Channel, Message, Metadata
from pydantic import ValidationError

from softarm.recordings import mcap_file
from softarm.recordings.mcap_file import LogError
from softarm.schemas import log
from softarm.schemas.config import Config


@dataclass(frozen=True, slots=True)
class LogFile:
    """Summary of a log, made when it was opened."""

    path: Path
    metadata: Mapping[str, Mapping[str, str]]  # by name in schemas.log, last values
    policies: tuple[Mapping[str, str], ...]  # in order of use
    records: int  # complete messages
    t_first_ns: int | None  # first tick, CLOCK_MONOTONIC of the recording machine
    t_last_ns: int | None
    finished: bool  # False if the daemon was killed or is still writing

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """Open a log; one that ends within a record is read up to its last complete record.

        Raises:
            LogError: The file does not exist, is not MCAP, or has a newer format.
        """
        path = Path(path)
        metadata: dict[str, Mapping[str, str]] = {}
        policies: list[Mapping[str, str]] = []
        topics: dict[int, str] = {}
        records, first, last = 0, None, None
        for record in mcap_file.records(path):
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Metadata):
                metadata[record.name] = record.metadata
                if record.name == log.SOFTWARE:
                    _check_format(path, record.metadata)
                if record.name == log.POLICY:
                    policies.append(record.metadata)
            elif isinstance(record, Message):
                records += 1
                if topics[record.channel_id] == log.TICK:
                    first = record.log_time if first is None else first
                    last = record.log_time
        return cls(path, metadata, tuple(policies), records, first, last, mcap_file.is_finished(path))

    @property
    def config(self) -> Config:
        """Return the configuration used during the recording. Raises LogError if the log does not contain it."""
        try:
            return Config.model_validate_json(self.metadata[log.CONFIGURATION]["json"])
        except (KeyError, ValidationError) as error:
            what = str(error).partition("\n")[0]
            raise LogError(f"{self.path}: holds no configuration that can be read ({what}); name another log") from None

    @property
    def duration_s(self) -> float:
        """Return the time from the first to the last tick."""
        if self.t_first_ns is None or self.t_last_ns is None:
            return 0.0
        return (self.t_last_ns - self.t_first_ns) * 1e-9

    @property
    def ending(self) -> str:
        """Return one sentence on how the file ends."""
        whole = f"{self.records} complete records over {self.duration_s:.2f} s"
        if self.finished:
            return f"{self.path}: finished, {whole}"
        return (
            f"{self.path}: not finished (the daemon was killed, the disk was full or it still records), "
            f"{whole}; the recorder finishes it at its next start, `softarm logs recover` now"
        )


def _check_format(path: Path, software: Mapping[str, str]) -> None:
    format_ = software.get(log.FORMAT_KEY, "1")
    if not format_.isdecimal() or int(format_) > log.FORMAT:
        raise LogError(
            f"{path}: is a log of format {format_}, written by softarm {software.get('softarm', 'unknown')}; this "
            f"software reads format {log.FORMAT}: update it"
        )
