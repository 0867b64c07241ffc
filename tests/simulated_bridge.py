"""Test fixture: the bridge and the firmware in simulated time, without threads, ROS or a port.

Real are the supervisor of the bridge with everything below it, the link with its protocol, the serial server of the
firmware and the firmware. Replaced are the node of rclpy (`SimulatedNode`), the thread of the link, which runs as the
main loop here, and the clock. Whatever else happens is an event at a simulated time, also while the link waits for the
board.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace
from typing import Any, Final, cast
from unittest import mock

from rclpy.node import Node
from rclpy.serialization import serialize_message
from servo_bridge.callback_watch import CallbackWatch
from servo_bridge.freemaster.line import Line
from servo_bridge.parameters import PARAMETERS, settings_from
from servo_bridge.runs.message_tap import MessageTap
from servo_bridge.supervisor import Supervisor
from servo_bridge.trajectory.follower import Follower
from servo_bridge.wire.board_clock import WallClock
from servo_bridge.wire.link import FinalWrite, Link
from servo_bridge.wire.link_queue import Job, JobQueue
from servo_bridge.wire.serial_port import LowLatency
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_twin.board import Board

LOG_NS: Final = 4_000_000
"""Period of the log of both shafts [ns]."""

START_NS: Final = 1_000_000_000
"""Steady clock of the host at the begin [ns]."""

WALL_NS: Final = 1_700_000_000_000_000_000
"""ROS time at steady time 0 [ns]."""

_WAIT_NS: Final = 2_000_000
"""Largest step while the link waits for the board [ns]."""

_PIECE_NS: Final = 1_000_000
"""Time for which an adapter collects received bytes [ns]."""

CATALOGUE: Final = Catalogue.load()

_ASSEMBLY: Final = "servo_bridge.assembly"
_LINK: Final = "servo_bridge.wire.link"


class _EndError(BaseException):
    """Ends the main loop of the link, as a kill of the process."""


@dataclass
class Row:
    """True state of the shafts."""

    time: float  # since the begin of the simulation [s]
    epoch: int  # number of restarts of the board
    theta: tuple[float, ...]  # angles of the motors [rad]
    omega: tuple[float, ...]  # speeds of the motors [rad/s]


class World:
    """A board, its line and the events around it, in simulated time."""

    def __init__(self, *, baud: int, seed: int) -> None:
        self.baud, self._seed = baud, seed
        self.log: list[Row] = []
        self.epoch = 0
        self._order = itertools.count()
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self.now_ns = self._origin_ns = START_NS  # steady clock of the host, and at the start of the board [ns]
        self._silent_until_ns = 0
        self.board = self._new_board()

    def _new_board(self) -> Board:
        return Board(level="ideal", baud=float(self.baud), seed=self._seed, catalogue=CATALOGUE)

    def restart_board(self) -> None:
        """Switch the board off and on; its shafts are at rest at angle 0 then."""
        self.board.close()
        self.board = self._new_board()
        self._origin_ns = self.now_ns
        self.epoch += 1

    def close(self) -> None:
        self.board.close()

    # ---- time
    def at(self, time_ns: int, event: Callable[[], None]) -> None:
        """Call a function at a time [ns]."""
        heapq.heappush(self._events, (time_ns, next(self._order), event))

    def advance(self, until_ns: int) -> None:
        """Advance to a time [ns], with the events until then."""
        while True:
            now = self.now_ns
            if self._events and self._events[0][0] <= now:
                heapq.heappop(self._events)[2]()
                continue
            if now >= until_ns:
                return
            following = min(until_ns, (now // LOG_NS + 1) * LOG_NS)
            if self._events:
                following = min(following, self._events[0][0])
            self.board.advance(following - self._origin_ns)
            self.now_ns = following
            if following % LOG_NS == 0:
                self.log.append(Row((following - START_NS) * 1e-9, self.epoch, *self.shafts()))

    def shafts(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Present angles [rad] and speeds [rad/s] of the motors."""
        truths = [self.board.truth(axis) for axis in range(AXES)]
        return tuple(truth.theta_m for truth in truths), tuple(truth.omega_m for truth in truths)

    def stall(self, seconds: float) -> None:
        """Pass no bytes to the computer for a time [s]."""
        self._silent_until_ns = self.now_ns + round(seconds * 1e9)

    # ---- port
    low_latency = LowLatency(None, "simulated")

    def write(self, data: bytes) -> None:
        while data:
            data = data[self.board.serial_in(data) :]
            if data:
                self.advance(self.now_ns + _WAIT_NS)

    def read(self, deadline: int) -> bytes:
        while True:
            now = self.now_ns
            data = self.board.serial_out() if now >= self._silent_until_ns else b""
            if data:
                return data
            if now >= deadline:
                return b""
            following = self.board.serial_next_ns()
            step = now + _WAIT_NS if following is None else max(following + self._origin_ns, now + _PIECE_NS)
            self.advance(min(deadline, step))


class _Port:
    """Port of a link."""

    low_latency = World.low_latency

    def __init__(self, world: World) -> None:
        self.write, self.read = world.write, world.read

    def close(self) -> None:
        """The cable stays connected."""


class _Queue(JobQueue):
    """Queue whose waiting advances the simulated time."""

    def __init__(self, limit: int, world: World) -> None:
        super().__init__(limit)
        self._world = world

    def take(self, timeout: float) -> Job | None:
        end = self._world.now_ns + round(timeout * 1e9)
        while (job := super().take(0.0)) is None and (now := self._world.now_ns) < end:
            self._world.advance(min(end, now + _WAIT_NS))
        return job


class _Stop:
    """Event of the end of the link; waiting advances the simulated time."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._set = False

    def is_set(self) -> bool:
        return self._set

    def set(self) -> None:
        self._set = True

    def wait(self, timeout: float) -> bool:
        self._world.advance(self._world.now_ns + round(timeout * 1e9))
        return self._set


class SimulatedLink(Link):
    """Link whose loop is called by the simulation instead of a thread."""

    def __init__(self, world: World, *args: Any, **arguments: Any) -> None:
        super().__init__(*args, open_port=lambda _url, _baud: _Port(world), **arguments)
        self._queue = _Queue(self._config.queue_limit, world)
        self._stop = _Stop(world)  # type: ignore[assignment]

    def start(self) -> None:
        """The simulation calls `run`."""

    def run(self) -> None:
        """Communicate until the simulation ends it."""
        self._run()

    def close(self, final_writes: Sequence[FinalWrite] = (), timeout: float = 3.0) -> bool:
        """Write the last values."""
        del timeout
        if self._session is not None:
            self._final_writes = final_writes
            self._write_last(self._session)
        return self._final_done


class _Timer:
    """Timer of a node."""

    def __init__(self, world: World, period: float, callback: Callable[[], None]) -> None:
        self._world, self._callback = world, callback
        self.timer_period_ns = round(period * 1e9)
        self._started = 0
        self.reset()

    def reset(self) -> None:
        self._started += 1
        self._world.at(self._world.now_ns + self.timer_period_ns, partial(self._fire, self._started))

    def cancel(self) -> None:
        self._started += 1

    def _fire(self, number: int) -> None:
        if number == self._started:
            self._world.at(self._world.now_ns + self.timer_period_ns, partial(self._fire, number))
            self._callback()


@dataclass
class _Publisher:
    node: SimulatedNode
    topic: str

    def publish(self, message: Any) -> None:
        self.node.published(self.topic, message)


@dataclass
class _Service:
    """Service of a node; `send_response` is replaced by the bridge."""

    callback: Callable[[Any, Any], Any]
    answers: dict[int, Future[Any]] = field(default_factory=dict)

    def send_response(self, response: Any, header: int) -> None:
        self.answers.pop(header).set_result(response)


class _Logger:
    """Collects log messages."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.lines: list[tuple[float, str, str]] = []  # time [s], level, text

    def _log(self, level: str, text: str) -> None:
        self.lines.append((round((self._world.now_ns - START_NS) * 1e-9, 3), level, text))

    def __getattr__(self, level: str) -> Callable[[str], None]:
        if level not in ("debug", "info", "warning", "error"):
            raise AttributeError(level)
        return partial(self._log, level)


class SimulatedNode:
    """The part of an rclpy node that the bridge uses; messages are passed as objects, at once."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.subscriptions: dict[str, Callable[[Any], None]] = {}
        self.services: dict[str, _Service] = {}
        self.timers: list[_Timer] = []
        self.listeners: dict[str, Callable[[Any], None]] = {}
        self.logger = _Logger(world)
        self.alive = True

    # ---- interface to the bridge
    def get_fully_qualified_name(self) -> str:
        return "/servo/servo_bridge"

    def resolve_topic_name(self, name: str) -> str:
        return f"/servo/{name}"

    def get_publishers_info_by_topic(self, _name: str) -> list[Any]:
        return []

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=PARAMETERS[name].default)

    def get_logger(self) -> _Logger:
        return self.logger

    def get_clock(self) -> Any:
        return SimpleNamespace(
            now=lambda: SimpleNamespace(nanoseconds=self._world.now_ns + WALL_NS), ros_time_is_active=False
        )

    def create_publisher(self, _kind: Any, name: str, _qos: Any) -> _Publisher:
        return _Publisher(self, name)

    def create_subscription(
        self, _kind: Any, name: str, callback: Callable[[Any], None], _qos: Any, raw: bool = False, **_: Any
    ) -> None:
        self.subscriptions[name] = (lambda message: callback(serialize_message(message))) if raw else callback

    def create_service(self, kind: Any, name: str, callback: Callable[[Any, Any], Any]) -> _Service:
        del kind
        self.services[name] = _Service(callback)
        return self.services[name]

    def create_timer(self, period: float, callback: Callable[[], None], clock: Any = None) -> _Timer:
        del clock
        self.timers.append(_Timer(self._world, period, callback))
        return self.timers[-1]

    # ---- interface to the simulation
    def published(self, topic: str, message: Any) -> None:
        if self.alive and topic in self.listeners:
            self.listeners[topic](message)

    def send(self, topic: str, message: Any) -> None:
        """Deliver a message to the bridge."""
        if self.alive:
            self.subscriptions[topic](message)

    def call(self, name: str, kind: Any, request: Any) -> Future[Any]:
        """Call a service."""
        service, answer = self.services[name], Future[Any]()
        service.answers[id(answer)] = answer
        service.send_response(service.callback(request, kind.Response()), id(answer))
        return answer

    def end(self) -> None:
        """End the node without a word."""
        self.alive = False
        for timer in self.timers:
            timer.cancel()


def _nothing() -> None:
    """No action interfaces are installed."""


class BridgeSimulation:
    """A bridge connected to a board, in simulated time; use as a context.

    Parameters
    ----------
    baud : int
        Line speed [bit/s].
    seed : int
        Seed of the board.
    parameters : keyword arguments
        Parameters of the bridge.
    """

    def __init__(self, *, baud: int = 1_000_000, seed: int = 7, **parameters: Any) -> None:
        self.world = World(baud=baud, seed=seed)
        self.listeners: dict[str, Callable[[Any], None]] = {}
        self.rejected: list[str] = []
        values = {name: spec.default for name, spec in PARAMETERS.items() if name != "autostart"}
        self._settings = settings_from({**values, "baud": baud, **parameters}, CATALOGUE)
        self._context = contextlib.ExitStack()
        self._links: list[SimulatedLink] = []
        self.node: SimulatedNode
        self.supervisor: Supervisor

    def __enter__(self) -> BridgeSimulation:
        clock_ns = self._clock_ns
        steady = SimpleNamespace(monotonic_ns=clock_ns, monotonic=self._clock)
        for name, module in list(sys.modules.items()):
            if name.startswith("servo_bridge.") and getattr(module, "time", None) is time:
                self._replace(name, "time", steady)
        self._replace(_LINK, "Line", partial(Line, clock=clock_ns))
        self._replace("servo_bridge.sample_clocks", "WallClock", partial(WallClock, steady=clock_ns))
        self._replace(_ASSEMBLY, "Follower", partial(Follower, clock=steady.monotonic))
        self._replace(_ASSEMBLY, "action_interfaces", _nothing)
        self._replace(_ASSEMBLY, "BoardRequests", mock.MagicMock())  # it has a thread
        self.start_bridge()
        return self

    def _replace(self, module: str, name: str, value: object) -> None:
        self._context.enter_context(mock.patch(f"{module}.{name}", value))

    def _clock_ns(self) -> int:
        return self.world.now_ns

    def _clock(self) -> float:
        return self.world.now_ns * 1e-9

    def __exit__(self, *_: object) -> None:
        self._context.close()
        self.world.close()

    # ---- bridge
    def start_bridge(self) -> None:
        """Start a new process of the bridge."""
        self.node = SimulatedNode(self.world)
        self.node.listeners = self.listeners

        def make_link(*args: Any, **arguments: Any) -> SimulatedLink:
            self._links.append(SimulatedLink(self.world, *args, **arguments))
            return self._links[-1]

        self.supervisor = Supervisor(
            cast(Node, self.node),
            CATALOGUE,
            self._settings,
            lambda function: function(),
            make_link,
            CallbackWatch(self._clock, self._clock),
            MessageTap(),
        )
        self.supervisor.parts.arbiter.sources._clock = self._clock
        self.supervisor.activate()

    def kill_bridge(self) -> None:
        """End the process of the bridge at once."""
        self.node.end()

    # ---- time
    @property
    def now(self) -> float:
        """Time since the begin [s]."""
        return (self.world.now_ns - START_NS) * 1e-9

    def run(self, script: Iterator[float]) -> None:
        """Run a script: a generator of pauses [s]; it may restart the bridge between two of them."""
        ended = False

        def step() -> None:
            nonlocal ended
            node = self.node
            try:
                pause = next(script)
            except StopIteration:
                ended = True
                raise _EndError from None
            self.world.at(self.world.now_ns + round(pause * 1e9), step)
            if self.node is not node:
                raise _EndError

        self.world.at(self.world.now_ns, step)
        while not ended:
            with contextlib.suppress(_EndError):
                self._links[-1].run()
