"""Motion capture from another package: a source on a thread of its own, where it can hold up nobody."""

import asyncio
import threading
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
    """What `drivers.mocap.driver` may be."""
    return (BUILT_IN, *sorted(plugins.installed(GROUP).keys() - {BUILT_IN}))


def load(name: str, options: Mapping[str, Option]) -> "PluggedMocapSource":
    """Make the device of an installed source. Raises PluginError that names it, what is wrong and the next step."""
    try:
        make = plugins.find(_KIND, name, plugins.installed(GROUP), (BUILT_IN,))
        plugins.check_interface(_KIND, name, make, INTERFACE)
        plugins.check_options(_KIND, name, make, options)
        source = make(**options)
        if not isinstance(source, Source):
            raise PluginError(f"{_KIND} '{name}' lacks description or run; see docs/plugins.md")
    except (Exception, SystemExit) as error:  # a module may even call sys.exit() while it is imported
        raise PluginError(f"drivers.mocap.driver '{name}': {plugins.said(error)}") from error
    return PluggedMocapSource(name, source)


class PluggedMocapSource(Reception):
    """A `softarm.drivers.base.MocapSource` around a `Source`."""

    def __init__(self, name: str, source: Source, clock: Callable[[], int] = time.monotonic_ns) -> None:
        super().__init__(f"motion capture source '{name}'", "correct the source: docs/wires.md", "start it", clock)
        self._source = source
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure: str | None = None  # of its last run, until a frame comes

    def start(self) -> None:
        """Run the source in a thread."""
        self._thread = threading.Thread(target=self._keep_running, name="mocap", daemon=True)
        self._thread.start()

    async def stop(self) -> None:
        """Ask it to end; one that does not is left behind."""
        await asyncio.to_thread(self.end)

    def end(self) -> None:
        """The same, waiting for it."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(0.9)
        self._good.clear()

    def problem(self) -> str | None:
        """See `softarm.drivers.base.Device.problem`."""
        failure = self._failure
        return self.heard() if failure is None else self.say("run", failure, "it is run again every second")

    @property
    def are_wanted(self) -> bool:
        """See `softarm.drivers.mocap.source.Frames`."""
        return not self._stopping.is_set()

    def now_ns(self) -> int:
        """See `softarm.drivers.mocap.source.Frames`."""
        return self.clock()

    def wait(self, seconds: float) -> None:
        """See `softarm.drivers.mocap.source.Frames`."""
        self._stopping.wait(seconds)

    def put(self, sequence: int, t_capture_ns: int, bodies: Bodies) -> None:
        """See `softarm.drivers.mocap.source.Frames`."""
        now_ns = self.clock()
        try:
            poses = {name: None if pose is None else [float(each) for each in pose] for name, pose in bodies.items()}
            frame = payload.frame_of({"sequence": sequence, "t_capture_ns": t_capture_ns, "bodies": poses}, now_ns)
        except Exception as error:  # whatever a stranger's numbers make float raise
            self.refuse(str(error))
            return
        self.accept(frame)
        self._failure = None

    def refuse(self, problem: str) -> None:
        """See `softarm.drivers.mocap.source.Frames`."""
        self.malformed += 1
        self.complain(self.clock(), f"a malformed frame: {problem}")

    def _keep_running(self) -> None:
        while self.are_wanted:
            try:
                self._source.run(self)
                failure = "run returned while frames are wanted"
            except (Exception, SystemExit) as error:
                failure = f"run raised {type(error).__name__}: {' '.join(str(error).split())}"
            if self.are_wanted:
                self._failure = failure
            self._stopping.wait(RETRY_S)
