"""Diagnosis of recordings as an object with its report page."""

import warnings
from dataclasses import dataclass, fields
from pathlib import Path

from softarm.common.processes import bar
from softarm.diagnosis.data.read import TABLES, stage_of_folder
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.engine.result import Diagnosis
from softarm.evaluation.notebook import needs
from softarm.reporting.document import framed

HEIGHT_PX = 760  # of the frame in a notebook


@dataclass(frozen=True, eq=False, repr=False)
class ReportedDiagnosis(Diagnosis):
    """A `Diagnosis` that shows its report in a notebook and its answer in a terminal."""

    def save(self, path: Path | str) -> None:
        """Write the report as one HTML file. Raises OSError if that fails."""
        from softarm.diagnosis import report

        report.write(self, Path(path))

    def __repr__(self) -> str:
        from softarm.diagnosis import report

        return "\n".join(report.answer(self))

    def _repr_html_(self) -> str:
        from softarm.diagnosis import report

        return framed(report.render(self), "report of the diagnosis", HEIGHT_PX)


@needs("diagnosis")
def diagnose(
    *recordings: str | Path, model: str | Path | None = None, data: str | Path | None = None
) -> ReportedDiagnosis:
    """Find the effects that a simulator lacks, as `softarm diagnose` does.

    Args:
        recordings: Logs (.mcap), trial folders, campaigns (folders of them), or a stage.yaml.
        model: Nominal simulator of the robot: a shipped name or a model file; default: the campaign's model.yaml, else
            seed with a warning.
        data: Folder of the data files of a stage.yaml; default: its own folder.

    Returns:
        The diagnosis: `.verdict` has the answer, `.patched` the model with the named effects.

    Raises:
        TrialError: There are no recordings, they cannot be compared, or `model` or `data` is for another kind.
        ModelFileError: The model is missing or invalid.
        ModuleNotFoundError: The extra `diagnosis` is not installed.
    """
    from softarm.diagnosis.diagnose import diagnose_files

    paths = [stage_of_folder(Path(recording)) for recording in recordings]
    stage = next((path for path in paths if path.suffix in TABLES), None)
    if data is not None and stage is None:
        raise TrialError(f"data={str(data)!r}: is for the data files of a stage.yaml; name one, or omit data")
    if model is not None and stage is not None:
        raise TrialError(
            f"model={str(model)!r}: is the simulator of the robot, but {stage} holds its own nominal model; omit model"
        )
    with bar("reading") as shown:
        found = diagnose_files(
            paths,
            None if model is None else Path(model),
            None if data is None else Path(data),
            shown.report,
            lambda text: warnings.warn(text, stacklevel=5),
        )
    return ReportedDiagnosis(**{each.name: getattr(found, each.name) for each in fields(found)})
