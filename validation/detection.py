"""Detection limit of every cause of the blind benchmark: `python -m validation.detection FOLDER`.

Robots with nuisances get one cause each, with strengths around the benchmark's weakest. The limit is the strength from
which 90 % of the answers are right. Healthy robots count the names that are given by chance. Nothing is sealed.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from softarm.common import batch, files
from softarm.common.batch import Kept, Work, Workers, workers_options
from softarm.common.revision import code_version
from softarm.reality.parameters import RobotParameters
from softarm.schemas.verdict import Verdict
from validation.blind import pages, run, seal
from validation.blind.cases import Case, with_trials
from validation.blind.imperfections import KNOWN, Cause, Variant, draw_nuisances, given, ranges
from validation.blind.make import is_written, write_case
from validation.blind.score import Scored

SHARES = (0.125, 2.0)  # of the strength of the benchmark's weakest cause
FOUND = 0.9
_SEED = 7


def causes() -> Iterator[tuple[str, Variant]]:
    """Yield every effect of the registry that a case may have, with each of its variants."""
    for name, variants in KNOWN.items():
        for variant in variants:
            yield name, variant


def weak(number: int, name: str, variant: Variant, draw: int, draws: int) -> tuple[Case, float]:
    """Return a robot with a cause of random strength, and the strength as a share of the weakest in the benchmark.

    The first knob of the variant sets the strength, the others are drawn as in the benchmark. Each of the `draws`
    robots of a variant has its own part of the range of strengths.
    """
    random = np.random.default_rng((_SEED, number, draw))
    robot = draw_nuisances(RobotParameters(), random)
    low, high = np.log(SHARES)
    share = float(np.exp(low + (draw + random.random()) / draws * (high - low)))
    first, *others = variant
    value = first.weakened(share)
    if first.either_way and random.random() < 0.5:
        value = 1 / value if first.how == "times" else -value
    robot, settings = given(robot, variant, [value, *(knob.draw(random) for knob in others)])
    cause = Cause(name, False, settings)
    return _named(with_trials(f"weak-{number:02d}-{draw:02d}", "single", [cause], robot, random)), share


def healthy(draw: int) -> Case:
    """Return a robot without a cause."""
    random = np.random.default_rng((_SEED, draw))
    return _named(with_trials(f"healthy-{draw:02d}", "none", [], draw_nuisances(RobotParameters(), random), random))


def _named(case: Case) -> Case:
    """Return a case whose name also identifies its content, so that only recordings of equal cases are reused."""
    digest = seal.sha256(f"{code_version('reality')}{case!r}")
    return replace(case, name=f"{case.name}-{digest[:8]}")


def right(case: Case, answer: Mapping[str, Any]) -> bool:
    """Return whether an answer names the case's cause and nothing else, or is `none` without a cause."""
    verdict = answer["verdict"] and Verdict.model_validate(answer["verdict"])
    return Scored(case.name, case.kind, case.causes, verdict, answer["failure"]).right


def limit(tries: Sequence[tuple[float, bool]]) -> float | None:
    """Return the smallest strength from which FOUND of the answers are right, from the strength and success of each.

    The result is None if there is no such strength.
    """
    ordered = sorted(tries, reverse=True)
    hits = np.cumsum([hit for _, hit in ordered]) / np.arange(1, len(ordered) + 1)
    enough = np.flatnonzero(hits >= FOUND)
    return ordered[enough[-1]][0] if len(enough) else None


def answer(case: Case, place: Path) -> dict[str, Any]:
    """Return the diagnosis of a case, which is recorded first unless it was already."""
    if not is_written(case, place, None):
        write_case(case, place)
    return run.answer_case(place / case.name, "diagnose")


def measure(place: Path, draws: int, robots: int, workers: Workers | None = None) -> dict[str, Any]:
    """Diagnose robots of each variant of a cause, and healthy ones, and return the figures of the table.

    `place` keeps recordings and answers, so that an interrupted measurement continues there.
    """
    known = list(causes())
    made = [(k, *weak(k, name, variant, i, draws)) for k, (name, variant) in enumerate(known) for i in range(draws)]
    well = [healthy(i) for i in range(robots)]
    cases = {case.name: case for case in (*(case for _, case, _ in made), *well)}
    kept = Kept(lambda name: place / "answers" / f"{name}.json", lambda name: {"tool": seal.tool_version()})
    work: Work[Case, dict[str, Any]] = Work(
        partial(answer, place=place),
        reads=lambda case: [place / case.name],
        writes=lambda case: [place / case.name],
    )
    done = batch.run("diagnosing", work, cases, workers, kept=kept).complete("the same command continues")
    hits = {name: right(cases[name], found) for name, found in done.items()}
    rows = []
    for k, (name, variant) in enumerate(known):
        least = limit([(share, hits[case.name]) for of, case, share in made if of == k])
        value = None if least is None else variant[0].weakened(least)
        rows.append({"cause": name, "drawn": ranges(variant), "share": least, "found": value})
    return {"causes": rows, "draws": draws, "healthy": robots, "healthy named": sum(not hits[c.name] for c in well)}


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--draws", default=8, help="Robots for each variant of a cause.")
@click.option("--healthy", "robots", default=60, help="Robots without a cause.")
@workers_options()
@click.option("--json", "json_file", type=click.Path(path_type=Path, dir_okay=False), help="Write the figures here.")
def main(folder: Path, draws: int, robots: int, workers: Workers, json_file: Path | None) -> None:
    """Diagnose weak causes, recorded into FOLDER, and print the table of detection limits."""
    found = measure(folder, draws, robots, workers)
    click.echo(pages.detection(found), nl=False)
    if json_file is not None:
        files.write_text(json_file, json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
