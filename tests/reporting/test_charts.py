"""Charts show their values at the right positions."""

import re

import numpy as np

from softarm.reporting import charts


def test_a_spectrum_keeps_its_level_when_thinned():
    frequency_hz = np.linspace(0.1, 50, 5000)
    f, density = charts.thinned(frequency_hz, np.full(5000, 0.3))
    assert len(f) < 200
    np.testing.assert_allclose(density, 0.3)


def test_a_spectrum_draws_what_has_values_and_names_it():
    frequency_hz = np.linspace(0.1, 50, 500)
    curves = {"nominal": 1 / frequency_hz, "patched": np.zeros(500)}
    drawn = charts.spectrum(frequency_hz, curves, 0.1, "Residual")
    assert "Residual: nominal<" in drawn
    assert drawn.count('class="curve ') == 1
    assert drawn.count('class="floor"') == 1
    assert charts.spectrum(frequency_hz, {"patched": np.zeros(500)}, 0.1, "Residual") is None


def test_a_flat_spectrum_of_one_frequency_is_drawn_without_nan():
    drawn = charts.spectrum(np.array([2.0]), {"nominal": np.array([0.3])}, float("nan"), "Residual")
    assert "nan" not in drawn
    assert "inf" not in drawn


def test_a_map_puts_places_where_they_are_and_marks_their_share():
    drawn = charts.disc_map([-0.4, 0.0, -0.4, 0.0], [0.55, 0.55, 0.80, 0.80], [1.0, 0.5, 0.25, 0.0], "reach")
    full, half, quarter = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="([\d.]+)" class="ink"/>', drawn)
    assert float(full[0]) == float(quarter[0]) < float(half[0])
    assert float(quarter[1]) < float(full[1]) == float(half[1])
    assert float(full[2]) > float(half[2]) > float(quarter[2]) > 0
    assert drawn.count('class="ring"') == 3
    assert drawn.count('class="missed"') == 1
    assert "<b>reach</b> 44 %" in drawn
    assert "y 0.00, z 0.55 m: 50 %" in drawn


def test_a_map_has_a_note_for_each_place_and_a_legend_of_its_marks():
    drawn = charts.disc_map([0.0, 0.1], [0.5, 0.6], [1.0, 0.0], "reach", ["12 mm", "<90 mm>"])
    assert "y 0.00, z 0.50 m: 12 mm" in drawn
    assert "&lt;90 mm&gt;" in drawn
    assert re.findall(r"</svg>(\w+)", charts.map_legend("all", "some", "none")) == ["all", "some", "none"]


def test_a_ladder_is_on_one_scale():
    drawn = charts.ladder(2.0, 1.0, 0.5, None)
    assert re.findall(r'<rect x="0" y="\d+" width="([\d.]+)"', drawn) == ["240.0", "120.0"]
    assert 'x1="60.0"' in drawn
    assert "50 %" in drawn


def test_lanes_draw_each_signal_over_the_whole_time():
    t_s = np.linspace(0.0, 4.0, 9)
    drawn = charts.lanes(t_s, {"pressure (kPa)": 18 * t_s / 4, "cart (m/s)": -0.5 * t_s / 4}, "Commands")
    for piece in ("pressure (kPa)", "cart (m/s)", ">18<", ">-0.5<", ">4 s<"):
        assert piece in drawn
    assert drawn.count("<path") == 2
