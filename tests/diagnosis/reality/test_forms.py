"""One flight in every form that is read: the same trials, the same verdict, whatever the order."""

import numpy as np
import pytest
from click.testing import CliRunner

from softarm.cli.main import main
from softarm.diagnosis.data.read import read_all
from softarm.diagnosis.diagnose import diagnose
from softarm.schemas.model import Model

DEAD_TIME_S = 0.06
pytestmark = pytest.mark.slow


@pytest.mark.parametrize("form", ["as_parquet", "as_logs"])
def test_the_trials_are_the_folders_own(form, flown, request):
    of_folder = {trial.name: trial for trial in read_all([flown(DEAD_TIME_S)])}
    of_form = {trial.name: trial for trial in read_all([request.getfixturevalue(form)])}
    assert of_form.keys() == of_folder.keys()
    for name, trial in of_form.items():
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
def test_a_shuffled_campaign_from_parquet_gets_the_same_verdict(diagnosed, as_parquet):
    verdict = diagnose(read_all([as_parquet])[::-1], Model()).verdict
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


@pytest.fixture(scope="module", params=["csv", "parquet"])
def exported(request, as_logs, tmp_path_factory):
    """The logs as `softarm logs export` gives them to other programs."""
    campaign = tmp_path_factory.mktemp(request.param)
    logs = sorted(map(str, as_logs.glob("*.mcap")))
    result = CliRunner().invoke(main, ["logs", "export", "--to", request.param, "--out", str(campaign), *logs])
    assert result.exit_code == 0, result.output
    return campaign


def test_what_is_exported_is_the_log_to_the_bit(exported, as_logs):
    """So its verdict is the log's: the diagnosis has no other input, and no dice."""
    of_logs, of_export = (read_all([each]) for each in (as_logs, exported))
    assert len(of_logs) == 2
    for log, export in zip(of_logs, of_export, strict=True):
        assert (log.name, log.kind, log.rail, log.warnings) == (export.name, export.kind, export.rail, export.warnings)
        assert log.channels.keys() == export.channels.keys()
        for channel, series in log.channels.items():
            assert series.columns.keys() == export.channels[channel].columns.keys()
            for column, values in {"t": series.t_s, **series.columns}.items():
                other = {"t": export.channels[channel].t_s, **export.channels[channel].columns}[column]
                np.testing.assert_array_equal(values, other)
