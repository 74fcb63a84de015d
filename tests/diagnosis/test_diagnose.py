"""Tests of every diagnosis, of the robot or of a rig."""

from pathlib import Path

import pytest
import sklearn.tree  # noqa: F401  loads OpenMP, whose threads are counted
from threadpoolctl import threadpool_info, threadpool_limits

from softarm.diagnosis.data.trials import Trial, TrialError
from softarm.diagnosis.diagnose import diagnose


def _threads():
    return {(each["user_api"], each["num_threads"]) for each in threadpool_info()}


def test_a_diagnosis_uses_one_thread_and_restores_the_others():
    seen = set()
    with threadpool_limits(2):
        with pytest.raises(TrialError):
            diagnose([Trial("one", "steps", Path("one"), {})], progress=lambda what, share: seen.update(_threads()))
        assert _threads() == {("blas", 2), ("openmp", 2)}
    assert seen == {("blas", 1), ("openmp", 1)}  # also the threads of the trees


def test_an_empty_campaign_is_rejected():
    with pytest.raises(TrialError, match="no trial to diagnose; name a campaign"):
        diagnose([])
