"""A marker set that wobbles on its link is found by mocap alone; noise, a wrong scale and a turned frame are none."""

from dataclasses import replace

import numpy as np
import pytest

from softarm.diagnosis.data.trials import Series
from softarm.diagnosis.diagnose import diagnose
from softarm.diagnosis.robot.markers import FLOOR_M, loose_marker
from softarm.schemas.model import Model

LINKS = 5
KINDS = ("pressure-multisine", "both")


def _changed(trials, change):
    """The same trials, `change` made of every mocap column by name."""
    return [
        replace(t, channels=t.channels | {"mocap": Series(m.t_s, {n: change(n, x, m) for n, x in m.columns.items()})})
        for t in trials
        for m in [t.channels["mocap"]]
    ]


def _wobbling(trials, link, size_m):
    def change(name, values, mocap):
        return values + size_m * np.sin(2 * np.pi * 4.3 * mocap.t_s) if name == f"link{link}_y" else values

    return _changed(trials, change)


def test_markers_that_move_with_their_links_or_wobble_within_the_noise_are_not_loose(campaign):
    assert loose_marker(campaign(kinds=KINDS), LINKS) is None
    assert loose_marker(_wobbling(campaign(kinds=KINDS), 3, 0.0002), LINKS) is None


@pytest.mark.parametrize("link", [1, 3, 5])
def test_a_marker_that_wobbles_is_found_by_link_and_size(link, campaign):
    found = loose_marker(_wobbling(campaign(kinds=KINDS), link, 0.001), LINKS)
    assert found is not None
    assert found.where.startswith(f"the markers of link {link} move")
    assert np.sqrt(found.energy) * FLOOR_M == pytest.approx(0.001 / np.sqrt(2), rel=0.15)


@pytest.mark.parametrize("sigma_m", [0.001, 0.004])
def test_noise_is_no_wobble_however_large(sigma_m, campaign):
    draw = np.random.default_rng(0)

    def noisy(name, values, mocap):
        return values + sigma_m * draw.normal(size=len(values)) if name.endswith(("_y", "_z")) else values

    assert loose_marker(_changed(campaign(kinds=KINDS), noisy), LINKS) is None


def test_a_wrong_scale_and_a_turned_frame_are_no_wobble(campaign):
    def turned(name, values, mocap):
        if not name.endswith(("_y", "_z")):
            return values
        y, z = (mocap[f"{name[:-2]}_{part}"] for part in ("y", "z"))
        return 1.04 * (y + 0.05 * z if name.endswith("_y") else z - 0.05 * y)

    assert loose_marker(_changed(campaign(kinds=KINDS), turned), LINKS) is None


def test_without_angles_no_marker_is_loose(campaign):
    trials = _wobbling(campaign(kinds=KINDS), 3, 0.004)
    bare = []
    for t in trials:
        mocap = t.channels["mocap"]
        columns = {name: x for name, x in mocap.columns.items() if not name.endswith("_angle")}
        bare.append(replace(t, channels=t.channels | {"mocap": Series(mocap.t_s, columns)}))
    assert loose_marker(bare, LINKS) is None


@pytest.mark.slow
def test_a_loose_marker_is_unknown_in_mocap_and_no_effect_of_the_arm(campaign):
    """Half a millimetre is within the floor of every stage, and the answer was none."""
    verdict = diagnose(_wobbling(campaign(kinds=KINDS), 3, 0.0007), Model()).verdict
    assert (verdict.verdict, verdict.effects, verdict.where.stage) == ("unknown", (), "mocap")
    assert any(text.startswith("mocap: the markers of link 3") for text in verdict.warnings)
