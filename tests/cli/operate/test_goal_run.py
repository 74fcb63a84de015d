"""Test of `softarm goal run` with the documented policy."""

import json
import os
import re
from pathlib import Path

import pytest

from tests.cli.invoke import invoke
from tests.processes import running, said, until

ROOT = Path(__file__).parents[3]
READY = '"arming_refusals": []'


@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_the_documented_policy_flies_from_the_command_line(install, tmp_path, monkeypatch):
    page = (ROOT / "docs" / "policies" / "interface.md").read_text(encoding="utf-8").partition("## Your own policy")[2]
    code = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert code is not None
    install("my_package", code[1], wave="Wave")
    config = tmp_path / "arm.yaml"
    config.write_text(f"api: {{port: 0}}\ncontrol: {{policy: wave}}\nrecorder: {{directory: {tmp_path}/logs}}\n")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', ROOT)}"}

    with running("run", "--simulated", "--config", config, env=environment) as daemon:
        monkeypatch.setenv("SOFTARM_URL", said(daemon, r"serving (http://\S+)"))

        def printed(*arguments):
            return invoke(*arguments).output

        until(lambda: (status := invoke("status", "--json")).exit_code == 0 and READY in status.output)
        assert printed("arm") == "armed\n"
        listed = printed("policy", "list")
        assert "* wave          sweeps the cart to and fro  (needs no target: `softarm goal run`)" in listed
        assert re.fullmatch(r"cancelled after 0\.\d\d s, as requested\n", printed("goal", "run", "--seconds", "0.5"))
        assert json.loads(printed("status", "--json"))["rail_position_m"] > 0.02
