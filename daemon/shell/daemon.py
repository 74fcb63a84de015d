"""The whole daemon put together: recorder, control loop, REST API, and their order of life and death."""

import logging
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType

from softarm.daemon.api.app import ApiContext, create_app
from softarm.daemon.api.login import Sessions
from softarm.daemon.api.server import ApiServer
from softarm.daemon.control.inbox import Inbox
from softarm.daemon.foxglove.guest import FoxgloveGuest
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.shell import realtime
from softarm.daemon.shell.first_policy import first_policy
from softarm.daemon.shell.loop import ControlLoop, Devices
from softarm.daemon.shell.service import Notifier, Watchdog, allow_descriptors
from softarm.daemon.stop.latch import LatchKeeper, latch_path
from softarm.daemon.stop.listener import StopListener
from softarm.daemon.stop.terminal import StopKey
from softarm.daemon.tick import Controller
from softarm.drivers.base import MocapSource
from softarm.policies import registry
from softarm.policies.base import Policy
from softarm.policies.runner import ThreadRunner
from softarm.schemas.config import Config, Mocap
from softarm.schemas.model import Model

log = logging.getLogger(__name__)

POLL_S = 0.1
SWITCH_INTERVAL_S = 0.0002  # the API's thread gives way to the control loop's within this, not in 5 ms


def real_devices(config: Config) -> Devices:
    """The robot on its wires (or the twin: the drivers cannot tell).

    Raises PluginError for a source of motion capture that cannot be used.
    """
    from softarm.drivers.rail.driver import DryveRailAxis
    from softarm.drivers.regulator.driver import TeensyRegulator

    return Devices(
        motion_capture(config.drivers.mocap),
        TeensyRegulator(config.drivers.regulator),
        DryveRailAxis(config.drivers.rail, config.control.realtime_priority),
    )


def motion_capture(config: Mocap) -> MocapSource:
    """What the configuration names: Zenoh, or another package's source. Raises PluginError when that cannot be used."""
    from softarm.drivers.mocap import plugged

    if config.driver != plugged.BUILT_IN:
        return plugged.load(config.driver, config.options)
    from softarm.drivers.mocap.driver import ZenohMocapSource

    return ZenohMocapSource(config)


def simulated_devices(model: Model | None = None) -> Devices:
    """The robot simulated in this process, which moves in real time from this instant on. Needs the extra `sim`."""
    from softarm.drivers.bodies.in_process import InProcessRobot
    from softarm.drivers.bodies.simulated import SimulatedBody

    robot = InProcessRobot(SimulatedBody(model), time.monotonic_ns())
    return Devices(robot.mocap, robot.regulator, robot.rail, simulated=True)


def latch_of(config: Config) -> LatchKeeper:
    """The latch of the robot on its wires. One simulated in this process begins anew, and has none."""
    return LatchKeeper(latch_path(config), config.control.realtime_priority)


class Daemon:
    """Started, it runs until stopped; the caller decides which devices it moves."""

    def __init__(
        self,
        config: Config,
        devices: Devices,
        latch: LatchKeeper | None = None,
        policy: Policy | None = None,
        foxglove: FoxgloveGuest | None = None,
    ) -> None:
        """policy: `control.policy`; loaded here without one. Raises PolicyError when it cannot be.

        Leaves the caller's priority alone. A program that is nothing but the daemon outranks others before, see
        `realtime.outrank_other_programs`: the threads that begin here inherit that.
        """
        self.config = config
        policy = policy or registry.load(config.control.policy, config.policies)
        self.recorder = Recorder(config, policy.spec)
        self.foxglove = foxglove
        if foxglove is not None:
            self.recorder.beside = foxglove.take
        self.inbox = Inbox()
        self.latch = latch
        self.notifier = Notifier()
        self.watchdog = Watchdog(self.notifier)
        controller = Controller(config, ThreadRunner(policy, config.failsafe.policy_budget_s))
        self.loop = ControlLoop(
            controller,
            devices,
            self.inbox,
            self.recorder,
            self.watchdog,
            latch,
            rate_hz=config.control.rate_hz,
            realtime_priority=config.control.realtime_priority,
        )
        sessions = Sessions(config.api.port)
        context = ApiContext(
            config,
            self.inbox,
            lambda: self.loop.snapshot,
            lambda: self.loop.problems,
            self.recorder,
            self.recorder.history,
            self.recorder.recent,
            frame=lambda: controller.frame,
            sessions=sessions,
            stop_port=lambda: self.stop_port,
            left_at=lambda: None if latch is None else latch.left_at,
            simulated=devices.simulated,
        )
        self.api = ApiServer(config.api, create_app(context))
        self.stop_way = StopListener(
            config.api,
            self.inbox,
            lambda: self.loop.snapshot,
            config.control.realtime_priority,
            lambda: self.port,
            sessions,
        )
        self.port = self.stop_port = 0

    def start(self) -> None:
        """Latch, recorder, stop, API, loop: people can ask before the hardware is up.

        Raises LatchError, RecorderError, FoxgloveError or ApiError; nothing is left running then.
        """
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        try:
            if self.latch is not None:
                self.latch.start()
            self.recorder.start()
            if self.foxglove is not None:
                self.foxglove.start()
            self.stop_port = self.stop_way.start()
            self.port = self.api.start()
        except Exception:
            self.stop_way.stop()
            self.recorder.stop()
            if self.foxglove is not None:
                self.foxglove.stop()
            if self.latch is not None:
                self.latch.stop()
            raise
        self.loop.start()

    def stop(self) -> None:
        """The loop first: it leaves the devices safe. Each part is stopped whatever the others do."""
        for part in (self.loop, self.latch, self.stop_way, self.api, self.recorder, self.foxglove):
            try:
                if part is not None:
                    part.stop()
            except Exception:
                log.exception("%s did not stop cleanly", type(part).__name__)

    @property
    def url(self) -> str:
        """Where the API answers."""
        return f"http://{self.config.api.host}:{self.port}"

    @property
    def stop_url(self) -> str:
        """Where a stop is taken that waits for nobody."""
        return f"http://{self.config.api.host}:{self.stop_port}/api/stop"

    def stop_by_key(self) -> None:
        """Somebody pressed a key."""
        self.inbox.post("stop", who="the terminal")
        log.warning("emergency stop by a key: `softarm acknowledge` frees the latch")


def wait_for(stop: threading.Event, poll_s: float = POLL_S) -> None:
    """Until a signal's handler has set it. For the main thread, where handlers run.

    `Event.wait` there may hold the very lock that the handler's `set` asks for, and both wait for ever.
    """
    while not stop.is_set():
        time.sleep(poll_s)


def run(
    config: Config,
    devices: Devices,
    on_ready: Callable[[Daemon], None],
    latch: LatchKeeper | None = None,
    foxglove: FoxgloveGuest | None = None,
) -> int:
    """Run until SIGINT or SIGTERM, and return which; tells systemd, if it is there.

    Raises what `first_policy` and Daemon raise.
    """
    stop, signals = threading.Event(), [signal.SIGTERM]

    def end(number: int, _frame: FrameType | None) -> None:
        signals.append(signal.Signals(number))
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    allow_descriptors()
    realtime.outrank_other_programs(config.control.realtime_priority)  # the policy's own threads as well
    policy = first_policy(config, stop)
    if policy is None:
        return signals[-1]
    daemon = Daemon(config, devices, latch, policy, foxglove)
    daemon.start()
    try:
        on_ready(daemon)
        daemon.notifier.ready(f"serving {daemon.url}")
        with StopKey(daemon.stop_by_key):
            wait_for(stop)
        daemon.notifier.stopping()
    finally:
        daemon.stop()
    return signals[-1]
