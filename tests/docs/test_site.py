"""The pages as a site: built strictly, every page in it, nothing fetched from anywhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_FETCHED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?\b(?:src|href)=\"?(https?:[^\">\s]+)")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder that `make docs` makes, elsewhere."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", folder]
    done = subprocess.run(command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    return folder


def test_every_page_is_in_it(site):
    pages = {page.stem for page in (ROOT / "docs").glob("*.md")}
    assert pages <= {page.stem for page in site.glob("*.html")}
    assert 'id="softarm.policies.base.Policy.step"' in (site / "code.html").read_text(encoding="utf-8")  # from the code


def test_it_shows_without_the_internet(site):
    fetched = {url for page in site.glob("*.html") for url in _FETCHED.findall(page.read_text(encoding="utf-8"))}
    assert not fetched


def test_files_that_pages_link_to_lie_beside_them(site):
    linked = re.findall(r'href="(files/[^"#]+)', (site / "configuration.html").read_text(encoding="utf-8"))
    assert linked
    assert all((site / name).is_file() for name in linked)


def test_references_are_made_from_the_code(site):
    keys = (site / "configuration-keys.html").read_text(encoding="utf-8")
    assert "limits.rail.position_min_m" in keys
    requests = (site / "rest-schemas.html").read_text(encoding="utf-8")
    assert "POST /api/goal" in requests
    assert 'href="#reachbody"' in requests
