"""The page of untried parts follows the constants in the packages."""

from pathlib import Path

from softarm.daemon.doctor import untried

PAGE = Path(__file__).parents[3] / "docs" / "hardware" / "untried.md"


def test_the_page_is_generated_from_the_constants():
    remedy = "stale: run `python -m softarm.daemon.doctor.untried > docs/hardware/untried.md`"
    assert PAGE.read_text(encoding="utf-8") == untried.page(), remedy
