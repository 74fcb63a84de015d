"""Files that users write: configuration, models, stages, trials, tables, sweeps, verdicts."""

from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import yaml

from softarm.common.revision import CHECKOUT
from validation.fuzz import mutate
from validation.fuzz.parsers.base import Parser, folder, parser, written

_TRIAL = "kind: chirp\nrail: held\n"
_SWEEP = """\
seeds: [1, 2]
base: {task: reach, frames: 3000000, settings: {run.robots: 1024}}
runs: {full: {}, no-delay: {model: no-delay}, like: {like: reach-robust, randomise: {arm.payload.mass: [0, 0.1]}}}
"""


def yaml_text(random: Random, texts: list[str]) -> bytes:
    """Return a YAML file with wrong characters, wrong content or excessive size."""
    text = random.choice(texts)
    match random.randrange(8):
        case 0 | 1 | 2:
            return mutate.of_bytes(random, [each.encode() for each in texts])
        case 3 | 4 | 5:
            return mutate.to_json(random, mutate.of_tree(random, yaml.safe_load(text)))  # JSON is almost valid YAML
        case 6:
            lines = text.splitlines()
            for _ in range(random.randint(1, 5)):
                line = random.choice(lines)
                lines.insert(
                    random.randint(0, len(lines)), random.choice((line, f"  {line}", line.strip(), f"? {line}"))
                )
            return "\n".join(lines).encode()
        case _:
            return random.choice(_BOMBS)(random) + text.encode() * random.randint(0, 1)


def _aliases(random: Random) -> bytes:
    """Return a billion laughs: nested aliases in lists, groups or merges."""
    shape = random.choice(("[{}]", "{{{}}}", "merge"))
    lines, wide = ["a0: &a0 {x: 1}" if shape == "merge" else "a0: &a0 [x, x]"], random.choice((2, 9))
    for level in range(1, random.choice((4, 12, 40))):
        before = f"*a{level - 1}"
        match shape:
            case "merge":
                lines.append(f"a{level}: &a{level} {{<<: [{', '.join([before] * wide)}], y{level}: 1}}")
            case "[{}]":
                lines.append(f"a{level}: &a{level} [{', '.join([before] * wide)}]")
            case _:
                lines.append(f"a{level}: &a{level} {{{', '.join(f'k{i}: {before}' for i in range(wide))}}}")
    return "\n".join(lines).encode() + b"\n"


def _deep(random: Random) -> bytes:
    depth = random.choice((30, 60, 1000, 20_000))
    inside = random.choice((b"[", b"{a: ", b"- ", b"? ", b"[{a: [", b"!x ["))
    return b"limits: " * random.randint(0, 1) + inside * depth


def _many(random: Random) -> bytes:
    count = random.choice((500, 5000))
    under = random.choice(("", "limits:\n  ", "policies:\n  "))
    indent = "  " if under else ""
    kind = random.choice(("key{i}: {i}", "velocity_max_m_{i}: 1", "k{i}: {{a: [1, 2]}}", "? [a, {i}]\n{indent}: 1"))
    return (under + f"\n{indent}".join(kind.format(i=i, indent=indent) for i in range(count)) + "\n").encode()


def _long(random: Random) -> bytes:
    size = random.choice((10_000, 300_000))
    return random.choice(
        (b"a" * size + b": 1\n", b"control: {policy: " + b"x" * size + b"}\n", b"a: " + b"9" * size + b"\n")
    )


_BOMBS: tuple[Callable[[Random], bytes], ...] = (_aliases, _deep, _many, _long)


def _yaml(texts: list[str], take: Callable[[Path], object], error: type[Exception]) -> Parser:
    return Parser(lambda random: yaml_text(random, texts), lambda data: take(written("file.yaml", data)), (error,))


@parser("yaml.configuration")
def _configuration() -> Parser:
    from softarm.daemon.config import configuration

    def take(path: Path) -> None:
        configuration.effective_limits(configuration.read(path))

    texts = [(CHECKOUT / name).read_text(encoding="utf-8") for name in ("softarm.yaml", "twin.yaml")]
    texts.append("policies:\n  p: {plugin: pid, options: {gain: 1.5}}\nrecorder: {keep_mb: 2000}\napi: {port: 0}\n")
    return _yaml(texts, take, configuration.ConfigurationError)


@parser("yaml.model")
def _model() -> Parser:
    from softarm.simulator import model_file

    texts = [path.read_text(encoding="utf-8") for path in sorted(model_file.MODELS.glob("*.yaml"))]
    return _yaml(texts, model_file.load, model_file.ModelFileError)


def _table(suffix: str, write: Callable[[Path, dict[str, Any]], object]) -> Parser:
    """Return the parser of a stage.yaml with its table, either of which may be wrong."""
    import numpy as np

    from softarm.diagnosis.data import tables
    from softarm.diagnosis.data.trials import TrialError

    path = folder() / f"good{suffix}"
    write(path, {"t": np.arange(50) * 0.02, "u": np.arange(50) % 3 * 1.0, "y": np.arange(50) % 5 * 0.5})
    good = path.read_bytes()
    about = (
        "name: servo\nkind: tracking\nchannels:\n"
        "  command: {time: {source: t, unit: s}, columns: {command: {source: u, unit: rad}}}\n"
        "  measured: {time: {source: t, unit: s}, columns: {position: {source: y, unit: deg, add: 0.1}}}\n"
        f"trials:\n  - {{name: a, kind: steps, files: {{command: table{suffix}, measured: table{suffix}}}}}\n"
    )

    def draw(random: Random) -> tuple[bytes, bytes]:
        if suffix == ".csv" and random.random() < 0.5:
            return yaml_text(random, [about]), good
        return about.encode(), mutate.of_bytes(random, [good])

    def take(case: tuple[bytes, bytes]) -> object:
        written(f"table{suffix}", case[1])
        return tables.read(written("stage.yaml", case[0]))

    return Parser(draw, take, (TrialError,))


@parser("yaml.stage")
def _csv() -> Parser:
    import numpy as np

    def write(path: Path, columns: dict[str, Any]) -> None:
        np.savetxt(path, np.stack(list(columns.values()), axis=1), "%.2f", ",", header="t,u,y", comments="")

    return _table(".csv", write)


@parser("table.mat")
def _matlab() -> Parser:
    from scipy.io import savemat

    return _table(".mat", savemat)


@parser("table.parquet")
def _parquet() -> Parser:
    import pyarrow
    from pyarrow import parquet

    return _table(".parquet", lambda path, columns: parquet.write_table(pyarrow.table(columns), path))


@parser("csv.trial")
def _trial() -> Parser:
    """Return the parser of a folder of CSV files as another program records them."""
    from softarm.diagnosis.data import folder as folders
    from softarm.diagnosis.data.trials import LINKS, ROBOT_CHANNELS, TrialError, mocap_columns

    tables = {}
    for name, units in ROBOT_CHANNELS.items():
        columns = ("t_capture", *mocap_columns(LINKS)) if name == "mocap" else ("t", *units)
        rows = [",".join(f"{0.01 * row if i == 0 else 0.1 * i:.4f}" for i in range(len(columns))) for row in range(30)]
        tables[name] = "\n".join([",".join(columns), *rows, ""]).encode()

    def draw(random: Random) -> tuple[bytes, str, bytes]:
        if random.random() < 0.3:
            return yaml_text(random, [_TRIAL]), "rail", tables["rail"]
        name = random.choice(sorted(tables))
        return _TRIAL.encode(), name, mutate.of_bytes(random, [tables[name]])

    def take(case: tuple[bytes, str, bytes]) -> object:
        trial, name, table = case
        (folder() / "trial").mkdir(exist_ok=True)
        for each, content in tables.items():
            written(f"trial/{each}.csv", table if each == name else content)
        return folders.read(written("trial/trial.yaml", trial).parent)

    return Parser(draw, take, (TrialError,))


@parser("yaml.sweep")
def _sweep() -> Parser:
    from softarm.training.run import sweep

    return _yaml([_SWEEP], sweep.load, sweep.SweepError)


@parser("json.verdict")
def _verdict() -> Parser:
    """Return the parser of a verdict as `softarm excite --plan` reads it."""
    from pydantic import ValidationError

    from softarm.schemas.verdict import Verdict

    number = {"value": 0.5, "low": 0.4, "high": 0.6}
    rms = {"arm": {"value": 0.01, "unit": "m"}}
    effect = {"name": "arm.payload", "parameters": {"mass": {**number, "unit": "kg"}}, "confidence": 0.9}
    tree = {
        "verdict": "named",
        "where": {"stage": "arm", "share": {"arm": 1.0}, "regime": "always"},
        "effects": [{**effect, "equivalents": [], "shrink": {"stage": number, "chain": None}}],
        "gap": {"before": rms, "after": rms, "floor": rms, "ceiling": rms},
        "next_experiment": {"excitation": "seed", "separates": ["arm.payload"], "expect": {"arm.payload": "slower"}},
    }
    Verdict.model_validate(tree)
    return Parser(
        lambda random: mutate.to_json(random, mutate.of_tree(random, tree)),
        Verdict.model_validate_json,
        (ValidationError,),
    )


@parser("json.latch")
def _latch() -> Parser:
    """Return the parser of a stored emergency stop, which only a valid file may declare absent."""
    from softarm.daemon.stop import latch

    stops = (latch.Stop(), latch.Stop("somebody asked for an emergency stop", 1.8e9), latch.Stop("\0" * 400))
    kept = [latch.encoded(stop) for stop in stops]

    def take(content: bytes) -> None:
        if latch.decoded(content).reason is None:
            assert b'"stopped": null' in content

    return Parser(lambda random: mutate.of_bytes(random, kept), take, (ValueError, RecursionError))
