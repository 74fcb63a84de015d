"""ROS 2 node: a thread that publishes new snapshots and passes commands to the inbox.

It is a client of the ROS 2 router, which may start later. Zenoh's queues drop messages instead of waiting.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import zenoh

from softarm.daemon.control import workspace
from softarm.daemon.control.inbox import ANSWER_S, Inbox, InboxFull, unanswered
from softarm.daemon.control.records import Outputs, RequestKind
from softarm.daemon.ros import messages
from softarm.daemon.ros.messages import Messages, Node
from softarm.drivers.mocap.zenoh_session import ClientThread
from softarm.schemas.config import Config
from softarm.schemas.goals import Goal
from softarm.schemas.messages import MocapFrame

log = logging.getLogger(__name__)

POLL_S = 0.005
STOP_S = 2.0  # a router that accepts and stays silent delays the thread's end by ten seconds
WAITING_MAX = 64  # commands whose answers are still to be published


@dataclass(frozen=True, slots=True)
class _Asked:
    """A command that waits for its answer."""

    kind: RequestKind
    number: int  # of the request
    at_ns: int


class _Publisher:
    """Publisher of one topic with its liveliness token."""

    def __init__(self, session: zenoh.Session, node: Node, number: int, topic: messages.Topic) -> None:
        self._token = node.endpoint(number, messages.PUBLISHER, topic)
        self._alive = session.liveliness().declare_token(self._token)
        self._publisher = session.declare_publisher(
            topic.key(node.domain), congestion_control=zenoh.CongestionControl.DROP
        )
        self._sequence = 0

    def put(self, data: bytes, now_ns: int) -> None:
        self._sequence += 1
        self._publisher.put(data, attachment=messages.attachment(self._sequence, now_ns, self._token))


class RosNode(ClientThread):
    """The daemon's node in the ROS 2 graph."""

    def __init__(
        self,
        config: Config,
        inbox: Inbox,
        snapshot: Callable[[], Outputs | None],
        frame: Callable[[], MocapFrame | None],
        clock: Callable[[], int] = time.monotonic_ns,
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Prepare the node of a configuration with `ros.router`. Raises ModuleNotFoundError without rosbags."""
        assert config.ros.router is not None
        super().__init__(config.ros.router, "ros")
        self._config, self._inbox, self._snapshot, self._frame = config, inbox, snapshot, frame
        self._clock, self._wall_ns = clock, wall_ns
        self._messages = Messages()
        self._waiting: deque[_Asked | str] = deque(maxlen=WAITING_MAX)  # texts are answers already

    def start(self) -> None:
        """Connect in the thread, now or when the router starts."""
        self.open()

    def stop(self) -> None:
        """End the thread, within two seconds even if the router hangs."""
        self.close(STOP_S)

    def _use(self, session: zenoh.Session) -> None:
        ros = self._config.ros
        node = Node(ros.domain_id, str(session.info.zid()), ros.name)
        declared: list[object] = [session.liveliness().declare_token(node.token)]
        publishers: dict[str, _Publisher] = {}
        for name, type_name in (messages.STATES | {messages.ANSWER: messages.ANSWER_TYPE}).items():
            topic = self._messages.topic(f"{ros.name}/{name}", type_name)
            publishers[name] = _Publisher(session, node, len(publishers) + 1, topic)
        for k, (name, take) in enumerate(self._commands()):
            topic = self._messages.topic(f"{ros.name}/{name}", messages.COMMANDS[name])
            token = node.endpoint(len(publishers) + 1 + k, messages.SUBSCRIPTION, topic)
            declared.append(session.declare_subscriber(topic.key(ros.domain_id), take))
            declared.append(session.liveliness().declare_token(token))
        log.info("ROS 2: connected to %s, topics under /%s, commands: %s", self._endpoint, ros.name, ros.commands)
        last: tuple[Outputs | None, MocapFrame | None] = (None, None)
        while not self._stopping.wait(POLL_S):
            present = (self._snapshot(), self._frame())
            for name, data in self._new(*last, *present):
                publishers[name].put(data, self._wall_ns())
            last = present

    def _new(
        self,
        last: Outputs | None,
        last_frame: MocapFrame | None,
        outputs: Outputs | None,
        frame: MocapFrame | None,
    ) -> Iterator[tuple[str, bytes]]:
        """Yield the messages of what is new since the last look."""
        offset_ns = self._wall_ns() - self._clock()
        if frame is not None and frame is not last_frame:
            yield from self._messages.of_frame(frame, frame.t_capture_ns + offset_ns)
        if outputs is not None and outputs is not last:
            yield from self._messages.of_tick(outputs, outputs.t_ns + offset_ns)
        for _ in range(len(self._waiting)):
            asked = self._waiting.popleft()
            answer = asked if isinstance(asked, str) else self._answer(asked, outputs)
            if answer is None:
                self._waiting.append(asked)
            else:
                yield messages.ANSWER, self._messages.answer(answer)

    def _commands(self) -> Iterator[tuple[str, Callable[[zenoh.Sample], None]]]:
        """Yield name and receiver of the topics that the configuration opens."""
        if self._config.ros.commands != "none":
            yield messages.STOP, self._take_stop
        if self._config.ros.commands == "all":
            yield messages.GOAL, self._take_goal

    def _take_stop(self, sample: zenoh.Sample) -> None:
        """Request an emergency stop, whatever the message holds. Zenoh's thread calls this."""
        self._ask("stop", None)

    def _take_goal(self, sample: zenoh.Sample) -> None:
        """Request a goal, or refuse it as the API does. Zenoh's thread calls this."""
        try:
            goal = self._messages.goal(sample.payload.to_bytes())
        except ValueError as error:
            self._waiting.append(f"goal refused: {error}")
            return
        if reasons := workspace.refusals(goal, self._config):
            self._waiting.append(f"goal refused: {'; '.join(reasons)}")
        else:
            self._ask("goal", goal)

    def _ask(self, kind: RequestKind, goal: Goal | None) -> None:
        now_ns = self._clock()
        try:
            number = self._inbox.post(kind, goal=goal, who=f"ROS 2, {self._endpoint}")
        except InboxFull as error:
            self._waiting.append(f"{kind} refused: {error}")
        else:
            self._waiting.append(_Asked(kind, number, now_ns))

    def _answer(self, asked: _Asked, outputs: Outputs | None) -> str | None:
        """Return the text that answers a request, or None while there is no answer."""
        result = None if outputs is None else outputs.answer(asked.kind, asked.number, asked.at_ns)
        if result is not None:
            return f"{asked.kind} " + ("accepted" if result.accepted else f"refused: {'; '.join(result.reasons)}")
        if self._clock() - asked.at_ns > ANSWER_S * 1e9:
            return "; ".join(unanswered(asked.kind))
        return None
