"""Additions to the site: tables generated from the code, and the repository's files that pages link to."""

import json
import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from softarm.cli import page as cli_page
from softarm.cli.shared.errors import EXITS
from softarm.daemon.api.app import ApiContext, create_app
from softarm.daemon.config import configuration
from softarm.daemon.control import failsafe
from softarm.daemon.control.inbox import Inbox
from softarm.evaluation import leaderboard
from softarm.reality import parameters
from softarm.schemas import stage_model
from softarm.schemas.config import Config
from softarm.simulator import effects_page
from validation.blind import pages

ROOT = Path(__file__).resolve().parents[1]
_LINK = re.compile(r"\]\((\.\./[\w./-]+?)(#[\w-]*)?\)")
_GENERATED = re.compile(r"^<!-- generated: ([\w-]+) -->$", re.MULTILINE)


def on_files(files: Files, config: Any) -> Files:
    """Add a copy of every file outside docs/ that a page links to."""
    for page in tuple(files.documentation_pages()):
        for target, _ in _LINK.findall(page.content_string):
            name = _outside(page.src_uri, target)
            if name and files.get_file_from_path(_copy(name)) is None:
                content = (ROOT / name).read_text(encoding="utf-8")
                files.append(File.generated(config, _copy(name), content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace the marks of generated tables, and point the links to files outside docs/ at their copies."""
    here = page.file.src_uri

    def replace(link: re.Match[str]) -> str:
        name = _outside(here, link[1])
        return f"]({posixpath.relpath(_copy(name), posixpath.dirname(here))})" if name else link[0]

    return _LINK.sub(replace, _GENERATED.sub(lambda mark: GENERATED[mark[1]](), markdown))


def _outside(page: str, target: str) -> str | None:
    """Return the path of the file outside docs/ that a link of a page leads to, or None if there is none."""
    name = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), target))
    return name if not name.startswith(("docs/", "../")) and (ROOT / name).is_file() else None


def _copy(name: str) -> str:
    """Return the path of a copy that a browser displays instead of saving it."""
    return f"files/{name.replace('/', '-')}.txt"


def exit_codes() -> str:
    """Return the exit codes of `softarm`."""
    rows = "\n".join(f"| {code} | {means} |" for code, means in EXITS.items())
    return f"| exit code | means |\n|---|---|\n{rows}"


def blind_causes() -> str:
    """Return every cause of the blind benchmark with its stored detection limit."""
    stored = json.loads((ROOT / "benchmarks/results/detection.json").read_text(encoding="utf-8"))
    about = stored["about"]
    return f"{pages.detection(stored)}\n*Measured {about['date'][:10]} at {about['revision'][:8]}.*"


def configuration_keys() -> str:
    """Return every key of softarm.yaml."""
    rows = "\n".join(f"| `{row.key}` | {' | '.join(map(_cell, row[1:]))} |" for row in configuration.key_rows())
    return f"| key | unit | allowed | default | meaning |\n|---|---|---|---|---|\n{rows}"


def rest_schemas() -> str:
    """Return every request of the REST API and every body."""
    api = create_app(ApiContext(Config(), Inbox(), lambda: None)).openapi()
    return "\n".join([*_requests(api["paths"]), *_bodies(api["components"]["schemas"])])


def _requests(paths: dict[str, Any]) -> Iterator[str]:
    for path, methods in paths.items():
        for method, request in methods.items():
            yield f"### {method.upper()} {path}\n\n{request.get('description') or request['summary']}\n"
            body = request.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema")
            if body is not None:
                yield f"Body: {_kind(body)}\n"
            for status, answer in request["responses"].items():
                schema = answer.get("content", {}).get("application/json", {}).get("schema")
                yield f"- {status}: {_cell(answer['description'])}{f', {_kind(schema)}' if schema else ''}"
            yield ""


def _bodies(schemas: dict[str, Any]) -> Iterator[str]:
    for name, schema in schemas.items():
        yield f"### {name} {{ #body-{name.lower()} }}\n\n{_cell(schema.get('description', ''))}\n"
        if schema.get("properties"):
            yield "| field | type | meaning |\n|---|---|---|"
            for field, of in schema["properties"].items():
                yield f"| `{field}` | {_kind(of)} | {_cell(of.get('description', ''))} |"
            yield ""


def _kind(schema: dict[str, Any]) -> str:
    """Return the type of a JSON schema in a few words."""
    if reference := schema.get("$ref"):
        name = reference.rpartition("/")[2]
        return f"[{name}](#body-{name.lower()})"
    if several := schema.get("anyOf") or schema.get("oneOf"):
        return " or ".join(map(_kind, several))
    if values := schema.get("enum") or ([schema["const"]] if "const" in schema else []):
        return ", ".join(f"`{value}`" for value in values)
    inner = f" of {_kind(schema['items'])}" if isinstance(schema.get("items"), dict) else ""
    return f"{schema.get('type', 'any')}{inner}"


def _cell(text: object) -> str:
    """Return a text in one line that does not end a table cell."""
    return " ".join(str(text).split()).replace("|", "\\|")


GENERATED: dict[str, Callable[[], str]] = {
    "blind-causes": blind_causes,
    "commands": cli_page.markdown,
    "configuration-keys": configuration_keys,
    "effects": effects_page.markdown,
    "exit-codes": exit_codes,
    "failsafe-events": failsafe.markdown,
    "leaderboard": lambda: leaderboard.markdown(leaderboard.load(ROOT / "benchmarks/leaderboard.json")),
    "reality-parameters": lambda: parameters.table(*parameters.GROUPS),
    "rest-schemas": rest_schemas,
    "stage-keys": stage_model.table,
}
