"""The table of closed gaps, from summaries of `softarm close-gap`."""

import json

from softarm.evaluation.robots import with_faults
from softarm.reality.parameters import RobotParameters
from validation import closing


def way(reached, stops=0):
    half = {"flights": 50, "reached": reached // 2, "stops": {}}
    return {"rest": half, "swinging": {**half, "stops": {"rail_outside": stops} if stops else {}}, "cpu_s": 20.0}


def summary(**ways):
    return {"verdict": "named", "effects": ["rail.lag"], "ways": ways, "fly": "mppi", "spent": {"fly": {"cpu_s": 60.0}}}


def test_a_gap_is_closed_if_one_way_comes_near_the_level_without_a_stop():
    found = {
        "rail.lag_s=0.1": summary(old=way(60), mppi=way(88)),
        "arm.damping=1": summary(old=way(60), mppi=way(88, stops=1), new=way(80)),
    }
    rows = closing.table(0.90, found).splitlines()
    assert "within 3 points of 90 %" in rows[0]
    assert "| 88 %, 20 s | " in rows[2]
    assert "| yes | mppi | 60 |" in rows[2]
    assert "88 %, 1 stops" in rows[3]
    assert "| no | mppi | 60 |" in rows[3]


def test_finished_cases_are_not_repeated(tmp_path):
    case = ("rail.delay_s=0.09",)
    done = tmp_path / case[0] / "closed" / "summary.json"
    done.parent.mkdir(parents=True)
    (tmp_path / case[0] / "campaign").mkdir()
    (tmp_path / case[0] / "campaign" / "model.yaml").write_text("")
    done.write_text(json.dumps(summary(old=way(60)) | {"limits": {}}))
    assert closing.closed(case, "reach", 120.0, tmp_path) == summary(old=way(60))


def test_the_cases_are_ten_faults_and_five_pairs():
    assert (len(closing.CASES), len(set(closing.CASES))) == (15, 15)
    assert all(with_faults(RobotParameters(), case) != RobotParameters() for case in closing.CASES)
