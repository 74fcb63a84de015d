"""HTML report of a diagnosis (docs/gap/diagnosis.md)."""

from softarm.diagnosis.report.answer import answer, headline
from softarm.diagnosis.report.following import flight, steps
from softarm.diagnosis.report.page import render, write
from softarm.diagnosis.report.stages import paragraphs
from softarm.diagnosis.report.words import calibration_in_words, corrected, interval, tolerance

__all__ = [
    "answer",
    "calibration_in_words",
    "corrected",
    "flight",
    "headline",
    "interval",
    "paragraphs",
    "render",
    "steps",
    "tolerance",
    "write",
]
