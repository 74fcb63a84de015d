"""YAML reader that returns plain data with the line of each key and item.

It reads YAML 1.1 like PyYAML, but 1e-3 is a number, keys are texts and dates stay texts. The size of a file is limited:
MAX_BYTES bytes, MAX_DEPTH nested levels, and MAX_ALIASED values behind aliases.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from yaml.constructor import SafeConstructor
from yaml.resolver import Resolver

# Keys and indices of items from the outside in; () is the file itself.
Place = tuple[str | int, ...]

MAX_DEPTH = 50
MAX_ALIASED = 10_000
# A file that people write has a few thousand.
MAX_BYTES = 2_000_000
# Number of reported errors of a file; the others are counted.
ERRORS_MAX = 20

_TOO_DEEP = f"it is nested too deeply (more than {MAX_DEPTH} levels)"
_CHECK = "check indentation, colons and quotes there"
# Half of a character beyond 16 bits.
_HALF = re.compile("[\ud800-\udfff]")
_TEXT = "tag:yaml.org,2002:str"
_MERGE = "tag:yaml.org,2002:merge"
_PLAIN_TAGS = (None, "!", "tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")


class FileError(Exception):
    """Errors of a file; `problems` holds one `FILE:LINE: key: error; allowed; next step` each.

    `rest` is the object of the file without its invalid values, or None, and `left_out` lists their places.
    """

    def __init__(self, problems: Iterable[str], rest: object = None, left_out: Iterable[Place] = ()) -> None:
        self.problems = tuple(problems)
        self.rest, self.left_out = rest, tuple(left_out)
        super().__init__("\n".join(self.problems))


class Mistake(NamedTuple):
    """Mistake at a place of a file. Its sentence is built on demand, since hints need a search."""

    place: Place
    line: int
    say: Callable[[], str]


class Document(NamedTuple):
    """Content of a file, with the line of each key."""

    path: Path
    data: Any
    lines: dict[Place, int]  # from 1
    mistakes: list[Mistake]  # errors of YAML itself; such a value is None

    def line(self, place: Place) -> int:
        """Return the line of a place, or of its innermost parent in the file."""
        return self.lines[self.known(place)]

    def known(self, place: Place) -> Place:
        """Return a place, or its innermost parent in the file."""
        while place not in self.lines:
            place = place[:-1]
        return place


def read(path: Path | str, instead: str) -> Document:
    """Read a file; `instead` is the next step in the message about a missing file.

    Raises:
        FileError: The file is missing, unreadable, too large or not valid YAML.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise FileError([f"{path}: has more than {MAX_BYTES / 1e6:g} MB; name a file that a person wrote"])
        return parse(content.decode("utf-8"), path)
    except FileNotFoundError:
        raise FileError([f"{path}: no such file; {instead}"]) from None
    except OSError as error:
        raise FileError([f"{path}: cannot be read ({error.strerror}); name a readable file"]) from None
    except UnicodeDecodeError as error:
        raise FileError([f"{path}: not UTF-8 text ({error.reason}); save it as UTF-8"]) from None


def parse(text: str, path: Path) -> Document:
    """Read a text; an empty text has no keys.

    Raises:
        FileError: The text is not valid YAML, or too large.
    """
    try:
        return _Reader(text, path, _FAST).document()
    except (yaml.YAMLError, UnicodeError):
        pass
    try:
        return _Reader(text, path, yaml.SafeLoader).document()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = " ".join(part for part in (error.context, error.problem) if part)
        where = f"{path}:{mark.line + 1 if mark else 1}"
        raise FileError([f"{where}: not valid YAML: {what}; {_CHECK}"]) from None
    except yaml.YAMLError as error:
        what = str(error).partition("\n")[0]
        raise FileError([f"{path}: not valid YAML: {what}; save it as plain text"]) from None


def refuse(document: Document, mistakes: Iterable[Mistake], rest: object = None) -> FileError:
    """Return the error with the first ERRORS_MAX mistakes, in the file's order, and the number of the others."""
    first: dict[tuple[int, Place], Callable[[], str]] = {}  # one error per place
    found = sorted(mistakes, key=lambda each: each.line)
    for place, line, say in found:
        first.setdefault((line, place), say)
    reported = []
    for (line, place), say in islice(first.items(), ERRORS_MAX):
        name = ".".join(map(str, place)) or "the file"
        # A key may have several lines.
        reported.append(" ".join(f"{document.path}:{line}: {name}: {say()}".split()))
    if len(first) > ERRORS_MAX:
        reported.append(f"{document.path}: and {len(first) - ERRORS_MAX} more; correct these first")
    return FileError(reported, rest, [place for place, _, _ in found])


class _Scalars(SafeConstructor, Resolver):
    """Resolver of plain scalars."""

    def __init__(self) -> None:
        SafeConstructor.__init__(self)
        Resolver.__init__(self)


_Scalars.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)
# libyaml is much faster. PyYAML's own parser reads a file with errors again, because it reports them better.
_FAST: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Reader:
    """Reader that processes the parser's events once."""

    def __init__(self, text: str, path: Path, loader: Any) -> None:
        self.events: Iterator[Any] = yaml.parse(text, loader)
        self.read = Document(path, {}, {(): 1}, [])
        self.scalars = _Scalars()
        # None while the anchored value is being read.
        self.anchors: dict[str, tuple[Place, Any] | None] = {}
        self.aliased = 0

    def document(self) -> Document:
        """Read the single document of a file."""
        # Start of the stream.
        next(self.events)
        if not isinstance(next(self.events), yaml.DocumentStartEvent):
            return self.read
        data = self._value(next(self.events), ())
        # End of the document.
        next(self.events)
        if isinstance(another := next(self.events), yaml.DocumentStartEvent):
            raise self._refuse(another, "expected a single document in the stream but found another document")
        return self.read._replace(data=data)

    def _value(self, event: Any, place: Place) -> Any:
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, place)
        if event.anchor is not None:
            self.anchors[event.anchor] = None
        if isinstance(event, yaml.ScalarEvent):
            value = self._scalar(event, place)
        elif len(place) >= MAX_DEPTH:
            raise self._refuse(event, _TOO_DEEP, "write it flatter")
        elif event.tag not in _PLAIN_TAGS:
            self._find(event, place, f"has the tag {event.tag}; remove it")
            self._skip(event, place)
            value = None
        else:
            value = self._mapping(place) if isinstance(event, yaml.MappingStartEvent) else self._sequence(place)
        if event.anchor is not None:
            self.anchors[event.anchor] = (place, value)
        return value

    def _sequence(self, place: Place) -> list[Any]:
        items: list[Any] = []
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            here = (*place, len(items))
            self.read.lines[here] = event.start_mark.line + 1
            items.append(self._value(event, here))
        return items

    def _mapping(self, place: Place) -> dict[str, Any]:
        data: dict[str, Any] = {}
        merged: list[tuple[Any, Place, dict[str, Any]]] = []
        while not isinstance(key := next(self.events), yaml.MappingEndEvent):
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarEvent):
                self._find(key, place, "a key must be a plain name")
                self._skip(key, place)
                self._skip(next(self.events), place)
                continue
            name = self._text(key)
            here = (*place, name)
            if here in self.read.lines:
                self._find(key, here, f"is given twice (first in line {self.read.lines[here]}); keep one")
                self._skip(next(self.events), place)
                continue
            self.read.lines[here] = line
            value = self._value(event := next(self.events), here)
            if self._tag(key) != _MERGE:
                data[name] = value
            elif isinstance(value, dict):
                merged.append((event, here, value))
            elif isinstance(value, list) and all(isinstance(each, dict) for each in value):
                merged += [(event, (*here, i), each) for i, each in enumerate(value)]
            else:
                self._find(event, here, "merges a value that is no group; name an anchor of a group")
        for event, source, group in merged:
            for name in [each for each in group if each not in data]:
                data[name] = group[name]
                self._repeat(event, (*source, name), (*place, name), group[name])
        return data

    def _scalar(self, event: Any, place: Place) -> Any:
        tag, text = self._tag(event), self._text(event)
        if tag == _TEXT:
            return text
        try:
            value = self.scalars.construct_object(yaml.ScalarNode(tag, text, event.start_mark, event.end_mark))
            # Fails for a number with too many digits to write it again.
            str(value)
        # LookupError and AttributeError come from tags that do not fit.
        except (yaml.YAMLError, ValueError, LookupError, AttributeError) as error:
            what = getattr(error, "problem", None) or error
            self._find(event, place, f"cannot be read ({what}); write a plain value")
            return None
        return value if isinstance(value, str | int | float | bool | None) else text

    def _text(self, event: Any) -> str:
        text = str(event.value)
        if _HALF.search(text):
            raise self._refuse(event, "it contains half a character", "write the whole character")
        return text

    def _tag(self, event: Any) -> Any:
        if event.tag in (None, "!"):
            return self.scalars.resolve(yaml.ScalarNode, event.value, event.implicit)  # type: ignore[no-untyped-call]
        return event.tag

    def _alias(self, event: Any, place: Place) -> Any:
        if event.anchor not in self.anchors:
            raise self._refuse(event, f"found undefined alias {event.anchor!r}")
        if (anchored := self.anchors[event.anchor]) is None:
            self._find(event, place, "refers to itself; write the values out")
            return None
        self._repeat(event, anchored[0], place, anchored[1])
        return anchored[1]

    def _repeat(self, event: Any, old: Place, new: Place, value: Any) -> None:
        """Register the lines of the value at `old` for its alias at `new`."""
        self.aliased += 1
        if self.aliased > MAX_ALIASED:
            raise self._refuse(event, f"its aliases stand for more than {MAX_ALIASED} values", "write the values out")
        self.read.lines.setdefault(new, self.read.lines[old])
        if isinstance(value, dict | list):
            if len(new) >= MAX_DEPTH:
                raise self._refuse(event, _TOO_DEEP, "write it flatter")
            for key in value if isinstance(value, dict) else range(len(value)):
                self._repeat(event, (*old, key), (*new, key), value[key])

    def _skip(self, event: Any, place: Place) -> None:
        """Skip a value with all its parts."""
        depth = 0
        while True:
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth == 0:
                return
            if len(place) + depth > MAX_DEPTH:
                raise self._refuse(event, _TOO_DEEP, "write it flatter")
            event = next(self.events)

    def _find(self, event: Any, place: Place, text: str) -> None:
        self.read.mistakes.append(Mistake(place, event.start_mark.line + 1, partial(str, text)))

    def _refuse(self, event: Any, what: str, instead: str = _CHECK) -> FileError:
        return FileError([f"{self.read.path}:{event.start_mark.line + 1}: not valid YAML: {what}; {instead}"])
