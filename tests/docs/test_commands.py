"""Commands shown on the pages exist: the verb, its options and its number of arguments."""

import contextlib
import re
import shlex
from pathlib import Path

import click
import pytest

from softarm.cli.main import main

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
_BLOCK = re.compile(r"^```(?:sh|console|bash|)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^    .*\n)+", re.MULTILINE)
_INLINE = re.compile(r"`(softarm [^`]+)`")
_PLACEHOLDER = re.compile(r"\.\.\.|…|\[|\||<")  # a form, not a command


def commands(page: Path) -> list[str]:
    """Return the commands of a page as a reader would type them, without comments."""
    text = page.read_text(encoding="utf-8")
    blocks = [*_BLOCK.findall(text), *_INDENTED.findall(_BLOCK.sub("", text))]
    lines = (line.strip().removeprefix("$ ") for block in blocks for line in block.replace("\\\n", " ").splitlines())
    shown = [*lines, *_INLINE.findall(text)]
    parts = (part.partition("  #")[0].strip() for line in shown for part in re.split(r"\s*&&\s*|;\s|\s&$", line))
    return [part for part in parts if re.match(r"softarm [a-z-]+(?!:)\b", part) and not _PLACEHOLDER.search(part)]


SHOWN = sorted({(page.name, command) for page in PAGES for command in commands(page)})


def test_the_pages_show_commands():
    assert len(SHOWN) > 60
    assert ("README.md", "softarm policy list") in SHOWN


@pytest.mark.parametrize(("page", "shown"), SHOWN)
def test_a_shown_command_exists(page, shown):
    _, *words = shlex.split(shown, comments=True)
    context = click.Context(main)
    command: click.Command = main
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name, found, words = command.resolve_command(context, words)
        assert found is not None
        command, context = found, click.Context(found, context, name, **found.context_settings)
    if words:
        # `softarm check --logs` names an option without its value; an unknown option raises another error.
        with contextlib.suppress(click.BadOptionUsage):
            command.make_parser(context).parse_args(list(words))
