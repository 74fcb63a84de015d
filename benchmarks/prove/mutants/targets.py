"""What is mutated, and the tests that promise how it behaves."""

from pathlib import Path
from typing import NamedTuple

from softarm.common.revision import ROOT


class Target(NamedTuple):
    """A module, and the tests that have to notice when it changes."""

    module: str  # its file, from the root of the sources
    tests: tuple[str, ...]
    root: Path = ROOT
    package: str = "softarm"  # what its import name begins with; empty: nothing

    @property
    def name(self) -> str:
        """What it is imported as."""
        return ".".join([self.package, *Path(self.module).with_suffix("").parts]).lstrip(".")

    @property
    def source(self) -> str:
        """Its text."""
        return (self.root / self.module).read_text(encoding="utf-8")


_CONTROL = "tests/daemon/control"
_TICK = "tests/daemon/test_tick.py"
_LATCH = "tests/daemon/test_latch.py"
_PAGE = "tests/drivers/test_wires_page.py"  # docs/wires.md is the promise of every codec
TARGETS = {
    target.module: target
    for target in (
        Target("common/braking.py", ("tests/common/test_braking.py", f"{_CONTROL}/test_safety.py")),
        Target("daemon/control/safety.py", (f"{_CONTROL}/test_safety.py",)),
        Target("daemon/control/failsafe.py", (f"{_CONTROL}/test_failsafe.py", _LATCH, _TICK)),
        Target("daemon/control/checks.py", (f"{_CONTROL}/test_checks.py", _TICK)),
        Target("daemon/control/plausibility.py", (f"{_CONTROL}/test_plausibility.py",)),
        Target("daemon/control/observer.py", (f"{_CONTROL}/test_observer.py",)),
        Target("daemon/control/alignment.py", (f"{_CONTROL}/test_alignment.py",)),
        Target("daemon/control/dead_reckoning.py", (f"{_CONTROL}/test_dead_reckoning.py",)),
        Target("daemon/control/following.py", (f"{_CONTROL}/test_following.py",)),
        Target("daemon/control/goals.py", (f"{_CONTROL}/test_goals.py",)),
        Target("daemon/tick.py", (_TICK, _LATCH)),
        Target("policies/runner.py", ("tests/policies/test_runner.py",)),
        Target("drivers/rail/cia402.py", ("tests/drivers/rail/test_cia402.py", _PAGE)),
        Target("drivers/regulator/teensy.py", ("tests/drivers/regulator/test_teensy.py", _PAGE)),
        Target("drivers/regulator/cobs.py", ("tests/drivers/regulator/test_cobs.py", _PAGE)),
        Target("drivers/mocap/payload.py", ("tests/drivers/mocap/test_payload.py", _PAGE)),
    )
}
