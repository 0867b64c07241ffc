"""``servo-up``: starts virtual board, bridge, twin and viewer on one machine, without ROS launch.

Starts the processes in sequence, prints instructions, and runs until Ctrl-C. With ``--demo`` it runs ``servo-demo``,
which moves both axes, and saves a recording and a picture. At the end all child processes are stopped, the bridge,
which switches the outputs off, first.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, NoReturn

from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.quantity import Quantity
from servo_msgs_py.run_file.series import segments, split
from servo_msgs_py.runtime.claim import ClaimError, claimed
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.node_name import taken
from servo_msgs_py.runtime.program import Interrupted, complain, deferred, program
from servo_msgs_py.runtime.ros_arguments import parameter_arguments

from servo_msgs_py import argument, board_parameters
from servo_twin.board import BoardError, SimulationError, needs_elf
from servo_twin.diagnosis.thresholds import Thresholds
from servo_twin.level import (
    DEFAULT_LEVEL,
    ELF_LEVEL,
    ELF_VARIABLE,
    FAST_LEVEL,
    LEVEL_VARIABLE,
    Level,
    add_level_options,
    chosen_level,
    use_elf,
)
from servo_twin.machine import SPEED_MIN, level_for, simulation_speed
from servo_twin.plant import PlantConfig
from servo_twin.processes import Child, ChildError, executable, stop_all, wait_until
from servo_twin.robot.command import MODEL_HELP, load_on_line

_PATIENCE: Final = 15.0  # until a message about what has not happened yet [s]; nothing fails because it is late
_LOOK: Final = 3.0  # for a servo on another machine [s]
_BRIDGE: Final = "servo/servo_bridge"  # namespace and name of the bridge
_DEMO_WAIT: Final = 60.0  # of the demonstration without progress while it connects [s]; up watches the processes
_ANNOUNCE: Final = 0.2  # interval of the messages about the processes [s]
_PICTURE, _RECORDING, _FIGURES = "demo.png", "demo.rrd", "demo.json"  # results of the demonstration
_RUNS_KEPT: Final = 5  # recordings of earlier sessions in the folder of the results
_RANGE, _LOCALHOST = "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"
_DOMAIN_MAX: Final = 232  # higher domain ids exceed the range of UDP ports

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


def _port(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("empty; give a device path or a pyserial URL, or omit the option")
    return text


def _domain(text: str) -> int:
    return argument.whole(text, Quantity(minimum=0.0, maximum=_DOMAIN_MAX, whole=True, text="a ROS domain"))


def _assignment(text: str) -> str:
    try:
        return board_parameters.parse(text, Catalogue.load()).text
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def parser() -> argparse.ArgumentParser:
    """Command line of ``servo-up``."""
    result = argument.Parser(prog="servo-up", description="Start board, bridge, twin and viewer; run until Ctrl-C.")
    result.add_argument(
        "--port", type=_port, help="serial port or pyserial URL of a real board (default: a virtual board)"
    )
    result.add_argument("--baud", type=argument.count, default=115200, help="line speed [bit/s] (default: %(default)s)")
    result.add_argument("--seed", type=int, default=1, help="seed of the virtual board (default: %(default)s)")
    result.add_argument("--plant", type=Path, help="plant file of the virtual board and of its twin")
    result.add_argument("--robot", metavar="MODEL", help=f"{MODEL_HELP}; also that of the twin")
    result.add_argument("--twin-plant", type=Path, help="plant file of the twin (default: --plant)")
    result.add_argument(
        "--thresholds", type=Path, help="threshold file of `servo_twin calibrate` for the diagnosis of the twin"
    )
    add_level_options(result, "virtual board and twin are", f"{DEFAULT_LEVEL}; {FAST_LEVEL} on a slow machine")
    result.add_argument("--no-web", action="store_true", help="do not start the viewer in the browser")
    result.add_argument("--record", type=argument.output_file, help="record to this .rrd file")
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
        "--out", type=argument.output_folder, default="out", help="folder for logs and results (default: %(default)s)"
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
        self.environment = environment
        self._log = out / "log"
        self._log.mkdir(parents=True, exist_ok=True)
        self.children: list[Child] = []
        self._missing: dict[Child, str] = {}

    def start(self, name: str, *arguments: str) -> Child:
        """Start an executable of this project.

        Raises
        ------
        ChildError
            If the executable cannot be started.
        """
        child = Child(name, [str(executable(name)), *arguments], self._log / f"{name}.log", self.environment)
        self.children.append(child)
        return child

    def expect(self, child: Child, missing: str) -> None:
        """Have `announce` wait until a child is ready; `missing` says what has not happened until then."""
        self._missing[child] = missing

    def announce(self) -> bool:
        """Print what the processes have sent since the last call; True if all that are expected to be are ready."""
        for child in self.children:
            for text in child.notices():
                _print(f"{child.name}: {text}")
        return all(child.ready for child in self._missing)

    def missing(self) -> list[str]:
        """What has not happened yet, with the last output of the process."""
        return [
            f"{text}. Last output ({child.log}):\n{child.last_output(3)}"
            for child, text in self._missing.items()
            if not child.ready
        ]

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for a condition as long as all children run; say from time to time that it is missing."""
        while not wait_until(condition, self.children, _PATIENCE):
            _print(f"waiting for {what} ...")

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
    domain = environment.get("ROS_DOMAIN_ID") or "0"
    found = taken(_BRIDGE, int(domain))
    if not found and environment[_RANGE] != _LOCALHOST:
        look = [str(executable("servo-command")), "--wait", f"{_LOOK:g}", "state"]
        found = subprocess.run(look, env=dict(environment), capture_output=True, check=False).returncode == 0
    if found:
        raise ChildError(
            f"a servo is already running in ROS domain {domain}; stop it first, or choose another domain with "
            "--domain-id"
        )


def _suitable_level(boards: int) -> Level:
    """Level that this machine can keep up with, according to a measurement, and for which there is software."""
    name = BoardDescription.load().name
    if needs_elf(name, ELF_LEVEL) and not os.environ.get(ELF_VARIABLE):
        _print(f"no ELF file of the firmware for the board {name} (--elf): level {FAST_LEVEL}")
        return FAST_LEVEL
    speed = simulation_speed(DEFAULT_LEVEL, boards)
    level = level_for(speed)
    if level != DEFAULT_LEVEL:
        _print(
            f"this machine simulates a board at level {DEFAULT_LEVEL} only {speed:.1f} times as fast as real time, and "
            f"{SPEED_MIN:g} are needed beside the other programs: level {level} (--level {DEFAULT_LEVEL} insists)"
        )
    return level


def _virtual_board(stack: Stack, args: argparse.Namespace, folder: Path) -> str:
    link = folder / "board"
    given = [("--plant", args.plant and args.plant.absolute()), ("--robot", args.robot)]
    more = [f"{option}={value}" for option, value in given if value]
    what = f"virtual board {BoardDescription.load().name} on {link}, {args.baud} baud, seed {args.seed}"
    elf = os.environ.get(ELF_VARIABLE) if args.level == ELF_LEVEL else None
    _print(f"{what}, level {args.level}{f', firmware {elf}' if elf else ''}")
    stack.start("virtual_board", "--link", str(link), "--baud", str(args.baud), "--seed", str(args.seed), *more)
    stack.wait(link.exists, "the port of the virtual board")
    return str(link)


def _run_file(args: argparse.Namespace) -> Path:
    """Path of the recording of this session; removes those that it replaces."""
    if args.demo:
        path = Path(args.out, "demo.mcap")
        replaced = segments(path)
    else:
        path = Path(args.out, time.strftime("up-%Y%m%d-%H%M%S.mcap"))
        sessions = sorted({name.with_name(f"{split(name)[0]}.mcap") for name in args.out.glob("up-*.mcap")})
        replaced = [file for session in sessions[: 1 - _RUNS_KEPT] for file in segments(session)]
    for file in replaced:
        file.unlink()
    return path.absolute()


def _start_all(stack: Stack, args: argparse.Namespace, folder: Path, record: Path | None) -> None:
    """Start all processes; `Stack.announce` prints their state.

    Raises
    ------
    ChildError
        If a child process fails.
    """
    port = args.port or _virtual_board(stack, args, folder)
    run_file = _run_file(args)
    _print(f"recording of the run: {run_file}")
    escaped = str(run_file).replace("%", "%%")  # the bridge inserts the time
    parameters = {"port": port, "baud": args.baud, "board_parameters": args.set or [""], "run_file": escaped}
    bridge = stack.start("servo_bridge", *parameter_arguments(**parameters))
    # The twin has the plant of the virtual board, but another seed: start angles and noise differ.
    files = {"plant": args.twin_plant or args.plant, "thresholds": args.thresholds}
    given = {name: str(path.absolute()) for name, path in files.items() if path}
    if args.robot:
        given["robot"] = args.robot
    twin = stack.start("servo_twin", *parameter_arguments(seed=args.seed + 1, **given))
    stack.expect(bridge, f"no board on {port} yet, the bridge goes on trying")
    stack.expect(twin, "the twin has no data of the board yet")
    web = not (args.no_web or args.demo)
    if web or record:
        viewer = stack.start("servo_viewer", *parameter_arguments(record=record.absolute() if record else "", web=web))
        stack.expect(viewer, "the viewer has not started yet")


def _wait_for_stop(stack: Stack, args: argparse.Namespace) -> NoReturn:
    domain = os.environ.get("ROS_DOMAIN_ID") if args.domain_id is None else str(args.domain_id)
    setting = f", ROS_DOMAIN_ID={domain}" if domain not in (None, "0") else ""
    if not wait_until(stack.announce, stack.children, _PATIENCE):
        for text in stack.missing():
            _print(text)
    _print(_HOW_TO.format(command=shlex.quote(str(executable("servo-command"))), domain=setting))
    while True:
        wait_until(lambda: False, stack.children, 1.0)
        stack.announce()


def _run_demo(stack: Stack, environment: Mapping[str, str], out: Path) -> int:
    """Run ``servo-demo``, which moves the axes; returns its exit status."""
    options = ["--require-twin", "--wait", f"{_DEMO_WAIT:g}", "--json", str((out / _FIGURES).absolute())]
    command = [str(executable("servo-demo")), *options]
    demo = subprocess.Popen(
        with_parent_death_signal(command), stdin=subprocess.DEVNULL, env=dict(environment), start_new_session=True
    )
    try:
        while not wait_until(lambda: demo.poll() is not None, stack.children, _ANNOUNCE):
            stack.announce()
        return int(demo.returncode)
    finally:
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
    from servo_twin.view.web_page import rerun_binary

    check = subprocess.run([str(rerun_binary()), "rrd", "verify", str(record)], capture_output=True, text=True)
    if check.returncode != 0:
        raise ChildError(f"the recording {record} is damaged:\n{check.stderr}")
    picture = out / _PICTURE
    draw(record, picture)
    _print(f"recording  {record}   (view: {shlex.join([str(executable('rerun')), str(record)])})\npicture    {picture}")


def _environment(args: argparse.Namespace) -> dict[str, str]:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    environment.setdefault(_RANGE, _LOCALHOST)
    if args.domain_id is not None:
        environment["ROS_DOMAIN_ID"] = str(args.domain_id)
    elif args.demo:
        # Another servo may run on this machine; the demonstration must not move its shafts.
        environment["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    return environment


def _check_inputs(args: argparse.Namespace) -> None:
    """Read the files of the children, before anything is started.

    Raises
    ------
    ValueError, OSError, SimulationError
        If one is wrong.
    """
    for plant in filter(None, (args.plant, args.twin_plant)):
        PlantConfig.load(plant)
    if args.thresholds:
        Thresholds.load(args.thresholds)
    if args.robot:
        load_on_line(args.robot, PlantConfig.load(args.plant))


@program("servo-up")
def main(argv: Sequence[str] | None = None) -> int:
    """Run until Ctrl-C, or until the end of the demonstration.

    Returns
    -------
    int
        0: normal end, without a demonstration also by a signal; 1: a child process or the demonstration failed; 2:
        wrong usage; else `program`.
    """
    args = parser().parse_args(argv)
    if args.demo and args.port:
        parser().error("--demo moves the shafts: it is permitted with the virtual board only, not with --port")
    try:
        use_elf(args)
        _check_inputs(args)
    except (SimulationError, ValueError) as error:
        complain(f"servo-up: {error}")
        return 2
    environment = _environment(args)
    args.out.mkdir(parents=True, exist_ok=True)
    record = args.out / _RECORDING if args.demo else args.record
    try:
        with claimed(args.out.resolve()):
            return _session(args, environment, record)
    except ClaimError as error:
        complain(f"servo-up: {error}")
        return 1
    except Interrupted as interruption:
        return interruption.status if args.demo else 0


def _session(args: argparse.Namespace, environment: dict[str, str], record: Path | None) -> int:
    """Start, run and stop all processes; returns the exit status."""
    stack = Stack(args.out, environment)
    if args.demo:
        for name in (_PICTURE, _RECORDING, _FIGURES):  # those of another run
            (args.out / name).unlink(missing_ok=True)
    status, interrupted = 0, False
    with tempfile.TemporaryDirectory(prefix="servo-") as folder:
        try:
            if not args.demo:
                _refuse_second_bridge(environment)
            if args.level is None:
                known = LEVEL_VARIABLE in environment
                args.level = chosen_level() if known else _suitable_level(1 if args.port else 2)
            environment[LEVEL_VARIABLE] = args.level
            _start_all(stack, args, Path(folder), record)
            if not args.demo:
                _wait_for_stop(stack, args)
            status = _run_demo(stack, environment, args.out)
        except Interrupted as stopped:
            _print("\nstopping: outputs off, then all processes")
            interrupted, status = True, stopped.status if args.demo else 0
        except (BoardError, ChildError, SimulationError, ValueError) as error:
            complain(f"servo-up: {error}")
            status = 1
        finally:
            with deferred() as stop:
                killed = stack.stop()
            stop.check()
        if killed:
            _print(f"killed after a timeout: {', '.join(killed)}")
            status = status or 1
    if args.demo and status and not interrupted and record and record.exists():
        _print(f"recording  {record}   (not complete; no picture)")
    if args.demo and status == 0 and not interrupted and record:
        try:
            _finish_demo(record, args.out)
        except (ChildError, ValueError) as error:
            complain(f"servo-up: {error}")
            status = status or 1
        except Interrupted:
            _print(f"\nstopped; the recording is in {record}, the picture was not drawn")
            raise
    return status


if __name__ == "__main__":
    sys.exit(main())
