"""The page of a diagnosis: its sections in order."""

from collections.abc import Iterable
from pathlib import Path

from softarm.common import files
from softarm.diagnosis.engine.result import Diagnosis
from softarm.diagnosis.report import evidence, overlays, sections, stages
from softarm.diagnosis.report.answer import headline
from softarm.pages.document import Section, document
from softarm.pages.markup import Html

Story = Iterable[tuple[str, str]]


def write(diagnosis: Diagnosis, path: Path, *, story: Story = ()) -> None:
    """Write the report as one HTML file. story: further sections, (title, HTML). Raises OSError."""
    files.write_text(path, render(diagnosis, story=story))


def render(diagnosis: Diagnosis, *, story: Story = ()) -> str:
    """The report as text; equal diagnoses give equal pages."""
    where = "Where in the chain" if diagnosis.nominal is not None else "Where the gap is"
    told = [
        Section("Stage by stage", "stages", stages.section(diagnosis)),
        Section("Measured, nominal, patched", "overlays", evidence.traces(diagnosis)),
        Section(where, "chain", sections.chain(diagnosis)),
        *(Section(title, f"story-{i}", Html(body)) for i, (title, body) in enumerate(story, 1)),
        Section("Frequencies and regimes", "frequencies", evidence.frequencies(diagnosis)),
        Section("Rivals", "rivals", evidence.contenders(diagnosis)),
        Section("What is left", "left", evidence.left(diagnosis)),
        Section("The next experiment", "next", sections.next_step(diagnosis)),
        Section("Details", "details", sections.details(diagnosis)),
        Section("Method", "method", sections.method(diagnosis)),
    ]
    lead, data = sections.result(diagnosis), overlays.packed(diagnosis)
    return document(headline(diagnosis), "softarm diagnosis", lead, told, plot=data)
