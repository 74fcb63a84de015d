"""Tests of every diagnosis, of the robot or of a rig."""

from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.diagnose import diagnose


def test_small_matrices_take_one_thread_whatever_the_machine_has() -> None:
    threads: list[int] = []

    def look(what: str, share: float) -> None:
        threads.extend(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")

    with pytest.raises(TrialError):
        diagnose([Trial("one", "steps", Path("one"), {})], progress=look)
    assert threads
    assert set(threads) == {1}
