"""What `softarm new` writes: a small package of one plugin, and a test that flies it.

The files ending in `.in` are `string.Template`s: `$name` as typed, `$module` and `$class_name` as Python
says it, `$version` of this softarm.
"""

import keyword
import re
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import NamedTuple

from softarm import __version__
from softarm.common import files
from softarm.common.plugins import PluginError

KINDS = ("policy", "task", "source")
NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
LONGEST = 40


class Package(NamedTuple):
    """What a plugin's package is called, and its parts."""

    kind: str
    name: str  # by which it is chosen

    @property
    def project(self) -> str:
        """Name of the distribution."""
        return f"softarm-{self.name}"

    @property
    def module(self) -> str:
        """Name of the module; the prefix keeps it apart from Python's own and from a user's."""
        return self.project.replace("-", "_")

    @property
    def class_name(self) -> str:
        """Name of the class."""
        return "".join(part.capitalize() for part in self.name.split("-")) + self.kind.capitalize()

    @property
    def texts(self) -> dict[str, str]:
        """Its files, by their path in the package."""
        places = {
            "pyproject.toml": "pyproject.toml",
            "README.md": "README.md",
            f"{self.module}.py": "module.py",
            f"tests/test_{self.module}.py": "test.py",
        }
        given = {"name": self.name, "project": self.project, "module": self.module, "class_name": self.class_name}
        given["version"] = ".".join(__version__.split(".")[:2])
        source = Path(__file__).parent / self.kind
        return {
            place: Template((source / f"{file}.in").read_text(encoding="utf-8")).substitute(given)
            for place, file in places.items()
        }


def named(kind: str, name: str) -> Package:
    """A package of this name. Raises PluginError for a name that cannot be, or is taken."""
    if not NAME.fullmatch(name) or len(name) > LONGEST:
        raise PluginError(
            f"'{name}' cannot name a {kind}; allowed are small letters, digits and single hyphens between them, a "
            f"letter first, {LONGEST} at most: my-{kind}"
        )
    if keyword.iskeyword(name):
        raise PluginError(f"'{name}' is a word of Python's; choose another, such as my-{name}")
    if name in (taken := _taken(kind)):
        raise PluginError(f"there is a {kind} '{name}' already ({', '.join(sorted(taken))}); choose another name")
    package = Package(kind, name)
    if find_spec(package.module) is not None:
        raise PluginError(f"a module {package.module} is installed already; choose another name")
    return package


def write(package: Package, folder: Path) -> list[Path]:
    """Write a package's files; returns their paths. Raises PluginError when the folder holds anything, OSError."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise PluginError(f"{folder}: is there already, and nothing is overwritten; give another --out, or remove it")
    written = []
    for place, text in package.texts.items():
        file = folder / place
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
