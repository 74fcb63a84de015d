"""A diagnosis in three lines of Python: the object, its page and its errors."""

from pathlib import Path

import pytest

import softarm
from softarm.diagnosis import report
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.engine.result import Diagnosis
from softarm.simulator.model_file import ModelFileError
from tests.diagnosis.data import servo

FLIGHT = Path(__file__).parents[2] / "data" / "flight.mcap"


# Over a second: a diagnosis.
@pytest.mark.slow
def test_a_diagnosis_shows_its_answer_and_its_report(tmp_path):
    with pytest.warns(UserWarning, match=r"no model\.yaml .* the seed's simulator is the nominal model") as warned:
        diagnosis = softarm.diagnose(str(FLIGHT))
    assert warned[0].filename == __file__
    assert isinstance(diagnosis, Diagnosis)
    assert diagnosis.verdict.verdict == "none"
    assert repr(diagnosis).splitlines() == list(report.answer(diagnosis))
    diagnosis.save(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == report.render(diagnosis)
    assert diagnosis._repr_html_().startswith("<iframe ")


@pytest.mark.parametrize(
    ("recordings", "options", "error", "text"),
    [
        ((), {}, TrialError, "no trial to diagnose; name a campaign"),
        (("none.mcap",), {}, TrialError, "none.mcap: does not exist; name an MCAP log"),
        ((FLIGHT,), {"model": "sead"}, ModelFileError, "did you mean seed"),
        ((FLIGHT,), {"data": "tables"}, TrialError, "data='tables': is for the data files of a stage.yaml; name one"),
        (("stage.yaml",), {"model": "seed"}, TrialError, "stage.yaml holds its own nominal model; omit model"),
    ],
)
def test_an_error_names_the_value_and_the_next_step(recordings, options, error, text):
    with pytest.raises(error, match=text):
        softarm.diagnose(*recordings, **options)


def test_the_folder_of_a_rig_is_used_as_its_stage_file(tmp_path):
    (tmp_path / "stage.yaml").write_text(servo.STAGE)
    with pytest.raises(TrialError, match=r"stage\.yaml holds its own nominal model; omit model"):
        softarm.diagnose(tmp_path, model="seed")
    with pytest.raises(TrialError, match=r"recordings/data\.csv"):
        softarm.diagnose(tmp_path, data=tmp_path / "recordings")
