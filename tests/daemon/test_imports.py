"""Imports of the daemon on real hardware and of its twin."""

import subprocess
import sys


def test_the_daemon_imports_neither_numba_nor_torch_and_the_twin_no_mujoco():
    program = (
        "import sys; from softarm.daemon.assembly import Daemon;"
        "from softarm.daemon.runtime.devices import real_devices;"
        "from softarm.schemas.config import Config;"
        "Daemon(Config(), real_devices(Config()));"
        "print(sorted({'numba', 'torch', 'mujoco', 'matplotlib', 'onnx'} & set(sys.modules)));"
        "import softarm.cli.operate.twin, softarm.drivers.twin.main;"
        "print(sorted({'mujoco', 'softarm.reality'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (run.stdout, run.returncode) == ("[]\n[]\n", 0), run.stderr
