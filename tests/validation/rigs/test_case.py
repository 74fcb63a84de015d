"""Drawn rigs and their recordings; the data reveal nothing of the truth."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter

from softarm.schemas.trial import StageFile
from validation.rigs.case import case_of, draw
from validation.rigs.faults import FAULTS
from validation.rigs.presets import RIGS
from validation.rigs.record import record, stage_model, write


def test_cases_follow_the_shares_alternate_kinds_and_depend_on_the_seed_alone():
    cases = draw(100, 3)
    kinds, categories = Counter(c.kind for c in cases), Counter(c.category for c in cases)
    assert set(kinds.values()) == {25}
    assert categories["unknown"] == 22
    assert categories["none"] == 14
    assert categories["single"] - 24 == 16 - categories["set"] >= 0  # a rig that ties nothing has a single instead
    assert sum(categories.values()) == 100
    assert [c.truth for c in draw(100, 3)] == [c.truth for c in cases]
    assert [c.truth for c in draw(100, 4)] != [c.truth for c in cases]
    assert len({c.name for c in cases}) == 100
    assert {c.kind for c in draw(6, 0, ("tracking", "pendulum"))} == {"tracking", "pendulum"}


def test_every_case_matches_its_category():
    for case in draw(300, 5):
        known = [c for c in case.causes if c.right["names"]]
        match case.category:
            case "single" | "half":
                assert len(known) == len(case.causes) == 1
                assert case.strength == (0.5 if case.category == "half" else 1.0)
            case "two":
                assert len(known) == 2
                assert not {*known[0].right["names"]} & {*known[1].right["names"]}
            case "set":
                assert len(case.causes[0].right["must"]) >= 2
                assert {c.fault for c in case.causes} <= FAULTS[case.rig.plant].keys()
            case "none":
                assert not case.causes
            case "unknown":
                assert not known
                assert len(case.causes) == 1


def short(case):
    """Return a case with two trials of one second."""
    return replace(case, excitations=case.excitations[:2], rig=replace(case.rig, duration_s=(1.0, 1.0)))


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["servo", "grip", "cart", "pendulum", "arm", "pole"])
def test_a_folder_holds_what_an_owner_has_and_the_truth_is_elsewhere(tmp_path, rig):
    name = "coulomb_friction" if "coulomb_friction" in FAULTS[RIGS[rig].plant] else "dead_time"
    case = short(case_of(rig, [name], seed=734211))
    truth = write(case, tmp_path / "data", tmp_path / "truths")
    assert write(case, tmp_path / "again", tmp_path / "truths") == truth
    folder = tmp_path / "data" / case.name
    stage = yaml.safe_load((folder / "stage.yaml").read_text())
    assert StageFile.model_validate(stage).kind == RIGS[rig].kind
    assert json.loads((tmp_path / "truths" / f"{case.name}.json").read_text()) == truth
    assert truth["causes"][0]["names"]
    files = {f for t in stage["trials"] for f in t["files"].values()}
    assert {p.name for p in folder.iterdir()} == {"stage.yaml", *files}
    assert all(p.read_bytes() == (tmp_path / "again" / case.name / p.name).read_bytes() for p in folder.iterdir())
    text = " ".join(p.read_text() for p in folder.iterdir())
    for word in ("truth", "cause", "fault", "strength", "categor", name, str(case.seed)):
        assert word not in text
    rows = np.genfromtxt(folder / sorted(files)[-1], delimiter=",", names=True)
    assert np.all(np.diff(rows["time"]) > 0)
    assert abs(np.median(np.diff(rows["time"])) * RIGS[rig].rate_hz - 1) < 0.05


def test_a_healthy_rig_is_near_its_nominal_model_and_a_fault_is_visible(tmp_path):
    sound, whole, half = (
        write(short(case_of("servo", faults, strength, seed=1)), tmp_path / "d", tmp_path / "t")
        for faults, strength in (([], 1.0), (["dead_time"], 1.0), (["dead_time"], 0.5))
    )
    assert sound["off_nominal"] < 3 * sound["floor"]
    assert sound["shows"] == {}
    assert whole["clarity"] > 1.5 * half["clarity"] > 10


@pytest.mark.slow
@pytest.mark.parametrize(
    "rig", ["servo", *(pytest.param(rig, marks=pytest.mark.prove) for rig in ("belt", "bellows", "tank"))]
)
def test_a_nominal_follower_equals_the_lag_and_delay_of_its_stage_yaml(rig):
    """The nominal values equal the fit of a single lag with delay: other values have a larger residual."""
    case = case_of(rig, [], seed=3, excitations=["chirp", "steps"])
    runs, floor = record(case)
    model = stage_model(case.rig)

    def left(lag_s, delay_s):
        return np.hypot(*(_left(run, lag_s, delay_s) for run in runs))

    lag, delay = model["lag_s"], model["delay_s"]
    assert left(lag, delay) < 3 * floor
    for other in ((1.04 * lag, delay), (0.96 * lag, delay), (lag, delay + 0.03 * lag), (lag, delay - 0.03 * lag)):
        assert left(lag, delay) < left(*other)


def _left(run, lag_s, delay_s):
    """RMS between the believed machine and one lag with a delay."""
    dt = min(1e-3, lag_s / 50)
    t = np.arange(0, run.sent_s[-1], dt)
    held = run.sent["command"][np.maximum(np.searchsorted(run.sent_s + delay_s, t, side="right") - 1, 0)]
    closes = -np.expm1(-dt / lag_s)
    reached, _ = lfilter([0.0, closes], [1.0, closes - 1.0], held, zi=run.clean[1][0])
    apart = run.clean[1][:, 0] - np.interp(run.stamps_s, t, reached)
    return np.sqrt(np.mean(apart[len(apart) // 10 :] ** 2))
