"""`softarm new`: write the package of a new plug-in with a test that flies it, or the stage file of a rig.

Files of templates/ are `string.Template`s with `$name` as typed, `$project`, `$module`, `$class_name`, `$version` of
this softarm, and the fields of `Kind`.
"""

import keyword
import re
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import NamedTuple

import click

from softarm import __version__
from softarm.cli.gap.new_rig import rig
from softarm.cli.shared.console import FOLDER
from softarm.common import files
from softarm.common.plugins import PluginError

_HELP = """Write a small installable package: {purpose}.

It contains a module of working code to change, and a test that flies it. The plug-in is selected by NAME.

\b
Example:
  softarm new {kind} mine
"""


class Kind(NamedTuple):
    """Parts of `pyproject.toml` that differ between the kinds of plug-ins."""

    description: str
    group: str  # of the entry point
    extra: str  # of softarm, for the plug-in's test
    purpose: str  # for `softarm new --help`
    following: tuple[str, ...]  # commands after the installation


KINDS = {
    "policy": Kind("A policy for softarm", "softarm.policies", "sim", "a policy", ("softarm evaluate {name}",)),
    "task": Kind(
        "A task for softarm's training",
        "softarm.tasks",
        "train",
        "a task to train on",
        ("softarm train {name} --minutes 5",),
    ),
    "source": Kind(
        "A source of motion capture for softarm",
        "softarm.mocap_sources",
        "sim",
        "a source of motion capture",
        (
            "in softarm.yaml, under drivers: mocap: {{driver: {name}, options: {{port: 9763}}}}",
            "softarm check softarm.yaml && softarm run --config softarm.yaml",
        ),
    ),
}
NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
LONGEST = 40
TEMPLATES = Path(__file__).parent / "templates"


class Package(NamedTuple):
    """Names and files of a plug-in's package."""

    kind: str
    name: str  # selects the plug-in

    @property
    def project(self) -> str:
        """Return the name of the distribution."""
        return f"softarm-{self.name}"

    @property
    def module(self) -> str:
        """Return the name of the module, with a prefix that avoids collisions with other modules."""
        return self.project.replace("-", "_")

    @property
    def class_name(self) -> str:
        """Return the name of the class."""
        return "".join(part.capitalize() for part in self.name.split("-")) + self.kind.capitalize()

    @property
    def texts(self) -> dict[str, str]:
        """Return the text of each file by its path in the package."""
        templates = {
            "pyproject.toml": "pyproject.toml.in",
            "README.md": f"{self.kind}/README.md.in",
            f"{self.module}.py": f"{self.kind}/module.py.in",
            f"tests/test_{self.module}.py": f"{self.kind}/test.py.in",
        }
        values = {"name": self.name, "project": self.project, "module": self.module, "class_name": self.class_name}
        values |= {"version": ".".join(__version__.split(".")[:2]), **KINDS[self.kind]._asdict()}
        return {
            place: Template((TEMPLATES / file).read_text(encoding="utf-8")).substitute(values)
            for place, file in templates.items()
        }


def named(kind: str, name: str) -> Package:
    """Return the package of a new plug-in. Raises PluginError if its name is invalid or taken."""
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        raise PluginError(
            f"'{name}' is no valid name of a {kind}: allowed are lower-case letters, digits and single hyphens, a "
            f"letter first, at most {LONGEST} characters, such as my-{kind}"
        )
    if keyword.iskeyword(name):
        raise PluginError(f"'{name}' is a keyword of Python; choose another name, such as my-{name}")
    if name in (taken := _taken(kind)):
        raise PluginError(f"the {kind} '{name}' exists already ({', '.join(sorted(taken))}); choose another name")
    package = Package(kind, name)
    if find_spec(package.module) is not None:
        raise PluginError(f"the module {package.module} is already installed; choose another name")
    return package


def write(package: Package, folder: Path) -> list[Path]:
    """Write the files of a package and return their paths.

    Raises:
        PluginError: The folder is not empty.
        OSError: A file cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise PluginError(f"{folder}: exists and is not overwritten; choose another --out, or remove it")
    written = []
    for path, text in package.texts.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        files.write_text(file, text)
        written.append(file)
    return written


def _taken(kind: str) -> set[str]:
    if kind == "policy":
        from softarm.policies import registry

        return set(registry.available())
    if kind == "source":
        from softarm.drivers.mocap import plugged

        return set(plugged.names())
    from softarm.training.run.recipe import PRESETS
    from softarm.training.task import registry as tasks

    return {*PRESETS, *tasks.names()}


@click.group()
def new() -> None:
    """Create the package of a plug-in, or the stage file of a rig.

    \b
    Examples:
      softarm new policy lean
      softarm new task gentle --out ~/arm/gentle
      softarm new source my-cameras
      softarm new rig recordings
    """


def _plugin(kind: str) -> click.Command:
    """Return the command that writes the package of one kind of plug-in."""

    @click.command(kind, help=_HELP.format(purpose=KINDS[kind].purpose, kind=kind))
    @click.argument("name")
    @click.option("--out", type=FOLDER, help="The folder to write.  [default: softarm-NAME]")
    def command(name: str, out: Path | None) -> None:
        package = named(kind, name)
        folder = out or Path(package.project)
        for file in write(package, folder):
            click.echo(f"wrote {file}")
        click.echo("next:")
        for line in (f"pip install --editable {folder}", f"pytest {folder}", *KINDS[kind].following):
            click.echo(f"  {line.format(name=name)}")

    return command


for _kind in KINDS:
    new.add_command(_plugin(_kind))
new.add_command(rig)
