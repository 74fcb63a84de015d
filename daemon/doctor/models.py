"""Do the shipped policies give here what they gave when they were exported, and in time?"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import onnxruntime as ort

from softarm.daemon.doctor.finding import Finding, ok, problem, warning
from softarm.policies import registry, trial
from softarm.policies.base import MODELS, Policy, PolicyError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.config import Config
from softarm.schemas.policy import OBSERVATION, REACH_GOAL

STEPS, STEPS_S = 300, 2.0  # that are timed, at most


@dataclass(frozen=True, slots=True)
class Golden:
    """A model's golden run, which is in its file, run again by this onnxruntime on this processor."""

    name: str
    off: float = 0.0  # of the network's -1 .. 1, at worst
    allowed: float = 0.0
    error: str | None = None


@dataclass(frozen=True, slots=True)
class Models:
    """What was run."""

    runtime: str
    goldens: tuple[Golden, ...]
    policy: str  # control.policy
    error: str | None = None  # why it does not load
    steps_ms: tuple[float, ...] = ()  # that each of its steps took; empty: not measured
    unusable: tuple[str, ...] = ()  # others of the configuration, each with why


def look(config: Config, measured: bool = True) -> Models:
    """Run every shipped model's golden run, and time the policy that the daemon starts with."""
    goldens = tuple(_golden(file.stem) for file in sorted(MODELS.glob("*.onnx")))
    name, entries = config.control.policy, registry.available(config.policies)
    others = (f"policies.{each}: {entries[each].error}" for each in config.policies if entries[each].error)
    facts = Models(ort.__version__, goldens, name, unusable=tuple(others))
    try:
        policy = trial.ready(registry.load(name, config.policies))
    except PolicyError as error:
        return replace(facts, error=str(error))
    try:
        return replace(facts, steps_ms=timed(policy) if measured else ())
    except Exception as error:  # somebody's own policy
        return replace(facts, error=f"policy '{name}': {type(error).__name__} in a step: {error}")


def _golden(name: str) -> Golden:
    try:
        policy = OnnxPolicy(name)
    except PolicyError as error:
        return Golden(name, error=str(error))
    off, _ = policy.golden_error()
    return Golden(name, off, policy.metadata.golden.tolerance)


def timed(policy: Policy) -> tuple[float, ...]:
    """A policy's steps on an arm that hangs about at random."""
    generator = np.random.default_rng(0)
    width = len(OBSERVATION) + (2 if policy.spec.wants_sight else 0)
    policy.reset()
    took_ms = []
    for _ in range(STEPS):
        observation = generator.normal(0.0, 0.2, width).astype(np.float32)
        begun_ns = time.monotonic_ns()
        policy.step(observation, np.zeros(len(REACH_GOAL), np.float32))
        took_ms.append((time.monotonic_ns() - begun_ns) * 1e-6)
        if sum(took_ms) > STEPS_S * 1e3:
            break
    return tuple(took_ms)


def judge(facts: Models, budget_s: float) -> Iterator[Finding]:
    """Findings on the golden runs, on the policy of the start and its time."""
    wrong = [each.error for each in facts.goldens if each.error is not None]
    for error in wrong:
        yield problem("golden run", error, "install softarm again; if it stays, another onnxruntime")
    if not wrong and facts.goldens:
        worst = max(facts.goldens, key=lambda each: each.off / each.allowed)
        figure = (
            f"{len(facts.goldens)} models as exported, off by {worst.off:.1g} at most ({worst.allowed:.1g} allowed)"
        )
        yield ok("golden runs", f"{figure}, onnxruntime {facts.runtime}")
    for text in facts.unusable:
        yield problem("policies", text, "correct it, or remove it from the configuration")
    if facts.error is not None:
        yield problem("policy", facts.error, "`softarm policy list` tells what there is; correct control.policy")
    elif facts.steps_ms:
        yield _time(facts, budget_s * 1e3)
    else:
        yield ok("policy", f"{facts.policy} loads; its time was not measured beside an arm in use")


def _time(facts: Models, budget_ms: float) -> Finding:
    median, p99 = (float(each) for each in np.percentile(facts.steps_ms, (50, 99)))
    figure = f"{facts.policy}: {median:.2f} ms a step (median), {p99:.2f} ms (99 %), {budget_ms:g} ms allowed"
    if median > budget_ms:
        return problem("policy", figure, "it would be given up tick after tick: choose another, or a faster computer")
    if p99 > budget_ms or median > 0.5 * budget_ms:
        advice = "take load off this computer (the daemon is granted more: `scheduling`), or choose a smaller policy"
        return warning("policy", figure, advice)
    return ok("policy", figure)
