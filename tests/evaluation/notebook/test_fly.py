"""A flight in three lines of Python: its result, table, page and errors."""

import re
import sys
from html import unescape
from importlib import import_module

import pytest

import softarm
from softarm.daemon.logbook import logs
from softarm.evaluation.notebook import needs
from softarm.evaluation.runner import Runner, load
from softarm.policies.base import MODELS
from softarm.recordings import tables
from softarm.schemas.config import Config, Goals
from softarm.schemas.flights import SHELF_MIDDLE_M, Scenario
from softarm.schemas.goals import Goal
from softarm.schemas.model import Model

TARGET = (-0.2, 0.65)


@pytest.fixture(scope="module")
def flight():
    return softarm.fly("reach", target=TARGET)


def test_a_flight_is_that_of_the_evaluation(flight):
    flown = Runner(load("reach")).fly(Scenario(Goal("reach", *TARGET), 0.0))
    assert flight.reached is flown.reached is True
    assert flight.closest_m == pytest.approx(flown.status.closest_m, abs=1e-9)
    assert flight.result.ticks == flown.ticks
    assert flight.reason is None


def test_a_policy_for_the_shelf_flies_at_a_shelf():
    flown = Runner(load("shelf")).fly(Scenario(Goal("reach", -0.48, 0.63), 0.1, depth_m=SHELF_MIDDLE_M))
    flight = softarm.fly("shelf", target=(-0.48, 0.63), start=0.1)
    assert (flight.result.ticks, flight.reached) == (flown.ticks, flown.reached)


def test_the_table_has_a_row_for_each_tick_and_the_columns_of_the_export(flight, request):
    log = logs.read(request.config.rootpath / "tests" / "data" / "flight.mcap")
    assert flight.table.column_names == list(tables.ticks(log))
    assert flight.table.num_rows == flight.result.ticks + Config().control.rate_hz
    assert flight.table["t_s"][0].as_py() == 0.0
    states = flight.table["goal_state"].to_pylist()
    assert states.index("reached") == flight.result.ticks - 1
    assert flight.table["closest_m"][-1].as_py() == pytest.approx(flight.closest_m)
    assert flight.table["action_pressure_kpa"][-1].as_py() is None  # no policy acts after the goal


def test_start_model_and_seed_change_the_flight():
    short = Config(goals=Goals(time_limit_s=0.5))

    def drawn(**options):
        table = softarm.fly("reach", target=TARGET, config=short, **options).table
        return table["observed_tip_y_m"].to_pylist()

    noisy = Model(effects=Model().effects | {"mocap.noise": {"sigma": 0.002}})
    usual = drawn()
    assert drawn() == usual
    assert drawn(model=noisy, seed=1) == drawn(model=noisy, seed=1) != drawn(model=noisy, seed=2)
    assert drawn(start=0.1)[0] == pytest.approx(0.1, abs=0.01)
    assert drawn(model="no-delay") != usual


def test_an_onnx_file_flies_under_its_own_name():
    flight = softarm.fly(MODELS / "reach.onnx", target=TARGET, config=Config())
    assert flight.reached
    assert flight.policy.name == "reach"


def test_a_flight_describes_itself_also_if_it_missed(flight):
    assert re.fullmatch(r"<reach to \(-0.2, 0.65\) m: reached, 0\.\d\d s, closest 0\.0\d\d m>", repr(flight))
    missed = softarm.fly("pid", target=TARGET)
    assert not missed.reached
    assert missed.reason in repr(missed)


def test_the_page_is_saved_and_framed(flight, tmp_path):
    flight.save(tmp_path / "swing.html")
    page = (tmp_path / "swing.html").read_text(encoding="utf-8")
    assert "<h1><code>reach to (-0.2, 0.65) m</code></h1>" in page
    frame = flight._repr_html_()
    assert frame.startswith("<iframe ")
    assert page.partition("<head>")[2] in unescape(frame)
    with pytest.raises(ValueError, match=r"swing.png: .*ends in \.html"):
        flight.save(tmp_path / "swing.png")


@pytest.mark.prove
def test_a_notebook_shows_the_arm_and_its_links_stay_in_the_frame(flight, browser, tmp_path):
    notebook = tmp_path / "notebook.html"
    notebook.write_text(f"<!doctype html><meta charset=utf-8><body>{flight._repr_html_()}</body>", encoding="utf-8")
    page = browser.new_page(viewport={"width": 1000, "height": 1400})
    problems = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.goto(notebook.as_uri())
    frame = page.frames[1]
    assert frame.locator("#charts figure").count() == 5
    frame.click("nav a[href='#log']")
    frame.click('[data-do="play"]')
    frame.locator("#clock", has_text="0:01.50 / 0:01.50").wait_for()  # played to its end
    assert "tip" in frame.locator("#scene").get_attribute("aria-label")
    assert problems == []


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"policy": "reech"}, "no policy 'reech'; did you mean 'reach'"),
        ({"policy": "excite"}, "policy 'excite': does not move to targets; choose one"),
        ({"target": (0.9, 0.65)}, "y_m 0.9 is outside the workspace; allowed -0.6..0.6 m"),
        ({"target": (0.1,)}, r"target \(0.1,\): give two numbers"),
        ({"start": 0.4}, r"start 0.4 is outside the rail limits; allowed -0.25..0.25 m .*; omit it"),
        ({"model": "no-dely"}, "did you mean no-delay"),
        ({"config": "none.yaml"}, "none.yaml: no such file; name an existing file"),
        ({"seed": -1}, "seed -1: allowed are whole numbers from 0"),
    ],
)
def test_an_error_names_the_value_and_the_next_step(options, text):
    with pytest.raises(Exception, match=text):
        softarm.fly(**{"policy": "reach", "target": TARGET, **options})


def test_a_target_outside_the_training_range_and_an_effect_of_the_loop_warn():
    late = Model(effects={"clock.jitter": {"sigma": 0.001}})
    with pytest.warns(UserWarning, match="it may miss") as high:
        softarm.fly("reach", target=(-0.2, 0.78))
    with pytest.warns(UserWarning, match=r"clock\.jitter: not simulated") as jitter:
        softarm.fly("reach", target=TARGET, model=late)
    assert {warning.filename for warning in (*high, *jitter)} == {__file__}


def test_a_missing_package_names_its_extra(monkeypatch):
    fresh = softarm.fly("reach", target=TARGET)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(
        ModuleNotFoundError, match=r"'pyarrow' is not installed; run pip install 'softarm\[diagnosis\]'"
    ):
        _ = fresh.table
    with pytest.raises(ModuleNotFoundError, match=r"softarm\.nothing"), needs("sim"):
        import_module("softarm.nothing")
