"""Test fixture: virtual board, bridge and twin as processes, a detachable serial cable, and a ROS client."""

from __future__ import annotations

import contextlib
import io
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import pytest
import rclpy
import serial
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from servo_msgs_py.convert import AppliedCommand, applied_from_message, snapshot_table
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.qos import command_qos, latched_qos, telemetry_qos
from servo_msgs_py.runtime.ros_arguments import parameter_arguments
from servo_msgs_py.units import PERIOD_NS
from servo_twin.level import LEVEL_VARIABLE, Level, chosen_level
from std_msgs.msg import Bool, Float64, Float64MultiArray, Int64MultiArray, String
from std_srvs.srv import SetBool, Trigger

from servo_bridge import tool

DOMAIN = int(os.environ.get("ROS_DOMAIN_ID", "0")) or 1 + os.getpid() * 37 % 100
MARK_VARIABLE = "SERVO_TEST_MARK"
PATIENCE = 45.0
"""Time after which a wait fails [s]: a test that hangs. What must happen in time is asserted in board time."""
FAST_BAUD = 1_000_000
"""Baud rate of tests that are independent of the line speed: reading the variable table takes 0.5 s, not 2.5 s."""
BOARD, BRIDGE, TWIN = "servo_twin.virtual_board", "servo_bridge.node", "servo_twin.node"


class Process:
    """Child process with its output in a file."""

    def __init__(self, name: str, command: Sequence[str], log: Path, environment: Mapping[str, str]) -> None:
        self.name = name
        self.log = log
        with log.open("wb") as output:
            self._popen = subprocess.Popen(
                with_parent_death_signal(command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=dict(environment),
                start_new_session=True,
            )

    @property
    def running(self) -> bool:
        return self._popen.poll() is None

    def cpu_seconds(self) -> float:
        """CPU time of all threads of the process [s]."""
        # proc(5): the name in parentheses may hold blanks; utime and stime are fields 14 and 15.
        fields = Path(f"/proc/{self._popen.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def text(self) -> str:
        return self.log.read_text(errors="replace")

    def send(self, number: int) -> None:
        self._popen.send_signal(number)

    def stop(self, number: int = signal.SIGINT, timeout: float = 10.0) -> int:
        """Send a signal and return the exit status."""
        if self.running:
            self.send(number)
        return self._popen.wait(timeout)

    def kill(self) -> None:
        if self.running:
            self._popen.kill()
            self._popen.wait()


class Cable:
    """Serial cable between a port and a TCP address, with `pull` and `plug`."""

    def __init__(self, port: Path) -> None:
        self._port = port
        self._address: tuple[str, int] = ("127.0.0.1", 0)
        self._stop: threading.Event | None = None
        self._thread: threading.Thread | None = None
        self.plug()

    @property
    def url(self) -> str:
        return f"socket://127.0.0.1:{self._address[1]}"

    def plug(self) -> None:
        """Connect both ends."""
        listener = socket.create_server(self._address)
        self._address = listener.getsockname()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry, args=(listener, self._stop), daemon=True)
        self._thread.start()

    def pull(self) -> None:
        """Close both connections."""
        if self._stop is not None and self._thread is not None:
            self._stop.set()
            self._thread.join(5.0)
            self._stop = None

    def _carry(self, listener: socket.socket, stop: threading.Event) -> None:
        with listener, serial.Serial(str(self._port), 115200, timeout=0, exclusive=True) as board:
            while not stop.is_set():
                if not select.select([listener], [], [], 0.05)[0]:
                    continue
                host, _ = listener.accept()
                host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                with host, contextlib.suppress(OSError):
                    self._pump(host, board, stop)

    @staticmethod
    def _pump(host: socket.socket, board: Any, stop: threading.Event) -> None:
        while not stop.is_set():
            ready, _, _ = select.select([host, board], [], [], 0.05)
            if host in ready:
                data = host.recv(4096)
                if not data:
                    return
                board.write(data)
            if board in ready:
                host.sendall(board.read(4096))


class Chain:
    """Virtual board, bridge and twin as processes that are started and stopped one by one.

    Parameters
    ----------
    folder : Path
        Folder of the port and the logs.
    baud : int
        Line speed [bit/s].
    environment : mapping, optional
        Environment variables of the processes, in addition to those of this process.
    level : {"ideal", "registers"}, optional
        Level of boards and twins; default: `chosen_level`. `ideal` takes a fifth of the CPU time.
    """

    def __init__(
        self,
        folder: Path,
        baud: int = 115200,
        environment: Mapping[str, str] | None = None,
        level: Level | None = None,
    ) -> None:
        self.folder = folder
        self.port = folder / "board"
        self.baud = baud
        self._mark = uuid.uuid4().hex
        self._started: list[Process] = []
        level = level or chosen_level()
        own = {"ROS_DOMAIN_ID": str(DOMAIN), MARK_VARIABLE: self._mark, "PYTHONUNBUFFERED": "1", LEVEL_VARIABLE: level}
        #: Environment of every process.
        self.environment = os.environ | own | dict(environment or {})

    def _start(self, module: str, *arguments: str) -> Process:
        return self._launch(module, [sys.executable, "-m", module, *arguments])

    def _launch(self, name: str, command: Sequence[str]) -> Process:
        process = Process(name, command, self.folder / f"{len(self._started)}-{name}.log", self.environment)
        self._started.append(process)
        return process

    def script(self, name: str, *arguments: str) -> Process:
        """Start a console script of the running Python environment; skip the test if it is not installed."""
        path = Path(sys.executable).with_name(name)
        if not path.exists():
            pytest.skip(f"{name} is not installed next to {sys.executable}")
        return self._launch(name, [str(path), *arguments])

    def board(self, seed: int = 5, flash: Path | None = None, options: Sequence[str] = ()) -> Process:
        """Start a board, with more options of ``virtual_board``, and wait for its port."""
        options = ["--link", str(self.port), "--baud", str(self.baud), "--seed", str(seed), *options]
        options += ["--flash", str(flash)] if flash else []
        board = self._start(BOARD, *options)
        wait_for(self.port.exists, 10.0, board.text)
        return board

    def bridge(self, port: str | None = None, *, hangs: float = 0.0, **parameters: object) -> Process:
        """Start a bridge; SIGUSR1 blocks its executor, not its link thread, for `hangs` [s], SIGUSR2 for a quarter."""
        arguments = parameter_arguments(port=port or self.port, baud=self.baud, **parameters)
        if not hangs:
            return self._start(BRIDGE, *arguments)
        # Signal handlers run in the main thread, which runs the executor.
        code = (
            "import runpy, signal, time; "
            f"signal.signal(signal.SIGUSR1, lambda *_: time.sleep({hangs})); "
            f"signal.signal(signal.SIGUSR2, lambda *_: time.sleep({hangs / 4.0})); "
            f"runpy.run_module({BRIDGE!r}, run_name='__main__')"
        )
        return self._launch(BRIDGE, [sys.executable, "-c", code, *arguments])

    def twin(self, **parameters: object) -> Process:
        return self._start(TWIN, *parameter_arguments(**parameters))

    def processes(self) -> dict[int, str]:
        """Command lines by process id of all running processes started here, with their descendants."""
        mark = f"{MARK_VARIABLE}={self._mark}".encode()
        found = {}
        for folder in Path("/proc").iterdir():
            if folder.name.isdigit():
                with contextlib.suppress(OSError):
                    if mark in (folder / "environ").read_bytes().split(b"\0"):
                        found[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        return found

    def read_variables(self, *names: str) -> dict[str, Any]:
        """Values of variables, read by ``servo-tool``; the bridge must not be running."""
        values: dict[str, Any] = json.loads(self.tool("get", "--json", *names))
        return values

    def tool(self, *arguments: str) -> str:
        """Output of a ``servo-tool`` command, run in this process; the bridge must not be running."""
        output, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            status = tool.main(["--port", str(self.port), "--baud", str(self.baud), *arguments])
        assert status == 0, output.getvalue() + errors.getvalue()
        return output.getvalue()

    def end(self) -> None:
        """Stop all running processes, the last one first."""
        for process in reversed(self._started):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.stop(signal.SIGTERM, 5.0)
            process.kill()

    def logs(self) -> str:
        return "\n".join(f"---- {p.name}\n{p.text()}" for p in self._started)


class User:
    """ROS node with the topics and services of the servo."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.executor = EventsExecutor(context=self.context)
        self.node = Node("user", context=self.context)
        self.messages: dict[str, list[Any]] = {}
        deep, latched = telemetry_qos(1000), latched_qos()
        for name, kind, qos in (
            ("/servo/joint_states", JointState, deep),
            ("/servo/snapshot", Float64MultiArray, deep),
            ("/servo/commands_applied", Int64MultiArray, deep),
            ("/servo/state", String, latched),
            ("/servo/link", DiagnosticStatus, latched),
            ("/servo/armed", Bool, latched),
            ("/twin/joint_states", JointState, deep),
            ("/twin/residual", JointState, deep),
            ("/twin/state", String, latched),
            ("/twin/healthy", Bool, latched),
            ("/diagnostics", DiagnosticArray, deep),
            ("/rosout", Log, deep),
        ):
            self.listen(name, kind, qos)
        qos = command_qos()
        self.joint_commands = self.node.create_publisher(JointState, "/servo/joint_commands", qos)
        self.commands = self.node.create_publisher(Float64MultiArray, "/servo/commands", qos)
        self.position = [self.node.create_publisher(Float64, f"/servo/axis{n}/position", qos) for n in (1, 2)]
        self._enable = self.node.create_client(SetBool, "/servo/enable")
        self._quick_stop = self.node.create_client(Trigger, "/servo/quick_stop")
        self._clear = self.node.create_client(Trigger, "/servo/clear_faults")
        self._set_parameters = self.node.create_client(SetParameters, "/servo/servo_bridge/set_parameters")
        self.executor.add_node(self.node)

    def listen(self, name: str, kind: Any, qos: Any) -> None:
        """Collect the messages of a topic."""
        self.messages[name] = []
        self.node.create_subscription(kind, name, self.messages[name].append, qos)

    def close(self) -> None:
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self.executor.shutdown()
        rclpy.shutdown(context=self.context)

    # ---- actions
    def until(self, condition: Callable[[], object], timeout: float = PATIENCE, what: str = "") -> None:
        """Spin the executor until the condition holds; fail after `timeout` [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, f"{what or 'not'} within {timeout} s: {self.states()}"
            self.executor.spin_once(timeout_sec=0.01)

    def matched(self) -> bool:
        """True if all topics and services of the bridge are discovered."""
        publishers = (self.joint_commands, self.commands, *self.position)
        clients = (self._enable, self._quick_stop, self._clear)
        return all(p.get_subscription_count() for p in publishers) and all(c.service_is_ready() for c in clients)

    def connected(self) -> bool:
        """True if the bridge is discovered and connected to its board."""
        return self.matched() and self.link_level() == DiagnosticStatus.OK

    def link_level(self) -> bytes:
        """Level of the last message on whether a board is connected; STALE before the first one."""
        levels = [message.level for message in self.messages["/servo/link"][-1:]]
        return bytes(levels[0]) if levels else DiagnosticStatus.STALE

    def call(self, client: Any, request: Any) -> tuple[bool, str]:
        future = client.call_async(request)
        self.until(future.done, what="the service does not answer")
        return bool(future.result().success), str(future.result().message)

    def enable(self, on: bool = True) -> tuple[bool, str]:
        return self.call(self._enable, SetBool.Request(data=on))

    def quick_stop(self) -> tuple[bool, str]:
        return self.call(self._quick_stop, Trigger.Request())

    def clear_faults(self) -> tuple[bool, str]:
        return self.call(self._clear, Trigger.Request())

    def set_board_parameters(self, *texts: str) -> tuple[bool, str]:
        """Set ``board_parameters`` of the bridge, as ``ros2 param set`` does."""
        parameter = Parameter("board_parameters", value=list(texts)).to_parameter_msg()
        future = self._set_parameters.call_async(SetParameters.Request(parameters=[parameter]))
        self.until(future.done, what="the service does not answer")
        result = future.result().results[0]
        return bool(result.successful), str(result.reason)

    def enable_axes(self) -> None:
        """Enable both axes and wait until they are armed."""
        success, message = self.enable()
        assert success, message
        self.until(lambda: self.last("/servo/armed") is True, what="not armed")

    # ---- received messages
    def last(self, name: str) -> Any:
        return self.messages[name][-1].data if self.messages[name] else ""

    def states(self) -> dict[str, Any]:
        return {name: self.last(name) for name in ("/servo/state", "/servo/armed", "/twin/state", "/twin/healthy")}

    def position_of(self, axis: int) -> float:
        """Position of an axis [rad]."""
        return float(self.messages["/servo/joint_states"][-1].position[axis])

    def rows(self, start: int = 0) -> list[dict[str, float]]:
        """Telemetry rows of all snapshot messages from number `start` on."""
        return [row for message in self.messages["/servo/snapshot"][start:] for row in rows_of(message)]

    def applied(self) -> list[AppliedCommand]:
        """Commands that have taken effect since the start, in order."""
        return [applied_from_message(m) for m in self.messages["/servo/commands_applied"]]

    def wait_board_time(self, duration: float) -> int:
        """Wait for `duration` of board time [s]; return the index of its first snapshot message."""
        start = len(self.messages["/servo/snapshot"])

        def passed() -> bool:
            messages = self.messages["/servo/snapshot"][start:]
            return bool(messages) and board_time(messages[-1]) - board_time(messages[0]) >= duration

        self.until(passed, duration + PATIENCE)
        return start

    def rejections(self) -> list[str]:
        """Log messages of the bridge about refused set-points."""
        return [m.msg for m in self.messages["/rosout"] if m.msg.startswith("rejected")]

    def until_rejected(self, before: int) -> str:
        """Wait for more than `before` rejections and return the last one."""
        self.until(lambda: len(self.rejections()) > before, what="not refused")
        return self.rejections()[-1]

    def status(self, name: str) -> DiagnosticStatus:
        found = [s for m in self.messages["/diagnostics"] for s in m.status if s.name == name]
        return found[-1] if found else DiagnosticStatus(message="no diagnostics yet")


def rows_of(message: Float64MultiArray) -> list[dict[str, float]]:
    """Rows of a snapshot message, by column name."""
    names, table = snapshot_table(message)
    return [dict(zip(names, row, strict=True)) for row in table.tolist()]


def board_time(message: Float64MultiArray) -> float:
    """Time of the first row of a snapshot message since the reset of the board [s]."""
    return float(message.data[0]) * PERIOD_NS * 1e-9


def wait_for(condition: Callable[[], object], timeout: float, why: Callable[[], str] = str) -> None:
    """Poll a condition until it holds; fail after `timeout` [s]."""
    deadline = time.monotonic() + timeout
    pause = threading.Event()
    while not condition():
        assert time.monotonic() < deadline, f"not within {timeout} s: {why()}"
        pause.wait(0.02)


@contextlib.contextmanager
def ros_user() -> Iterator[User]:
    result = User()
    try:
        yield result
    finally:
        result.close()


@contextlib.contextmanager
def followed_board(
    folder: Path, baud: int = 115200, level: Level | None = None, telemetry_rate: float = 0.0
) -> Iterator[User]:
    """ROS client of a virtual board, its bridge and its twin, when the twin is healthy."""
    chain = Chain(folder, baud, level=level)
    with ros_user() as user:
        try:
            chain.board()
            chain.bridge(telemetry_rate=telemetry_rate)
            chain.twin()
            user.until(user.connected, what="the bridge is not connected")
            user.until(lambda: user.last("/twin/healthy") is True, what="the twin is not healthy")
            yield user
        finally:
            chain.end()
            print(chain.logs())
