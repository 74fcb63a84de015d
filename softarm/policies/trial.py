"""Trial of a policy in a separate process before the daemon loads it: that process may crash or be killed.

The process gets the policy's name, and the configured policies as JSON on standard input. It prints the problem; no
output and exit code 0 mean success.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping

import numpy as np

from softarm.policies import registry
from softarm.policies.base import Policy, PolicyError, PolicySpec
from softarm.policies.runner import InlineRunner
from softarm.schemas.config import Policy as ConfiguredPolicy
from softarm.schemas.policy import OBSERVATION, places

TRIAL_S = 90.0  # to load and step once; a plug-in may compile for half a minute
MEMORY_MAX = 16 * 1024**3  # bytes of address space, most of which a just-in-time compiler only reserves
# The kernel kills the process with the thread that started it and waits for it (prctl(2), PR_SET_PDEATHSIG is 1).
# The daemon's real-time priority is dropped before any other import.
_PROGRAM = """
import ctypes
import os
import signal
import sys
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
os.nice(10)
ctypes.CDLL(None).prctl(1, signal.SIGKILL)
if os.getppid() != int(sys.argv[2]):
    sys.exit()
from softarm.policies import trial
trial.main()
"""
# Target of the first steps, in the training range.
_TARGET = np.array([-0.2, 0.6], dtype=np.float32)


def observed_values(spec: PolicySpec) -> int:
    """Return the number of values in the observation of a policy."""
    return len(OBSERVATION) + (2 if spec.wants_tracking else 0)


def ready(policy: Policy) -> Policy:
    """Run the first step of a policy twice, reset in between. Raises PolicyError if that fails.

    A step may refuse the trial's target with a PolicyError, as planned trajectories to other targets do.
    """
    hanging = np.zeros(observed_values(policy.spec), dtype=np.float32)
    hanging[places("tip_z_m")] = 0.52
    runner = InlineRunner(policy)
    for _ in range(2):
        runner.reset()
        fault = runner.step(hanging, _TARGET).fault
        if fault is not None and f"step raised {PolicyError.__name__}:" not in fault:
            raise PolicyError(f"{fault}; repair it or choose another policy")
    return policy


def load(name: str, configured: Mapping[str, ConfiguredPolicy], limit_s: float) -> Policy:
    """Try out a policy in another process, then load it here. Raises PolicyError if either fails."""
    try_out(name, configured, limit_s)
    return ready(registry.load(name, configured))


def try_out(name: str, configured: Mapping[str, ConfiguredPolicy], limit_s: float) -> None:
    """Load a policy and run its first step in another process.

    Raises PolicyError with the problem, also if it takes longer than `limit_s` or the process ends.
    """
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, name, str(os.getpid())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with process:
        try:
            policies = json.dumps({key: policy.model_dump(mode="json") for key, policy in configured.items()})
            answer, _ = process.communicate(policies.encode(), timeout=limit_s)
        except subprocess.TimeoutExpired:
            raise PolicyError(
                f"policy '{name}': no first step within {limit_s:g} s; repair the policy or choose another"
            ) from None
        finally:
            process.kill()
    if answer:
        raise PolicyError(answer.decode(errors="replace"))
    if process.returncode:
        how = process.returncode
        ended = f"by {signal.Signals(-how).name}" if how < 0 else f"with exit code {how}"
        raise PolicyError(f"policy '{name}': its process ended {ended} during its trial; repair it")


def main() -> None:
    """Run as the trial's process; it does not return."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_MAX, hard))
    answer = os.dup(1)
    os.dup2(2, 1)  # keep output of the plug-in out of the answer
    configured = {key: ConfiguredPolicy.model_validate(policy) for key, policy in json.load(sys.stdin).items()}
    try:
        ready(registry.load(sys.argv[1], configured))
    except PolicyError as error:
        os.write(answer, str(error).encode())
    os._exit(0)  # do not wait for threads of the plug-in
