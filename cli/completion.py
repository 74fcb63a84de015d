"""Names for the shell's completion, found without importing what they name: it has to be quick."""

from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

ROOT = Path(__file__).resolve().parents[1]  # of the rooms


def _items(names: Iterable[str], begun: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in sorted(set(names)) if name.startswith(begun)]


def _file(begun: str) -> CompletionItem:
    """The shell goes on with files itself."""
    return CompletionItem(begun, type="file")


def policies(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """Installed, shipped, and of the file after --config."""
    names = {point.name for point in entry_points(group="softarm.policies")} - {"onnx"}
    names |= {file.stem for file in (ROOT / "policies" / "models").glob("*.onnx")}
    return _items(names | set(_configured(context.params.get("config_file"))), begun)


def _configured(file: Any) -> Iterable[str]:
    from softarm.common import yaml_lines

    try:
        data = yaml_lines.read(file, "").data if file is not None else {}
        return list(data["policies"])
    except (yaml_lines.FileError, KeyError, TypeError):
        return []


def models(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """Shipped models, and files."""
    return [*_items((file.stem for file in (ROOT / "simulator" / "models").glob("*.yaml")), begun), _file(begun)]


def logs(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """The newest first, of the folder `logs` that recordings go to by default, and files."""
    newest = sorted((str(file) for file in Path("logs").glob("*.mcap")), reverse=True)
    return [*(CompletionItem(name) for name in newest if name.startswith(begun)), _file(begun)]


def excitations(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """What `softarm excite` plays."""
    from softarm.schemas.excitation import EXCITATIONS

    return [CompletionItem(e.name, help=e.description) for e in EXCITATIONS.values() if e.name.startswith(begun)]


def incident_files(_: click.Context, __: click.Parameter, begun: str) -> list[CompletionItem]:
    """Of the folder `logs`; and `latest`."""
    return _items(["latest", *(file.name for file in Path("logs", "incidents").glob("incident-*.zip"))], begun)


def targets(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """Of the paper's 54: first a y, then the z that are tried with it."""
    from softarm.schemas.flights import TEST_TARGETS

    y = context.params.get("y")
    found = [goal.y_m if y is None else goal.z_m for goal in TEST_TARGETS if y in (None, goal.y_m)]
    return _items((f"{number:g}" for number in found), begun)


def faults(context: click.Context, _: click.Parameter, begun: str) -> list[CompletionItem]:
    """Of the twin's wires, and of the robot that it is."""
    from softarm.drivers.twin.faults import described

    items = [CompletionItem(fault.name, help=fault.meaning) for fault in described()]
    return [*_items(["list"], begun), *(item for item in items if item.value.startswith(begun))]
