"""The rows of a comparison: policies by name, ONNX file or training folder, and the ceiling."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from softarm.common.words import did_you_mean
from softarm.policies import registry, trial
from softarm.policies.base import PolicyError
from softarm.policies.onnx_policy import OnnxPolicy
from softarm.schemas.config import Config
from softarm.schemas.policy import TrainingRange

CEILING = "ceiling"  # the row of an open-loop search that knows the simulator

Rows = dict[str, list["Entry"]]


class Entry(NamedTuple):
    """A policy file, a plug-in or the ceiling; one entry per training seed."""

    name: str
    seed: int | None = None  # None: not trained
    file: Path | None = None  # of an ONNX policy; None: the registry knows the name
    trained: TrainingRange | None = None
    sha256: str | None = None  # of the ONNX file, also of a shipped one


def given(policies: Sequence[str], config: Config | None = None) -> list[Entry]:
    """Return the rows of policies as typed, in their order, after a first step of each.

    Args:
        policies: Names, ONNX files and folders. A name precedes a folder of the same name. The folder of a run gives
            its policy, the folder of a sweep one row for each name in it, with an entry per seed.
        config: Configuration with further policies.

    Raises:
        PolicyError: A policy is unknown, takes no targets, cannot be loaded or fails; the text names it.
    """
    configured = (config or Config()).policies
    known = registry.available(configured)
    rows: Rows = {}
    for word in policies:
        if word == CEILING:
            rows[word] = [Entry(word)]
        elif word in known:
            rows[word] = [_registered(known[word])]
            trial.ready(registry.load(word, configured))
        else:
            rows |= _at_path(word, known)
    return [entry for group in rows.values() for entry in group]


def files_of(entry: Entry, config: Config | None) -> list[Path]:
    """Return the files that a row reads: of its policy, and of the policies of the configuration."""
    options = [str(option) for policy in (config or Config()).policies.values() for option in policy.options.values()]
    return [path for path in (entry.file, *map(Path, options)) if path is not None and path.is_file()]


def every(
    runs: Path | None = None, names: Sequence[str] = (), only_runs: bool = False, config: Config | None = None
) -> list[Entry]:
    """Return all rows: usable policies that take targets, and the ceiling.

    Args:
        runs: Folder of a sweep. Its policies (NAME/seed-K) replace shipped ones of the same name, one entry per seed.
        names: Names of the wanted rows; without a name, every row is wanted.
        only_runs: Leave out everything but the sweep's policies.
        config: Configuration with further policies.

    Raises:
        PolicyError: A name is unknown, a file is invalid, or `runs` holds no policy.
    """
    trained = _in_sweep(runs) if runs else {}
    if runs and not trained:
        raise PolicyError(f"{runs}: no NAME/seed-K/*.onnx in it; `softarm train --sweep` writes them")
    known = registry.available((config or Config()).policies)
    usable = [entry for entry in known.values() if entry.spec is not None and _takes_targets(entry)]
    rows = trained if only_runs else {each.name: [_registered(each)] for each in usable} | {CEILING: [Entry(CEILING)]}
    rows |= trained
    if unknown := sorted(set(names) - rows.keys()):
        if unknown[0] in known:
            _registered(known[unknown[0]])  # raises the reason
        hint = did_you_mean(unknown[0], rows)
        raise PolicyError(f"no policy {', '.join(unknown)}; {hint}there is {', '.join(rows)}")
    return [entry for name, group in rows.items() if not names or name in names for entry in group]


def _takes_targets(known: registry.PolicyEntry) -> bool:
    return known.spec is not None and known.spec.needs_target and known.name != "hold"


def _registered(known: registry.PolicyEntry) -> Entry:
    """Return the row of a policy that has a name. Raises PolicyError if it cannot be used at targets."""
    if known.spec is None:
        raise PolicyError(f"policy {known.name}: {known.error}")
    if not _takes_targets(known):
        raise PolicyError(f"policy {known.name}: it takes no targets; allowed: a policy that reaches for targets")
    seed = OnnxPolicy(str(known.options["model"])).metadata.seed if known.plugin == "onnx" else None
    return Entry(known.name, seed, None, known.spec.trained, known.spec.sha256)


def _at_path(word: str, known: Mapping[str, registry.PolicyEntry]) -> Rows:
    """Return the rows of a file or folder."""
    path = Path(word)
    if path.is_dir():
        return _in_folder(word, path)
    if path.is_file() and path.suffix == ".onnx":
        return {word: [_read(word, path)]}
    if path.is_file():
        raise PolicyError(
            f"{word}: is no ONNX file; name a policy, an ONNX file or a training folder. "
            "`softarm dev export` makes an ONNX file from a checkpoint (best.pt)"
        )
    if path.suffix == ".onnx" or path.parent != Path("."):
        raise PolicyError(f"{word}: does not exist; name an ONNX file, or the folder of `softarm train`")
    usable = [name for name, entry in known.items() if _takes_targets(entry)]
    raise PolicyError(
        f"no policy {word}; {did_you_mean(word, usable)}name one of {', '.join(usable)}, "
        "an ONNX file or a training folder"
    )


def _in_folder(word: str, folder: Path) -> Rows:
    """Return the rows of a run's, a sweep's or a sweep configuration's folder."""
    if files := sorted(folder.glob("*.onnx")):
        names = {file: word if len(files) == 1 else str(file) for file in files}
        return {name: [_read(name, file)] for file, name in names.items()}
    if seeds := sorted(folder.glob("seed-*/*.onnx")):
        return {word: [_read(word, file, _seed(file)) for file in seeds]}
    if rows := _in_sweep(folder):
        paths = {name: str(folder / name) for name in rows}
        return {paths[name]: [each._replace(name=paths[name]) for each in group] for name, group in rows.items()}
    if (folder / "latest.pt").exists():
        raise PolicyError(
            f"{word}: the run has not written its policy yet; wait for its end, "
            f"or export a checkpoint: softarm dev export {folder / 'latest.pt'} --out mine.onnx"
        )
    below = sorted({str(file.parent) for file in folder.glob("*/*.onnx")})
    hint = f"name one of {', '.join(below[:5])}" if below else "`softarm train --out` writes one"
    raise PolicyError(f"{word}: no policy (*.onnx or NAME/seed-K/*.onnx) in this folder; {hint}")


def _in_sweep(runs: Path) -> Rows:
    """Return the policies of a sweep's folder by name, one entry per seed."""
    rows: Rows = {}
    for file in sorted(runs.glob("*/seed-*/*.onnx")):
        name = file.parts[-3]
        rows.setdefault(name, []).append(_read(name, file, _seed(file)))
    return rows


def _seed(file: Path) -> int | None:
    """Return the seed of a sweep's run, or None if the folder is not called `seed-NUMBER`."""
    number = file.parent.name.removeprefix("seed-")
    return int(number) if number.isdecimal() else None


def _read(name: str, file: Path, seed: int | None = None) -> Entry:
    """Load an ONNX file and return its row; the seed defaults to that of the file."""
    policy = OnnxPolicy(str(file))
    return Entry(name, policy.metadata.seed if seed is None else seed, file, policy.spec.trained, policy.spec.sha256)
