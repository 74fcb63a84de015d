"""The documentation site builds strictly, holds every page, and needs no internet and no server."""

import re
from pathlib import Path

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config

ROOT = Path(__file__).parents[2]
_FETCHED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*?\b(?:src|href)=\"?(https?:[^\">\s]+)")

pytestmark = pytest.mark.slow


# Over 3 s: builds the site, once for all tests.
@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the built site."""
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NO_MKDOCS_2_WARNING", "1")
        config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder))
        assert config.strict  # a warning aborts the build
        config.plugins.on_startup(command="build", dirty=False)
        build(config)
    return folder


def test_every_page_is_in_the_site(site):
    pages = {page.relative_to(ROOT / "docs").with_suffix("") for page in (ROOT / "docs").rglob("*.md")}
    assert pages <= {page.relative_to(site).with_suffix("") for page in site.rglob("*.html")}
    assert 'id="softarm.policies.base.Policy.step"' in (site / "reference/code.html").read_text(encoding="utf-8")


def test_the_site_loads_nothing_from_the_internet(site):
    fetched = {url for page in site.rglob("*.html") for url in _FETCHED.findall(page.read_text(encoding="utf-8"))}
    assert not fetched


def test_the_search_works_without_a_server(site):
    assert (site / "search/search_index.js").is_file()
    assert 'src="assets/iframe-worker.js"' in (site / "index.html").read_text(encoding="utf-8")


def test_linked_files_of_the_repository_are_in_the_site(site):
    linked = re.findall(
        r'href="\.\./(files/[^"#]+)', (site / "reference/configuration.html").read_text(encoding="utf-8")
    )
    assert linked
    assert all((site / name).is_file() for name in linked)


@pytest.mark.parametrize(
    ("page", "shown"),
    [
        ("blind-causes", "unknown.gear_ripple"),
        ("cli", "softarm goal reach"),
        ("cli", "<td>130</td>"),
        ("configuration", "limits.rail.position_min_m"),
        ("effects", "pressure.lag.inflate"),
        ("failsafe", "rail_not_homed"),
        ("reality", "Rail.stribeck_m_s"),
        ("rest", 'href="#body-reachbody"'),
        ("trials", "armature_kg_m2"),
    ],
)
def test_tables_are_generated_from_the_code(site, page, shown):
    text = (site / f"reference/{page}.html").read_text(encoding="utf-8")
    assert shown in text
    assert "generated:" not in text


def test_the_readme_has_at_most_100_lines_and_ten_links():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 100
    assert len(re.findall(r"(?<!!)\[(?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*\]\([^)]+\)", text)) <= 10
