"""Lists the parts of softarm that have never been used with real hardware."""

from collections.abc import Iterator
from importlib import import_module

from softarm.common.finding import Finding, ok

# Packages with a constant `UNTRIED`, one sentence each, by the part's name.
PACKAGES = {
    "motion capture bridge": "softarm.drivers.bridge",
    "pressure regulator": "softarm.drivers.regulator",
    "rail drive": "softarm.drivers.rail",
    "homing and centring": "softarm.drivers.rail.commissioning",
    "systemd service": "softarm.daemon.install",
}
ADVICE = "Watch its first use with a hand on the emergency-stop button."


def sentences() -> dict[str, str]:
    """Return the sentence of each untried part by the part's name."""
    return {part: import_module(package).UNTRIED for part, package in PACKAGES.items()}


def judge() -> Iterator[Finding]:
    """Yield a finding for each untried part. None of them is a problem of this computer."""
    for part, sentence in sentences().items():
        yield ok(part, sentence, ADVICE)


def page() -> str:
    """Return docs/hardware/untried.md; `python -m softarm.daemon.doctor.untried` prints it."""
    rows = [f"| {part} | `{PACKAGES[part]}` | {sentence} |" for part, sentence in sentences().items()]
    lines = [
        "# Parts that never met hardware",
        "",
        "For everyone who builds or commissions the robot. These parts were written from manuals and tested with",
        "emulated devices. `softarm doctor` lists them as well.",
        "",
        "Generated from the constants `UNTRIED` in the packages with",
        "`python -m softarm.daemon.doctor.untried > docs/hardware/untried.md`.",
        "",
        "| part | package | state |",
        "|---|---|---|",
        *rows,
        "",
        ADVICE,
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
