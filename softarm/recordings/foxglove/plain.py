"""JSON schemas in the form that Foxglove reads: one type per field, no references, arrays of one type.

Foxglove rejects a topic with any other schema (docs.foxglove.dev, MCAP, JSON schemas). A field that may be null has its
other type and is not required.
"""

import json
from typing import Any

_KEPT = ("title", "description", "type", "enum", "const", "format")
Node = dict[str, Any]


def plain(schema: bytes) -> bytes:
    """Return the schema of an object in this form. Raises KeyError if a reference has no definition."""
    root: Node = json.loads(schema)
    return json.dumps(_plain(root, root.get("$defs", {})), allow_nan=False).encode()


def _plain(node: Node, named: Node) -> Node:
    if "$ref" in node:
        node = named[node["$ref"].rpartition("/")[2]] | {name: node[name] for name in _KEPT if name in node}
    if "anyOf" in node:
        first = next((one for one in node["anyOf"] if one.get("type") != "null"), {"type": "string"})
        return _plain(first, named) | {name: node[name] for name in ("title", "description") if name in node}
    made = {name: node[name] for name in _KEPT if name in node}
    made.setdefault("type", "string")  # of listed values without a type
    if made["type"] == "object":
        fields = node.get("properties", {})
        made["properties"] = {name: _plain(field, named) for name, field in fields.items()}
        made["required"] = [name for name in node.get("required", ()) if not _nullable(fields[name])]
    if made["type"] == "array":
        made["items"] = _plain(node.get("items") or (node.get("prefixItems") or [{"type": "string"}])[0], named)
    return made


def _nullable(node: Node) -> bool:
    return any(one.get("type") == "null" for one in node.get("anyOf", ()))
