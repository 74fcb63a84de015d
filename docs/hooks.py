"""Additions to the site: references generated from the code, and the repository's files that pages link to."""

import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
_LINK = re.compile(r"\]\((\.\./[\w./-]+?)(#[\w-]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the generated references, and a copy of every file outside docs/ that a page links to."""
    for name, generate in REFERENCES.items():
        files.append(File.generated(config, name, content=generate()))
    for page in tuple(files.documentation_pages()):
        for target, _ in _LINK.findall(page.content_string):
            name = _outside(page.src_uri, target)
            if name and files.get_file_from_path(_copy(name)) is None:
                content = (ROOT / name).read_text(encoding="utf-8")
                files.append(File.generated(config, _copy(name), content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point the links to files outside docs/ at their copies."""
    here = page.file.src_uri

    def replace(link: re.Match[str]) -> str:
        name = _outside(here, link[1])
        return f"]({posixpath.relpath(_copy(name), posixpath.dirname(here))})" if name else link[0]

    return _LINK.sub(replace, markdown)


def _outside(page: str, target: str) -> str | None:
    """Return the path of the file outside docs/ that a link of a page leads to, or None if there is none."""
    name = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return name if not name.startswith(("docs/", "../")) and (ROOT / name).is_file() else None


def _copy(name: str) -> str:
    """Return the path of a copy that a browser displays instead of saving it."""
    return f"files/{name.replace('/', '-')}.txt"


def configuration_keys() -> str:
    """Return the page with every key of softarm.yaml."""
    from softarm.daemon.config import keys

    rows = "\n".join(f"| `{row.key}` | {' | '.join(map(_cell, row[1:]))} |" for row in keys.rows())
    head = "| key | unit | allowed | default | meaning |\n|---|---|---|---|---|"
    lead = "The output of `softarm config units`; see [Configuration](configuration.md)."
    return f"# Configuration keys\n\n{lead}\n\n{head}\n{rows}\n"


def reality_parameters() -> str:
    """Return the page with every parameter of the independent robot."""
    from softarm.reality.parameters import GROUPS
    from softarm.reality.quantities import table

    lead = "The output of `softarm twin --reality --fault list`; see [Independent robot](reality.md)."
    return f"# Parameters of the independent robot\n\n{lead}\n\n{table(*GROUPS)}"


def rest_schemas() -> str:
    """Return the page with every request of the REST API and every body."""
    from softarm.daemon.api.app import ApiContext, create_app
    from softarm.daemon.control.inbox import Inbox
    from softarm.schemas.config import Config

    api = create_app(ApiContext(Config(), Inbox(), lambda: None)).openapi()
    lead = "The content of the daemon's own page `/docs`; see [REST API](rest.md)."
    lines = [
        "# REST requests and bodies",
        "",
        lead,
        "",
        *_requests(api["paths"]),
        *_bodies(api["components"]["schemas"]),
    ]
    return "\n".join(lines)


def _requests(paths: dict[str, Any]) -> Iterator[str]:
    for path, methods in paths.items():
        for method, request in methods.items():
            yield f"## {method.upper()} {path}\n\n{request.get('description') or request['summary']}\n"
            body = request.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema")
            if body is not None:
                yield f"Body: {_kind(body)}\n"
            for status, answer in request["responses"].items():
                schema = answer.get("content", {}).get("application/json", {}).get("schema")
                yield f"- {status}: {_cell(answer['description'])}{f', {_kind(schema)}' if schema else ''}"
            yield ""


def _bodies(schemas: dict[str, Any]) -> Iterator[str]:
    for name, schema in schemas.items():
        yield f"## {name}\n\n{_cell(schema.get('description', ''))}\n"
        if schema.get("properties"):
            yield "| field | type | meaning |\n|---|---|---|"
            for field, of in schema["properties"].items():
                yield f"| `{field}` | {_kind(of)} | {_cell(of.get('description', ''))} |"
            yield ""


def _kind(schema: dict[str, Any]) -> str:
    """Return the type of a JSON schema in a few words."""
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
    """Return a text in one line that does not end a table cell."""
    return " ".join(str(text).split()).replace("|", "\\|")


REFERENCES: dict[str, Callable[[], str]] = {
    "reference/configuration-keys.md": configuration_keys,
    "reference/reality-parameters.md": reality_parameters,
    "reference/rest-schemas.md": rest_schemas,
}
