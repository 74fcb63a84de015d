"""The dashboard in Firefox: a swing, every tab and the stop, without a message or an address elsewhere."""

from urllib.parse import urlsplit

import pytest

from softarm.daemon.runtime.jobs import Done
from tests.daemon.dashboard import firefox
from tests.processes import until

pytestmark = pytest.mark.prove  # on a busy machine Firefox draws for minutes without a graphics card


class Ready:
    """Work that is done at once."""

    def run(self, progress):
        return Done(("the rail lags",))

    def end(self):
        pass


@pytest.fixture(scope="module")
def daemon(tmp_path_factory, started):
    if firefox.found() is None:
        pytest.skip("there is no firefox: its page is not tried (apt-get install firefox-esr)")
    with started(tmp_path_factory.mktemp("logs")) as made:
        yield made


def test_firefox_shows_a_swing_and_every_tab_and_stops(daemon, robot, tmp_path):
    reports = daemon.config.api.reports
    reports.mkdir()
    (reports / "gap.html").write_text("<!doctype html><script>1</script><h1>The rail lags</h1>")
    daemon.jobs.start("diagnose", "diagnosis of a log", Ready(), "gap.html")
    with firefox.opened(tmp_path / "profile") as page:
        page.open(daemon.url, 1280, 860)
        page.until("document.querySelector('#link').dataset.link === 'live'")
        page.evaluate("document.querySelector('#do-arm').click()")
        page.until("document.querySelector('#mode').dataset.mode === 'armed'")
        page.evaluate("document.querySelector('#do-reach').click()")
        page.until("document.querySelector('#swing').dataset.goal")
        for tab in ("goals", "events", "jobs", "logs", "incidents", "reports", "policies"):
            page.evaluate(f"document.querySelector('#panel-{tab}-tab').click()")
            page.until(f"!document.querySelector('#panel-{tab}').textContent.includes('Loading')")
        page.evaluate("document.querySelector('#panel-jobs-tab').click()")
        page.until("document.querySelector('[aria-label=\"Show report job 1\"]')")
        page.evaluate("document.querySelector('[aria-label=\"Show report job 1\"]').click()")
        page.until("document.querySelector('iframe')")

        def focus_is_back() -> bool:
            page.click("iframe")  # again if the report had not loaded
            return page.evaluate("document.activeElement.tagName === 'BODY'")

        until(focus_is_back)
        page.press(" ")
        robot.until(lambda status: status["mode"] == "stopped")
        page.until("document.querySelector('#stopped').dataset.state === 'stopped'")
        own = {urlsplit(url).hostname for url in page.asked if not url.startswith(("data:", "blob:"))}
        assert own == {urlsplit(daemon.url).hostname}
        assert page.messages == []
