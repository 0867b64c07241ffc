"""``servo-up``: virtual board, bridge, twin and viewer together, on one machine and without ROS's launch.

Brings them up one after the other, says how to use them, and stays until Ctrl-C. With ``--demo`` it lets ``servo-demo``
move both axes instead and leaves a recording and a picture. Whatever happens, no child stays behind, and the bridge,
which switches the outputs off, is the first to be stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
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

from servo_msgs_py import board_parameters
from servo_twin.level import LEVEL_VARIABLE, add_level_option, chosen_level
from servo_twin.processes import Child, ChildError, executable, stop_all, wait_until

_BOARD_TIMEOUT: Final = 10.0  # [s]
_CONNECT_TIMEOUT: Final = 15.0
_VIEWER_TIMEOUT: Final = 30.0  # the first start of the viewer compiles nothing but reads a lot
_DEMO_TIMEOUT: Final = 240.0
_INTERRUPTED: Final = 130
_HIGHEST_DOMAIN: Final = 232  # a higher one has no ports
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
Ctrl-C ramps down, switches the outputs off and ends everything."""


class _StopRequested(BaseException):
    """SIGINT, SIGTERM or SIGHUP; no library that works when it comes may take it for an error of its own."""


class _Signals:
    """Turns SIGINT, SIGTERM and SIGHUP (a closed terminal) into `_StopRequested`, once; ignores them afterwards."""

    _NUMBERS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        self._held = False
        self._came = False
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
        self._came = True
        if not self._held:
            raise _StopRequested

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Let nothing interrupt what is done in here; a signal that came meanwhile counts at its end."""
        came, self._held = self._came, True
        try:
            yield
        finally:
            self._held = False
        if self._came and not came:
            raise _StopRequested


def _port(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("it is empty; give a device path or a pyserial URL, or leave it out")
    return text


def _domain(text: str) -> int:
    if not text.isdecimal() or int(text) > _HIGHEST_DOMAIN:
        raise argparse.ArgumentTypeError(f"{text!r} is no ROS domain; they are 0 .. {_HIGHEST_DOMAIN}")
    return int(text)


def _assignment(text: str) -> str:
    try:
        return board_parameters.parse(text, Catalogue.load()).text
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def parser() -> argparse.ArgumentParser:
    """Command line of ``servo-up``."""
    result = argparse.ArgumentParser(
        prog="servo-up", description="Bring up board, bridge, twin and viewer; stay until Ctrl-C."
    )
    result.add_argument(
        "--port", type=_port, help="serial port or pyserial URL of a real board (default: a virtual board)"
    )
    result.add_argument("--baud", type=int, default=115200, help="line speed [bit/s] (default: %(default)s)")
    result.add_argument("--seed", type=int, default=1, help="seed of the virtual board (default: %(default)s)")
    result.add_argument("--plant", type=Path, help="plant file of the virtual board and of its twin")
    result.add_argument("--twin-plant", type=Path, help="another plant file for the twin")
    result.add_argument("--thresholds", type=Path, help="of `servo_twin calibrate`, for the diagnosis of the twin")
    add_level_option(result, "virtual board and twin are")
    result.add_argument("--no-web", action="store_true", help="no viewer in the browser")
    result.add_argument("--record", type=Path, help="record to this .rrd file")
    result.add_argument(
        "--domain-id", type=_domain, help="ROS domain (default: $ROS_DOMAIN_ID, or one of its own with --demo)"
    )
    result.add_argument(
        "--set",
        action="append",
        default=[],
        type=_assignment,
        metavar="NAME=VALUE",
        help="parameter of the board, such as param.i_q_limit=1.0,1.5; may be repeated",
    )
    result.add_argument("--demo", action="store_true", help="move both axes, leave a recording and a picture, and end")
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
        """Start one of our executables.

        Raises
        ------
        ChildError
            If it cannot be started.
        """
        child = Child(name, [str(executable(name)), *arguments], self._log / f"{name}.log", self._environment)
        self.children.append(child)
        return child

    def wait(self, child: Child, text: str, timeout: float) -> bool:
        """Wait until a child has printed something; False after the timeout [s]."""
        return wait_until(lambda: text in child.text(), self.children, timeout)

    def tell_warnings(self) -> None:
        """Pass on what the virtual board warns of: that the machine is too slow for it."""
        texts = [child.text() for child in self.children if child.name == "virtual_board"]
        lines = [line for text in texts for line in text.splitlines() if line.startswith(_WARNING)]
        for line in lines[self._warnings :]:
            _say(line)
        self._warnings = max(self._warnings, len(lines))

    def stop(self) -> list[str]:
        """Stop the bridge, which switches the outputs off, then the rest; names of those that had to be killed."""
        order = {"servo_bridge": 0, "servo_viewer": 1, "servo_twin": 2}
        killed = stop_all(sorted(self.children, key=lambda child: order.get(child.name, 3)))
        self.children.clear()
        return killed


def _ros(**parameters: object) -> list[str]:
    """Arguments that set parameters of a node."""
    result = ["--ros-args"]
    for name, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        result += ["-p", f"{name}:={text}"]
    return result


def _say(text: str) -> None:
    print(text, flush=True)


def _refuse_a_second(environment: Mapping[str, str]) -> None:
    """Two bridges in one domain would both obey every command.

    Raises
    ------
    ChildError
        If a servo is up already.
    """
    look = [str(executable("servo-command")), "--wait", "3", "state"]
    found = subprocess.run(look, env=dict(environment), capture_output=True, text=True, check=False)
    if found.returncode == 0:
        domain = environment.get("ROS_DOMAIN_ID", "0")
        raise ChildError(
            f"a servo is up already in ROS domain {domain} ({found.stdout.splitlines()[0]});"
            " stop it first, or choose another domain with --domain-id"
        )


def _virtual_board(stack: Stack, args: argparse.Namespace, folder: Path) -> str:
    link = folder / "board"
    plant = ["--plant", str(args.plant)] if args.plant else []
    _say(f"virtual board on {link}, {args.baud} baud, seed {args.seed}, level {chosen_level(args.level)}")
    stack.start("virtual_board", "--link", str(link), "--baud", str(args.baud), "--seed", str(args.seed), *plant)
    if not wait_until(link.exists, stack.children, _BOARD_TIMEOUT):
        raise ChildError(f"the virtual board made no port within {_BOARD_TIMEOUT:g} s")
    return str(link)


def _bring_up(stack: Stack, args: argparse.Namespace, folder: Path, record: Path | None) -> None:
    """Start everything and say what happens.

    Raises
    ------
    ChildError
        If a child does not come up.
    """
    port = args.port or _virtual_board(stack, args, folder)
    wanted = json.dumps(args.set or [""])
    bridge = stack.start("servo_bridge", *_ros(port=port, baud=args.baud, board_parameters=wanted))
    # The twin has the model of the virtual board, but other random numbers: start angles and noise differ.
    files = {"plant": args.twin_plant or args.plant, "thresholds": args.thresholds}
    given = {name: path.absolute() for name, path in files.items() if path}
    twin = stack.start("servo_twin", *_ros(seed=args.seed + 1, **given))
    web = not (args.no_web or args.demo)
    viewer = None
    if web or record:
        viewer = stack.start("servo_viewer", *_ros(record=record or "''", web=web))
    if stack.wait(bridge, "connected to", _CONNECT_TIMEOUT):
        _say(f"bridge connected to {port}")
    else:
        _say(f"bridge: no board on {port} yet; it keeps trying. It says:\n{bridge.last_words(3)}")
    _say(f"twin follows (log: {twin.log})")
    if web and viewer is not None:
        found = wait_until(lambda: _URL.search(viewer.text()) is not None, stack.children, _VIEWER_TIMEOUT)
        match = _URL.search(viewer.text())
        _say(f"viewer: {match.group(0) if found and match else 'not up yet, see ' + str(viewer.log)}")
    if record:
        _say(f"recording to {record}")


def _stay(stack: Stack, args: argparse.Namespace) -> NoReturn:
    domain = os.environ.get("ROS_DOMAIN_ID") if args.domain_id is None else str(args.domain_id)
    setting = f", ROS_DOMAIN_ID={domain}" if domain not in (None, "0") else ""
    _say(_HOW_TO.format(command=executable("servo-command"), domain=setting))
    while True:
        wait_until(lambda: False, stack.children, 1.0)
        stack.tell_warnings()


def _run_demo(stack: Stack, environment: Mapping[str, str], out: Path) -> int:
    """Let ``servo-demo`` move the axes, its output shown; returns its exit status."""
    command = [str(executable("servo-demo")), "--require-twin", "--json", str(out / "demo.json")]
    demo = subprocess.Popen(
        with_parent_death_signal(command), stdin=subprocess.DEVNULL, env=dict(environment), start_new_session=True
    )
    try:
        ended = wait_until(lambda: demo.poll() is not None, stack.children, _DEMO_TIMEOUT)
        if not ended:
            _say(f"servo-demo did not end within {_DEMO_TIMEOUT:g} s")
        return demo.returncode if ended else 1
    finally:
        stack.tell_warnings()
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
    _say(f"recording  {record}   (look at it with {executable('rerun')} {record})\npicture    {picture}")


def _environment(args: argparse.Namespace) -> dict[str, str]:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if args.level is not None:
        environment[LEVEL_VARIABLE] = args.level
    if args.domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(args.domain_id)
    elif args.demo:
        # Another servo may be up on this machine; the demonstration must not move its shafts.
        environment["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    return environment


def main(argv: Sequence[str] | None = None) -> int:
    """Run until Ctrl-C, or until the demonstration is over.

    Returns
    -------
    int
        0 after an orderly end; 1 when a child fails or the demonstration does not succeed; 2 for a wrong usage; 130
        when the demonstration was interrupted.
    """
    args = parser().parse_args(argv)
    if args.demo and args.port:
        parser().error("--demo moves the shafts without asking: it runs on the virtual board only, not on --port")
    environment = _environment(args)
    args.out.mkdir(parents=True, exist_ok=True)
    record = args.out / "demo.rrd" if args.demo else args.record
    with _Signals() as signals:
        try:
            return _session(args, environment, record, signals)
        except _StopRequested:
            return _INTERRUPTED if args.demo else 0


def _session(args: argparse.Namespace, environment: Mapping[str, str], record: Path | None, signals: _Signals) -> int:
    """Everything from the first child to the last; returns the exit status."""
    stack = Stack(args.out, environment)
    status = 0
    with tempfile.TemporaryDirectory(prefix="servo-") as folder:
        try:
            if not args.demo:
                _refuse_a_second(environment)
            _bring_up(stack, args, Path(folder), record)
            if not args.demo:
                _stay(stack, args)
            status = _run_demo(stack, environment, args.out)
        except _StopRequested:
            _say("\nstopping: outputs off, then everything else")
            status = _INTERRUPTED if args.demo else 0
        except ChildError as error:
            _say(f"servo-up: {error}")
            status = 1
        finally:
            with signals.held():
                killed = stack.stop()
        if killed:
            _say(f"had to be killed: {', '.join(killed)}")
            status = status or 1
    if args.demo and status != _INTERRUPTED and record and record.exists():
        try:
            _finish_demo(record, args.out)
        except (ChildError, ValueError) as error:
            _say(f"servo-up: {error}")
            status = status or 1
        except _StopRequested:
            _say(f"\nstopped; the recording is in {record}, the picture was not drawn")
            raise
    return status


if __name__ == "__main__":
    sys.exit(main())
