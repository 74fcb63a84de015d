"""Trusted policies: networks whose computation is bounded, which may run on the control loop's own thread.

A network is trusted by construction: this package runs it, its file was checked (no loop, limited size), and its
warm-up steps took a small share of the budget. Every other policy has a thread of its own and may hang there.
"""

import numpy as np

from softarm.policies.base import Policy
from softarm.policies.hold import Hold
from softarm.policies.runner import InlineRunner, PolicyRunner, ThreadRunner
from softarm.schemas.policy import OBSERVATION, REACH_GOAL

SHARE_MAX = 0.1  # of the budget, for a step of a trusted network after loading


def is_trusted(policy: Policy, budget_s: float) -> bool:
    """Return whether a policy is a checked network whose steps take a small share of the budget."""
    from softarm.policies.onnx_policy import OnnxPolicy  # imports onnxruntime

    # A subclass may do anything in its step.
    return type(policy) is OnnxPolicy and policy.step_s <= SHARE_MAX * budget_s


def runner(policy: Policy, budget_s: float) -> PolicyRunner:
    """Return the control loop's runner of a policy: on the loop's own thread if the policy is trusted."""
    return InlineRunner(policy, budget_s) if is_trusted(policy, budget_s) else ThreadRunner(policy, budget_s)


def rehearsal(of: PolicyRunner) -> PolicyRunner:
    """Return a runner for rehearsals: a network with a state of its own, or a stand-in for an untrusted policy."""
    from softarm.policies.onnx_policy import OnnxPolicy

    if isinstance(of, InlineRunner) and isinstance(of.policy, OnnxPolicy):
        return InlineRunner(of.policy.replica())
    stand_in = Hold()
    stand_in.spec = of.policy.spec
    return InlineRunner(stand_in)


def read_weights(replica: PolicyRunner) -> None:
    """Run a step of a rehearsal's runner on zeros, which brings the weights of its network into the caches."""
    replica.step(np.zeros(len(OBSERVATION), np.float32), np.zeros(len(REACH_GOAL), np.float32))
