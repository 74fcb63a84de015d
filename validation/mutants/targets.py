"""The mutated modules, and the tests that define their behaviour."""

from pathlib import Path
from typing import NamedTuple

from softarm.common.revision import CHECKOUT


class Target(NamedTuple):
    """Module together with the tests that must detect its changes."""

    module: str  # file, relative to the package
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """Return the import name of the module."""
        return ".".join(["softarm", *Path(self.module).with_suffix("").parts])

    @property
    def source(self) -> str:
        """Return the source text of the module."""
        return (CHECKOUT / "softarm" / self.module).read_text(encoding="utf-8")


_CONTROL = "tests/daemon/control"
_TICK = ("tests/daemon/test_tick.py", "tests/daemon/test_tick_stops.py")
_LATCH = "tests/daemon/test_latch.py"
_PAGE = "tests/drivers/test_wires_page.py"  # docs/reference/wires.md specifies every codec
_RAIL = "tests/drivers/rail"
_WORDS = (f"{_RAIL}/test_driver.py", f"{_RAIL}/commissioning/test_search.py")  # controlwords and bits of the statusword
_TRACED = "tests/training/task/test_tensor_environment.py::test_the_traced_braking_law_has_the_bits_of_the_law"
TARGETS = {
    target.module: target
    for target in (
        Target("common/braking.py", ("tests/common/test_braking.py", f"{_CONTROL}/test_safety.py", _TRACED)),
        Target("daemon/control/safety.py", (f"{_CONTROL}/test_safety.py",)),
        Target("daemon/control/failsafe.py", (f"{_CONTROL}/test_failsafe.py", _LATCH, *_TICK)),
        Target("daemon/control/modes.py", (f"{_CONTROL}/test_failsafe.py", _LATCH, *_TICK)),
        Target("daemon/control/checks.py", (f"{_CONTROL}/test_checks.py", *_TICK)),
        Target("daemon/control/plausibility.py", (f"{_CONTROL}/test_plausibility.py",)),
        Target("daemon/control/observer.py", (f"{_CONTROL}/test_observer.py",)),
        Target("daemon/control/alignment.py", (f"{_CONTROL}/test_alignment.py",)),
        Target("daemon/control/dead_reckoning.py", (f"{_CONTROL}/test_dead_reckoning.py",)),
        Target("daemon/control/following.py", (f"{_CONTROL}/test_following.py",)),
        Target("daemon/control/goals.py", (f"{_CONTROL}/test_goals.py",)),
        Target("daemon/tick.py", (*_TICK, _LATCH)),
        Target("policies/runner.py", ("tests/policies/test_runner.py",)),
        Target("drivers/rail/cia402.py", (f"{_RAIL}/test_cia402.py", _PAGE, *_WORDS)),
        Target("drivers/regulator/teensy.py", ("tests/drivers/regulator/test_teensy.py", _PAGE)),
        Target("drivers/regulator/cobs.py", ("tests/drivers/regulator/test_cobs.py", _PAGE)),
        Target("drivers/mocap/payload.py", ("tests/drivers/mocap/test_payload.py", _PAGE)),
    )
}
