"""The leaderboard: a file of results that others extend and reproduce."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from pydantic import ValidationError

from softarm.common.revision import revision
from softarm.common.shares import Share
from softarm.evaluation.entries import CEILING, Entry
from softarm.evaluation.table import Comparison
from softarm.evaluation.tests import COLUMNS
from softarm.schemas.base import Strict

RANKED = "all"  # column that orders the entries


class LeaderboardError(ValueError):
    """A leaderboard that cannot be read; the text names the file and the remedy."""


class Row(Strict):
    """Results of one policy."""

    name: str
    sha256: tuple[str, ...]  # of its ONNX files, one for each seed; empty for a plug-in
    seeds: tuple[int, ...]
    results: dict[str, Share]  # by column of `softarm evaluate --json`
    date: str
    revision: str
    command: str

    def is_of(self, other: "Row") -> bool:
        """Return whether two rows are results of the same policy."""
        return self.sha256 == other.sha256 and (bool(self.sha256) or self.name == other.name)


class Board(Strict):
    """Content of a leaderboard file, best first."""

    entries: tuple[Row, ...] = ()


def rows(comparison: Comparison, found: Sequence[Entry], command: str) -> list[Row]:
    """Return the rows of a comparison that `command` has made, without the ceiling."""
    made = []
    for name, figures in comparison["policies"].items():
        if name == CEILING:
            continue
        row = Row(
            name=Path(name).name.removesuffix(".onnx"),
            sha256=tuple(sorted(each.sha256 for each in found if each.name == name and each.sha256 is not None)),
            seeds=tuple(comparison["seeds"][name]),
            results={column: figure["counted"] for column, figure in figures.items()},
            date=f"{datetime.now(UTC):%Y-%m-%d}",
            revision=revision(),
            command=command,
        )
        made.append(row)
    return made


def load(file: Path) -> Board:
    """Return the content of a leaderboard, empty if the file does not exist. Raises LeaderboardError."""
    try:
        return Board.model_validate_json(file.read_bytes())
    except FileNotFoundError:
        return Board()
    except (OSError, ValidationError) as error:
        what = str(error).partition("\n")[0]
        raise LeaderboardError(f"{file}: is no leaderboard ({what}); name a file of `--leaderboard`") from None


def merged(board: Board, new: Sequence[Row]) -> tuple[Board, list[str], bool]:
    """Add rows to a leaderboard, and compare those of known policies with their entries, which stay.

    Returns:
        The new content, a sentence for each row, and whether every known entry was reproduced.
    """
    entries, sentences, same = list(board.entries), [], True
    for row in new:
        known = next((each for each in board.entries if each.is_of(row)), None)
        if known is None:
            entries.append(row)
            sentences.append(f"{row.name}: added")
            continue
        said = [_difference(known, row, column) for column in row.results if not _agrees(known, row, column)]
        same = same and not said
        exact = all(known.results.get(column) in (None, figure) for column, figure in row.results.items())
        how = "reproduced, flight count by flight count" if exact else "reproduced within the entry's intervals"
        sentences.append(f"{row.name}: {'NOT reproduced: ' + '; '.join(said) if said else how}")
    entries.sort(key=lambda row: -(row.results[RANKED]["share"] or 0.0) if RANKED in row.results else 1.0)
    return Board(entries=tuple(entries)), sentences, same


def markdown(board: Board) -> str:
    """Return a leaderboard as a table: shares with their 95 % intervals, in percent."""
    used = [column for column in COLUMNS if any(column in row.results for row in board.entries)]
    head = ["policy", *(COLUMNS[column] for column in used), "SHA-256", "date", "revision", "command"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for row in board.entries:
        cells = [_cell(row.results.get(column)) for column in used]
        sums = ", ".join(f"`{each[:12]}`" for each in row.sha256) or "plug-in"
        lines.append(
            f"| {' | '.join([f'`{row.name}`', *cells, sums, row.date, row.revision[:8], f'`{row.command}`'])} |"
        )
    return "\n".join(lines)


def _agrees(known: Row, new: Row, column: str) -> bool:
    entry, value = known.results.get(column), new.results[column]["share"]
    if entry is None or entry["low"] is None or entry["high"] is None or value is None:
        return True
    return entry["low"] <= value <= entry["high"]


def _difference(known: Row, new: Row, column: str) -> str:
    now, then = new.results[column], known.results[column]
    return f"{column} {now['hits']} of {now['of']}, entry {then['hits']} of {then['of']}"


def _cell(figure: Share | None) -> str:
    if figure is None or figure["share"] is None or figure["low"] is None or figure["high"] is None:
        return ""
    return f"{100 * figure['share']:.1f} ({100 * figure['low']:.0f} to {100 * figure['high']:.0f})"
