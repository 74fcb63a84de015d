"""The complete daemon: recorder, control loop, API and stop port, and the order in which they start and stop."""

import logging
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from types import FrameType
from typing import Self

from softarm.common import realtime
from softarm.common.address import local_url
from softarm.daemon.access.auth import Sessions
from softarm.daemon.api.app import create_app
from softarm.daemon.api.context import ApiContext
from softarm.daemon.api.server import ApiServer
from softarm.daemon.config.configuration import latch_path
from softarm.daemon.foxglove.publisher import FoxglovePublisher
from softarm.daemon.logbook.recorder import Recorder
from softarm.daemon.ros.node import RosNode
from softarm.daemon.runtime.devices import Devices
from softarm.daemon.runtime.jobs import Jobs
from softarm.daemon.runtime.loop import ControlLoop, Rehearsal
from softarm.daemon.runtime.service import Notifier, allow_descriptors
from softarm.daemon.stop.kept import KeptInbox
from softarm.daemon.stop.latch import LatchKeeper
from softarm.daemon.stop.listener import StopListener
from softarm.daemon.stop.terminal import StopKey
from softarm.daemon.tick import Controller
from softarm.policies import registry, trial, trusted
from softarm.policies.base import Policy, PolicyError
from softarm.schemas.config import Config

LOADING_S = 120.0  # trial and loading together: a policy may hang even after its trial
POLL_S = 0.05


def first_policy(config: Config, over: threading.Event) -> Policy | None:
    """Return the configured policy, or None if `over` was set before it was loaded.

    A loading thread that is abandoned is left behind.

    Raises:
        PolicyError: The policy cannot be used or was not loaded in time.
    """
    name = config.control.policy
    answer: Future[Policy] = Future()

    def load() -> None:
        try:
            answer.set_result(trial.load(name, config.policies, trial.TRIAL_S))
        except PolicyError as error:
            answer.set_exception(error)
        except BaseException as error:  # including sys.exit() in a plug-in
            answer.set_exception(PolicyError(f"{type(error).__name__}: {error}"))

    threading.Thread(target=load, name=f"loading {name}", daemon=True).start()
    deadline_s = time.monotonic() + LOADING_S
    while not wait((answer,), POLL_S).done:
        if over.is_set():
            return None
        if time.monotonic() > deadline_s:
            raise PolicyError(f"policy '{name}': was not loaded within {LOADING_S:g} s; repair it or choose another")
    return answer.result()


log = logging.getLogger(__name__)

SIGNAL_POLL_S = 0.1
SWITCH_INTERVAL_S = 0.0002  # the API's thread yields to the control loop within this time instead of 5 ms


class Daemon:
    """The daemon in this process, on the caller's devices; a context in which it runs."""

    def __init__(
        self,
        config: Config,
        devices: Devices,
        policy: Policy | None = None,
        foxglove: FoxglovePublisher | None = None,
    ) -> None:
        """Assemble the daemon without starting it; keeps the priority of the calling thread.

        `policy` is the loaded `control.policy`; without it the policy is loaded here.

        Raises:
            PolicyError: The policy cannot be loaded.
        """
        self.config = config
        policy = policy or registry.load(config.control.policy, config.policies)
        self.recorder = Recorder(config, policy.spec)
        self.foxglove = foxglove
        if foxglove is not None:
            self.recorder.listener = foxglove.take
        self.jobs = Jobs()
        # A robot simulated in this process has no stop to keep.
        self.latch = None if devices.simulated else LatchKeeper(latch_path(config), config.control.realtime_priority)
        keep = (lambda reason: None) if self.latch is None else self.latch.note
        self.inbox = KeptInbox(lambda: self.loop.snapshot, keep)
        self.notifier = Notifier()
        runner = trusted.runner(policy, config.failsafe.policy_budget_s)
        controller = Controller(config, runner)
        self.loop = ControlLoop(
            controller,
            devices,
            self.inbox,
            self.recorder,
            self.notifier,
            self.latch,
            config.control.realtime_priority,
            Rehearsal(config, runner),
        )
        sessions = Sessions(config.api.port)
        self.api = ApiServer(config.api, create_app(self._api_context(controller, devices, sessions)))
        self.stop_listener = StopListener(
            config.api,
            self.inbox,
            lambda: self.loop.snapshot,
            config.control.realtime_priority,
            lambda: self.port,
            sessions,
        )
        self.ros: RosNode | None = None
        if config.ros.router is not None:
            self.ros = RosNode(config, self.inbox, lambda: self.loop.snapshot, lambda: controller.frame)
        self.port = self.stop_port = 0

    def _api_context(self, controller: Controller, devices: Devices, sessions: Sessions) -> ApiContext:
        return ApiContext(
            self.config,
            self.inbox,
            lambda: self.loop.snapshot,
            lambda: self.loop.problems,
            self.recorder,
            self.recorder.history,
            self.recorder.recent,
            self.jobs,
            frame=lambda: controller.frame,
            sessions=sessions,
            stop_port=lambda: self.stop_port,
            left_at=lambda: None if self.latch is None else self.latch.left_at,
            simulated=devices.simulated,
        )

    def __enter__(self) -> Self:
        """Start latch, recorder, stop port, API and loop: the API answers before the hardware is ready.

        Raises:
            LatchError, RecorderError, FoxgloveError, ApiError: A part cannot start; the others are stopped again.
        """
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        try:
            if self.latch is not None:
                self.latch.start()
            self.inbox.start()
            self.recorder.start()
            if self.foxglove is not None:
                self.foxglove.start()
            if self.ros is not None:
                self.ros.start()
            self.stop_port = self.stop_listener.start()
            self.port = self.api.start()
        except Exception:
            self._stop_parts()
            raise
        self.loop.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop every part, even if another fails; the loop first, since it leaves the devices safe."""
        self._stop_parts(self.loop)

    def _stop_parts(self, *first: ControlLoop) -> None:
        parts = self.jobs, self.inbox, self.latch, self.stop_listener, self.api, self.ros, self.recorder, self.foxglove
        for part in (*first, *parts):
            try:
                if part is not None:
                    part.stop()
            except Exception:
                log.exception("%s did not stop cleanly", type(part).__name__)

    @property
    def url(self) -> str:
        """Return the address of the API."""
        return local_url(self.config.api.host, self.port)

    @property
    def stop_url(self) -> str:
        """Return the address of the dedicated stop port."""
        return f"{local_url(self.config.api.host, self.stop_port)}/api/stop"

    def stop_by_key(self) -> None:
        """Request an emergency stop from the terminal."""
        self.inbox.post("stop", who="the terminal")
        log.warning("emergency stop by key: `softarm acknowledge` releases the latch")


def wait_for(stop: threading.Event, poll_s: float = SIGNAL_POLL_S) -> None:
    """Wait until a signal handler sets the event. For the main thread, where handlers run.

    `Event.wait` could hold the lock that the handler's `set` needs, and deadlock.
    """
    while not stop.is_set():
        time.sleep(poll_s)


def run(
    config: Config,
    devices: Devices,
    on_ready: Callable[[Daemon], None],
    foxglove: FoxglovePublisher | None = None,
) -> int:
    """Run the daemon until SIGINT or SIGTERM and return the signal; notify systemd if present.

    Calls `on_ready` once the daemon has started. Raises the errors of `first_policy` and `Daemon`.
    """
    stop, signals = threading.Event(), [signal.SIGTERM]

    def end(number: int, _frame: FrameType | None) -> None:
        signals.append(signal.Signals(number))
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    allow_descriptors()
    realtime.outrank_other_programs(config.control.realtime_priority)  # inherited by the policy's threads
    policy = first_policy(config, stop)
    if policy is None:
        return signals[-1]
    with Daemon(config, devices, policy, foxglove) as daemon:
        on_ready(daemon)
        daemon.notifier.ready(f"serving {daemon.url}")
        with StopKey(daemon.stop_by_key):
            wait_for(stop)
        daemon.notifier.stopping()
    return signals[-1]
