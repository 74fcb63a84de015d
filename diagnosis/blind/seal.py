"""Labels apart, a commitment beside the data, answers frozen: what makes the benchmark blind."""

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMMITMENT = "commitment.json"


class SealError(Exception):
    """What is not as it was sealed, in words, with the next step."""


@dataclass(frozen=True, slots=True)
class Labels:
    """What must not be known before the answers are frozen."""

    salt: str  # 32 random bytes in hex, so that nobody finds a label by trying them all
    seed: int  # the cases' own, from which every label could be drawn again
    cases: Mapping[str, Mapping[str, Any]]  # case -> Case.label


def new_secret() -> tuple[str, int]:
    """A salt and a seed that nobody can guess."""
    return secrets.token_hex(32), secrets.randbits(63)


def canonical(data: object) -> str:
    """JSON with sorted keys and no spaces: equal data, equal text."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"))


def sha256(text: str | bytes) -> str:
    """In hex."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def commitment(labels: Labels) -> dict[str, Any]:
    """What binds to the labels without telling them: one hash for each case, one for all and the seed."""
    cases = {name: sha256(f"{labels.salt}{name}{canonical(label)}") for name, label in labels.cases.items()}
    return {"cases": cases, "all": sha256(labels.salt + canonical({"seed": labels.seed, "cases": labels.cases}))}


def write_labels(labels: Labels, file: Path, data: Path) -> None:
    """Write the labels and, into the data folder, the commitment. Raises SealError for a file inside that folder."""
    keep_apart(file, data)
    data.mkdir(parents=True, exist_ok=True)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        json.dumps({"salt": labels.salt, "seed": labels.seed, "cases": labels.cases}, indent=1) + "\n", encoding="utf-8"
    )
    file.chmod(0o600)
    (data / COMMITMENT).write_text(json.dumps(commitment(labels), indent=1) + "\n", encoding="utf-8")


def keep_apart(place: Path, data: Path) -> None:
    """Raise SealError when `place` is inside the data folder or around it."""
    inside, outside = place.resolve(), data.resolve()
    if inside == outside or outside in inside.parents:
        raise SealError(f"{place}: lies inside {data}, which is handed to the tool; name a place outside of it")


def read_labels(file: Path) -> Labels:
    """Raises SealError for a file that holds no labels."""
    data = _json(file, "the labels that `softarm blind make` wrote")
    try:
        return Labels(data["salt"], data["seed"], data["cases"])
    except (KeyError, TypeError):
        raise SealError(f"{file}: holds no labels; name the file that `softarm blind make --labels` wrote") from None


def check_labels(labels: Labels, data: Path) -> None:
    """Raise SealError when the labels are not those that were committed to beside the data."""
    promised, found = _json(data / COMMITMENT, "the commitment of `softarm blind make`"), commitment(labels)
    if promised != found:
        cases = promised.get("cases", {}) if isinstance(promised, dict) else {}
        other = sorted(name for name in {*cases, *found["cases"]} if cases.get(name) != found["cases"].get(name))
        what = f"the labels of {', '.join(other[:5])}" if other else "the seed or the salt"
        raise SealError(
            f"{data / COMMITMENT}: {what} differ from what was committed to; "
            "score with the labels that were made with these data"
        )


def freeze(answers: Path) -> str:
    """Write the SHA-256 of a file beside it, `FILE.sha256`; returns it."""
    digest = sha256(answers.read_bytes())
    _frozen(answers).write_text(f"{digest}  {answers.name}\n", encoding="utf-8")
    return digest


def check_frozen(answers: Path) -> str:
    """Return the SHA-256 of a frozen file. Raises SealError when it was never frozen or has changed since."""
    try:
        frozen = _frozen(answers).read_text(encoding="utf-8").split()[0]
        digest = sha256(answers.read_bytes())
    except (OSError, IndexError):
        raise SealError(
            f"{answers}: is not frozen ({_frozen(answers).name} is missing); finish `softarm blind run` first"
        ) from None
    if digest != frozen:
        raise SealError(f"{answers}: has changed since it was frozen; run `softarm blind run` again on unseen cases")
    return digest


def _frozen(answers: Path) -> Path:
    return answers.with_name(answers.name + ".sha256")


def _json(file: Path, what: str) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SealError(f"{file}: cannot be read ({error}); name {what}") from None
