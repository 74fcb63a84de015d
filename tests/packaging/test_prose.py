"""Rules of tools/prose.py, which `make lint` applies to the project: a broken one is found."""

import pytest

from tools import prose


@pytest.mark.parametrize(
    ("name", "source", "finding"),
    [
        ("module.py", '"""What is shown of a log."""', "docstring does not start with what the thing does or is"),
        ("module.py", '"""As above."""', "docstring of fewer than 4 words"),
        ("module.py", '"""Return the newest frame."""\n# nobody is told', '"nobody": use'),
        ("module.py", '"""Return the newest frame."""\n\n_hush = 1', '"hush": use drain'),
        ("page.md", "# Page\n\n" + "word " * 26 + ".", "sentence of 26 words"),
        ("page.md", "# Page\n" + "\n" * prose.PAGE_LINES_MAX, "lines, allowed 150"),
    ],
)
def test_a_broken_rule_is_found(name, source, finding, tmp_path):
    file = tmp_path / name
    file.write_text(source + "\n")
    assert any(finding in found.text for found in prose.findings(file))
