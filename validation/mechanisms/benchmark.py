"""Benchmark of the diagnosis on mechanisms with a MuJoCo model: make, answer and score cases.

    python -m validation.mechanisms.benchmark make FOLDER --cases 60 --seed 1
    python -m validation.mechanisms.benchmark run FOLDER
    python -m validation.mechanisms.benchmark score FOLDER

FOLDER/data contains the inputs of the diagnosis, FOLDER/truths the causes and FOLDER/answers the verdicts. Robots, laws
and faults are those of `validation.mechanisms`.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import click
import numpy as np

from softarm.cli.shared.errors import failing
from softarm.common.batch import Workers, workers_options
from softarm.diagnosis.data.trials import TrialError
from validation.blind.cases import apportioned
from validation.mechanisms.cases import ANY, MechanismCase, draw_and_write
from validation.rigs.benchmark import CASES, FOLDER, REFUSALS, SEED, answered, make, run_command

# Share of each category: one fault, one at half strength, two at two joints, one of the whole mechanism, none, and one
# that no effect expresses.
SHARES = {"single": 0.2, "half": 0.15, "two": 0.15, "whole": 0.1, "none": 0.25, "unknown": 0.15}
OUTCOMES = ("right", "set", "calibrated", "part", "silent", "wrong", "failed")


def categories(count: int, random: np.random.Generator) -> list[str]:
    """Return a category for each case, in random order."""
    found = [name for name, number in apportioned(SHARES, count).items() for _ in range(number)]
    return [str(each) for each in random.permutation(found)]


def draw(count: int, seed: int, category: str | None = None) -> list[MechanismCase]:
    """Draw cases of all categories, or of one."""
    kinds = [category] * count if category else categories(count, np.random.default_rng(seed))
    return [MechanismCase(seed, index, kind) for index, kind in enumerate(kinds)]


def outcome(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> str:
    """Return right, wrong, part (of two causes), set (of names that hold the right one), calibrated, silent or failed.

    An answer is `calibrated` if every cause that it does not name is a parameter of its calibration, within tolerance.
    """
    verdict = answer["verdict"]
    if verdict is None:
        return "failed"
    groups = [{effect["name"], *effect["equivalents"]} for effect in verdict["effects"]]
    causes = [{f"{j}.{name}" for j in cause["joints"] for name in cause["names"]} for cause in truth["causes"]]
    known = [cause for cause in causes if cause]
    if not known:
        if groups:
            return "wrong"
        return "right" if (verdict["verdict"] == "none") != bool(causes) else "silent"
    if any(not any(group & cause for cause in known) for group in groups):
        return "wrong"
    met = [cause for cause in known if any(group & cause for group in groups)]
    tuned = {each["name"].rpartition(".")[0] for each in verdict["calibration"]}
    if len(met) < len(known) and all(cause & tuned for cause in known if cause not in met):
        return "calibrated"
    if not met:
        return "silent"
    if len(met) < len(known):
        return "part"
    return "right" if all(any(group <= cause for cause in known) for group in groups) else "set"


def joint_right(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> bool | None:
    """Return whether the stage with the largest gap has a cause; None without a known cause or a stage."""
    verdict = answer["verdict"]
    stage = verdict and verdict["where"]["stage"]
    if not stage or not any(cause["names"] for cause in truth["causes"]):
        return None
    return stage in {joint for cause in truth["causes"] for joint in cause["joints"]}


def intervals(truth: Mapping[str, Any], answer: Mapping[str, Any]) -> dict[str, bool]:
    """Return for each size that the truth states and the answer names whether the interval holds it."""
    true = {path: size for cause in truth["causes"] for path, size in cause["sizes"].items()}
    effects = answer["verdict"]["effects"] if answer["verdict"] else ()
    named: dict[str, Mapping[str, Any]] = {}
    for effect in effects:
        joint, _, law = effect["name"].partition(".")
        for name, each in effect["parameters"].items():
            named[f"{joint}.{law}.{name}"] = each
            named.setdefault(f"{ANY}.{law}.{name}", each)  # of a size that joints share, one entry counts
    return {path: each["low"] <= true[path] <= each["high"] for path, each in named.items() if path in true}


def table(cases: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> str:
    """Return outcomes by category as a table."""
    rows = [
        f"| | cases | {' | '.join(OUTCOMES)} | right joint |",
        f"|---|---|{'---|' * len(OUTCOMES)}---|",
    ]
    for category in ("all", *SHARES):
        own = [(t, a) for t, a in cases if category in ("all", t["category"])]
        if not own:
            continue
        counts = Counter(outcome(t, a) for t, a in own)
        places = [right for t, a in own if (right := joint_right(t, a)) is not None]
        cells = [counts[name] for name in OUTCOMES]
        rows.append(f"| {category} | {len(own)} | {' | '.join(map(str, cells))} | {sum(places)} of {len(places)} |")
    return "\n".join(rows)


def wrong_lines(cases: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Iterator[str]:
    """Yield a line for each case that is not right."""
    for truth, answer in cases:
        if (found := outcome(truth, answer)) == "right":
            continue
        causes = ", ".join(f"{'/'.join(c['joints'])}.{c['fault']}" for c in truth["causes"]) or "healthy"
        verdict = answer["verdict"]
        named = "; ".join(
            f"{e['name']} ({e['confidence'] or 0:.2f}) = {', '.join(e['equivalents'])}" for e in verdict["effects"]
        ) if verdict else answer["failure"]  # fmt: skip
        stated = verdict["verdict"] if verdict else "failed"
        yield f"{found:7s} {truth['case']} {truth['robot']}: {causes} -> {stated}: {named} [{answer['seconds']:.0f} s]"


@click.group()
def main() -> None:
    """Measure the diagnosis on mechanisms with a MuJoCo model and known causes."""


@main.command("make")
@FOLDER
@CASES
@SEED
@click.option("--category", type=click.Choice(tuple(SHARES)), help="Cases of this category alone.")
@workers_options()
@failing(*REFUSALS)
def make_command(folder: Path, count: int, seed: int, category: str | None, workers: Workers) -> None:
    """Draw cases and record them."""
    make(draw(count, seed, category), folder, draw_and_write, workers)
    click.echo(f"{count} cases in {folder / 'data'}, their causes in {folder / 'truths'}")


main.add_command(run_command)


@main.command("score")
@FOLDER
@failing(TrialError)
def score_command(folder: Path) -> None:
    """Print outcomes, wrong answers and the share of intervals that hold the true size."""
    cases = answered(folder)
    seconds = [reply["seconds"] for _, reply in cases]
    click.echo("\n".join((table(cases), *wrong_lines(cases))))
    held = [each for truth, reply in cases for each in intervals(truth, reply).values()]
    click.echo(f"size intervals: {sum(held)} of {len(held)} hold the true size")
    click.echo(f"processor time: median {median(seconds):.0f} s, worst {max(seconds):.0f} s")


if __name__ == "__main__":
    main()
