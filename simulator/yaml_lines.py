"""YAML as plain data, and the line at which each key and item stands."""

import re
from typing import Any, NamedTuple

import yaml

Place = tuple[str | int, ...]


class YamlError(Exception):
    """Why a text is no YAML that a file of ours could be, and in which line."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.line = line


class Document(NamedTuple):
    """What a file says, and where; `()` is the file itself."""

    data: Any
    lines: dict[Place, int]

    def line(self, place: Place) -> int:
        """The line of a place, or of the innermost one around it that stands in the file."""
        while place not in self.lines:
            place = place[:-1]
        return self.lines[place]


def parse(text: str) -> Document:
    """Read a text; an empty one holds no keys. Raises YamlError."""
    lines: dict[Place, int] = {(): 1}
    try:
        loader = _Loader(text)  # refuses what is not printable
        node = loader.get_single_node()
        return Document({} if node is None else _plain(loader, node, (), lines, ()), lines)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise YamlError(mark.line + 1 if mark else 1, str(error.problem or error.context)) from None
    except (yaml.YAMLError, ValueError) as error:
        raise YamlError(1, str(error).partition("\n")[0]) from None
    except RecursionError:
        raise YamlError(1, "it is nested too deeply") from None


class _Loader(yaml.SafeLoader):
    """YAML 1.1 as PyYAML reads it, plus the numbers that it takes for texts (1e-3)."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def _plain(
    loader: _Loader, node: yaml.Node, place: Place, lines: dict[Place, int], above: tuple[yaml.Node, ...]
) -> Any:
    """Turn a node into plain data and note the lines of its keys or items."""
    if node in above:
        raise yaml.MarkedYAMLError(problem="it refers to itself", problem_mark=node.start_mark)
    if isinstance(node, yaml.MappingNode):
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="a key must be a plain name", problem_mark=key_node.start_mark)
            key = str(key_node.value)
            if key in data:
                raise yaml.MarkedYAMLError(problem=f"{key} stands twice", problem_mark=key_node.start_mark)
            lines[*place, key] = key_node.start_mark.line + 1
            data[key] = _plain(loader, value_node, (*place, key), lines, (*above, node))
        return data
    if isinstance(node, yaml.SequenceNode):
        for i, item in enumerate(node.value):
            lines[*place, i] = item.start_mark.line + 1
        return [_plain(loader, item, (*place, i), lines, (*above, node)) for i, item in enumerate(node.value)]
    try:
        value = loader.construct_object(node)
    except (ValueError, LookupError, AttributeError):  # PyYAML's, of tags that do not fit: `!!int` of nothing, dates
        raise yaml.MarkedYAMLError(problem=f"{node.value!r} cannot be read", problem_mark=node.start_mark) from None
    return value if isinstance(value, str | int | float | bool | None) else str(node.value)
