"""Report page of a diagnosis, with its sections in order."""

from collections.abc import Iterable
from pathlib import Path

from softarm.common import files
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report import evidence, sections, stages
from softarm.diagnosis.report.answer import headline
from softarm.diagnosis.report.film import drawing
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Html, join

FurtherSections = Iterable[tuple[str, str]]


def write(diagnosis: Diagnosis, path: Path, *, further: FurtherSections = ()) -> None:
    """Write the report as one HTML file; raise OSError if that fails.

    Args:
        diagnosis: diagnosis to report.
        path: file to write.
        further: title and HTML of each section to insert after the next experiment.
    """
    files.write_text(path, render(diagnosis, further=further))


def render(diagnosis: Diagnosis, *, further: FurtherSections = ()) -> str:
    """Return the report as HTML; equal diagnoses give equal pages."""
    shown = [
        Section("The worst two seconds", "overlays", _worst(diagnosis)),
        Section("Next experiment", "next", sections.next_step(diagnosis)),
        *(Section(title, f"further-{i}", Html(body)) for i, (title, body) in enumerate(further, 1)),
        Section("Stage by stage", "stages", stages.section(diagnosis), folded=True),
        Section("Calibration", "calibration", sections.calibration(diagnosis), folded=True),
        Section("Frequencies and regimes", "frequencies", evidence.frequencies(diagnosis), folded=True),
        Section("Rivals", "rivals", evidence.contenders(diagnosis), folded=True),
        Section("Remaining gap", "left", evidence.left(diagnosis), folded=True),
        Section("Details", "details", sections.details(diagnosis), folded=True),
        Section("Method", "method", sections.method(diagnosis), folded=True),
    ]
    lead, data = sections.result(diagnosis), evidence.packed(diagnosis)
    return document(headline(diagnosis), "softarm diagnosis", lead, shown, plot=data)


def _worst(diagnosis: Diagnosis) -> Html:
    film = [] if diagnosis.film is None else [drawing(diagnosis.film)]
    return join([*film, evidence.traces(diagnosis)])
