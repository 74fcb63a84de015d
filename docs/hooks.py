"""What the site needs beside the pages: the files of the repository that they link to, as they are."""

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
_OUTSIDE = re.compile(r"\]\(\.\./([\w./-]+?)(#[\w-]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add every file outside docs/ that a page links to."""
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
