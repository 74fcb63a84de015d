"""Prose of the project: the word list, the docstrings and the pages follow the writing rules of CONTRIBUTING.md."""

import pytest

from softarm.common.revision import CHECKOUT
from tools import prose

PLACES = (
    "softarm",
    "validation",
    "benchmarks",
    "tools",
    "examples",
    "tests",
    "docs",
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_the_prose_follows_the_writing_rules(place):
    files = prose.tracked((CHECKOUT / place,))
    assert files
    assert [str(finding) for file in files for finding in prose.findings(file)] == []


@pytest.mark.parametrize(
    ("source", "finding"),
    [
        ('"""What is shown of a log."""', "docstring does not start with what the thing does or is"),
        ('"""As above."""', "docstring of fewer than 4 words"),
        ('"""Return the newest frame."""\n# nobody is told', '"nobody": use'),
        ('"""Return the newest frame."""\n\n_hush = 1', '"hush": use drain'),
        ('"""Return the newest frame."""\n\nTEXT = "the house"', '"house": use project'),
    ],
)
def test_a_private_word_or_an_unclear_docstring_is_found(source, finding, tmp_path):
    file = tmp_path / "module.py"
    file.write_text(source + "\n")
    assert any(finding in found.text for found in prose.findings(file))


def test_a_long_sentence_and_a_long_page_are_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n" + "word " * 26 + ".\n" + "\n" * prose.PAGE_LINES_MAX)
    found = [finding.text for finding in prose.findings(page)]
    assert any(text.startswith("sentence of 26 words") for text in found)
    assert any("lines, allowed 150" in text for text in found)


def test_a_reference_may_be_long_and_code_is_not_read_as_prose(tmp_path):
    folder = tmp_path / prose.REFERENCE_FOLDER
    folder.mkdir()
    page = folder / "page.md"
    page.write_text("# Page\n\n    nobody is told\n" + "\n" * prose.PAGE_LINES_MAX)
    assert list(prose.findings(page)) == []
