"""Checks of Python, the required packages and the extras."""

import importlib.metadata
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from softarm import __version__
from softarm.common.finding import Finding, ok, problem, warning
from softarm.common.revision import revision

TRIED = ((3, 11), (3, 13))  # oldest and newest Python that the packages were found for: docs/install.md
EXTRAS = {
    "sim": "robots in the simulator: demo, run --simulated, twin, evaluate",
    "diagnosis": "identify, diagnose",
    "train": "train, export",
    "mujoco": "the independent robot",
    "ros": "ROS bags, ROS 2 topics",
}


@dataclass(frozen=True, slots=True)
class Package:
    """A required package and its installed version."""

    name: str
    wanted: str  # as in pyproject.toml
    installed: str | None
    fits: bool


@dataclass(frozen=True, slots=True)
class Software:
    """Facts about the installed software."""

    python: tuple[int, int, int]
    softarm: str
    revision: str
    core: tuple[Package, ...]
    extras: Mapping[str, tuple[Package, ...]]


def look() -> Software:
    """Gather the facts of this environment; no packages are required if softarm is not installed."""
    try:
        lines = importlib.metadata.requires("softarm") or []
    except importlib.metadata.PackageNotFoundError:
        lines = []
    wanted = [Requirement(line) for line in lines]
    version = sys.version_info
    return Software(
        (version.major, version.minor, version.micro),
        __version__,
        revision(),
        tuple(_asked_for(wanted, "")),
        {extra: tuple(_asked_for(wanted, extra)) for extra in EXTRAS},
    )


def _asked_for(wanted: list[Requirement], extra: str) -> Iterator[Package]:
    """Yield the packages of the core or of one extra, including the extras that it names."""
    for each in wanted:
        alone = bool(extra) and each.marker is not None and not each.marker.evaluate({"extra": ""})
        if (each.marker is not None and not each.marker.evaluate({"extra": extra})) or bool(extra) != alone:
            continue
        if canonicalize_name(each.name) == "softarm":
            for named in sorted(each.extras):
                yield from _asked_for(wanted, named)
            continue
        try:
            found = importlib.metadata.version(each.name)
        except importlib.metadata.PackageNotFoundError:
            yield Package(each.name, f"{each.name}{each.specifier}", None, False)
        else:
            fits = each.specifier.contains(found, prereleases=True)
            yield Package(each.name, f"{each.name}{each.specifier}", found, fits)


def judge(facts: Software) -> Iterator[Finding]:
    """Yield findings on Python, softarm, its packages and each extra."""
    (oldest, newest), version = TRIED, facts.python
    text, span = ".".join(map(str, version)), f"{oldest[0]}.{oldest[1]} to {newest[0]}.{newest[1]}"
    if version[:2] < oldest:
        yield problem("Python", f"{text}; required {span}", "use a newer Python: docs/install.md")
    elif version[:2] > newest:
        advice = "if a package fails, create the environment with a tested version"
        yield warning("Python", f"{text}; tested {span}", advice)
    else:
        yield ok("Python", text)
    from_checkout = "" if facts.revision.startswith("unknown") else f" ({facts.revision})"
    yield ok("softarm", f"{facts.softarm}{from_checkout}")
    if not facts.core:
        yield warning("packages", "softarm is not installed in this environment", "install it: docs/install.md")
    elif wrong := _wrong(facts.core):
        yield problem("packages", wrong, "pip install --upgrade softarm")
    else:
        yield ok("packages", f"all {len(facts.core)} packages of the daemon")
    for extra, packages in facts.extras.items():
        if lacking := [each.name for each in packages if not each.fits]:
            advice = f"pip install 'softarm[{extra}]', for {EXTRAS[extra]}"
            yield ok(f"extra {extra}", f"lacks {', '.join(lacking)}", advice)
        else:
            yield ok(f"extra {extra}", "complete")


def _wrong(packages: tuple[Package, ...]) -> str:
    return ", ".join(
        f"{each.wanted} is {'not installed' if each.installed is None else each.installed}"
        for each in packages
        if not each.fits
    )
