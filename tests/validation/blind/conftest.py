"""Fixtures of the blind benchmark's tests."""

from tests.diagnosis.conftest import campaign

__all__ = ["campaign"]
