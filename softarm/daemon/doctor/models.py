"""Checks that the shipped policies give the exported outputs on this computer, and in time."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import onnxruntime as ort

from softarm.common.finding import Finding, ok, problem, warning
from softarm.policies import registry, trial
from softarm.policies.base import MODELS, Policy, PolicyError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.config import Config
from softarm.schemas.policy import REACH_GOAL

STEPS, STEPS_S = 300, 2.0  # limits of the timing


@dataclass(frozen=True, slots=True)
class Golden:
    """Result of repeating the golden run stored in a model file."""

    name: str
    off: float = 0.0  # largest error of the network's output, -1 to 1
    allowed: float = 0.0
    error: str | None = None


@dataclass(frozen=True, slots=True)
class Models:
    """Results of the golden runs and the timing."""

    runtime: str
    goldens: tuple[Golden, ...]
    policy: str  # control.policy
    error: str | None = None  # why the policy does not load
    steps_ms: tuple[float, ...] = ()  # duration of each step; empty if not measured
    unusable: tuple[str, ...] = ()  # other configured policies with the reason


def look(config: Config, measured: bool = True) -> Models:
    """Repeat the golden run of every shipped model and time the configured policy."""
    goldens = tuple(_golden(file.stem) for file in sorted(MODELS.glob("*.onnx")))
    name, entries = config.control.policy, registry.available(config.policies)
    others = (f"policies.{each}: {entries[each].error}" for each in config.policies if entries[each].error)
    facts = Models(ort.__version__, goldens, name, unusable=tuple(others))
    try:
        policy = trial.load(name, config.policies, trial.TRIAL_S)
    except PolicyError as error:
        return replace(facts, error=str(error))
    try:
        return replace(facts, steps_ms=timed(policy) if measured else ())
    except Exception as error:  # a plug-in may raise anything
        return replace(facts, error=f"policy '{name}': {type(error).__name__} in a step: {error}")


def _golden(name: str) -> Golden:
    try:
        policy = OnnxPolicy(name)
    except PolicyError as error:
        return Golden(name, error=str(error))
    off, _ = policy.golden_error()
    return Golden(name, off, policy.metadata.golden.tolerance)


def timed(policy: Policy) -> tuple[float, ...]:
    """Return the duration of a policy's steps on random observations, ms."""
    generator = np.random.default_rng(0)
    policy.reset()
    took_ms = []
    for _ in range(STEPS):
        observation = generator.normal(0.0, 0.2, trial.observed_values(policy.spec)).astype(np.float32)
        begun_ns = time.monotonic_ns()
        policy.step(observation, np.zeros(len(REACH_GOAL), np.float32))
        took_ms.append((time.monotonic_ns() - begun_ns) * 1e-6)
        if sum(took_ms) > STEPS_S * 1e3:
            break
    return tuple(took_ms)


def judge(facts: Models, budget_s: float) -> Iterator[Finding]:
    """Yield findings on the golden runs, the configured policy and its duration."""
    wrong = [each.error for each in facts.goldens if each.error is not None]
    for error in wrong:
        yield problem("golden run", error, "reinstall softarm; if that does not help, install another onnxruntime")
    if not wrong and facts.goldens:
        worst = max(facts.goldens, key=lambda each: each.off / each.allowed)
        figure = f"{len(facts.goldens)} models, largest error {worst.off:.1g}, allowed {worst.allowed:.1g}"
        yield ok("golden runs", f"{figure}, onnxruntime {facts.runtime}")
    for text in facts.unusable:
        yield problem("policies", text, "correct it, or remove it from the configuration")
    if facts.error is not None:
        yield problem("policy", facts.error, "correct control.policy; `softarm policy list` lists the policies")
    elif facts.steps_ms:
        yield _time(facts, budget_s * 1e3)
    else:
        yield ok("policy", f"{facts.policy} loads; not timed because the arm is in use")


def _time(facts: Models, budget_ms: float) -> Finding:
    median, p99 = (float(each) for each in np.percentile(facts.steps_ms, (50, 99)))
    figure = f"{facts.policy}: {median:.2f} ms a step (median), {p99:.2f} ms (99 %), allowed {budget_ms:g} ms"
    if median > budget_ms:
        return problem("policy", figure, "every tick would time out: choose another policy or a faster computer")
    if p99 > budget_ms or median > 0.5 * budget_ms:
        advice = "reduce the load of this computer, or choose a smaller policy"
        return warning("policy", figure, advice)
    return ok("policy", figure)
