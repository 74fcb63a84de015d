"""Motion capture from a plug-in: the source runs on a thread of its own and cannot delay the control loop."""

import time
from collections.abc import Callable, Mapping

from softarm.common import plugins
from softarm.common.plugins import Option, PluginError
from softarm.drivers.mocap import payload
from softarm.drivers.mocap.reception import Reception
from softarm.drivers.mocap.source import GROUP, INTERFACE, Bodies, Source

RETRY_S = 1.0
BUILT_IN = "zenoh"
_KIND = "motion capture source"


def names() -> tuple[str, ...]:
    """Return the allowed values of `drivers.mocap.driver`."""
    return (BUILT_IN, *sorted(plugins.installed(GROUP).keys() - {BUILT_IN}))


def load(name: str, options: Mapping[str, Option]) -> "PluggedMocapSource":
    """Return the device of an installed source, created with the options.

    Raises:
        PluginError: No such source, or it failed; with the cause and the next step.
    """
    try:
        make = plugins.find(_KIND, name, plugins.installed(GROUP), (BUILT_IN,))
        plugins.check_interface(_KIND, name, make, INTERFACE)
        plugins.check_options(_KIND, name, make, options)
        source = make(**options)
        if not isinstance(source, Source):
            raise PluginError(f"{_KIND} '{name}' lacks description or run; see docs/policies/plugins.md")
    # A module may call sys.exit() while it is imported.
    except (Exception, SystemExit) as error:
        raise PluginError(f"drivers.mocap.driver '{name}': {plugins.said(error)}") from error
    return PluggedMocapSource(name, source)


class PluggedMocapSource(Reception):
    """Device that runs a `Source`, a `softarm.drivers.base.MocapSource`."""

    def __init__(self, name: str, source: Source, clock: Callable[[], int] = time.monotonic_ns) -> None:
        super().__init__(
            f"motion capture source '{name}'", "correct the source: docs/reference/wires.md", "start it", clock
        )
        self._source = source
        # Failure of the last run, until a frame arrives.
        self._failure: str | None = None

    def problem(self) -> str | None:
        """Return why there is no fresh frame, as one sentence with the next step, or None if all is well."""
        failure = self._failure
        if failure is None:
            return self.sample_problem()
        return self.describe("run", failure, "correct the source; it is restarted every second")

    @property
    def are_wanted(self) -> bool:
        """Whether the source should go on; see `softarm.drivers.mocap.source.Frames`."""
        return not self._stopping.is_set()

    def now_ns(self) -> int:
        """Return the present time of CLOCK_MONOTONIC."""
        return self.clock()

    def wait(self, seconds: float) -> None:
        """Wait, or return early when no more frames are wanted."""
        self._stopping.wait(seconds)

    def put(self, sequence: int, t_capture_ns: int, bodies: Bodies) -> None:
        """Check a frame and pass it to the control loop; see `softarm.drivers.mocap.source.Frames`."""
        now_ns = self.clock()
        try:
            poses = {name: None if pose is None else [float(each) for each in pose] for name, pose in bodies.items()}
            frame = payload.frame_of({"sequence": sequence, "t_capture_ns": t_capture_ns, "bodies": poses}, now_ns)
        # A plug-in's own number types may raise any exception.
        except Exception as error:
            self.refuse(str(error))
            return
        self.accept(frame)
        self._failure = None

    def refuse(self, problem: str) -> None:
        """Count and report input that is not a frame."""
        self.malformed += 1
        self.complain(self.clock(), f"a frame is malformed: {problem}")

    def _run(self) -> None:
        while self.are_wanted:
            try:
                self._source.run(self)
                failure = "run returned while frames were wanted"
            except (Exception, SystemExit) as error:
                failure = f"run raised {type(error).__name__}: {' '.join(str(error).split())}"
            if self.are_wanted:
                self._failure = failure
            self._stopping.wait(RETRY_S)
