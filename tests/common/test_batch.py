"""Batches of jobs: order, isolation of failures, restarts and files that travel to a cluster."""

import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from softarm.common import batch, cluster
from softarm.common.batch import Kept, Work, Workers
from tests.common.work import squared

KEYS = st.lists(st.text("abc -", min_size=1, max_size=5), unique=True, max_size=8)
HERE, FAKE = Workers(1), Workers(ray="local")


class FakeRay:
    """Stand-in for the part of Ray that jobs use; the last job finishes first, without a shared folder if wanted."""

    def __init__(self):
        self.asked, self.is_open = [], False

    def init(self, address, **_options):
        if address != "local":
            raise ConnectionError(f"could not reach {address}\nand much more")
        self.is_open = True

    def shutdown(self):
        self.is_open = False

    def nodes(self):
        return [
            {"Alive": alive, "Resources": {"CPU": count}} for alive, count in ((True, 1.0), (True, 2.0), (False, 64.0))
        ]

    def remote(self, **options):
        def task(function, asked=options):
            def start(*arguments):
                self.asked.append(asked)
                return lambda: function(*arguments)

            return SimpleNamespace(options=lambda **more: task(function, asked | more), remote=start)

        return task

    def wait(self, waiting, num_returns):
        return waiting[-1:], waiting[:-1]

    def get(self, ready):
        return ready()


@pytest.fixture
def ray(monkeypatch):
    fake = FakeRay()
    monkeypatch.setitem(sys.modules, "ray", fake)
    monkeypatch.setattr(cluster, "_end_with", lambda parent: None)
    return fake


def copied(place):
    """Write the doubled content of a file to a folder, and continue what the folder has."""
    before = (place / "out" / "twice").read_text() if (place / "out" / "twice").exists() else ""
    text = (place / "in" / "text").read_text()
    (place / "out").mkdir(exist_ok=True)
    (place / "out" / "twice").write_text(before + 2 * text)
    return str(place)


@given(KEYS, st.data())
@settings(max_examples=15, deadline=None)
def test_a_restart_runs_exactly_the_missing_jobs_and_gives_the_same(tmp_path_factory, keys, data):
    folder, run, numbers = tmp_path_factory.mktemp("kept"), [], {key: len(key) + k for k, key in enumerate(keys)}
    kept = Kept(lambda key: folder / key / "r.json", lambda key: {"of": numbers[key]})

    def work(number):
        run.append(number)
        return squared(number)

    first = {key: numbers[key] for key in data.draw(st.lists(st.sampled_from(keys), unique=True))} if keys else {}
    batch.run("first", work, first, HERE, kept=kept)
    changed = data.draw(st.sampled_from([*first, None]))
    if changed is not None:
        numbers[changed] += 100  # the input of a kept result changes
    run.clear()
    whole = batch.run("whole", work, numbers, HERE, kept=kept).complete()
    assert run == [number for key, number in numbers.items() if key not in first or key == changed]
    assert list(whole) == keys
    assert whole == {key: {"of": number, "square": number * number} for key, number in numbers.items()}


@given(st.lists(st.integers(-2, 5), max_size=6))
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_results_have_the_order_of_the_jobs_and_a_failure_stops_no_other(ray, numbers):
    todo = {f"job {k}": number for k, number in enumerate(numbers)}
    here, there = (batch.run("squaring", squared, todo, place) for place in (HERE, FAKE))
    assert here.results == there.results == {k: squared(n) for k, n in todo.items() if n >= 0}
    assert list(here.results) == list(there.results) == [key for key, n in todo.items() if n >= 0]
    assert {k: str(f) for k, f in here.failures.items()} == {
        key: f"ValueError: {n} is negative" for key, n in todo.items() if n < 0
    }
    assert list(there.failures) == list(here.failures)
    if here.failures:
        with pytest.raises(batch.JobsFailed, match=f"{len(here.failures)} of {len(todo)} jobs failed:\njob") as caught:
            here.complete()
        assert all("in squared" in note for note in caught.value.__notes__)


def test_other_processes_give_the_same(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2]))
    todo = {"a": 3, "b": -1, "c": 2}
    assert batch.run("", squared, todo, Workers(2)).results == batch.run("", squared, todo, HERE).results


def test_a_damaged_result_is_missing(tmp_path):
    kept = Kept(lambda key: tmp_path / f"{key}.json", lambda key: {})
    kept.write("a", {"square": 1})
    assert kept.read("a") == {"square": 1}
    kept.file("a").write_text('{"square": ')
    assert kept.read("a") is None
    kept.file("a").write_text("[]")
    assert kept.read("a") is None


def test_finished_results_stay_after_ctrl_c(tmp_path):
    def work(number):
        if number == 2:
            raise KeyboardInterrupt
        return squared(number)

    kept = Kept(lambda key: tmp_path / f"{key}.json", lambda key: {})
    with pytest.raises(KeyboardInterrupt):
        batch.run("", work, {"a": 1, "b": 2, "c": 3}, HERE, kept=kept)
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("shared", [True, False])
def test_the_files_of_a_job_travel_with_it(tmp_path, monkeypatch, ray, shared):
    (tmp_path / "case" / "in").mkdir(parents=True)
    (tmp_path / "case" / "out").mkdir()
    (tmp_path / "here").mkdir()
    (tmp_path / "case" / "in" / "text").write_text("ab")
    (tmp_path / "case" / "out" / "twice").write_text("-")  # of an interrupted run
    monkeypatch.chdir(tmp_path / "here")
    seen, place = [], Path("..", "case")
    work = Work(copied, lambda p: [p / "in", p / "out"], lambda p: [p / "out"])
    if not shared:
        parcel = cluster._parcel
        monkeypatch.setattr(cluster, "_parcel", lambda *of: parcel(*of)._replace(mark="not there"))
        unpack = cluster.unpack
        monkeypatch.setattr(cluster, "unpack", lambda content: (seen.append(Path.cwd()), unpack(content)))
    assert batch.run("", work, {"a": place}, FAKE).complete() == {"a": "../case"}
    assert (tmp_path / "case" / "out" / "twice").read_text() == "-abab"
    assert Path.cwd() == tmp_path / "here"
    assert not list((tmp_path / "here").iterdir())  # no mark is left
    assert not any(path.exists() for path in seen if path != tmp_path / "here")
    assert bool(seen) is not shared


def test_a_cluster_gets_the_needs_of_each_job_and_is_detached(ray):
    work = Work(lambda n: {"open": ray.is_open}, threads=3, cards=lambda n: int(n == 2))
    found = batch.run("", work, {"a": 1, "b": 2}, FAKE).complete()
    assert found == {"a": {"open": True}, "b": {"open": True}}
    # No node has three cores.
    assert ray.asked == [{"max_retries": 0, "num_cpus": 2, "num_gpus": cards} for cards in (0, 1)]
    assert not ray.is_open


def test_a_cluster_holds_few_jobs_at_once(ray, monkeypatch):
    waits, wait = [], ray.wait
    monkeypatch.setattr(ray, "wait", lambda waiting, num_returns: waits.append(len(waiting)) or wait(waiting, 1))
    batch.run("", squared, {str(n): n for n in range(20)}, FAKE)
    assert max(waits) == cluster.AHEAD * 3


def test_a_worker_that_died_and_another_version_are_failures_of_their_jobs(ray, monkeypatch):
    parcel = cluster._parcel
    monkeypatch.setattr(cluster, "_parcel", lambda *of: parcel(*of)._replace(code="0.1"))
    (failure,) = batch.run("", squared, {"a": 1}, FAKE).failures.values()
    assert str(failure).startswith("ClusterError: this node has softarm")
    error = OSError("Ray's long text")
    error.cause = MemoryError("too large")
    monkeypatch.setattr(ray, "get", lambda ready: (_ for _ in ()).throw(error))
    (failure,) = batch.run("", squared, {"a": 1}, FAKE).failures.values()
    assert str(failure) == "MemoryError: too large"
    assert not ray.is_open


def test_an_unusable_cluster_is_reported(ray, monkeypatch):
    with pytest.raises(cluster.ClusterError, match=r"no Ray cluster at 'far:1': could not reach far:1; give"):
        batch.run("", squared, {"a": 1}, Workers(ray="far:1"))
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(cluster.ClusterError, match=r"pip install 'softarm\[ray\]'"):
        batch.run("", squared, {"a": 1}, FAKE)


def test_the_bar_estimates_from_the_cost_of_the_missing_jobs(monkeypatch, tmp_path):
    shown = []

    def bar(text, total, done):
        shown.append((text, total, done))
        return nullcontext(SimpleNamespace(advance=shown.append))

    monkeypatch.setattr(batch, "bar", bar)
    kept = Kept(lambda key: tmp_path / f"{key}.json", lambda key: {})
    kept.write("a", {"square": 1})
    batch.run("flying", squared, {"a": 1, "b": 2, "c": -3}, HERE, kept=kept, cost=lambda n: 10 * abs(n))
    assert shown == [("flying", 60, 10), 20, 30]
