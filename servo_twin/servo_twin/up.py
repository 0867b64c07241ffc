"""``servo-up``: starts virtual board, bridge, twin and viewer on one machine, without ROS launch.

Starts the processes in sequence, prints instructions, and runs until Ctrl-C. With ``--demo`` it runs ``servo-demo``,
which moves both axes, and saves a recording and a picture. At the end all child processes are stopped, the bridge,
which switches the outputs off, first.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final, NoReturn

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.ros_arguments import parameter_arguments

from servo_msgs_py import board_parameters
from servo_twin.level import LEVEL_VARIABLE, add_level_option, chosen_level
from servo_twin.processes import Child, ChildError, executable, stop_all, wait_until

_BOARD_TIMEOUT: Final = 10.0  # [s]
_CONNECT_TIMEOUT: Final = 15.0
_VIEWER_TIMEOUT: Final = 30.0  # the first start of the viewer reads many files
_DEMO_TIMEOUT: Final = 240.0
_INTERRUPTED: Final = 130
_DOMAIN_MAX: Final = 232  # higher domain ids exceed the range of UDP ports
_WARNING: Final = "virtual_board: warning:"
_URL: Final = re.compile(r"http://\S+")

_HOW_TO: Final = """
With ROS 2 (in another terminal{domain}):
  ros2 service call /servo/enable std_srvs/srv/SetBool "{{data: true}}"
  ros2 topic pub --once /servo/axis1/position std_msgs/msg/Float64 "{{data: 6.28}}"
  ros2 topic pub --once /servo/joint_commands sensor_msgs/msg/JointState \\
    "{{name: [axis1, axis2], position: [31.4, -31.4]}}"
  ros2 topic echo /servo/joint_states
Without:
  {command} enable
  {command} position axis1=6.28 axis2=-6.28
  {command} state
  {command} set param.speed_limit=100,100
  {command} disable
Ctrl-C ramps down, switches the outputs off and stops all processes."""


class _StopRequested(BaseException):
    """SIGINT, SIGTERM or SIGHUP; a BaseException, so that no library catches it as an error."""


class _Signals:
    """Converts SIGINT, SIGTERM and SIGHUP (closed terminal) to one `_StopRequested`; ignores them afterwards."""

    _NUMBERS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self._held = False
        self._requested = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        self._before = {number: signal.signal(number, self._request) for number in self._NUMBERS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _request(self, _signum: int, _frame: FrameType | None) -> None:
        for number in self._NUMBERS:
            signal.signal(number, signal.SIG_IGN)
        self._requested = True
        if not self._held:
            raise _StopRequested

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Delay a signal until the end of the block."""
        requested_before, self._held = self._requested, True
        try:
            yield
        finally:
            self._held = False
        if self._requested and not requested_before:
            raise _StopRequested


def _port(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("empty; give a device path or a pyserial URL, or omit the option")
    return text


def _domain(text: str) -> int:
    if not text.isdecimal() or int(text) > _DOMAIN_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is not a ROS domain (0 .. {_DOMAIN_MAX})")
    return int(text)


def _assignment(text: str) -> str:
    try:
        return board_parameters.parse(text, Catalogue.load()).text
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def parser() -> argparse.ArgumentParser:
    """Command line of ``servo-up``."""
    result = argparse.ArgumentParser(
        prog="servo-up", description="Start board, bridge, twin and viewer; run until Ctrl-C."
    )
    result.add_argument(
        "--port", type=_port, help="serial port or pyserial URL of a real board (default: a virtual board)"
    )
    result.add_argument("--baud", type=int, default=115200, help="line speed [bit/s] (default: %(default)s)")
    result.add_argument("--seed", type=int, default=1, help="seed of the virtual board (default: %(default)s)")
    result.add_argument("--plant", type=Path, help="plant file of the virtual board and of its twin")
    result.add_argument("--twin-plant", type=Path, help="plant file of the twin (default: --plant)")
    result.add_argument(
        "--thresholds", type=Path, help="threshold file of `servo_twin calibrate` for the diagnosis of the twin"
    )
    add_level_option(result, "virtual board and twin are")
    result.add_argument("--no-web", action="store_true", help="do not start the viewer in the browser")
    result.add_argument("--record", type=Path, help="record to this .rrd file")
    result.add_argument(
        "--domain-id", type=_domain, help="ROS domain (default: $ROS_DOMAIN_ID; with --demo a separate domain)"
    )
    result.add_argument(
        "--set",
        action="append",
        default=[],
        type=_assignment,
        metavar="NAME=VALUE",
        help="parameter of the board, such as param.i_q_limit=1.0,1.5; may be repeated",
    )
    result.add_argument("--demo", action="store_true", help="move both axes, save a recording and a picture, and exit")
    result.add_argument(
        "--out", type=Path, default=Path("out"), help="folder for logs and results (default: %(default)s)"
    )
    return result


class Stack:
    """The processes of one session, in a private folder for the virtual serial port.

    Parameters
    ----------
    out : Path
        Folder for the logs.
    environment : mapping
        Environment of all children.
    """

    def __init__(self, out: Path, environment: Mapping[str, str]) -> None:
        self._environment = environment
        self._log = out / "log"
        self._log.mkdir(parents=True, exist_ok=True)
        self.children: list[Child] = []
        self._warnings = 0

    def start(self, name: str, *arguments: str) -> Child:
        """Start an executable of this project.

        Raises
        ------
        ChildError
            If the executable cannot be started.
        """
        child = Child(name, [str(executable(name)), *arguments], self._log / f"{name}.log", self._environment)
        self.children.append(child)
        return child

    def wait(self, child: Child, text: str, timeout: float) -> bool:
        """Wait until a child has printed something; False after the timeout [s]."""
        return wait_until(lambda: text in child.text(), self.children, timeout)

    def print_warnings(self) -> None:
        """Print new warnings of the virtual board (machine too slow)."""
        texts = [child.text() for child in self.children if child.name == "virtual_board"]
        lines = [line for text in texts for line in text.splitlines() if line.startswith(_WARNING)]
        for line in lines[self._warnings :]:
            _print(line)
        self._warnings = max(self._warnings, len(lines))

    def stop(self) -> list[str]:
        """Stop the bridge, which switches the outputs off, then the others; returns the names of killed processes."""
        order = {"servo_bridge": 0, "servo_viewer": 1, "servo_twin": 2}
        killed = stop_all(sorted(self.children, key=lambda child: order.get(child.name, 3)))
        self.children.clear()
        return killed


def _print(text: str) -> None:
    print(text, flush=True)


def _refuse_second_bridge(environment: Mapping[str, str]) -> None:
    """Refuse a second bridge in a domain: both would execute every command.

    Raises
    ------
    ChildError
        If a servo is already running.
    """
    look = [str(executable("servo-command")), "--wait", "3", "state"]
    found = subprocess.run(look, env=dict(environment), capture_output=True, text=True, check=False)
    if found.returncode == 0:
        domain = environment.get("ROS_DOMAIN_ID", "0")
        raise ChildError(
            f"a servo is already running in ROS domain {domain} ({found.stdout.splitlines()[0]});"
            " stop it first, or choose another domain with --domain-id"
        )


def _virtual_board(stack: Stack, args: argparse.Namespace, folder: Path) -> str:
    link = folder / "board"
    plant = ["--plant", str(args.plant)] if args.plant else []
    _print(f"virtual board on {link}, {args.baud} baud, seed {args.seed}, level {chosen_level(args.level)}")
    stack.start("virtual_board", "--link", str(link), "--baud", str(args.baud), "--seed", str(args.seed), *plant)
    if not wait_until(link.exists, stack.children, _BOARD_TIMEOUT):
        raise ChildError(f"the virtual board did not create its port within {_BOARD_TIMEOUT:g} s")
    return str(link)


def _start_all(stack: Stack, args: argparse.Namespace, folder: Path, record: Path | None) -> None:
    """Start all processes and print their state.

    Raises
    ------
    ChildError
        If a child process fails.
    """
    port = args.port or _virtual_board(stack, args, folder)
    parameters = {"port": port, "baud": args.baud, "board_parameters": args.set or [""]}
    bridge = stack.start("servo_bridge", *parameter_arguments(**parameters))
    # The twin has the plant of the virtual board, but another seed: start angles and noise differ.
    files = {"plant": args.twin_plant or args.plant, "thresholds": args.thresholds}
    given = {name: path.absolute() for name, path in files.items() if path}
    twin = stack.start("servo_twin", *parameter_arguments(seed=args.seed + 1, **given))
    web = not (args.no_web or args.demo)
    viewer = None
    if web or record:
        viewer = stack.start("servo_viewer", *parameter_arguments(record=record or "", web=web))
    if stack.wait(bridge, "connected to", _CONNECT_TIMEOUT):
        _print(f"bridge connected to {port}")
    else:
        _print(f"bridge: no board on {port} yet, connection attempts continue. Last output:\n{bridge.last_output(3)}")
    _print(f"twin started (log: {twin.log})")
    if web and viewer is not None:
        found = wait_until(lambda: _URL.search(viewer.text()) is not None, stack.children, _VIEWER_TIMEOUT)
        match = _URL.search(viewer.text())
        _print(f"viewer: {match.group(0) if found and match else 'not started yet, see ' + str(viewer.log)}")
    if record:
        _print(f"recording to {record}")


def _wait_for_stop(stack: Stack, args: argparse.Namespace) -> NoReturn:
    domain = os.environ.get("ROS_DOMAIN_ID") if args.domain_id is None else str(args.domain_id)
    setting = f", ROS_DOMAIN_ID={domain}" if domain not in (None, "0") else ""
    _print(_HOW_TO.format(command=shlex.quote(str(executable("servo-command"))), domain=setting))
    while True:
        wait_until(lambda: False, stack.children, 1.0)
        stack.print_warnings()


def _run_demo(stack: Stack, environment: Mapping[str, str], out: Path) -> int:
    """Run ``servo-demo``, which moves the axes; returns its exit status."""
    command = [str(executable("servo-demo")), "--require-twin", "--json", str(out / "demo.json")]
    demo = subprocess.Popen(
        with_parent_death_signal(command), stdin=subprocess.DEVNULL, env=dict(environment), start_new_session=True
    )
    try:
        ended = wait_until(lambda: demo.poll() is not None, stack.children, _DEMO_TIMEOUT)
        if not ended:
            _print(f"servo-demo did not finish within {_DEMO_TIMEOUT:g} s")
        return demo.returncode if ended else 1
    finally:
        stack.print_warnings()
        if demo.poll() is None:
            demo.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                demo.wait(5.0)
            demo.kill()


def _finish_demo(record: Path, out: Path) -> None:
    """Check the recording and draw the picture.

    Raises
    ------
    ChildError
        If the recording is damaged.
    """
    from servo_twin.view.picture import draw

    check = subprocess.run([str(executable("rerun")), "rrd", "verify", str(record)], capture_output=True, text=True)
    if check.returncode != 0:
        raise ChildError(f"the recording {record} is damaged:\n{check.stderr}")
    picture = out / "demo.png"
    picture.unlink(missing_ok=True)
    draw(record, picture)
    _print(f"recording  {record}   (view: {shlex.join([str(executable('rerun')), str(record)])})\npicture    {picture}")


def _environment(args: argparse.Namespace) -> dict[str, str]:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if args.level is not None:
        environment[LEVEL_VARIABLE] = args.level
    if args.domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(args.domain_id)
    elif args.demo:
        # Another servo may run on this machine; the demonstration must not move its shafts.
        environment["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    return environment


def main(argv: Sequence[str] | None = None) -> int:
    """Run until Ctrl-C, or until the end of the demonstration.

    Returns
    -------
    int
        0: normal end; 1: a child process or the demonstration failed; 2: wrong usage; 130: the demonstration was
        interrupted.
    """
    args = parser().parse_args(argv)
    if args.demo and args.port:
        parser().error("--demo moves the shafts: it is permitted with the virtual board only, not with --port")
    environment = _environment(args)
    args.out.mkdir(parents=True, exist_ok=True)
    record = args.out / "demo.rrd" if args.demo else args.record
    with _Signals() as signals:
        try:
            return _session(args, environment, record, signals)
        except _StopRequested:
            return _INTERRUPTED if args.demo else 0


def _session(args: argparse.Namespace, environment: Mapping[str, str], record: Path | None, signals: _Signals) -> int:
    """Start, run and stop all processes; returns the exit status."""
    stack = Stack(args.out, environment)
    status = 0
    with tempfile.TemporaryDirectory(prefix="servo-") as folder:
        try:
            if not args.demo:
                _refuse_second_bridge(environment)
            _start_all(stack, args, Path(folder), record)
            if not args.demo:
                _wait_for_stop(stack, args)
            status = _run_demo(stack, environment, args.out)
        except _StopRequested:
            _print("\nstopping: outputs off, then all processes")
            status = _INTERRUPTED if args.demo else 0
        except ChildError as error:
            _print(f"servo-up: {error}")
            status = 1
        finally:
            with signals.held():
                killed = stack.stop()
        if killed:
            _print(f"killed after a timeout: {', '.join(killed)}")
            status = status or 1
    if args.demo and status != _INTERRUPTED and record and record.exists():
        try:
            _finish_demo(record, args.out)
        except (ChildError, ValueError) as error:
            _print(f"servo-up: {error}")
            status = status or 1
        except _StopRequested:
            _print(f"\nstopped; the recording is in {record}, the picture was not drawn")
            raise
    return status


if __name__ == "__main__":
    sys.exit(main())
