"""Check the prose of the project against its writing rules (CONTRIBUTING.md).

    python -m tools.prose                     everything
    python -m tools.prose softarm/drivers     one folder or file

Python files: docstrings, comments, text literals and identifiers must avoid the words that readers stumbled over, and
docstrings must start with what the thing does or is. Pages: also the length of sentences and of the page.
"""

import ast
import io
import re
import subprocess
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click

from softarm.common.revision import CHECKOUT

# Archaic words and metaphors, each with the field's term. A word of one letter case matches all.
WORDS = {
    "dark": "dropout, without tracking",
    "guest": "client, plug-in",
    "guests": "clients, plug-ins",
    "sight": "view, tracking",
    "sighting": "tracked pose",
    "shots": "windows",
    "twins": "indistinguishable effects",
    "wild": "divergent, chaotic",
    "patient": "target, subject",
    "bell": "wake-up",
    "farewell": "final command",
    "bury": "reap",
    "hush": "drain",
    "heed": "accept",
    "tell": "report, show, state",
    "tells": "reports, shows, states",
    "told": "reported, given",
    "heard": "received",
    "blamed": "attributed",
    "dial": "parameter",
    "lens": "view",
    "deed": "action",
    "wish": "requested command",
    "wishes": "requested commands",
    "house": "project, package",
    "anew": "again",
    "shall": "must, will",
    "nobody": "no client, no user",
    "whoever": "name the actor",
    "thereby": "so",
    "hence": "so",
    "forthwith": "immediately",
}
STARTS = (
    *("What", "Who", "Whose", "Whoever", "Whether it", "Of", "As", "And", "Or"),
    *("None:", "See", "Where", "It", "Nobody", "Nothing", "That", "Those"),
)
CSS = ('"dark"', '"light dark"')  # colour schemes
DOCSTRING_WORDS_MIN = 4
SENTENCE_WORDS_MAX = 25
PAGE_LINES_MAX = 150
PAGE_WORDS_MAX = 1500
# Pages that are looked up, not read.
REFERENCES = {"CHANGELOG.md", "LICENSE"}
REFERENCE_FOLDER = "reference"
OWN = {"prose.py", "test_prose.py"}  # these files quote the words

_WORD = re.compile(r"[A-Za-z]+(?:'[a-z]+)?")
_IDENTIFIER = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_ANY = re.compile("|".join(WORDS), re.IGNORECASE)
_STARTS = re.compile(rf"(?:{'|'.join(STARTS)})(?![\w'-])")


Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


class Finding(NamedTuple):
    """A place that breaks a rule."""

    file: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file.relative_to(CHECKOUT)}:{self.line}: {self.text}"


def findings(file: Path) -> Iterator[Finding]:
    """Yield the findings of one file, Python or Markdown."""
    return _of_page(file) if file.suffix == ".md" else _of_module(file)


def tracked(places: tuple[Path, ...] = ()) -> list[Path]:
    """Return the Python files and pages under the given places that git tracks, without symbolic links."""
    command = ["git", "ls-files", "--", *map(str, places)]
    listed = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=True).stdout.splitlines()
    files = (CHECKOUT / name for name in listed if Path(name).suffix in {".py", ".md"})
    return [file for file in files if file.name not in OWN and file.is_file() and not file.is_symlink()]


def documented(node: ast.AST) -> Iterator[Documented]:
    """Yield a module's nodes that may have a docstring, without a look at expressions."""
    if isinstance(node, Documented):
        yield node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield from documented(child)


def _of_module(file: Path) -> Iterator[Finding]:
    source = file.read_text(encoding="utf-8")
    tree = ast.parse(source)
    in_tests = file.is_relative_to(CHECKOUT / "tests")
    for node in documented(tree):
        if text := ast.get_docstring(node):
            private = in_tests or getattr(node, "name", "").startswith("_")
            yield from (Finding(file, getattr(node, "lineno", 1), why) for why in _of_docstring(text, private))
    # To tokenize takes most of the time, and few modules hold a word at all.
    suspects = (line for line in source.splitlines() if _ANY.search(line))
    if not any(word.lower() in WORDS for line in suspects for word in _IDENTIFIER.findall(line) + _WORD.findall(line)):
        return
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.NAME:
            words = _IDENTIFIER.findall(token.string) if token.string != "tell" else []  # of Python's files
        elif token.type in {tokenize.COMMENT, tokenize.STRING} | {getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}:
            words = _WORD.findall(token.string) if token.string not in CSS else []
        else:
            continue
        yield from (Finding(file, token.start[0], why) for why in _stumbled_over(words))


def _of_docstring(text: str, private: bool) -> Iterator[str]:
    first = text.splitlines()[0]
    if not private and len(first.split()) < DOCSTRING_WORDS_MIN:
        yield f'docstring of fewer than {DOCSTRING_WORDS_MIN} words: "{first}"'
    if _STARTS.match(text):
        yield f'docstring does not start with what the thing does or is: "{first}"'


def _stumbled_over(words: list[str]) -> Iterator[str]:
    for word in words:
        if word.lower() in WORDS:
            yield f'"{word}": use {WORDS[word.lower()]}'


def _of_page(file: Path) -> Iterator[Finding]:
    lines = file.read_text(encoding="utf-8").splitlines()
    prose, fenced = [], False
    for number, line in enumerate(lines, start=1):
        fenced ^= line.lstrip().startswith("```")
        is_code = fenced or line.startswith(("    ", "```"))
        prose.append("" if is_code or line.startswith(("|", "#", "<", "!")) else line)
        if not is_code:
            text = re.sub(r"`[^`]*`", "", line)
            yield from (Finding(file, number, why) for why in _stumbled_over(_WORD.findall(text)))
    yield from _long_sentences(file, prose)
    if file.name not in REFERENCES and REFERENCE_FOLDER not in file.parts:
        words = sum(len(line.split()) for line in lines)
        if len(lines) > PAGE_LINES_MAX:
            yield Finding(file, 1, f"{len(lines)} lines, allowed {PAGE_LINES_MAX}")
        if words > PAGE_WORDS_MAX:
            yield Finding(file, 1, f"{words} words, allowed {PAGE_WORDS_MAX}")


def _long_sentences(file: Path, prose: list[str]) -> Iterator[Finding]:
    """Yield sentences over the limit; a list item, an empty line and a colon's end of line end a sentence."""
    paragraph: list[str] = []
    begun = 1
    for number, line in enumerate([*prose, ""], start=1):
        if not line.strip() or re.match(r"\s*([-*]|\d+\.)\s", line):
            yield from (Finding(file, begun, why) for why in _long_in(" ".join(paragraph)))
            paragraph = []
        if line.strip():
            begun = begun if paragraph else number
            paragraph.append(line.strip())


def _long_in(text: str) -> Iterator[str]:
    text = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "code", text))
    for sentence in re.split(r"(?<=[.!?:;])[\"')*]*\s+", text):
        words = len(re.findall(r"[A-Za-z0-9][^\s]*", sentence))
        if words > SENTENCE_WORDS_MAX:
            yield f'sentence of {words} words: "{sentence[:60]} ..."'


@click.command()
@click.argument("places", nargs=-1, type=click.Path(exists=True, path_type=Path))
def main(places: tuple[Path, ...]) -> None:
    """Print every place that breaks a writing rule; exit with 1 if there is one.

    \b
    Example:
      python -m tools.prose softarm/drivers docs
    """
    found = [finding for file in tracked(places) for finding in findings(file)]
    for finding in found:
        click.echo(finding)
    click.echo(f"{len(found)} findings")
    raise SystemExit(bool(found))


if __name__ == "__main__":
    main()
