"""Control tick: turns the measurements of one instant into one command. Pure: no I/O, no clock, no asyncio.

The same tick runs at 30 Hz on hardware, in lockstep with the simulator, and over a recorded log.
"""

from collections import deque
from collections.abc import Iterator, Mapping

import numpy as np

from softarm.daemon.control.checks import device_events
from softarm.daemon.control.failsafe import Event
from softarm.daemon.control.following import Following
from softarm.daemon.control.goals import GoalTracker
from softarm.daemon.control.modes import ModeMachine
from softarm.daemon.control.observer import Observer, as_array
from softarm.daemon.control.records import Inputs, Mode, Observed, Outputs, Request, RequestResult
from softarm.daemon.control.safety import SafetyFilter
from softarm.policies.runner import PolicyOutcome, PolicyRunner
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import SAFE, Command, MocapFrame

RESULTS_KEPT = 32
REST_SPEED_M_S = 0.02  # a slower cart is at rest
BRAKING_S = 1.0  # longest wait of a soft stop for the cart to come to rest
SWING_M_S = 0.3  # an arm whose tip is faster could move a cart that the drive no longer holds
HALF_SWING_S = 0.75  # a swinging tip is slower than SWING_M_S while it reverses
SETTLING_S = 10.0  # longest wait of a soft stop for the arm to be still
CHOOSE_POLICY = "choose another policy (`softarm policy use NAME`, or Policies on the dashboard)"
UNSETTLED = ("mocap_missing", "mocap_stale", "mocap_settling")  # too few frames for arming


class Controller:
    """The control tick and its state between ticks."""

    def __init__(self, config: Config, policy: PolicyRunner) -> None:
        rate = config.control.rate_hz
        self._config = config
        self._policy = policy
        drive = config.drivers.rail
        self._observer = Observer(config)
        self._safety = SafetyFilter(config.limits, 1 / rate, drive.hold_s)
        self._following = Following(config.limits.rail.braking_law(drive.hold_s))
        waits_s = (config.failsafe.arming_timeout_s, BRAKING_S, SETTLING_S)
        self._machine = ModeMachine(*(round(each * rate) for each in waits_s))
        self._goals = GoalTracker(config.goals)
        self._results: deque[RequestResult] = deque(maxlen=RESULTS_KEPT)
        self._tick = 0
        self._missed_total = 0
        self._sent = SAFE
        self._last_stop_ns: int | None = None
        self._swung_ns: int | None = None  # when the arm last swung or was last unseen

    @property
    def frame(self) -> MocapFrame | None:
        """Return the newest good motion capture frame, or None if there is none yet."""
        return self._observer.good

    def tick(self, inputs: Inputs, runners: Mapping[int, PolicyRunner] | None = None) -> Outputs:
        """Decide on the command of one tick; `runners` are the loaded policies of its policy requests by number."""
        self._tick += 1
        self._missed_total += inputs.missed
        if inputs.latched is not None:
            self._machine.latch(inputs.latched)
        self._observer.update(inputs)
        self._following.update(inputs.rail, self._safety.sent)
        observed = self._observer.observe(inputs.t_ns, self._sent.cart_velocity_m_s)
        stops = self._machine.stops
        events = tuple(self._events(inputs))
        for request in inputs.requests:
            self._answer(request, events, runners or {})
        outcome = self._run_policy(inputs.t_ns, observed, events)
        if outcome is not None and outcome.fault is not None:
            events = (Event("policy_fault", outcome.fault), *events)
        still = self._still(inputs.t_ns, observed)
        self._machine.update(events, devices_armed=self._devices_armed(), at_rest=self._at_rest(), still=still)
        if self._machine.stops != stops:
            self._last_stop_ns = inputs.t_ns
        if self._machine.mode in (Mode.DISARMED, Mode.STOPPED):
            self._observer.alignment.restart()  # else a latency measured once would never be measured again
        if self._machine.mode is not Mode.ARMED:
            self._goals.end("failed", self._machine.last_stop or "the arm is not armed")
        requested = self._requested(outcome)
        sent, clamps = self._safety.apply(requested, inputs.rail, inputs.t_ns)
        self._sent = sent
        return Outputs(
            t_ns=inputs.t_ns,
            tick=self._tick,
            late_ns=inputs.late_ns,
            missed=inputs.missed,
            missed_total=self._missed_total,
            mode=self._machine.mode,
            estop=self._machine.estop,
            sent=sent,
            action=None if outcome is None or outcome.action is None else _pair(outcome),
            policy=self._policy.policy.spec.name,
            policy_ns=0 if outcome is None else outcome.duration_ns,
            policy_fault=None if outcome is None else outcome.fault,
            clamps=clamps,
            observed=observed,
            rail_position_m=inputs.rail.position_m if inputs.rail else None,
            rail_velocity_m_s=inputs.rail.velocity_m_s if inputs.rail else None,
            rail_cycle_p50_ms=inputs.rail.cycle_p50_ns / 1e6 or None if inputs.rail else None,
            rail_cycle_max_ms=inputs.rail.cycle_max_ns / 1e6 or None if inputs.rail else None,
            goal=self._goals.status,
            events=tuple(event.active() for event in events),
            arming_refusals=self._machine.refusals(events),
            last_stop=self._machine.last_stop,
            last_stop_ns=self._last_stop_ns,
            results=tuple(self._results),
            reset_devices=any(request.kind == "acknowledge" for request in inputs.requests),
        )

    def resume(self, recorded: Outputs) -> None:
        """Take over the state of a recorded tick, except the policy's memory: for the replay of a log with gaps."""
        self._tick, self._missed_total, self._sent = recorded.tick, recorded.missed_total, recorded.sent
        self._last_stop_ns = recorded.last_stop_ns
        self._safety.resume(recorded.sent)
        self._machine.resume(recorded.mode, recorded.estop, recorded.last_stop)
        self._goals.status = recorded.goal
        if not any(event.name in UNSETTLED for event in recorded.events):
            self._observer.frames_in_a_row = max(self._observer.frames_in_a_row, self._config.failsafe.arming_frames)

    def _events(self, inputs: Inputs) -> Iterator[Event]:
        """Yield the events of this tick: a requested stop, the devices' and the loop's."""
        if any(request.kind == "stop" for request in inputs.requests):
            yield Event("stop_requested")
        engaged = self._machine.mode in (Mode.ARMED, Mode.STOPPING)
        yield from device_events(inputs, self._observer, self._config, engaged)
        if self._following.is_lost:
            yield Event("rail_astray", f"{self._following.error_m_s:.2f} m/s off for {self._following.ticks} ticks")
        if inputs.missed >= self._config.failsafe.missed_ticks_max:
            yield Event("ticks_missed", f"{inputs.missed} in a row, {inputs.late_ns / 1e6:.0f} ms late")
        elif inputs.missed:
            yield Event("tick_late", f"{inputs.missed} skipped, {inputs.late_ns / 1e6:.0f} ms late")
        if inputs.recorder_problem is not None and not self._config.recorder.arm_without_log:
            yield Event("not_recorded", inputs.recorder_problem)
        if inputs.latch_problem is not None:
            yield Event("stop_not_kept", inputs.latch_problem)
        if inputs.recorder_dropped:
            yield Event("recorder_dropping", f"{inputs.recorder_dropped} so far")

    def _answer(self, request: Request, events: tuple[Event, ...], runners: Mapping[int, PolicyRunner]) -> None:
        """Carry out a request and store its result."""
        reasons: tuple[str, ...] = ()
        match request.kind:
            case "stop":
                pass  # handled as an event, so that it precedes all other requests
            case "acknowledge":
                reasons = self._machine.acknowledge(events)
            case "arm":
                reasons = self._machine.arm(events)
            case "disarm":
                self._machine.disarm("disarmed by request")
            case "goal":
                reasons = self._start_goal(request.goal)
            case "cancel_goal":
                self._goals.end("cancelled", "cancelled by request")
            case "policy":
                reasons = self._use_policy(runners.get(request.number))
        self._results.append(RequestResult(request.number, not reasons, reasons))

    def _start_goal(self, goal: Goal | None) -> tuple[str, ...]:
        if goal is None:
            return ("the goal request has no goal",)
        if self._machine.mode is not Mode.ARMED:
            return (f"the arm is {self._machine.mode}: arm it first (`softarm arm`, or Arm on the dashboard)",)
        spec = self._policy.policy.spec
        if goal.kind == "reach" and not spec.needs_target:
            return (f"the policy {spec.name!r} does not move to targets: {CHOOSE_POLICY}",)
        if goal.kind == "run" and spec.needs_target:
            return (f"the policy {spec.name!r} needs a target: request a reach goal, or {CHOOSE_POLICY}",)
        steps = spec.episode_steps
        self._goals.start(goal, None if steps is None else steps / self._config.control.rate_hz)
        self._policy.reset()
        return ()

    def _use_policy(self, runner: PolicyRunner | None) -> tuple[str, ...]:
        if self._goals.running is not None and self._goals.running.kind != "hold":
            advice = "wait for its end or cancel it (`softarm goal cancel`, or Cancel goal on the dashboard)"
            return (f"a goal is running: {advice}",)
        if runner is None:
            return ("the policy was not loaded",)
        self._policy.close()
        self._policy = runner
        return ()

    def _run_policy(self, now_ns: int, observed: Observed | None, events: tuple[Event, ...]) -> PolicyOutcome | None:
        """Return the policy's outcome, or None unless the arm is armed and a goal other than hold runs freely."""
        if self._machine.mode is not Mode.ARMED or observed is None:
            return None
        if any(e.rule.response > 0 for e in events):
            return None
        self._goals.update([(pose.tip_y_m, pose.tip_z_m) for pose in self._observer.seen], now_ns)
        goal = self._goals.running
        if goal is None or goal.kind == "hold":
            return None
        observation = as_array(observed, self._policy.policy.spec.wants_tracking)
        return self._policy.step(observation, np.array((goal.y_m, goal.z_m), dtype=np.float32))

    def _requested(self, outcome: PolicyOutcome | None) -> Command:
        """Return the requested command: brake and vent, unless an armed arm has a valid action."""
        mode = self._machine.mode
        if mode in (Mode.DISARMED, Mode.STOPPED):
            return SAFE
        if mode is Mode.ARMED and outcome is not None and outcome.action is not None:
            velocity, pressure = _pair(outcome)
            return Command(True, velocity, pressure)
        return Command(True, 0.0, 0.0)

    def _devices_armed(self) -> bool:
        pressure, rail = self._observer.pressure, self._observer.rail
        return pressure is not None and rail is not None and pressure.armed and rail.enabled

    def _at_rest(self) -> bool:
        rail = self._observer.rail
        return rail is not None and abs(rail.velocity_m_s) < REST_SPEED_M_S

    def _still(self, now_ns: int, observed: Observed | None) -> bool:
        """Return whether the arm hangs still, so that it would not move a cart whose drive is off."""
        stale_ns = self._config.failsafe.mocap_stale_s * 1e9
        unseen = observed is None or observed.mocap_age_ns > stale_ns
        swings = observed is not None and abs(observed.values.tip_vy_m_s) > SWING_M_S
        if self._swung_ns is None or unseen or swings:
            self._swung_ns = now_ns
        return now_ns - self._swung_ns >= HALF_SWING_S * 1e9


def _pair(outcome: PolicyOutcome) -> tuple[float, float]:
    assert outcome.action is not None
    return float(outcome.action[0]), float(outcome.action[1])
