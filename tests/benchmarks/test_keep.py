"""Storing of figures: a result without its dependencies is refused before anything is measured."""

from click.testing import CliRunner

from benchmarks import keep


def test_an_unknown_result_is_refused_before_its_command_runs(tmp_path):
    done = CliRunner().invoke(keep.main, ["nosuch-result", "--", "touch", str(tmp_path / "ran")])
    assert done.exit_code == 1
    assert "add it to DEPENDS in benchmarks/results.py" in done.output
    assert not (tmp_path / "ran").exists()
