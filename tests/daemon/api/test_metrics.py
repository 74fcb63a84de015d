"""GET /metrics in the text format 0.0.4 of Prometheus, parsed by its published grammar."""

import re
import shutil
from dataclasses import replace

import pytest

from softarm.daemon.control.records import ActiveEvent, EStop, Inputs, Mode, Outputs
from softarm.daemon.logbook.history import LATE_NS, History
from softarm.schemas.config import Config

LABEL = r'[a-zA-Z_][a-zA-Z0-9_]*="(?:[^"\\\n]|\\["\\n])*"'
SAMPLE = re.compile(rf"([a-zA-Z_:][a-zA-Z0-9_:]*)(\{{{LABEL}(?:,{LABEL})*\}})? (\S+)")
SUFFIXES = {"counter": ("",), "gauge": ("",), "histogram": ("_bucket", "_sum", "_count")}


def parsed(text):
    """Return samples by name and labels; assert complete families with help and type first."""
    assert text.endswith("\n")
    kinds, samples, family = {}, {}, None
    for line in text.splitlines():
        if line.startswith("# HELP "):
            family = line.split(" ")[2]
            assert family not in kinds
        elif line.startswith("# TYPE "):
            assert line.split(" ")[2] == family
            kinds[family] = line.split(" ")[3]
        else:
            name, labels, value = SAMPLE.fullmatch(line).groups()
            assert name in [family + suffix for suffix in SUFFIXES[kinds[family]]]
            assert name + (labels or "") not in samples
            samples[name + (labels or "")] = float(value)
    return kinds, samples


@pytest.fixture
def figures(loop, app, client_of, tmp_path):
    """Return a client of a daemon that armed once; ticks were 0.2 ms late and one 5 ms."""
    history = History("run", lambda: 0, lambda: 0)
    still = Outputs(0, 1, 200_000, 0, 0, Mode.DISARMED, EStop.CLEAR)
    late = ActiveEvent("tick_late", "warn", "late")
    for tick in range(1, 5):
        history.take(Inputs(tick), replace(still, t_ns=tick, tick=tick))
    history.take(Inputs(5), replace(still, t_ns=5, tick=5, late_ns=5_000_000, mode=Mode.ARMED, events=(late,)))
    return client_of(app(loop, Config(recorder={"directory": tmp_path}), history=history))


def test_the_metrics_have_the_format_of_prometheus(figures, tmp_path):
    answer = figures.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    kinds, samples = parsed(answer.text)
    assert all(name.endswith("_total") for name, kind in kinds.items() if kind == "counter")
    assert samples['softarm_mode{mode="armed"}'] == 1
    assert sum(value for name, value in samples.items() if name.startswith("softarm_mode")) == 1
    assert samples['softarm_estop{state="clear"}'] == 1
    assert samples["softarm_healthy"] == 1
    assert samples['softarm_age_seconds{of="mocap"}'] == pytest.approx(0.005)
    assert samples['softarm_age_seconds{of="rail"}'] == pytest.approx(0.007)
    assert samples['softarm_age_seconds{of="tick"}'] < 5
    assert samples["softarm_log_disk_free_bytes"] == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.1)
    assert samples['softarm_events_total{kind="mode",what="armed"}'] == 1
    assert samples['softarm_events_total{kind="event",what="tick_late"}'] == 1


def test_lateness_is_a_histogram_of_all_ticks(figures):
    _, samples = parsed(figures.get("/metrics").text)
    buckets = {name: value for name, value in samples.items() if name.startswith("softarm_tick_late_seconds_bucket")}
    assert list(buckets.values()) == [0, 4, 4, 4, 5, 5, 5]
    bounds = [float(re.search('le="(.*)"', name)[1]) for name in buckets]
    assert bounds == pytest.approx([ns * 1e-9 for ns in LATE_NS] + [float("inf")])
    assert samples["softarm_tick_late_seconds_count"] == 5
    assert samples["softarm_tick_late_seconds_sum"] == pytest.approx(0.0058)


def test_a_failed_control_loop_has_no_count_of_ticks(silent):
    client, loop = silent
    loop.outputs = Outputs(0, -1, 0, 0, 0, Mode.STOPPED, EStop.ENGAGED)
    _, samples = parsed(client.get("/metrics").text)
    assert samples['softarm_mode{mode="stopped"}'] == 1
    assert "softarm_ticks_total" not in samples


def test_before_the_first_tick_the_known_metrics_are_served(silent):
    client, loop = silent
    loop.outputs = None
    _, samples = parsed(client.get("/metrics").text)
    assert samples["softarm_healthy"] == 0
    assert not any(name.startswith("softarm_mode") for name in samples)
