"""Data of the plot: decoding gives the measured values."""

import base64

import numpy as np
import pytest

from softarm.reporting import plot
from softarm.reporting.plot import Traces


def decoded(packed):
    levels = np.frombuffer(base64.b64decode(packed["levels"]), "<u2").astype(float)
    return np.where(levels == 65535, np.nan, packed["low"] + levels * (packed["high"] - packed["low"]) / 65534)


def stamps(packed):
    if "us" in packed:
        return packed["start"] + np.frombuffer(base64.b64decode(packed["us"]), "<u4") / 1e6
    return packed["start"] + packed["step"] * np.arange(packed["n"])


def item(t_s, **curves):
    (packed,) = plot.packed(("trial",), [Traces(("one",), "seed", "m", t_s, curves)])["items"]
    return packed


@pytest.mark.parametrize("jitter_s", [0.0, 1e-4], ids=["uniform", "jittered"])
def test_curves_and_stamps_come_back_as_they_were(jitter_s):
    draw = np.random.default_rng(1)
    t_s = 7.0 + np.arange(400) / 100 + jitter_s * draw.uniform(size=400)
    measured = np.sin(t_s) + 0.01 * draw.normal(size=400)
    measured[50:60] = np.nan
    packed = item(t_s, measured=measured, nominal=np.sin(t_s))
    assert ("us" in packed["t"]) == (jitter_s > 0)
    np.testing.assert_allclose(stamps(packed["t"]), t_s, atol=2e-6)
    for name, given in (("measured", measured), ("nominal", np.sin(t_s))):
        back = decoded(packed["curves"][name])
        assert np.array_equal(np.isnan(back), np.isnan(given))
        np.testing.assert_allclose(back, given, atol=2e-5, equal_nan=True)


def test_empty_and_constant_recordings_come_back_too():
    packed = item(np.arange(5) / 10, constant=np.ones(5), gone=np.full(5, np.nan))
    assert decoded(packed["curves"]["constant"]).tolist() == [1.0] * 5
    assert np.isnan(decoded(packed["curves"]["gone"])).all()
    assert item(np.array([]), measured=np.array([]))["t"]["n"] == 0


def test_beyond_the_budget_every_curve_is_thinned_alike(monkeypatch):
    monkeypatch.setattr(plot, "BUDGET", 700)
    t_s = np.arange(400) / 100
    items = [Traces(("one",), "", "-", t_s, {"a": t_s, "b": t_s}), Traces(("two",), "", "-", t_s, {"a": t_s})]
    assert plot.every(items) == 2
    for packed in plot.packed(("trial",), items)["items"]:
        np.testing.assert_allclose(stamps(packed["t"]), t_s[::2], atol=2e-6)
        for curve in packed["curves"].values():
            np.testing.assert_allclose(decoded(curve), t_s[::2], atol=1e-4)


def test_a_number_without_a_unit_shows_none():
    items = [Traces(("one",), "", unit, np.zeros(1), {"a": np.zeros(1)}) for unit in ("-", "1", "kPa")]
    assert [packed["unit"] for packed in plot.packed(("trial",), items)["items"]] == ["", "", "kPa"]


def test_a_page_may_open_on_a_part_of_its_first_recording():
    items = [Traces(("one",), "", "-", np.arange(5.0), {"a": np.zeros(5)})]
    assert plot.packed(("trial",), items, view=(1.0, 2.0))["view"] == [1.0, 2.0]
    assert "view" not in plot.packed(("trial",), items)
