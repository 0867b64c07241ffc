"""``servo-demo``: moves both axes over ROS topics and measures accuracy and settling.

A separate process that uses the topics and services of the servo only. It enables the axes, runs point-to-point moves,
simultaneous moves, a reversal, a stop and a path of both axes, prints its progress and tables of figures. The axes are
disabled at the end in any case.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import ExternalShutdownException
from rclpy.utilities import remove_ros_args
from servo_measurement.step_response import measure_step, rms
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.convert import flag_texts
from servo_msgs_py.output_file import write_file
from servo_msgs_py.runtime.program import complain, program
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS

from servo_bridge.client import CommandError, ros_session
from servo_bridge.demo_client import ServoClient
from servo_bridge.demo_report import PathRow, Residual, Row, passed, path_table, report, table
from servo_bridge.path_metrics import measure_path
from servo_bridge.trajectory.path import Path as Motion
from servo_bridge.trajectory.shapes import lissajous
from servo_msgs_py import argument

TURN: Final = 2.0 * math.pi
_HOLD: Final = 0.25  # time within the tolerance of the target before the next move [s]
_APPLY_TIMEOUT: Final = 2.0  # from the publication of a set-point to its effect [s of board time]
_REACHED: Final = 0.1 * TURN  # distance from the target within which a stop counts as without effect [rad]
_AMPLITUDE: Final = 1.0  # of the path [turns]
_FREQUENCIES: Final = (1.0, 1.5)  # of the axes [Hz]
_PATH_TIME: Final = 4.0  # [s]
_AHEAD: Final = 0.5  # from the publication of the path to its start [s]
_ATTEMPTS: Final = 3  # number of attempts to start the path
_SLOWER: Final = (1, 2, 4)  # divisors of the speed of the path: at each attempt it needs fewer points per second
_PATH_ERROR: Final = 0.02  # largest distance from the path [rad]
_TWIN_TIMEOUT: Final = 3.0  # for the residuals of a move [s of board time]
_FULL_SPEED: Final = 0.95  # of real time: a board time that runs slower is mentioned


class Demo:
    """Sequence of the demonstration.

    Parameters
    ----------
    client : ServoClient
        The servo.
    tolerance : float
        Half width of the band around a target that counts as reached [rad].
    timeout : float
        Longest time for one move [s of board time].
    info : callable
        Prints a line of progress.
    """

    def __init__(self, client: ServoClient, tolerance: float, timeout: float, info: Callable[[str], None]) -> None:
        self._client = client
        self._tolerance = tolerance
        self._timeout = timeout
        self._info = info
        self._catalogue = Catalogue.load()
        self._base: list[float] = []
        self._begun = (0, 0)  # tick and ROS time [ns] after the connection
        self.twin = False
        self.rows: list[Row] = []
        self.paths: list[PathRow] = []

    # ---- phases
    def connect(self, timeout: float, *, require_twin: bool) -> None:
        """Wait for the servo, and for the twin if it is required.

        Parameters
        ----------
        timeout : float
            Longest time without progress [s]: no topic, service or state of the twin is added.
        require_twin : bool
            Whether a twin has to send residuals.
        """
        client = self._client
        self._info("waiting for the servo ...")
        if not self._progresses(lambda: not client.missing(), lambda: len(client.missing()), timeout):
            state = f"; state: {client.state}" if client.state else ""
            raise CommandError(
                f"no servo within {timeout:g} s{state}; missing: {', '.join(client.missing())}. Start the servo first: "
                "`make up`, or `servo_bridge --ros-args -p port:=/dev/ttyUSB0` for a board; ROS_DOMAIN_ID must be the "
                "same for both"
            )
        if require_twin and not self._progresses(lambda: client.residual_after(0), lambda: client.twin_state, timeout):
            state = f"its state is {client.twin_state}" if client.twin_state else "there is no topic with its state"
            raise CommandError(f"no residuals of a twin within {timeout:g} s of board time: {state}; see its log")
        if client.geared:
            raise CommandError(
                f"{', '.join(client.geared)} has a gear ratio, a direction or an offset; the demonstration turns "
                "the motor shafts by several revolutions; use the default gear_ratio, direction and offset"
            )
        self._begun = client.tick, client.now_ns()
        self.twin = require_twin or client.wait_for(lambda: client.twin_present, 1.0)
        self._info(
            f"servo found: {client.state}; " + ("comparing with the twin" if self.twin else "no twin is running")
        )

    def _progresses(self, condition: Callable[[], bool], progress: Callable[[], object], timeout: float) -> bool:
        """Wait for a condition; False after a time [s] without progress, or after the tenth with it."""
        for _ in range(10):
            before = progress()
            if self._client.wait_for(condition, timeout):
                return True
            if progress() == before:
                return False
        return False

    @property
    def speed(self) -> float:
        """Board time per real time since the connection; below 1 if the computer is too slow for a virtual board."""
        tick, begun_ns = self._begun
        passed_ns = self._client.now_ns() - begun_ns
        return (self._client.tick - tick) * PERIOD_NS / passed_ns if passed_ns > 0 else 1.0

    def enable(self) -> None:
        """Enable both axes and wait for RUN/SPIN."""
        self._info("enabling again ..." if self._base else "enabling: rotor search ...")
        self._client.enable(True)
        if not self._watch_states(lambda: all(self._is_spinning(axis) for axis in self._axes), 15.0):
            raise CommandError(f"the axes did not reach RUN/SPIN within 15 s; state: {self._client.state}")
        if not self._base:
            # Nearest whole turn: close to the shafts, and easy to read in the table.
            self._base = [round(self._position(axis) / TURN) * TURN for axis in self._axes]

    def run(self) -> None:
        """Run all moves and the path."""
        self._move("point to point", {0: 5.0})
        self._move("point to point", {1: -5.0})
        self._move("simultaneous", {0: 0.0, 1: 0.0})
        self._move("reversal", {0: 0.0, 1: 0.0}, first={0: 5.0, 1: -5.0})
        self._stop("stop", {0: 30.0, 1: -30.0})
        self.enable()
        self._move("return", {0: 0.0, 1: 0.0})
        self._path("Lissajous")

    def disable(self) -> None:
        """Disable both axes and wait until they are off."""
        self._client.enable(False)
        off = self._client.wait_for(lambda: not any(self._is_in(axis, "RUN") for axis in range(AXES)), 10.0)
        if not off:
            raise CommandError(f"the outputs are not off 10 s after disable: {self._client.state}")
        self._info(f"disabled: {self._client.state}")

    # ---- moves
    def _move(self, title: str, turns: Mapping[int, float], first: Mapping[int, float] | None = None) -> None:
        """Run one move; with `first`, command `first` before and reverse half way."""
        self._announce(title, turns if first is None else first)
        if first is not None:
            self._start_and_wait_half_way(first)
            self._info("  half way: reversing")
        start_ns, tick = self._command(turns)
        targets = {axis: self._target(axis, turns[axis]) for axis in turns}
        self._wait(lambda: all(self._at_rest(axis, targets[axis], tick) for axis in targets), title)
        self._measure(title, tick, start_ns, targets)

    def _stop(self, title: str, turns: Mapping[int, float]) -> None:
        """Interrupt a move half way by ``quick_stop``; the axes must hold where they came to rest."""
        self._announce(title, turns)
        self._start_and_wait_half_way(turns)
        self._info("  half way: quick_stop")
        known = len(self._client.applied)
        start_ns = self._client.now_ns()
        self._client.quick_stop()
        tick = self._applied_since(known, "cmd.quick_stop")

        def hold_point(axis: int) -> float:
            return self._client.latest(f"{axis_name(axis)}.position_ref")

        self._wait(lambda: all(self._at_rest(axis, hold_point(axis), tick) for axis in turns), title)
        self._measure(title, tick, start_ns, {axis: hold_point(axis) for axis in turns})
        if self.twin:
            self._info("  (the twin stops after its own ramp, then takes the position of the board)")
        for axis, value in turns.items():
            if abs(hold_point(axis) - self._target(axis, value)) < _REACHED:
                raise CommandError(
                    f"{title}: {self._client.joints[axis]} continued to its target; quick_stop had no effect"
                )

    def _path(self, title: str) -> None:
        """Follow a timed path of both axes, commanded as by a planner."""
        for slower in _SLOWER:
            try:
                self._follow_and_measure(title, slower)
                return
            except ValueError as error:
                self._info(f"  the points did not reach the board in time: {error}")
                _, tick = self._command(dict.fromkeys(self._axes, 0.0))
                self._wait_at_base(tick, "return")
        raise CommandError(f"{title}: the axes did not follow; see the log of servo_bridge")

    def _follow_and_measure(self, title: str, slower: int) -> None:
        """Follow the path at a fraction of its speed; ValueError if the board has not received it completely."""
        client = self._client
        low, high = (frequency / slower for frequency in _FREQUENCIES)
        duration = _PATH_TIME * slower
        self._info(f"{title}: {client.joints[0]} at {low:g} Hz, {client.joints[1]} at {high:g} Hz, {duration:g} s")
        # Phase 0 gives the largest area; with other phases the figure may retrace itself.
        path = lissajous(client.joints, self._base, [_AMPLITUDE * TURN] * 2, (low, high), duration, phase=0.0)
        start_ns, start, tick = self._follow(path)
        end = start + round(duration * 1e9 / PERIOD_NS)
        self._wait_at_base(end, title, duration)
        names = [f"{axis_name(axis)}.{name}" for name in ("position", "position_ref") for axis in self._axes]
        ticks, *columns = client.since(tick, ["tick", *names])
        position, reference = np.array_split(np.column_stack(columns), 2, axis=1)
        time = (ticks - ticks[0]) * (PERIOD_NS * 1e-9)
        figures = measure_path(time, position, reference, path)
        residuals = tuple(filter(None, self._residuals(start_ns, client.now_ns())))
        self.paths.append(PathRow(title, tuple(client.joints), figures, _PATH_ERROR, self._tolerance, residuals))
        for joint, distance in zip(client.joints, figures.error_max, strict=True):
            self._info(f"  {joint}: at most {distance / TURN * COUNTS_PER_TURN:.1f} counts from the path")
        self._info(f"  start of the axes: {figures.ticks_apart} ticks apart")

    def _follow(self, path: Motion) -> tuple[int, int, int]:
        """Publish a path; returns its start in ROS time [ns], about its start tick, and that of its first write."""
        for _ in range(_ATTEMPTS):
            # By the board's clock: ROS time would be wrong by what a slow board loses until then.
            start = self._client.tick + round(_AHEAD * 1e9 / PERIOD_NS)
            known, start_ns = len(self._client.applied), self._client.now_ns() + round(_AHEAD * 1e9)
            self._client.follow(path, start_ns)
            try:
                return start_ns, start, self._applied_since(known, "cmd.points")
            except CommandError as error:
                # Points that arrive too late (busy computer) are refused as a whole; nothing moves.
                self._info(f"  {error}")
        raise CommandError(f"the path was not accepted in {_ATTEMPTS} attempts; see the log of servo_bridge")

    def _announce(self, title: str, turns: Mapping[int, float]) -> None:
        parts = (f"{self._client.joints[axis]} to {value:+g} turns" for axis, value in turns.items())
        self._info(f"{title}: {', '.join(parts)}")

    def _command(self, turns: Mapping[int, float]) -> tuple[int, int]:
        """Publish targets; returns the ROS time before [ns] and the tick of the effect in the firmware."""
        known = len(self._client.applied)
        start_ns = self._client.now_ns()
        self._client.command({axis: self._target(axis, value) for axis, value in turns.items()})
        return start_ns, self._applied_since(known, "cmd.position")

    def _start_and_wait_half_way(self, turns: Mapping[int, float]) -> None:
        start = {axis: self._position(axis) for axis in turns}
        self._command(turns)
        half = {axis: (start[axis] + self._target(axis, value)) / 2.0 for axis, value in turns.items()}
        self._wait(
            lambda: all((self._position(axis) - half[axis]) * (half[axis] - start[axis]) >= 0.0 for axis in turns),
            "the first half",
        )

    def _applied_since(self, known: int, variable: str) -> int:
        """Tick of the first write of `variable` after the first `known` applied commands."""
        client = self._client

        def found() -> bool:
            client.check()
            return any(a.variable == variable for a in client.applied[known:])

        if not client.wait_for(found, _APPLY_TIMEOUT):
            raise CommandError(f"no {variable} took effect within {_APPLY_TIMEOUT:g} s; see the log of servo_bridge")
        return next(a.tick for a in client.applied[known:] if a.variable == variable)

    def _wait(self, condition: Callable[[], bool], name: str, planned: float = 0.0) -> None:
        """Wait for the condition; after a timeout the table shows the move as not reached."""
        done = self._client.wait_for(lambda: condition() or self._faulted(), planned + self._timeout)
        if self._faulted():
            raise CommandError(f"{name}: {self._fault_text()}")
        if not done:
            self._info(f"  {name}: not finished after {self._timeout:g} s")

    def _wait_at_base(self, tick: int, name: str, planned: float = 0.0) -> None:
        """Wait until both axes rest at their base, counted from a tick on."""
        self._wait(lambda: all(self._at_rest(axis, self._base[axis], tick) for axis in self._axes), name, planned)

    def _measure(self, title: str, tick: int, start_ns: int, targets: Mapping[int, float]) -> None:
        """Measure and print the figures of every axis of a move."""
        client = self._client
        residuals = self._residuals(start_ns, client.now_ns())
        for axis, target in targets.items():
            prefix = axis_name(axis)
            ticks, position, reference = client.since(tick, ["tick", f"{prefix}.position", f"{prefix}.position_ref"])
            time = (ticks - tick) * (PERIOD_NS * 1e-9)
            figures = measure_step(time, position, target, self._tolerance, reference=reference)
            self.rows.append(Row(title, client.joints[axis], figures, residuals[axis]))
            settled = "did not settle" if figures.settling_time is None else f"settled in {figures.settling_time:.3f} s"
            error = figures.error / TURN * COUNTS_PER_TURN
            self._info(
                f"  {client.joints[axis]}: {settled}, {figures.reached / TURN:+.4f} turns, {error:+.1f} counts error"
            )

    def _residuals(self, start_ns: int, end_ns: int) -> list[Residual | None]:
        """Position residual between board and twin per axis in a span of ROS time [ns]; None without data of a twin."""
        client = self._client
        self.twin = self.twin or client.twin_present
        if self.twin and not client.wait_for(lambda: client.residual_after(end_ns), _TWIN_TIMEOUT):
            self._info(f"  no data of the twin for {_TWIN_TIMEOUT:g} s")
        table = client.residuals(start_ns, end_ns)
        if not len(table):
            return [None for _ in self._axes]
        return [Residual(rms(one), float(np.max(np.abs(one))), len(one)) for one in table.T]

    # ---- recorded data
    @property
    def _axes(self) -> range:
        return range(len(self._client.joints))

    def _target(self, axis: int, turns: float) -> float:
        return self._base[axis] + turns * TURN

    def _position(self, axis: int) -> float:
        return self._client.latest(f"{axis_name(axis)}.position")

    def _is_spinning(self, axis: int) -> bool:
        spin = self._catalogue.enums["substate_t"]["SPIN"]
        return self._is_in(axis, "RUN") and self._client.latest(f"{axis_name(axis)}.substate") == spin

    def _is_in(self, axis: int, state: str) -> bool:
        """Whether a connected board reports this state of an axis."""
        value = self._client.latest(f"{axis_name(axis)}.state")
        return self._client.connected and value == self._catalogue.enums["state_t"][state]

    def _at_rest(self, axis: int, target: float, since_tick: int) -> bool:
        """True if the axis has been within the tolerance of its target for the hold time."""
        hold = round(_HOLD * 1e9 / PERIOD_NS)
        first = max(since_tick, self._client.tick - hold)
        if self._client.tick - since_tick < hold:
            return False
        (position,) = self._client.since(first, [f"{axis_name(axis)}.position"])
        return bool(np.all(np.abs(position - target) <= self._tolerance))

    def _watch_states(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait for the condition and print every change of the state; a fault raises an error."""
        shown = [""]

        def sample() -> bool:
            if self._client.state != shown[0]:
                shown[0] = self._client.state
                self._info(f"  {shown[0]}")
            return condition() or self._faulted()

        done = self._client.wait_for(sample, timeout)
        if self._faulted():
            raise CommandError(self._fault_text())
        return done

    def _faulted(self) -> bool:
        return not self._client.connected or any(self._is_in(axis, "FAULT") for axis in range(AXES))

    def _fault_text(self) -> str:
        texts = [
            f"{self._client.joints[axis]}: {text}"
            for axis in self._axes
            for text in flag_texts(self._catalogue, "faults", int(self._client.latest(f"{axis_name(axis)}.faults")))
        ]
        return f"the servo stopped ({self._client.state}). {' '.join(texts)}".strip()


def _arguments(argv: Sequence[str]) -> argparse.Namespace:
    parser = argument.Parser(prog="servo-demo", description="Move both axes over ROS topics and measure.")
    parser.add_argument("--json", type=argument.output_file, metavar="FILE", help="write all figures to this file")
    for name, whose in (("servo", "board's node"), ("twin", "twin")):
        parser.add_argument(
            f"--{name}",
            type=argument.namespace,
            default=name,
            metavar="NAMESPACE",
            help=f"namespace of the {whose}",
        )
    parser.add_argument("--require-twin", action="store_true", help="fail if no twin is running")
    parser.add_argument(
        "--tolerance", type=argument.positive, default=2.0, metavar="COUNTS", help="tolerance of a target (default: 2)"
    )
    parser.add_argument(
        "--timeout",
        type=argument.positive,
        default=10.0,
        metavar="S",
        help="timeout of a move in board time (default: 10)",
    )
    parser.add_argument(
        "--wait",
        type=argument.not_negative,
        default=20.0,
        metavar="S",
        help="longest time without progress while connecting to servo and twin (default: 20)",
    )
    return parser.parse_args(argv)


def _info(line: str) -> None:
    print(line, flush=True)


def _perform(client: ServoClient, arguments: argparse.Namespace) -> int:
    # 0.01 counts more, so that whole counts are inside the band in spite of rounding.
    tolerance = (arguments.tolerance + 0.01) * TURN / COUNTS_PER_TURN
    demo = Demo(client, tolerance, arguments.timeout, _info)
    demo.connect(arguments.wait, require_twin=arguments.require_twin)
    trouble = ""
    try:
        try:
            demo.enable()
            demo.run()
        except CommandError as error:
            trouble = str(error)
        finally:
            demo.disable()
    except CommandError as error:
        trouble = trouble or str(error)
    figures = report(demo.rows, demo.paths, tolerance_counts=arguments.tolerance, twin=demo.twin, speed=demo.speed)
    figures["trouble"] = trouble or None
    if arguments.json is not None:
        write_file(arguments.json, json.dumps(figures, indent=2) + "\n")
    if demo.rows:
        _info("\n" + table(demo.rows) + "\n")
    if demo.paths:
        _info(path_table(demo.paths) + "\n")
    if demo.speed < _FULL_SPEED:
        _info(
            f"board time ran at {demo.speed:.2f} of real time: the computer is too slow; the figures are in board time"
        )
    if trouble:
        _info(f"stopped: {trouble}")
        return 1
    if not passed(demo.rows, demo.paths, twin=demo.twin):
        _info(_shortcoming(demo))
        return 1
    _info(
        f"both axes reached their targets within {arguments.tolerance:g} counts, "
        f"and followed the path within {_PATH_ERROR:g} rad"
    )
    return 0


def _shortcoming(demo: Demo) -> str:
    if not all(row.figures.arrived for row in demo.rows):
        return "not every axis reached its target"
    if not all(row.followed(axis) for row in demo.paths for axis in range(len(row.axes))):
        return f"not every axis followed the path within {_PATH_ERROR:g} rad, synchronously, to its end"
    return "the twin sent no data"


@program("servo-demo")
def main(args: Sequence[str] | None = None) -> int:
    """Run the program.

    Returns
    -------
    int
        0: both axes reached their targets; 1: not; 2: no servo; else `program`.
    """
    argv = list(sys.argv if args is None else ["servo-demo", *args])
    arguments = _arguments(remove_ros_args(argv)[1:])
    try:
        # A signal disables the axes before the end.
        with ros_session(argv) as session, ServoClient(session, arguments.servo, arguments.twin) as client:
            return _perform(client, arguments)
    except (CommandError, ExternalShutdownException, ROSInterruptException) as error:
        complain(f"servo-demo: {error}")
        return 2


if __name__ == "__main__":
    sys.exit(main())
