"""What the site has beside the pages: references made from the code, and the repository's files that pages link to."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
_OUTSIDE = re.compile(r"\]\(\.\./([\w./-]+?)(#[\w-]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the references, and every file outside docs/ that a page links to."""
    for name, made in REFERENCES.items():
        files.append(File.generated(config, name, content=made()))
    for page in tuple(files.documentation_pages()):
        for name, _ in _OUTSIDE.findall(page.content_string):
            path = ROOT / name
            if path.is_file() and files.get_file_from_path(f"files/{_shown(name)}") is None:
                files.append(File.generated(config, f"files/{_shown(name)}", content=path.read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead those links to the copies."""
    return _OUTSIDE.sub(lambda link: f"](files/{_shown(link[1])})" if (ROOT / link[1]).is_file() else link[0], markdown)


def _shown(name: str) -> str:
    """A name that a browser shows rather than saves, and that is no page of the site."""
    return name.replace("/", "-") + ".txt"


def configuration_keys() -> str:
    """Every key of softarm.yaml."""
    from softarm.daemon.config import keys

    rows = "\n".join(f"| `{row.key}` | {' | '.join(map(_cell, row[1:]))} |" for row in keys.rows())
    head = "| key | unit | allowed | default | meaning |\n|---|---|---|---|---|"
    lead = "What `softarm config units` prints; see [Configuration](configuration.md)."
    return f"# Every key of softarm.yaml\n\n{lead}\n\n{head}\n{rows}\n"


def rest_schemas() -> str:
    """Every request of the REST API and every body."""
    from softarm.daemon.api.app import ApiContext, create_app
    from softarm.daemon.control.inbox import Inbox
    from softarm.schemas.config import Config

    told = create_app(ApiContext(Config(), Inbox(), lambda: None)).openapi()
    return "\n".join(_rest(told))


def _rest(told: dict[str, Any]) -> Iterator[str]:
    yield "# REST, every request and body\n"
    yield "What the daemon's own page `/docs` shows, from the same schema; see [REST API](rest.md).\n"
    for path, methods in told["paths"].items():
        for method, request in methods.items():
            yield f"## {method.upper()} {path}\n\n{request.get('description') or request['summary']}\n"
            body = request.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema")
            if body is not None:
                yield f"Body: {_kind(body)}\n"
            for status, answer in request["responses"].items():
                schema = answer.get("content", {}).get("application/json", {}).get("schema")
                yield f"- {status}: {_cell(answer['description'])}{f', {_kind(schema)}' if schema else ''}"
            yield ""
    for name, schema in told["components"]["schemas"].items():
        yield f"## {name}\n\n{_cell(schema.get('description', ''))}\n"
        if schema.get("properties"):
            yield "| field | kind | |\n|---|---|---|"
            for field, of in schema["properties"].items():
                yield f"| `{field}` | {_kind(of)} | {_cell(of.get('description', ''))} |"
            yield ""


def _kind(schema: dict[str, Any]) -> str:
    """A JSON schema in a word."""
    if reference := schema.get("$ref"):
        name = reference.rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if several := schema.get("anyOf") or schema.get("oneOf"):
        return " or ".join(map(_kind, several))
    if values := schema.get("enum") or ([schema["const"]] if "const" in schema else []):
        return ", ".join(f"`{value}`" for value in values)
    inner = f" of {_kind(schema['items'])}" if isinstance(schema.get("items"), dict) else ""
    return f"{schema.get('type', 'any')}{inner}"


def _cell(text: object) -> str:
    """Text that ends no cell of a table."""
    return " ".join(str(text).split()).replace("|", "\\|")


REFERENCES: dict[str, Callable[[], str]] = {
    "configuration-keys.md": configuration_keys,
    "rest-schemas.md": rest_schemas,
}
