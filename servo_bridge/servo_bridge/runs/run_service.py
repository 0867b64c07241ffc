"""The service ``record_run``: a recording of everything that determines a run.

The messages of the bridge come from its `MessageTap`; those of other nodes, such as the twin, by subscriptions that do
not convert them.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from servo_msgs_py.run_file.series import Limits
from servo_msgs_py.run_file.topic import Topic
from std_srvs.srv import SetBool

from servo_bridge.board_context import BoardContext
from servo_bridge.deferred_service import DeferredService
from servo_bridge.outcome import Outcome, answered
from servo_bridge.part import Part
from servo_bridge.runs.message_tap import MessageTap
from servo_bridge.runs.recorder import RunRecorder, RunReport
from servo_msgs_py import topics

_DEPTH: Final = 1000
"""Queue of a subscription; the executor may be busy for a second."""

_BYTES_MAX: Final = 1 << 26
"""Largest recorded message of another node [bytes]."""


@dataclass(frozen=True)
class RunSettings:
    """Parameters of recordings."""

    path: str  # with the codes of strftime; empty: none
    limits: Limits
    topics: tuple[str, ...]  # of other nodes, see the parameter ``run_topics``
    left_out: tuple[str, ...] = ()  # see the parameter ``run_left_out``


class RunService(Part):
    """Starts and ends recordings.

    Parameters
    ----------
    context : BoardContext
        Access to the executor and the log.
    node : Node
        Owner of service and subscriptions.
    tap : MessageTap
        Of the messages of the node.
    settings : RunSettings
        A change applies to the next recording.
    prepare : callable
        Called before a recording begins.
    """

    def __init__(
        self,
        context: BoardContext,
        node: Node,
        tap: MessageTap,
        settings: RunSettings,
        prepare: Callable[[], None],
    ) -> None:
        self._context, self._node, self._tap, self._prepare = context, node, tap, prepare
        self.settings = settings
        self._recorder: RunRecorder | None = None  # of the present or last recording
        self._running = False
        self._answer: Future[Outcome] | None = None  # of the call that ends the recording
        self._subscriptions: dict[str, Any] = {}
        self._left_out: Callable[[str], bool] = lambda name: False
        self._service = DeferredService(node, SetBool, topics.RECORD_RUN, lambda request: self._on_call(request.data))

    @property
    def report(self) -> RunReport | None:
        """State of the present or last recording; None if there was none."""
        return None if self._recorder is None else self._recorder.report

    def begin(self) -> Future[Outcome]:
        """Start a recording."""
        if self._running and self._recorder is not None:
            path = self._recorder.report.path
            return answered(False, f"recording to {path}; call {topics.RECORD_RUN} with data: false to end it first")
        if not self.settings.path:
            return answered(False, "the parameter run_file is empty; set it to the path of a .mcap file first")
        self._prepare()
        answer: Future[Outcome] = Future()
        self._left_out = left_out = self._named(self.settings.left_out)
        self._recorder = recorder = RunRecorder(
            Path(time.strftime(self.settings.path)).absolute(),
            self.settings.limits,
            {topic: data for topic, data in self._tap.latched.items() if not left_out(topic.name)},
            Topic(self._node.resolve_topic_name(topics.RUN_LOST), "std_msgs/msg/UInt64"),
            lambda outcome: self._context.post(partial(self._begun, answer, outcome)),
            lambda outcome: self._context.post(partial(self._ended, outcome)),
        )
        self._running = True

        def receive(topic: Topic, data: bytes, time_ns: int) -> None:
            if not left_out(topic.name):
                recorder.add(topic, data, time_ns)

        self._tap.receiver = receive
        self.look()
        return answer

    def look(self) -> None:
        """Subscribe to new topics of other nodes; call it once a second."""
        if not self._running:
            return
        own = {entity.topic_name for entity in (*self._node.publishers, *self._node.subscriptions)}  # the tap has them
        wanted = self._named(self.settings.topics)
        for name, kinds in self._node.get_topic_names_and_types():
            if wanted(name) and not self._left_out(name) and name not in own and name not in self._subscriptions:
                self._subscribe(name, kinds[0])

    def close(self) -> None:
        """Complete the recording."""
        if self._recorder is not None:
            self._tap.receiver = None
            self._recorder.end()
            self._recorder.join()

    def _named(self, patterns: Sequence[str]) -> Callable[[str], bool]:
        """Whether an absolute name is one of these topics; see the parameter ``run_topics``."""
        own = self._node.get_namespace().rstrip("/")
        beside = own.rpartition("/")[0]
        names = [
            f"{beside}/{each[3:]}" if each.startswith("../") else each if each.startswith("/") else f"{own}/{each}"
            for each in patterns
        ]
        return cache(lambda name: any(name.startswith(each) if each[-1] == "/" else name == each for each in names))

    def _on_call(self, begin: bool) -> Future[Outcome]:
        if begin:
            return self.begin()
        if not self._running or self._recorder is None:
            return answered(False, f"nothing is recorded; call {topics.RECORD_RUN} with data: true first")
        self._answer = self._answer or Future()
        self._recorder.end()
        return self._answer

    def _begun(self, answer: Future[Outcome], outcome: Outcome) -> None:
        success, message = outcome
        (self._context.info if success else self._context.warn)(message)
        answer.set_result(outcome)
        if not success:
            self._stop()

    def _ended(self, outcome: Outcome) -> None:
        success, message = outcome
        (self._context.info if success else self._context.warn)(message)
        self._stop()
        if self._answer is not None:
            answer, self._answer = self._answer, None
            answer.set_result(outcome)

    def _stop(self) -> None:
        self._running = False
        self._tap.receiver = None
        for subscription in filter(None, self._subscriptions.values()):
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def _subscribe(self, name: str, kind: str) -> None:
        """Have the tap receive a topic, with the quality of service of its publishers."""
        found = [each.qos_profile for each in self._node.get_publishers_info_by_topic(name)]
        if not found:
            return
        reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in found)
        latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in found)
        qos = QoSProfile(
            depth=_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        package, group, message = kind.split("/")
        try:
            module = importlib.import_module(f"{package}.{group}")
            message_class = getattr(module, message)
        except (ImportError, AttributeError):
            self._context.warn(f"the recording of the run leaves {name} out: the type {kind} is not installed")
            self._subscriptions[name] = None
            return
        self._subscriptions[name] = self._node.create_subscription(
            message_class, name, lambda data: None, qos, raw=True, bytes_max=_BYTES_MAX
        )
