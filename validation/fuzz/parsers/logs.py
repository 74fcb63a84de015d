"""Recordings: MCAP files as read for listing, recovery, replay and diagnosis."""

from functools import cache
from pathlib import Path
from random import Random

from validation.fuzz import mutate
from validation.fuzz.parsers.base import Parser, folder, parser, written


@cache
def example() -> bytes:
    """Return a short flight as a killed recorder leaves it, without chunks and end."""
    from softarm.daemon.control.records import Tick
    from softarm.daemon.logbook.ticks import TickFile
    from softarm.daemon.runtime.offline import Lockstep
    from softarm.policies.hold import Hold
    from softarm.schemas.config import Config

    ticks: list[Tick] = []
    Lockstep(Config(), Hold(), record=lambda *tick: ticks.append(tick)).arm()
    path = folder() / "live.mcap"
    with path.open("wb") as file:
        live = TickFile(file)
        live.head(Config(), Hold.spec, 5, 7)
        for tick in ticks:
            live.write(tick)
        live.flush()
    return path.read_bytes()


@cache
def examples() -> list[bytes]:
    """Return the unfinished flight and the finished one, with chunks and an index."""
    from softarm.recordings import log_file

    path = written("example.mcap", example())
    log_file.finish(path)
    return [example(), path.read_bytes()]


def _draw(random: Random) -> bytes:
    return mutate.of_bytes(random, examples())


@parser("log.listing")
def _listed() -> Parser:
    from softarm.recordings.log_file import listing

    def take(data: bytes) -> None:
        path = written("logs.d.mcap", data)
        assert path.name in {entry.name for entry in listing(path.parent)}

    return Parser(_draw, take, ())


@parser("log.recover")
def _recovered() -> Parser:
    """Return the parser of `softarm logs recover`: the file is complete afterwards, or rejected with a message."""
    from softarm.recordings import log_file, mcap_file

    def take(data: bytes) -> None:
        path = written("cut.mcap", data)
        before = log_file.recover(path)
        if before.finished:
            assert len(list(mcap_file.messages(path))) == before.records

    return Parser(_draw, take, (mcap_file.LogError,))


@parser("log.replay")
def _replayed() -> Parser:
    """Return the parser of `softarm logs replay`: a log's configuration and every tick of it."""
    from softarm.daemon.logbook import logs
    from softarm.daemon.runtime.replay import replay
    from softarm.policies.base import PolicyError
    from softarm.policies.hold import Hold
    from softarm.recordings.mcap_file import LogError

    def take(path: Path) -> None:
        log = logs.read(path)
        replay(log.ticks(), log.config, lambda name: Hold())

    return Parser(_draw, lambda data: take(written("replay.mcap", data)), (LogError, PolicyError))


@parser("log.diagnose")
def _diagnosed() -> Parser:
    from softarm.diagnosis.data import mcap
    from softarm.diagnosis.data.trials import TrialError

    return Parser(_draw, lambda data: mcap.read(written("trial.mcap", data)), (TrialError,))


@parser("log.limits")
def _limits() -> Parser:
    """Return the parser of `softarm check --logs`: the limits of the rail that recordings show."""
    from softarm.daemon.limits.findings import findings
    from softarm.diagnosis.data.read import rail_motions
    from softarm.diagnosis.data.trials import TrialError

    def take(data: bytes) -> object:
        return findings(rail_motions([written("motion.mcap", data)])).patch()

    return Parser(_draw, take, (TrialError,))
