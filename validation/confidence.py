"""Calibration of confidences on cases with known causes: share of right answers by margin.

    python -m validation.confidence robot CASES --labels FILE --answers FILE
    python -m validation.confidence rig FOLDER [FOLDER ...]

Writes the part for soft arm or rigs of `engine/confidence.json`. Published figures come from other cases.
"""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.engine import confidence
from validation.blind import run, seal
from validation.rigs.benchmark import answered
from validation.rigs.score import right_names

# Edges of the bins. A bin with too few cases, or without a higher chance than the one below, is joined with that one.
MARGINS: Final = (0.0, 0.12, 0.25, 0.5, 0.75, 1.0)
BIN_LEAST = 20

# Kind of answer (alone or set), margin, whether it was right.
Answer = tuple[str, float, bool]


def curves(answers: Sequence[Answer]) -> dict[str, list[dict[str, float | int]]]:
    """Return bins of margins for each kind of answer, with counts of right and of all answers.

    Chances grow with the margin.
    """
    return {kind: _curve([(m, right) for k, m, right in answers if k == kind]) for kind in ("alone", "set")}


def _curve(pairs: Sequence[tuple[float, bool]]) -> list[dict[str, float | int]]:
    bins: list[dict[str, float | int]] = []
    for low, high in zip(MARGINS, (*MARGINS[1:], float("inf")), strict=True):
        inside = [right for margin, right in pairs if low <= margin < high]
        bins.append({"margin": low, "right": sum(inside), "of": len(inside)})
        while len(bins) > 1 and _join(*bins[-2:]):
            last = bins.pop()
            bins[-1] |= {key: bins[-1][key] + last[key] for key in ("right", "of")}
    return [each for each in bins if each["of"]]


def _join(below: dict[str, float | int], above: dict[str, float | int]) -> bool:
    few = below["of"] < BIN_LEAST or above["of"] < BIN_LEAST
    return few or confidence.chance(above) <= confidence.chance(below)


def of_robot(labels: seal.Labels, content: dict[str, Any]) -> Iterator[Answer]:
    """Yield every named effect that has a margin, of answers to cases with these labels."""
    for answer in content["answers"]:
        causes = {cause["name"] for cause in labels.cases[answer["case"]]["causes"]}
        effects = answer["verdict"]["effects"] if answer["verdict"] else ()
        right = {e["name"]: not causes.isdisjoint((e["name"], *e["equivalents"])) for e in effects}
        yield from _rated(answer, right)


def of_rigs(folder: Path) -> Iterator[Answer]:
    """Yield every named effect that has a margin, of a folder of `validation.rigs.benchmark`."""
    for truth, answer in answered(folder):
        yield from _rated(answer, right_names(truth, answer))


def _rated(answer: Mapping[str, Any], right: Mapping[str, bool]) -> Iterator[Answer]:
    for effect in answer["verdict"]["effects"] if answer["verdict"] else ():
        if effect["name"] in answer["margins"]:
            kind = "set" if effect["equivalents"] else "alone"
            yield kind, answer["margins"][effect["name"]], right[effect["name"]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line (`python -m validation.confidence --help`)."""
    parser = argparse.ArgumentParser(prog=f"python -m {__spec__.name}", description=__doc__.split("\n")[0])
    customers = parser.add_subparsers(dest="customer", required=True)
    robot = customers.add_parser("robot", help="from opened cases and their answers")
    robot.add_argument("data", type=Path)
    robot.add_argument("--labels", type=Path, required=True)
    robot.add_argument("--answers", type=Path, required=True)
    rig = customers.add_parser("rig", help="from folders of answered rigs")
    rig.add_argument("folders", type=Path, nargs="+")
    for each in (robot, rig):
        each.add_argument("--made-by", default="", help="commands that made the cases, for the record")
    given = parser.parse_args(arguments)
    try:
        if given.customer == "robot":
            labels = seal.read_labels(given.labels)
            seal.check_labels(labels, given.data)
            answers = list(of_robot(labels, run.read_answers(given.answers)))
        else:
            answers = [each for folder in given.folders for each in of_rigs(folder)]
    except (seal.SealError, TrialError) as error:
        raise SystemExit(f"error: {error}") from None
    if not answers:
        raise SystemExit("error: no answer names an effect with a margin; name answered cases (`run` answers them)")
    file = Path(confidence.__file__).with_name("confidence.json")
    table = json.loads(file.read_text(encoding="utf-8"))
    table[given.customer] = {"command": given.made_by, **curves(answers)}
    file.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(table[given.customer], indent=1))


if __name__ == "__main__":
    main()
