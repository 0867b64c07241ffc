"""Test rig: the bridge node under real rclpy with a fake link instead of a serial port."""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any, TypeVar

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from servo_bridge.freemaster.client import BoardInfo
from servo_bridge.node import ServoBridge
from servo_bridge.wire.link import LinkConfig, LinkDownError, LinkState, LinkStatus, Sample
from servo_bridge.wire.link_statistics import LinkStatistics
from servo_bridge.wire.scope import ScopeLayout
from servo_bridge.wire.serial_port import LowLatency
from servo_bridge.wire.session import Session
from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import Catalogue, Value
from servo_msgs_py.convert import applied_from_message, parameters_from_message, snapshot_table
from servo_msgs_py.runtime.qos import command_qos, latched_qos, telemetry_qos
from std_msgs.msg import Bool, Float64, Float64MultiArray, Int64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from servo_msgs_py import topics

T = TypeVar("T")
DOMAIN = int(os.environ.get("ROS_DOMAIN_ID", "0")) or 20 + os.getpid() % 80
STOP, SPIN, FAULT = (2, 0), (3, 3), (0, 0)
NOMINAL_VALUES = {"axis1.torque_constant": 0.04, "axis2.torque_constant": 0.05} | {
    f"axis{k}.acceleration_current": 2.0e-4 for k in (1, 2)
}


class FakeLink:
    """Link to a fake board that the test controls by `connect`, `sample` and `disconnect`.

    Writes are acknowledged at once and take effect with the next sample, unless `ignores_writes`.
    """

    def __init__(
        self,
        config: LinkConfig,
        catalogue: Catalogue,
        *,
        on_sample: Callable[[Sample], None],
        on_state: Callable[[LinkStatus], None],
        hang: Callable[[], str],
    ) -> None:
        self.hang = hang
        self.keep_alive_period = 0.0  # s
        self.config = config
        self.layout = ScopeLayout([catalogue[name] for name in config.telemetry])
        self.written: list[tuple[str, int, tuple[int, ...]]] = []
        self.reads: list[str] = []
        self.final_writes: list[Any] = []
        self.ignores_writes = False
        self.connected = False
        self.tick = 8
        self.epoch = 0
        self.values: dict[str, int] = {f"axis{k}.{name}": 0 for k in (1, 2) for name in ("home_state", "oscillation")}
        self.parameters = {v.name: [v.to_raw(v.minimum)] * v.count for v in parameters(catalogue)}
        self.blocks: dict[str, bytes] = {}
        self.pending_reads: list[Future[Value]] | None = None  # unanswered reads of blocks; None: blocks are answered
        self.rejected_parameter = ""  # name of a parameter whose writes have no effect
        self.catalogue = catalogue
        self.link_statistics = LinkStatistics()
        self.session: Session | None = None
        self._effects = 0
        self._on_sample, self._on_state = on_sample, on_state

    # ---- interface to the node
    board = BoardInfo(name="fake", description="board of a test")
    low_latency = LowLatency(None, "none")

    def start(self) -> None:
        self._on_state(LinkStatus(LinkState.CONNECTING, "connecting to a test"))

    def close(self, final_writes: Sequence[Any] = (), timeout: float = 3.0) -> bool:
        self.final_writes = list(final_writes)
        return self.connected

    def write_raw(self, name: str, raw: Sequence[int], *, first: int = 0, urgent: bool = False) -> Future[None]:
        done: Future[None] = Future()
        if not self.connected:
            done.set_exception(LinkDownError("no link"))
        else:
            self.written.append((name, first, tuple(raw)))
            if name in self.parameters and name != self.rejected_parameter:
                self.parameters[name] = list(raw)
            if name in self.parameters or not self.ignores_writes:
                self._effects += 1
                done.set_result(None)
        return done

    def read(self, name: str) -> Future[Value]:
        self.reads.append(name)
        done: Future[Value] = Future()
        if name in self.parameters:
            done.set_result(self.catalogue[name].decode(self.catalogue[name].encode_raw(self.parameters[name])))
        elif name in self.blocks and self.pending_reads is not None:
            self.pending_reads.append(done)
        elif name in self.blocks:
            done.set_result(self.blocks[name])
        else:
            count = self.catalogue[name].count
            done.set_result(NOMINAL_VALUES.get(name, self.values.get(name, 1.5 if count == 1 else [1.5] * count)))
        return done

    def call(self, function: Callable[[Session], T]) -> Future[T]:
        done: Future[T] = Future()
        if self.session is None:
            done.set_exception(LinkDownError("no link"))
            return done
        try:
            done.set_result(function(self.session))
        except Exception as error:
            done.set_exception(error)
        return done

    def set_keep_alive_period(self, period: float) -> None:
        self.keep_alive_period = period

    def statistics(self) -> LinkStatistics:
        return self.link_statistics

    # ---- interface to the test
    def connect(self) -> None:
        self.connected = True
        self._on_state(LinkStatus(LinkState.CONNECTED, "connected to fake"))

    def disconnect(
        self, state: LinkState = LinkState.DISCONNECTED, reason: str = "gone", remedy: str = "plug it in"
    ) -> None:
        self.connected = False
        for done in self.pending_reads or ():
            done.set_exception(LinkDownError(reason))
        self._on_state(LinkStatus(state, reason, remedy))

    def set_states(self, *states: tuple[int, int]) -> None:
        """Set state and sub-state of every axis for the next samples."""
        for axis, (state, substate) in enumerate(states, 1):
            self.values[f"axis{axis}.state"], self.values[f"axis{axis}.substate"] = state, substate

    def sample(self, periods: int = 16, age: float = 0.0) -> None:
        """Deliver a sample `periods` PWM periods later, received `age` ago [s]; writes before it have taken effect."""
        self.tick += periods
        if self._effects:
            self.values["applied_count"] = (self.values.get("applied_count", 0) + self._effects) & 0xFFFF
            self.values["applied_tick"] = self.tick & 0xFFFF_FFFF
            self._effects = 0
        numbers: list[int] = []
        for variable in self.layout.variables:
            value = self.tick & 0xFFFF_FFFF if variable.name == "tick" else self.values.get(variable.name, 0)
            numbers += [value] * variable.count
        now = time.monotonic_ns() - round(age * 1e9)
        self._on_sample(Sample(self.tick, self.epoch, now, now, b"", tuple(numbers), self.layout))


ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of the log topic: no message is lost, even if it was published before the subscription."""


class Rig:
    """Bridge, fake link and a user node on one executor."""

    def __init__(self, **parameters: Any) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.executor = EventsExecutor(context=self.context)
        self.links: list[FakeLink] = []
        self.messages: dict[str, list[Any]] = {}
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        try:
            self.bridge = ServoBridge(
                self.executor.create_task,
                link_factory=self._make_link,
                context=self.context,
                parameter_overrides=overrides,
            )
        except BaseException:
            rclpy.shutdown(context=self.context)
            raise
        self.user = Node("user", namespace="servo", context=self.context)
        for name, kind in (
            (topics.JOINT_STATES, JointState),
            (topics.SNAPSHOT, Float64MultiArray),
            (topics.COMMANDS_APPLIED, Int64MultiArray),
            (topics.DIAGNOSTICS, DiagnosticArray),
            (f"var/{parameters.get('joints', ['axis1'])[0]}/i_q", Float64),
        ):
            self.listen(name, kind, telemetry_qos(1000))
        self.listen("/rosout", Log, ROSOUT)
        self.listen(topics.PARAMETERS, Float64MultiArray, latched_qos())
        self.listen(topics.ROBOT_DESCRIPTION, String, latched_qos())
        self.listen(topics.STATE, String, latched_qos())
        self.listen(topics.LINK, DiagnosticStatus, latched_qos())
        self.listen(topics.ARMED, Bool, latched_qos())
        qos = command_qos()
        self.joint_commands = self.user.create_publisher(JointState, topics.JOINT_COMMANDS, qos)
        self.commands = self.user.create_publisher(Float64MultiArray, topics.COMMANDS, qos)
        self.position = self.user.create_publisher(Float64, "axis2/position", qos)
        self.enable_client = self.user.create_client(SetBool, topics.ENABLE)
        self.quick_stop_client = self.user.create_client(Trigger, topics.QUICK_STOP)
        self.clear_client = self.user.create_client(Trigger, topics.CLEAR_FAULTS)
        self.executor.add_node(self.bridge)
        self.executor.add_node(self.user)
        if self.bridge.supervisor is not None:
            try:
                self.discover()
            except BaseException:
                self.__exit__()
                raise

    @property
    def link(self) -> FakeLink:
        return self.links[-1]

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *_: object) -> None:
        # The events executor keeps references to its nodes; the next test would discover remaining nodes.
        self.executor.remove_node(self.bridge)
        self.executor.remove_node(self.user)
        self.bridge.shutdown()
        self.user.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)

    def _make_link(self, config: LinkConfig, catalogue: Catalogue, **callbacks: Any) -> FakeLink:
        self.links.append(FakeLink(config, catalogue, **callbacks))
        return self.links[-1]

    def listen(self, name: str, kind: Any, qos: Any) -> None:
        """Collect the messages of a topic."""
        self.messages[name] = []
        self.user.create_subscription(kind, name, self.messages[name].append, qos)

    def discover(self) -> None:
        """Wait until bridge and user have found each other's topics and services."""
        self.until(self._matched, 20.0)

    def _matched(self) -> bool:
        publishers = (self.joint_commands, self.commands, self.position)
        clients = (self.enable_client, self.quick_stop_client, self.clear_client)
        return (
            all(p.get_subscription_count() for p in publishers)
            and all(c.service_is_ready() for c in clients)
            and all(self.user.count_publishers(name) for name in self.messages)
            and bool(self.messages[topics.STATE] and self.messages[topics.ARMED])
        )

    # ---- steps
    def until(self, condition: Callable[[], object], timeout: float = 45.0) -> None:
        """Spin the executor until the condition holds; fail after `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f"not within {timeout} s"
            self.executor.spin_once(timeout_sec=0.01)

    def until_sampled(self, condition: Callable[[], object]) -> None:
        """Deliver samples until the condition holds."""

        def sampled() -> object:
            self.link.sample()
            return condition()

        self.until(sampled)

    @contextlib.contextmanager
    def samples(self, before_sample: Callable[[], None] = lambda: None) -> Iterator[None]:
        """Deliver samples from a thread, each after `before_sample`; the main thread can run a ROS program."""
        stop = threading.Event()

        def run() -> None:
            due = 0.0
            while not stop.is_set():
                if self.link.connected and time.monotonic() >= due:
                    before_sample()
                    self.link.sample()
                    due = time.monotonic() + 0.005
                self.executor.spin_once(timeout_sec=0.005)

        board = threading.Thread(target=run)
        board.start()
        try:
            yield
        finally:
            stop.set()
            board.join()

    def wait_for_pending(self) -> None:
        """Wait for all pending messages, by set-points that are refused."""
        before = len(self.rejections())
        self.joint_commands.publish(JointState(name=["marker"], position=[0.0]))
        self.commands.publish(Float64MultiArray(data=[0.0] * 9))
        self.position.publish(Float64(data=float("nan")))
        self.until(lambda: len(self.rejections()) >= before + 3)

    def connect(self, *states: tuple[int, int]) -> None:
        """Connect the link and deliver one sample."""
        self.link.set_states(*(states or (STOP, STOP)))
        supervisor = self.bridge.supervisor
        assert supervisor is not None
        before = supervisor._snapshot
        self.link.connect()
        self.link.sample()
        self.until(lambda: self.messages[topics.LINK] and self.messages[topics.LINK][-1].level == DiagnosticStatus.OK)
        self.until(lambda: supervisor._snapshot is not before)
        published = supervisor.parts.publications
        self.until(lambda: self.messages[topics.STATE] and self.state() == published._last_state)

    def enable_axes(self) -> None:
        """Connect and enable, with both axes in RUN/SPIN."""
        self.connect(SPIN, SPIN)
        assert self.enable(True)[0]
        self.until(self.armed)
        self.link.written.clear()

    def call(self, client: Any, request: Any) -> Any:
        """Call a service and deliver samples until it answers; after 50 samples in larger steps, for time-outs."""
        future = client.call_async(request)
        calls = itertools.count()

        def answered() -> bool:
            if self.link.connected:
                self.link.sample(16 if next(calls) < 50 else 1600)
            return bool(future.done())

        self.until(answered)
        response = future.result()
        return response.success, response.message

    def enable(self, on: bool) -> Any:
        return self.call(self.enable_client, SetBool.Request(data=on))

    def quick_stop(self) -> Any:
        return self.call(self.quick_stop_client, Trigger.Request())

    def clear_faults(self) -> Any:
        return self.call(self.clear_client, Trigger.Request())

    # ---- received messages
    def state(self) -> str:
        return str(self.messages[topics.STATE][-1].data)

    def armed(self) -> bool:
        return bool(self.messages[topics.ARMED][-1].data)

    def logs(self, level: int = Log.WARN) -> list[str]:
        return [m.msg for m in self.messages["/rosout"] if m.name == "servo.servo_bridge" and m.level >= level]

    def accepted(self) -> int:
        """Number of accepted set-points."""
        assert self.bridge.supervisor is not None
        return self.bridge.supervisor.parts.commands.figures.accepted

    def was_rejected(self, name: str) -> bool:
        """True if the last rejection, logged or not, is of this joint."""
        assert self.bridge.supervisor is not None
        return f"'{name}'" in self.bridge.supervisor.parts.commands.figures.last_rejection

    def rejections(self) -> list[str]:
        return [text for text in self.logs() if text.startswith("rejected")]

    def warnings(self, beginning: str) -> list[str]:
        return [text for text in self.logs() if text.startswith(beginning)]

    def until_rejected(self, before: int) -> None:
        """Wait for more than `before` rejections."""
        self.until(lambda: len(self.rejections()) > before)

    def applied(self) -> list[Any]:
        return [applied_from_message(m) for m in self.messages[topics.COMMANDS_APPLIED]]

    def snapshots(self) -> list[dict[str, float]]:
        tables = (snapshot_table(m) for m in self.messages[topics.SNAPSHOT])
        return [dict(zip(names, row, strict=True)) for names, table in tables for row in table.tolist()]

    def parameters(self) -> dict[str, list[int]]:
        """Last published parameters, raw."""
        messages = self.messages[topics.PARAMETERS]
        return parameters_from_message(messages[-1], self.link.catalogue) if messages else {}

    def set_parameter(self, name: str, value: Any) -> tuple[bool, str]:
        """Set a parameter of the bridge, like ``ros2 param set``."""
        client = self.user.create_client(SetParameters, "servo_bridge/set_parameters")
        self.until(client.service_is_ready)
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        future = client.call_async(request)
        self.until(future.done)
        result = future.result().results[0]
        return result.successful, result.reason

    def diagnosis(self, part: str) -> Any:
        """Diagnostic status of one part after the periodic update."""
        assert self.bridge.supervisor is not None
        begun = self.bridge.get_clock().now()
        self.bridge.supervisor._every_second()
        found = self.messages[topics.DIAGNOSTICS]
        # A message of the timer may still be on the way.
        self.until(lambda: found and Time.from_msg(found[-1].header.stamp) >= begun)
        return next(s for s in found[-1].status if s.name == f"servo/servo_bridge: {part}")
