"""HTML report of a diagnosis (docs/gap/diagnosis.md)."""

from softarm.diagnosis.report.answer import answer
from softarm.diagnosis.report.following import flight, steps
from softarm.diagnosis.report.page import render, write
from softarm.diagnosis.report.stages import paragraphs

__all__ = ["answer", "flight", "paragraphs", "render", "steps", "write"]
