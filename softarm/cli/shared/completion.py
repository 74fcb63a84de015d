"""Shell completion of names, found without importing the named things because completion must be quick."""

from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

PACKAGE = Path(__file__).resolve().parents[2]


def _items(names: Iterable[str], begun: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in sorted(set(names)) if name.startswith(begun)]


def _file(begun: str) -> CompletionItem:
    """Return an item that makes the shell complete file names."""
    return CompletionItem(begun, type="file")


def policies(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete policies: installed, shipped, and those of the file after --config."""
    names = {point.name for point in entry_points(group="softarm.policies")} - {"onnx"}
    names |= {file.stem for file in (PACKAGE / "policies" / "models").glob("*.onnx")}
    return _items(names | set(_configured(context.params.get("config_file"))), begun)


def policies_and_files(context: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete policies as `policies` does, and files and folders."""
    return [*policies(context, parameter, begun), _file(begun)]


def _configured(file: Any) -> Iterable[str]:
    from softarm.common import yaml_lines

    try:
        data = yaml_lines.read(file, "").data if file is not None else {}
        return list(data["policies"])
    except (yaml_lines.FileError, KeyError, TypeError):
        return []


def models(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete shipped models and file names."""
    return [*_items((file.stem for file in (PACKAGE / "simulator" / "models").glob("*.yaml")), begun), _file(begun)]


def logs(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete recordings of the default folder `logs`, newest first, and file names."""
    newest = sorted((str(file) for file in Path("logs").glob("*.mcap")), reverse=True)
    return [*(CompletionItem(name) for name in newest if name.startswith(begun)), _file(begun)]


def excitations(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete the excitations of `softarm excite`."""
    from softarm.schemas.excitation import EXCITATIONS

    return [CompletionItem(e.name, help=e.description) for e in EXCITATIONS.values() if e.name.startswith(begun)]


def incident_files(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete incident files of the default folder `logs`, and `latest`."""
    return _items(["latest", *(file.name for file in Path("logs", "incidents").glob("incident-*.zip"))], begun)


def targets(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete the paper's 54 targets: first a y, then the z values tested with that y."""
    from softarm.schemas.flights import TEST_TARGETS

    y = context.params.get("y")
    found = [goal.y_m if y is None else goal.z_m for goal in TEST_TARGETS if y in (None, goal.y_m)]
    return _items((f"{number:g}" for number in found), begun)


def faults(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete faults of the twin's wires."""
    from softarm.drivers.twin.faults import described

    items = [CompletionItem(name, help=meaning) for name, _, meaning in described()]
    return [*_items(["list"], begun), *(item for item in items if item.value.startswith(begun))]
