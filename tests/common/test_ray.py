"""Batches of jobs on a Ray cluster of two nodes: the same bytes as on processes of this computer."""

import json
import os
import shutil
import time
from pathlib import Path

import pytest

from softarm.common import batch, cluster
from softarm.common.batch import Workers
from softarm.diagnosis import many
from softarm.evaluation import entries, table
from softarm.policies.base import MODELS
from softarm.simulator import model_file
from softarm.training.run import sweep
from tests.ray_instance import WITH_RAY, apart
from validation.rigs.case import case_of
from validation.rigs.record import write

# The nodes start for half a minute; test_batch.py proves the same with a stand-in for Ray.
pytestmark = [pytest.mark.prove, pytest.mark.timeout(1800), WITH_RAY]
HERE = Workers(1)
SWEEP = """
seeds: [1]
base: {task: reach, frames: 256, settings: {run.robots: 16, run.validate_every: 2, run.validation_trials: 8}}
runs: {one: {}, two: {model: mine.yaml}}
"""


@pytest.fixture(scope="module")
def address():
    """Start two nodes of one core each."""
    with apart():
        from ray.cluster_utils import Cluster

        nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        try:
            nodes.add_node(num_cpus=1)
            yield nodes.address
        finally:
            nodes.shutdown()


@pytest.fixture(params=["the same folder", "no shared folder"])
def there(request, address, monkeypatch):
    """Return the cluster, whose nodes see the driver's folder or not."""
    if request.param == "no shared folder":
        parcel = cluster._parcel
        monkeypatch.setattr(cluster, "_parcel", lambda *of: parcel(*of)._replace(mark="not there"))
    return Workers(1, address)


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Return two equal folders; the current one is that of the cluster."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "there")
    return tmp_path / "here", tmp_path / "there"


def in_both(folders, there, work):
    """Return the results of work on this computer and on the cluster."""
    found = []
    for folder, workers in zip(folders, (HERE, there), strict=True):
        os.chdir(folder)
        found.append(work(workers))
    return found


def node(_number):
    import ray

    time.sleep(0.5)  # so that one node alone does not take all jobs
    return ray.get_runtime_context().get_node_id()


def fails(number):
    if number == 1:
        os._exit(1)
    return number


def test_both_nodes_work_and_a_killed_worker_stops_no_other_job(there):
    found = batch.run("", node, {str(k): k for k in range(6)}, there).complete()
    assert len(set(found.values())) == 2
    done = batch.run("", fails, {str(k): k for k in range(4)}, there)
    assert done.results == {"0": 0, "2": 2, "3": 3}
    assert list(done.failures) == ["1"]


def test_a_sweep_gives_the_same_policies_and_figures(there, folders):
    for folder in folders:
        (folder / "sweep.yaml").write_text(SWEEP)
        shutil.copy(model_file.locate("no-delay"), folder / "mine.yaml")

    def train(workers):
        results = sweep.run_all(sweep.plan(sweep.load(Path("sweep.yaml")), Path("out")), workers)
        return [result._replace(seconds=0.0) for result in results]

    here, far = in_both(folders, there, train)
    assert here == far
    for result in here:
        files = [folder / "out" / result.name / "seed-1" for folder in folders]
        assert len({(file / result.policy).read_bytes() for file in files}) == 1
        assert (files[1] / "latest.pt").is_file()
        assert json.loads((files[1] / "result.json").read_text())["name"] == result.name


def test_an_evaluation_gives_the_same_table(there, folders):
    for folder in folders:
        shutil.copy(MODELS / "shelf.onnx", folder / "mine.onnx")

    def compare(workers):
        return json.dumps(table.compare(entries.given(("mine.onnx", "pid")), workers, ("shelf",)))

    here, far = in_both(folders, there, compare)
    assert here == far


def test_a_diagnosis_gives_the_same_bytes(there, folders):
    for folder in folders:
        for strength in (0.5, 1.0):
            case = case_of("servo", ["dead_time"], strength, 1, ["steps"])
            write(case, folder / "data" / str(strength), folder / "truths")

    def diagnose(workers):
        return many.diagnose_all(sorted(Path("data").glob("*/*")), many.Options(Path("out"), budget_s=5.0), workers)

    here, far = in_both(folders, there, diagnose)
    assert here == far
    content = [{file.name: file.read_bytes() for file in (folder / "out").glob("*.*")} for folder in folders]
    assert content[0] == content[1]
    assert len(content[0]) >= 6
