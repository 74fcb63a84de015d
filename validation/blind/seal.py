"""Sealing of the blind benchmark: secret labels, a commitment next to the data, frozen answers."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from softarm.common.revision import code_version

COMMITMENT = "commitment.json"


class SealError(Exception):
    """Broken seal of the benchmark; the message states the next step."""


@dataclass(frozen=True, slots=True)
class Labels:
    """Sealed labels of a blind benchmark."""

    salt: str  # 32 random bytes in hex, so that labels cannot be found by trying them all
    seed: int  # seed of the cases, from which every label can be drawn again
    cases: Mapping[str, Mapping[str, Any]]  # case -> Case.label


def canonical(data: object) -> str:
    """Return data as JSON with sorted keys and no spaces, so that equal data give equal text."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"))


def sha256(text: str | bytes) -> str:
    """Return the SHA-256 of a text or of bytes, in hex."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def tool_version() -> str:
    """Return the package's version with a hash of the code that answers."""
    return code_version("common", "diagnosis", "schemas", "simulator")


def commitment(labels: Labels) -> dict[str, Any]:
    """Return hashes that commit to the labels without revealing them: one per case, and one of all and the seed."""
    cases = {name: sha256(f"{labels.salt}{name}{canonical(label)}") for name, label in labels.cases.items()}
    return {"cases": cases, "all": sha256(labels.salt + canonical({"seed": labels.seed, "cases": labels.cases}))}


def write_labels(labels: Labels, file: Path, data: Path) -> None:
    """Write the labels, and the commitment into the data folder; raise SealError if the labels are inside it."""
    keep_apart(file, data)
    data.mkdir(parents=True, exist_ok=True)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(asdict(labels), indent=1) + "\n", encoding="utf-8")
    file.chmod(0o600)
    (data / COMMITMENT).write_text(json.dumps(commitment(labels), indent=1) + "\n", encoding="utf-8")


def keep_apart(place: Path, data: Path) -> None:
    """Raise SealError if `place` is inside the data folder."""
    inside, outside = place.resolve(), data.resolve()
    if inside == outside or outside in inside.parents:
        raise SealError(f"{place}: is inside {data}, which the tool can read; name a place outside it")


def read_labels(file: Path) -> Labels:
    """Raises SealError for a file that holds no labels."""
    data = _json(file, "the labels that `python -m validation.blind make` wrote")
    try:
        return Labels(data["salt"], data["seed"], data["cases"])
    except (KeyError, TypeError):
        raise SealError(
            f"{file}: contains no labels; name the file that `python -m validation.blind make --labels` wrote"
        ) from None


def check_labels(labels: Labels, data: Path) -> None:
    """Raise SealError if the labels differ from the commitment in the data folder."""
    promised, found = (
        _json(data / COMMITMENT, "the commitment of `python -m validation.blind make`"),
        commitment(labels),
    )
    if promised != found:
        cases = promised.get("cases", {}) if isinstance(promised, dict) else {}
        other = sorted(name for name in {*cases, *found["cases"]} if cases.get(name) != found["cases"].get(name))
        what = f"the labels of {', '.join(other[:5])}" if other else "the seed or the salt"
        raise SealError(
            f"{data / COMMITMENT}: {what} differ from the commitment; use the labels that were made with these data"
        )


def freeze(answers: Path) -> str:
    """Write the SHA-256 of a file to `FILE.sha256` and return it."""
    digest = sha256(answers.read_bytes())
    beside(answers, ".sha256").write_text(f"{digest}  {answers.name}\n", encoding="utf-8")
    return digest


def check_frozen(answers: Path) -> str:
    """Return the SHA-256 of a frozen file; raise SealError if it was not frozen or has changed since."""
    try:
        frozen = beside(answers, ".sha256").read_text(encoding="utf-8").split()[0]
        digest = sha256(answers.read_bytes())
    except (OSError, IndexError):
        raise SealError(
            f"{answers}: is not frozen ({answers.name}.sha256 is missing); "
            "finish `python -m validation.blind run` first"
        ) from None
    if digest != frozen:
        raise SealError(
            f"{answers}: has changed since it was frozen; run `python -m validation.blind run` again on unseen cases"
        )
    return digest


def beside(file: Path, ending: str) -> Path:
    """Return the file next to another with this ending after its name."""
    return file.with_name(file.name + ending)


def _json(file: Path, what: str) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SealError(f"{file}: cannot be read ({error}); name {what}") from None
