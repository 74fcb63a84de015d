"""Gaps that `validation.closing` closes: an interrupted case is repeated from its last complete step."""

import json
from pathlib import Path
from types import SimpleNamespace

from validation import closing

FOUND = dict.fromkeys(("verdict", "effects", "ways", "fly", "spent"), "as written")


def test_an_interrupted_case_is_closed_from_an_empty_folder(tmp_path, monkeypatch):
    folder = tmp_path / "rail.lag_s=0.1"
    for half_done in (folder / "campaign" / "trial-1", folder / "closed"):
        half_done.mkdir(parents=True)
        (half_done / "verdict.json").touch()

    def record(campaign, robot):
        assert not campaign.exists()
        campaign.mkdir()
        (campaign / "model.yaml").touch()

    def run(command, **_):
        out = Path(command[command.index("--out") + 1])
        assert not out.exists()
        out.mkdir()
        (out / "summary.json").write_text(json.dumps(FOUND))
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(closing, "record_campaign", record)
    monkeypatch.setattr(closing.subprocess, "run", run)
    assert closing.closed(("rail.lag_s=0.1",), tmp_path) == FOUND
