"""Imports of the daemon on real hardware."""

import subprocess
import sys


def test_the_daemon_with_real_drivers_imports_neither_numba_nor_torch():
    program = (
        "import sys; from softarm.daemon.assembly import Daemon;"
        "from softarm.daemon.runtime.devices import real_devices;"
        "from softarm.schemas.config import Config;"
        "Daemon(Config(), real_devices(Config()));"
        "print(sorted({'numba', 'torch', 'mujoco', 'matplotlib', 'onnx'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (run.stdout.strip(), run.returncode) == ("[]", 0), run.stderr
