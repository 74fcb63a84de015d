"""A JSON schema in the words that Foxglove reads: one type for each field, nothing by reference, arrays of one kind.

What its reader meets beside these it refuses, and the whole topic with it (docs.foxglove.dev, MCAP, JSON schemas). A
field that may be null is of the type that it has otherwise, and not required.
"""

import json
from typing import Any

_KEPT = ("title", "description", "type", "enum", "const", "format")
Node = dict[str, Any]


def plain(schema: bytes) -> bytes:
    """The schema of an object again. Raises KeyError for a reference to what the schema does not define."""
    root: Node = json.loads(schema)
    return json.dumps(_plain(root, root.get("$defs", {})), allow_nan=False).encode()


def _plain(node: Node, named: Node) -> Node:
    if "$ref" in node:
        node = named[node["$ref"].rpartition("/")[2]] | {name: node[name] for name in _KEPT if name in node}
    if "anyOf" in node:
        first = next((one for one in node["anyOf"] if one.get("type") != "null"), {"type": "string"})
        return _plain(first, named) | {name: node[name] for name in ("title", "description") if name in node}
    made = {name: node[name] for name in _KEPT if name in node}
    made.setdefault("type", "string")  # of what is listed without one
    if made["type"] == "object":
        fields = node.get("properties", {})
        made["properties"] = {name: _plain(field, named) for name, field in fields.items()}
        made["required"] = [name for name in node.get("required", ()) if not _nullable(fields[name])]
    if made["type"] == "array":
        made["items"] = _plain(node.get("items") or (node.get("prefixItems") or [{"type": "string"}])[0], named)
    return made


def _nullable(node: Node) -> bool:
    return any(one.get("type") == "null" for one in node.get("anyOf", ()))
