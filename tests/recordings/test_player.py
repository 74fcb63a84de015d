"""The page of the log player contains the flight and stays small."""

import base64
import json
import re
from datetime import UTC, datetime
from html import unescape

import numpy as np
import pytest

from softarm.recordings import flight, player
from softarm.schemas.events import Entry


@pytest.fixture(scope="module")
def text(log):
    return player.page(log, log.entries())


def said(text):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text)[1])


def values(packed):
    levels = np.frombuffer(base64.b64decode(packed["levels"]), "<u2").astype(float)
    return np.where(levels == 65535, np.nan, packed["low"] + levels * (packed["high"] - packed["low"]) / 65534)


def stamps(data):
    return np.frombuffer(base64.b64decode(data["stamps"]), "<u4") / 1e3


def test_the_players_curves_are_the_ticks(log, text):
    data, recorded = said(text), list(log)
    begin_ns = recorded[0][0].t_ns
    np.testing.assert_allclose(stamps(data), [(i.t_ns - begin_ns) * 1e-9 for i, _, _ in recorded], atol=1.01e-3)
    poses = [inputs.mocap[-1].bodies for inputs, _, _ in recorded]  # the simulated cameras miss no tick
    for number, name in enumerate(("cart", "link1", "link2", "link3", "link4", "link5")):
        np.testing.assert_allclose(values(data["series"][f"{name}_y"]), [p[number].y_m for p in poses], atol=1e-5)
        np.testing.assert_allclose(values(data["series"][f"{name}_z"]), [p[number].z_m for p in poses], atol=1e-5)
    sent = [outputs.sent for _, outputs, _ in recorded]
    np.testing.assert_allclose(values(data["series"]["pressure_sent"]), [s.pressure_kpa for s in sent], atol=2e-4)
    np.testing.assert_allclose(values(data["series"]["cart_sent"]), [s.cart_velocity_m_s for s in sent], atol=2e-5)
    offset_ns = int(log.metadata["clock"]["wall_minus_monotonic_ns"])
    assert data["begin_ms"] == (begin_ns + offset_ns) // 10**6


def test_a_log_of_six_days_keeps_its_times(log, monkeypatch):
    *before, last = filter(None, flight.moments(log.path))
    six_days_ns = 6 * 86_400 * 10**9
    outputs = last.tick.outputs.model_copy(update={"t_ns": last.tick.outputs.t_ns + six_days_ns})
    later = last._replace(tick=last.tick.model_copy(update={"outputs": outputs}))
    monkeypatch.setattr(flight, "moments", lambda path: iter([*before, later]))
    length_s = (outputs.t_ns - before[0].tick.outputs.t_ns) * 1e-9
    assert stamps(said(player.page(log, [])))[-1] == pytest.approx(length_s, abs=1.01e-3)


def test_a_state_begins_at_the_time_of_its_tick(text):
    data = said(text)
    begins = {time for each in data["runs"].values() for time, *_ in each}
    assert begins <= set(stamps(data))


def test_states_and_events_have_their_times(log, text):
    data = said(text)
    assert [mode for _, mode in data["runs"]["mode"]][:3] == ["disarmed", "arming", "armed"]
    goals = [run[1:5] for run in data["runs"]["goal"]]
    assert [1, "reach", "running", [-0.3, 0.62]] in goals
    assert [1, "reach", "reached", [-0.3, 0.62]] in goals
    assert [each[2] for each in data["events"]] == [entry.text for entry in log.entries()]
    assert data["robot"]["soft_m"] == [-0.25, 0.25]


def test_the_page_fetches_nothing_and_no_text_ends_its_script(log):
    nasty = "</script><script>alert(1)</script><img src=http://example.org/>"
    entry = Entry(1, log.t_first_ns, datetime.now(UTC), 1, "event", "x", nasty)
    text = player.page(log, [entry])
    assert "<script>alert" not in text
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'unsafe-inline'" in unescape(text)
    assert not re.search(r'(?:src|href)="(?!#)', text)
    assert said(text)["events"][0][2] == nasty


def test_a_long_log_is_thinned_with_the_worst_lateness_kept():
    samples = player.Samples(most=1000)
    late = player.SERIES.index("late_ms")
    draw = np.random.default_rng(4)
    rows = draw.uniform(size=(7300, len(player.SERIES)))
    rows[4321, late], rows[7299, late] = 50.0, 60.0
    for number, row in enumerate(rows):
        samples.add(number * 33_333_333, row)
    assert samples.every == 8
    np.testing.assert_array_equal(samples.stamps_ns, np.arange(0, 7300, 8) * 33_333_333)
    np.testing.assert_array_equal(samples.columns["cart_y"], rows[::8, 0])
    worst = [rows[i : i + 8, late].max() for i in range(0, 7300, 8)]
    np.testing.assert_array_equal(samples.columns["late_ms"], worst)
