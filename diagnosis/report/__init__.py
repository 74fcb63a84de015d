"""The report of a diagnosis: one HTML page that a person reads from top to bottom. docs/diagnosis.md is its page."""

from softarm.diagnosis.report.answer import answer
from softarm.diagnosis.report.following import flight, steps
from softarm.diagnosis.report.page import render, write
from softarm.diagnosis.report.stages import paragraphs

__all__ = ["answer", "flight", "paragraphs", "render", "steps", "write"]
