"""The tabs: policies, goals, events, logs, incidents, reports."""

import json
import shutil
from pathlib import Path

import pytest

from softarm.daemon.logbook import logs
from softarm.schemas import excitation
from tests.processes import WAIT_S

pytestmark = pytest.mark.slow

FLIGHT = next((Path(__file__).parents[2] / "data").glob("*.mcap"))


def tab(page, name: str):
    page.locator(f"#panel-{name}-tab").click()
    return page.locator(f"#panel-{name}")


# Over 3 s: two policies, each tried in a process of its own.
def test_policies_are_listed_and_run_is_offered_for_one_without_target(page, robot):
    panel = tab(page, "policies")
    panel.locator("li").first.wait_for()
    listed = robot.client.get("/api/policies").json()["policies"]
    assert panel.locator("li b").all_inner_texts() == [one["name"] for one in listed]
    assert panel.locator("li", has_text="in use").locator("b").inner_text() == "reach"
    broken = next(one for one in listed if one["error"])
    assert "cannot be used" in panel.locator("h3 + ul li.broken", has_text=broken["name"]).inner_text().lower()

    assert page.locator("#do-run").is_hidden()
    page.get_by_role("button", name="Use hold").click()
    page.locator("#said >> text=Policy hold in use").wait_for()
    page.locator("#do-run").wait_for()
    robot.arm()
    page.locator("#do-run[aria-disabled=false]").click()
    page.wait_for_function("() => document.querySelector('#goal dd').textContent === 'run'")
    assert robot.status["goal"]["goal"]["kind"] == "run"
    robot.calm()
    assert robot.client.put("/api/policy", json={"name": "reach"}, timeout=60).status_code == 200  # of another client
    page.locator("#panel-policies li", has_text="in use").locator("b", has_text="reach").wait_for()
    page.locator("#do-run").wait_for(state="hidden")


def test_the_answer_to_an_earlier_request_replaces_no_newer_list(page):
    """The daemon reads every log to list them, which takes long on a busy machine."""
    held = []
    page.route("**/api/logs", lambda route: route.continue_() if held else held.append(route))
    tab(page, "logs")
    page.wait_for_function("() => document.querySelector('#panel-logs').innerText.includes('Loading')")
    panel = tab(page, "logs")
    listed = panel.locator("li", has_text=".mcap").first
    listed.wait_for()
    with page.expect_response("**/api/logs"):
        held[0].fulfill(json={"directory": "old", "logs": []})
    page.evaluate("() => fetch('api/logs').then((answer) => answer.text())")  # by then the page has read the old one
    assert listed.is_visible()


@pytest.mark.prove
def test_choosing_a_policy_shades_its_range_and_draws_its_shelf(page, robot, press):
    shaded = page.locator("#drawing .trained").get_attribute("width")
    page.get_by_role("button", name="Use shelf").click()
    page.locator("#said >> text=Policy shelf in use").wait_for()
    page.wait_for_function(
        "(was) => document.querySelector('#drawing .trained').getAttribute('width') !== was", arg=shaded
    )
    assert robot.status["policy"] == "shelf"
    page.locator("#k-shelf").wait_for()
    assert page.locator("#drawing .shelf").get_attribute("visibility") == "hidden"
    robot.arm()
    press(page, -0.44, 0.62)
    page.locator("#drawing .shelf[visibility=visible]").wait_for()
    ring, board = (page.locator(f"#drawing {part}").bounding_box() for part in ("circle.target", ".shelf"))
    assert board["x"] + board["width"] > ring["x"] + ring["width"] / 2  # its front edge is beyond the target
    assert board["y"] > ring["y"] + ring["height"] / 2 - 1  # and its board below it
    robot.calm()
    robot.client.put("/api/policy", json={"name": "reach"})


ROWS = """
async () => {
  const { el, update } = await import("/dashboard/view/dom.js");
  const list = (...names) => el("ul", {}, names.map((name) => el("li", {}, name)));
  const place = el("div", {}, list("flight", "recording", "old"));
  const [flight, recording, old] = place.firstElementChild.children;
  update(place, [list("newer", "recording", "flight")]);
  const now = [...place.firstElementChild.children];
  return [now.map((row) => row.textContent), now[1] === recording, now[2] === flight, old.isConnected];
}
"""


@pytest.fixture
def flight(daemon):
    """Yield a finished log in the daemon's folder."""
    place = daemon.config.recorder.directory / "flight.mcap"
    shutil.copy(FLIGHT, place)
    yield place
    place.unlink(missing_ok=True)


def test_tabs_are_chosen_by_arrow_keys_and_show_events_goals_logs_and_reports(
    page, robot, press, daemon, flight, tmp_path
):
    page.locator("#panel-policies-tab").focus()
    names = []
    for _ in range(7):
        page.keyboard.press("ArrowRight")
        names.append(json.loads(page.evaluate("JSON.stringify(document.activeElement.textContent)")))
        assert page.locator("[role=tab][aria-selected=true]").inner_text() == names[-1]
        assert page.locator("[role=tabpanel]:visible").count() == 1
    assert names == ["Goals", "Events", "Jobs", "Logs", "Incidents", "Reports", "Policies"]
    assert page.evaluate(ROWS) == [["newer", "recording", "flight"], True, True, False]

    panel = tab(page, "events")
    robot.arm()
    panel.locator("li", has_text="Arm requested from the API").first.wait_for()
    newest = robot.client.get("/api/events").json()["events"][-1]["text"]
    panel.locator("li", has_text=newest[1:]).first.wait_for()
    rows = "[...document.querySelectorAll('#panel-events li.event')]"
    marks = page.evaluate(f"() => {rows}.map((row) => getComputedStyle(row).borderRadius)")
    assert set(marks) == {"0px"}  # events must not look like the mode's sign

    before = robot.status["goal"]["number"]
    press(page, -0.22, 0.63)
    goal = robot.until(lambda now: now["goal"]["number"] > before and now["goal"]["state"] != "running")["goal"]
    panel = tab(page, "goals")
    row = panel.locator("li:first-child", has_text=f"Goal {goal['number']} {goal['state']}")
    row.wait_for()
    assert row.get_attribute("class") == f"goal {goal['state']}"  # on a busy machine the arm may miss
    assert "of" in panel.locator(".hint").inner_text()

    panel = tab(page, "reports")
    panel.locator("text=No reports").wait_for()
    folder = daemon.config.api.reports
    folder.mkdir(exist_ok=True)
    report = folder / "gap.html"
    report.write_text("<!doctype html><title>gap</title><h1>The rail lags</h1>")
    panel = tab(page, "logs")
    recording = panel.locator("li", has_text=daemon.recorder.path.name)
    button = recording.get_by_role("button", name="Delete")
    assert button.get_attribute("aria-disabled") == "true"
    reason = recording.locator("text=This log is being recorded.")
    while not reason.is_visible():  # the list that the tab loads may replace the row after a click
        button.click(force=True)
        page.wait_for_timeout(100)
    assert daemon.recorder.path.exists()

    row = panel.locator("li", has_text="flight.mcap")
    with page.expect_download() as download:
        row.get_by_role("link", name="Download").click()
    download.value.save_as(tmp_path / "mine.mcap")
    assert (tmp_path / "mine.mcap").read_bytes() == flight.read_bytes()
    row.get_by_role("button", name="Delete").click()
    assert flight.exists()
    page.locator("#panel-logs-tab").focus()  # cancelled by moving the focus
    assert row.get_by_role("button", name="Delete").inner_text() == "Delete"
    row.get_by_role("button", name="Delete").click()
    with page.expect_response("**/api/logs"):  # a reload, as after a lost connection, keeps the question
        page.evaluate("document.getElementById('panel-logs-tab').click()")
    row.locator("text=Delete permanently?").click()
    row.wait_for(state="detached")
    assert not flight.exists()

    panel = tab(page, "reports")
    with page.context.expect_page() as other:
        panel.get_by_role("link", name="Open gap.html").click()
    assert other.value.locator("h1").inner_text() == "The rail lags"
    other.value.close()
    report.unlink()


def row(page):
    return page.locator("#panel-jobs .entries li").first


@pytest.fixture
def short(monkeypatch):
    """Add an excitation of two seconds, since a busy machine may stall a daemon for half of one."""
    made = excitation.Excitation("short", "half a bend", (excitation.Ramp(2.0, 0.0, 8.0),))
    monkeypatch.setitem(excitation.EXCITATIONS, "short", made)
    monkeypatch.setattr("softarm.policies.excite.LEAD_IN_S", 0.5)


# The window's event may come before the focus has moved, or not at all; the page must not depend on it.
WITHOUT_BLUR = """
const add = window.addEventListener;
window.addEventListener = (kind, ...rest) => { if (kind !== "blur") add.call(window, kind, ...rest); };
"""


# Over 3 s: an excitation, and the processes of two jobs.
def test_jobs_run_and_show_their_results_and_space_still_stops(page, robot, daemon, flight, short, verb_runs):
    page.add_init_script(WITHOUT_BLUR)
    panel = tab(page, "jobs")
    start = panel.get_by_role("button", name="Start excitation")
    panel.locator("select").select_option("short")
    start.click()
    panel.locator("[role=status]", has_text="The arm is disarmed: press Arm first").wait_for()
    robot.until(lambda status: status["uptime_s"] > 11)  # a log younger than ten seconds is not replaced
    robot.arm()
    start.click()
    panel.get_by_role("button", name="Cancel job").wait_for()
    assert robot.ask("/api/jobs", {"kind": "excite", "excitation": "seed"}).status_code == 409
    page.reload()
    page.locator("#link[data-link=live]").wait_for()
    tab(page, "jobs")
    row(page).locator("b", has_text="Excitation ✓ done").wait_for()
    job = robot.client.get("/api/jobs").json()["jobs"][0]
    assert robot.status["policy"] == "reach"
    log = logs.read(daemon.config.recorder.directory / job["log"])
    flown = {(outputs.policy, outputs.goal.goal.kind) for _, outputs in log.ticks() if outputs.goal.state == "running"}
    assert flown == {("excite-short", "run")}
    assert max(outputs.sent.pressure_kpa for _, outputs in log.ticks()) > 1.0

    verb_runs(
        "print('fitting (40 %, about 9 s left)', file=sys.stderr, flush=True)\n"
        "open(sys.argv[-1], 'w').write('<!doctype html><h1>The rail lags</h1>')\n"
        "import time\nwhile not os.path.exists(sys.argv[-1] + '.go'): time.sleep(0.01)\n"
    )
    box = panel.locator("label", has_text="flight.mcap").locator("input")
    box.press("Enter")  # the space key stops the robot
    panel.locator("[aria-label='Start diagnosis'][aria-disabled=false]").wait_for()
    assert box.is_checked()
    assert box.evaluate("(box) => box === document.activeElement")
    panel.get_by_role("button", name="Start diagnosis").click()
    row(page).locator("progress[value='0.4']").wait_for()
    row(page).locator("text=Fitting (40 %, about 9 s left)").wait_for()
    reports = flight.parent / "reports"
    (next(reports.glob("diagnosis-*.html")).with_suffix(".html.go")).touch()
    heading = page.frame_locator("#panel-jobs iframe").locator("h1")
    assert heading.inner_text() == "The rail lags"
    heading.click()
    page.wait_for_function("() => document.activeElement.tagName === 'BODY'")
    page.keyboard.press("Space")
    robot.until(lambda status: status["mode"] == "stopped")
    for made in reports.iterdir():
        made.unlink()

    verb_runs("")
    tab(page, "logs").locator("li", has_text="flight.mcap").get_by_role("button", name="Replay").click()
    row(page).locator("b", has_text="Replay ✓ done").wait_for(timeout=1000 * WAIT_S)
