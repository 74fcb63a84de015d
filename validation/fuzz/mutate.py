"""Mutation of valid examples in the ways that break parsers, seeded so that a number identifies a case."""

import copy
import json
import math
from collections.abc import Sequence
from random import Random
from typing import Any

# Syntax characters, and numbers at the ends of their range.
_TOKENS = (
    b"\x00 \xff \xff\xff\xff\xff \x7f \x80 \r\n \r\n\r\n \n\n \t \xef\xbb\xbf \xed\xa0\x80 \xc0\x80 \xf4\x90\x80\x80 "
    b"{ } [ ] [[[[ {{{{ : , ,, : ; = - -- --- ... ? | > & &a *a <<: *a ! !!python/object:os.system !!float !!binary % "
    b"@ ` ' \" \\ \\u0000 \\ud800 # ~ null true yes NaN Infinity -Infinity nan inf 1e999 -1e999 1e-999 0x1F 0o7 1_0 "
    b"18446744073709551616 -9223372036854775809 99999999999999999999999999999999999 2001-01-01 60:60:60 .nan .inf"
).split(b" ")
_NUMBERS = (0, -1, 1, 2**31, -(2**31) - 1, 2**63, 2**64, 10**30, 10**400, 1e308, -1e308, 5e-324, 1e-9, -0.0)
SIZE_MAX = 1_000_000  # maximum bytes of a case
_ODD = (None, True, False, "", " ", "x", "yes", "1e-3", "nan", "\0", "\n", "\ud800", "é" * 300, math.nan, math.inf)


def of_bytes(random: Random, examples: Sequence[bytes]) -> bytes:
    """Return one or several of the examples with some bytes changed, sometimes with nothing left of them."""
    data = bytearray(random.choice(examples))
    for _ in range(random.choice((1, 1, 1, 2, 3, 8))):
        at, size = random.randint(0, len(data)), random.choice((1, 1, 2, 4, 8, 64, 1000))
        match random.randrange(8):
            case 0 if data:
                data[at % len(data)] ^= 1 << random.randrange(8)
            case 1:
                data[at : at + size] = b""
            case 2:
                data[at:at] = data[at : at + size] * random.choice((1, 1, 2, 50))
            case 3:
                data[at:at] = random.choice(_TOKENS) * random.choice((1, 1, 1, 3, 300))
            case 4:
                data[at : at + size] = random.randbytes(size)
            case 5:
                other = random.choice(examples)
                data[at:] = other[random.randint(0, len(other)) :]
            case 6:
                data = data[:at]
            case _:
                width = random.choice((1, 2, 4, 8))
                number = random.choice((0, 1, 2 ** (8 * width) - 1, 2 ** (8 * width - 1), random.randrange(256)))
                order = random.choice(("big", "little"))
                data[at : at + width] = (number % 2 ** (8 * width)).to_bytes(width, order)
    return bytes(data)


def of_tree(random: Random, tree: Any) -> Any:
    """Return a copy of plain data (dicts, lists, scalars) with one to three nodes changed."""
    root = [copy.deepcopy(tree)]
    for _ in range(random.choice((1, 1, 2, 3))):
        _change(random, *random.choice(_nodes(root)))
    return root[0]


def to_json(random: Random, tree: Any) -> bytes:
    """Return the data as JSON, sometimes with tokens that JSON does not allow."""
    data = json.dumps(tree, ensure_ascii=random.random() < 0.7).encode("utf-8", "surrogatepass")[:SIZE_MAX]
    return of_bytes(random, [data]) if random.random() < 0.2 else data


def odd(random: Random) -> Any:
    """Return an unexpected value."""
    match random.randrange(6):
        case 0 | 1:
            return random.choice(_NUMBERS)
        case 2 | 3:
            return random.choice(_ODD)
        case 4:
            return nested(random.choice((3, 60, 400)), random.choice(([], {})))
        case _:
            many = random.choice((0, 1, 12, 2000))
            return random.choice(([0] * many, {f"key{i}": i for i in range(many)}, "x" * (many * 20)))


def nested(depth: int, of: list[Any] | dict[str, Any]) -> Any:
    """Return lists or groups nested `depth` deep."""
    tree: Any = type(of)()
    for _ in range(depth):
        tree = [tree] if isinstance(of, list) else {"a": tree}
    return tree


def _nodes(root: list[Any]) -> list[tuple[Any, Any]]:
    """Return every place of a tree as its container and the key there."""
    found: list[tuple[Any, Any]] = []
    waiting: list[Any] = [root]
    while waiting:
        holder = waiting.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            found.append((holder, key))
            if isinstance(holder[key], dict | list):
                waiting.append(holder[key])
    return found


def _change(random: Random, holder: Any, key: Any) -> None:
    value = holder[key]
    match random.randrange(7):
        case 0 if isinstance(holder, dict):
            del holder[key]
        case 1 if isinstance(holder, dict):
            holder[random.choice((f"{key}x", str(key)[:-1], str(key).upper(), "", "\0", "a" * 400))] = value
        case 2 if isinstance(value, int | float):
            holder[key] = random.choice((-value, str(value), [value], value + 0.5 if abs(value) < 1e300 else 0))
        case 3 if isinstance(value, list) and value:
            holder[key] = random.choice((value * 2, value[:-1], value * 500 if len(value) < 20 else [], value[::-1]))
        case 4 if isinstance(holder, list):
            holder.insert(random.randint(0, len(holder)), copy.deepcopy(value))
        case 5:
            holder[key] = random.choice(([value], {"a": value}))
        case _:
            holder[key] = odd(random)
