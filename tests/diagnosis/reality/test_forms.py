"""One flight as trial folders and as logs: the same trials, the same verdict, whatever the order."""

import numpy as np
import pytest

from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.diagnose import diagnose
from softarm.schemas.model import Model

DEAD_TIME_S = 0.06
pytestmark = pytest.mark.slow


def test_the_trials_of_logs_are_the_folders_own(flown, as_logs):
    of_folder = {trial.name: trial for trial in read_all([flown(DEAD_TIME_S)])}
    of_logs = {trial.name: trial for trial in read_all([as_logs])}
    assert of_logs.keys() == of_folder.keys()
    for name, trial in of_logs.items():
        other = of_folder[name]
        assert (trial.kind, trial.rail, trial.warnings) == (other.kind, other.rail, other.warnings)
        assert trial.channels.keys() == other.channels.keys()
        shift_s = trial.channels["mocap"].t_s[0] - other.channels["mocap"].t_s[0]
        for channel, series in trial.channels.items():
            np.testing.assert_allclose(series.t_s, other.channels[channel].t_s + shift_s, rtol=0, atol=1e-8)
            for column, values in series.columns.items():
                late_s = shift_s if column == "t_receive" else 0.0
                np.testing.assert_allclose(values, other.channels[channel][column] + late_s, rtol=0, atol=1e-8)


@pytest.mark.prove
def test_a_shuffled_campaign_gets_the_same_verdict(diagnosed, flown):
    verdict = diagnose(read_all([flown(DEAD_TIME_S)])[::-1], Model()).verdict
    assert verdict == diagnosed(DEAD_TIME_S).verdict


def test_the_daemons_logs_get_the_same_verdict(diagnosed, as_logs):
    """Their clock begins elsewhere: what depends on where a grid begins differs by rounding, nothing else."""
    verdict, expected = diagnose(read_all([as_logs]), Model()).verdict, diagnosed(DEAD_TIME_S).verdict
    assert (verdict.verdict, verdict.where.stage) == (expected.verdict, expected.where.stage)
    assert [(e.name, e.equivalents) for e in verdict.effects] == [(e.name, e.equivalents) for e in expected.effects]
    for one, other in zip(verdict.effects, expected.effects, strict=True):
        for name, estimate in one.parameters.items():
            known = other.parameters[name]
            chance = 0.1 * (known.high - known.low)
            ends = [known.value, known.low, known.high]
            assert [estimate.value, estimate.low, estimate.high] == pytest.approx(ends, abs=chance)
    for stage, before in verdict.gap.before.items():
        assert before.value == pytest.approx(expected.gap.before[stage].value, rel=0.02)
