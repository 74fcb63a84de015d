"""The report of a diagnosis: one HTML page that a person reads from top to bottom. docs/diagnosis.md is its page."""

from softarm.diagnosis.report.page import render, write
from softarm.diagnosis.report.words import answer

__all__ = ["answer", "render", "write"]
