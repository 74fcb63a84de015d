"""Diagnosis of many robots and rigs as a batch of jobs: a report of each, and one page and table of all."""

import json
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypedDict
from urllib.parse import quote

from softarm.common import batch, files
from softarm.common.batch import Kept, Work, Workers
from softarm.common.revision import code_version
from softarm.diagnosis import report
from softarm.diagnosis.data import stage_file
from softarm.diagnosis.data.read import TABLES, stage_of_folder
from softarm.diagnosis.data.trials import TrialError
from softarm.diagnosis.diagnose import BUDGET_S, diagnose_files
from softarm.diagnosis.engine.result import Diagnosis
from softarm.reporting.document import Section, document
from softarm.reporting.markup import Child, el, join, prose, table, tiles
from softarm.reporting.numbers import percent
from softarm.simulator import model_file

INDEX, KEPT = "index", "kept"
SUFFIXES = (".html", ".json", ".yaml")
COLUMNS = ("recordings", "verdict", "answer", "confidence", "gap, RMS")


class Row(TypedDict):
    """Diagnosis of one input; its files are NAME.html, NAME.json (the verdict) and NAME.yaml (the patch)."""

    name: str
    input: str
    failure: str  # empty if the diagnosis has succeeded
    answer: str  # one sentence
    gap: str  # of the stage with the largest gap, before and after
    patched: bool
    notes: list[str]
    verdict: dict[str, Any] | None  # as in NAME.json


class Options(NamedTuple):
    """Options of all diagnoses."""

    out: Path  # folder of the results
    model: Path | None = None  # nominal model of robots; by default the campaign's, else the seed's
    budget_s: float = BUDGET_S  # processor time of each rig
    calibration: bool = True  # whether the patches contain the calibration


def diagnose_all(inputs: Sequence[Path], options: Options, workers: Workers | None = None) -> list[Row]:
    """Diagnose each input on its own and write its files, index.html and index.json; return a row for each.

    Inputs are logs, trial folders, campaigns, stage.yaml files and folders that have one. Kept answers of the same tool
    to the same data are used again. The place of the jobs changes no byte.

    Raises:
        TrialError: Two inputs are the same.
        ModelFileError: The model file is missing or invalid.
        OSError: A file cannot be written.
    """
    out, todo = options.out, {name: (name, stage_of_folder(path)) for name, path in names(inputs).items()}
    tool = code_version("common", "diagnosis", "recordings", "reporting", "schemas", "simulator")
    model = None if options.model is None else model_file.fingerprint(model_file.load(options.model))

    @cache
    def data(name: str) -> list[str]:
        return [files.sha256_of(path, out) for path in input_files(todo[name][1]) if path.exists()]

    def depends_on(name: str) -> dict[str, Any]:
        settings = [model, options.budget_s, options.calibration]
        written = [suffix for suffix in SUFFIXES if (out / f"{name}{suffix}").is_file()]
        return {"tool": tool, "settings": settings, "data": data(name), "written": written}

    out.mkdir(parents=True, exist_ok=True)
    work = Work(
        partial(_diagnosed, options=options),
        reads=lambda named: [*input_files(named[1]), *([] if options.model is None else [options.model])],
        writes=lambda named: [out / f"{named[0]}{suffix}" for suffix in SUFFIXES],
    )
    kept = Kept(lambda name: out / KEPT / f"{name}.json", depends_on)
    for name in todo:
        if kept.read(name) is None:
            _forget(kept.file(name), out / f"{name}.yaml")
    done = batch.run("diagnosing", work, todo, workers, kept=kept)
    rows = []
    for name, source in todo.values():
        if (failure := done.failures.get(name)) is not None:
            rows.append(_row(name, source, failure=failure.message or failure.kind))
        else:
            rows.append(done.results[name]["row"])
    files.write_text(out / f"{INDEX}.json", json.dumps(rows, indent=1) + "\n")
    files.write_text(out / f"{INDEX}.html", page(rows))
    return rows


def names(inputs: Sequence[Path]) -> dict[str, Path]:
    """Return the inputs by short unique names: the last parts of their paths that differ. Raises TrialError."""
    absolute = [Path(os.path.abspath(path)) for path in inputs]
    whole = [path.parent if path.name == "stage.yaml" else path for path in absolute]
    if twice := [str(path) for path, count in Counter(whole).items() if count > 1]:
        raise TrialError(f"{twice[0]}: is given twice; name each input once")
    for parts in range(1, 1 + max(len(path.parts) for path in whole)):
        found = ["-".join(path.parts[1:][-parts:]) for path in whole]  # without the root
        if len(set(found)) == len(found) and not {"", INDEX} & set(found):
            return dict(zip(found, inputs, strict=True))
    wrong = next(path for path, name in zip(whole, found, strict=True) if found.count(name) > 1 or name in ("", INDEX))
    raise TrialError(f"{wrong}: gives its results no name; allowed is any but {INDEX} and another input's; rename it")


def patch(result: Diagnosis, stage: Path | None, calibration: bool, best_fit: bool = False) -> str | None:
    """Return the nominal model with the findings as a file's text, or None if there are none.

    Args:
        result: Diagnosis.
        stage: stage.yaml of a rig; None for the robot.
        calibration: Whether the calibration is a part of it.
        best_fit: Whether stages of a rig that have a best fit get that instead.
    """
    if stage is not None:
        from softarm.diagnosis.rigs.patch import patched

        return patched(stage, result.verdict, calibration, best_fit)
    model = result.calibrated if calibration else result.patched
    return None if model is None else model_file.text(model)


def _forget(kept: Path, patch: Path) -> None:
    """Delete an outdated result, with the patch that it wrote; a file of another origin stays."""
    earlier = Kept(lambda name: kept, lambda name: {}).read(kept.stem)
    if earlier is not None and earlier.get("row", {}).get("patched"):
        patch.unlink(missing_ok=True)
    kept.unlink(missing_ok=True)


def input_files(source: Path) -> list[Path]:
    """Return the files and folders that a diagnosis reads: of a rig or a recording, with the model of its campaign."""
    if source.suffix in TABLES:
        return [source.parent, *_outside(source)]
    return [source, source.parent / "model.yaml"]


def _outside(source: Path) -> list[Path]:
    """Return the files that a stage.yaml names outside its own folder; none if it is invalid."""
    base, found = source.parent, set[Path]()
    try:
        stages = stage_file.load(source)
    except TrialError:
        return []
    for stage in stages:
        for each in stage_file.recordings(source, base, stage):
            found |= set() if isinstance(each, TrialError) else set(each.files.values())
        if mjcf := stage.about.model.get("mjcf"):
            found.add(base / str(mjcf))
    return sorted(path for path in found if not path.resolve().is_relative_to(base.resolve()))


def _diagnosed(named: tuple[str, Path], options: Options) -> dict[str, Row]:
    """Diagnose one input and write its files; the time that it took is left out, so that equal answers are equal."""
    (name, source), out, notes = named, options.out, list[str]()
    own = None if source.suffix in TABLES else options.model
    found = diagnose_files([source], own, warn=notes.append, budget_s=options.budget_s, processes=1)
    result = replace(found, seconds=0.0)
    verdict, stage = result.verdict, result.verdict.where.stage
    text = patch(result, source if source.suffix in TABLES else None, options.calibration)
    out.mkdir(parents=True, exist_ok=True)
    report.write(result, out / f"{name}.html")
    files.write_text(out / f"{name}.json", verdict.model_dump_json(indent=1) + "\n")
    if text is not None:
        files.write_text(out / f"{name}.yaml", text)
    row = _row(name, source, answer=report.headline(result), patched=text is not None, notes=notes)
    row["verdict"] = json.loads(verdict.model_dump_json())
    if stage in verdict.gap.before:
        row["gap"] = f"{stage}: {report.corrected(result, stage)}"
    return {"row": row}


def _row(name: str, source: Path, **known: Any) -> Row:
    row = Row(name=name, input=str(source), failure="", answer="", gap="", patched=False, notes=[], verdict=None)
    row.update(known)  # type: ignore[typeddict-item]
    return row


def cells(row: Row) -> tuple[str, str, str, str]:
    """Return verdict, answer, smallest confidence of a named effect, and gap of a row as texts."""
    verdict = row["verdict"]
    if verdict is None:
        return "failed", row["failure"], "", ""
    rated = [effect["confidence"] for effect in verdict["effects"] if effect["confidence"] is not None]
    return verdict["verdict"], row["answer"], percent(min(rated)) if rated else "-", row["gap"]


def page(rows: Sequence[Row]) -> str:
    """Return the page with a row per input, each with a link to its report; equal rows give equal pages."""
    counts = Counter(cells(row)[0] for row in rows)
    title = f"{len(rows)} diagnoses"
    lead = join([el("h1", title), tiles([(kind, str(count)) for kind, count in sorted(counts.items())])])
    shown = table((*COLUMNS, "patch"), map(_cells, rows), title)
    return document(title, "softarm diagnosis", lead, [Section("All recordings", "all", shown)])


def _cells(row: Row) -> tuple[Child, ...]:
    name = row["name"]
    verdict, answer, *others = cells(row)
    link = name if row["verdict"] is None else el("a", name, href=quote(f"{name}.html"), title=row["input"])
    patch = el("a", "patch", href=quote(f"{name}.yaml")) if row["patched"] else ""
    return link, verdict, prose(answer), *others, patch
