"""Test bench of the experiments: board with both axes in closed-loop control, recordings with true plant values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_measurement import step_response
from servo_msgs_py.board_port import active, choose, reached, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, TICK, TICK_NS

from servo_twin.board import Board
from servo_twin.level import FAST_LEVEL, Level, chosen_level
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.servo_config import ServoConfig
from servo_twin.simulation import SimulationError, enable, keep_set_points

RPM: Final = np.pi / 30.0
"""One revolution per minute [rad/s]."""

COUNT: Final = 2.0 * np.pi / COUNTS_PER_TURN
"""One encoder count [rad]."""

SETTLED: Final = 0.1
"""Settling time after the rotor search, whose last vector has moved the shaft [s]."""


SLOW: Final = 0.2 * COUNT / TICK  # speed with negligible motion between true value and snapshot of a tick [rad/s]


WORDS: Final = ("limits", "faults", "state", "substate", "oscillation")
"""Variables of an axis that are recorded as words of the firmware."""

_COUNTED: Final = ("position", "position_ref")  # recorded in counts
_SIGNALS: Final = ("speed_ref", "speed", "i_q_ref", "i_q", "i_d", "u_d", "u_q")  # recorded in SI


def shaft_counts(recording: Trace) -> NDArray[np.float64]:
    """True angle in the coordinates of ``position`` [counts], within half a count of it at low speed.

    The median is used because a single tick may deviate by a tenth of a count with an uneven encoder.
    """
    counts = recording["theta"] / COUNT
    slow = np.abs(recording["omega"]) < SLOW
    slow[0] = True
    return np.asarray(counts - np.round(np.median((counts - recording["position"])[slow]) - 0.5) - 0.5)


_level: Final[ContextVar[Level | None]] = ContextVar("level", default=None)
_prepare: Final[ContextVar[Callable[[Board], None] | None]] = ContextVar("prepare", default=None)


@contextmanager
def at_level(level: Level | None) -> Iterator[None]:
    """Set the level of all boards created in the block; None: `level`."""
    token = _level.set(level)
    try:
        yield
    finally:
        _level.reset(token)


def level() -> Level:
    """Level of new boards: that of `at_level`, of the environment, or `FAST_LEVEL`."""
    return chosen_level(_level.get(), default=FAST_LEVEL)


@contextmanager
def prepared(prepare: Callable[[Board], None]) -> Iterator[None]:
    """Apply a function to all boards created in the block, before they run."""
    token = _prepare.set(prepare)
    try:
        yield
    finally:
        _prepare.reset(token)


def fresh_board(plant: PlantConfig, seed: int, servo: ServoConfig | None = None) -> Board:
    """New board of the level `level`; its set-points do not expire."""
    board = Board(plant, seed=seed, level=level(), servo=servo)
    keep_set_points(board)
    if (prepare := _prepare.get()) is not None:
        prepare(board)
    return board


JITTER_MAX: Final = math.sqrt(6.0)  # largest jitter of an edge [standard deviations]


def edge_shift(axis: AxisPlant) -> float:
    """Largest deviation of an encoder edge from its nominal position [counts]; 0 on the averaged plant.

    With a positive duty error the rising edge comes early and the falling edge late, each by half the error times the
    period of four counts. Jitter and half of the hysteresis are added.
    """
    if level() == "ideal":
        return 0.0
    return 2.0 * abs(axis.encoder_duty_error) + JITTER_MAX * axis.encoder_jitter + 0.5 * axis.encoder_hysteresis


@contextmanager
def spinning(plant: PlantConfig, seed: int) -> Iterator[Board]:
    """New board with both axes in SPIN, in position hold at standstill."""
    with fresh_board(plant, seed) as board:
        enable(board)
        board.run(SETTLED)
        yield board


def after_snapshot(board: Board) -> int:
    """Run until the snapshot of the present tick is complete; returns the time [ns].

    At level registers the slow loop with its snapshot may extend into the next PWM period.
    """
    if board.level == "registers":
        board.advance(board.time_ns + (PERIOD_NS - board.time_ns) % TICK_NS)
    return board.time_ns


def record(
    board: Board,
    axes: Sequence[int],
    seconds: float,
    act: Callable[[int], None] | None = None,
    *,
    may_fail: bool = False,
) -> dict[int, Trace]:
    """Run in slow ticks and record signals of the firmware and true values.

    Columns of the trace of an axis: ``position`` and ``position_ref`` [counts]; speeds, currents and voltages of the
    firmware [SI]; `WORDS`; the true values ``theta`` [rad], ``omega`` [rad/s], ``i_q_true`` [A], ``torque`` of the air
    gap [N m] and ``u_dc`` [V].

    Parameters
    ----------
    board : Board
        Board at a slow-tick boundary, as from `spinning`.
    axes : sequence of int
        Axes to record (index).
    seconds : float
        Length [s].
    act : callable, optional
        Called before each tick with its number, to write set-points, loads, supply voltage.
    may_fail : bool
        Faults are permitted.

    Raises
    ------
    SimulationError
        If an axis has a fault and `may_fail` is false.
    """
    ticks = round(seconds / TICK)
    start = after_snapshot(board)
    truths: dict[int, list[tuple[float, float, float, float, float]]] = {axis: [] for axis in axes}
    rows: list[bytes] = []
    for k in range(ticks):
        if act is not None:
            act(k)
        rows.append(board.record(start + (k + 1) * TICK_NS).tobytes())
        for axis, rows_of_axis in truths.items():
            t = board.truth(axis)
            rows_of_axis.append((t.theta_m, t.omega_m, t.i_q, t.torque_e, t.u_dc))
    log = np.frombuffer(
        b"".join(rows), board.snapshot_dtype
    )  # faster than concatenate(), which compares all fields of every row
    if log.size != ticks:
        raise SimulationError(f"{log.size} snapshots in {ticks} slow ticks")
    if not may_fail:
        _refuse_faults(board, log)
    return {axis: _recording(board, log, axis, truths[axis]) for axis in axes}


def _refuse_faults(board: Board, log: NDArray[np.void]) -> None:
    for axis in range(AXES):
        words = log[f"{axis_name(axis)}.faults"]
        if words.any():
            first = words[int(np.argmax(words != 0))]
            faults = "; ".join(f"{f.name}: {f.cause}" for f in board.catalogue.active("faults", int(first)))
            raise SimulationError(f"{axis_name(axis)} ended in a fault. {faults}")


def _recording(
    board: Board, log: NDArray[np.void], axis: int, truths: list[tuple[float, float, float, float, float]]
) -> Trace:
    name, si = axis_name(axis), board.si(log)
    columns = {signal: log[f"{name}.{signal}"].astype(np.float64) for signal in _COUNTED}
    columns |= {signal: si[f"{name}.{signal}"] for signal in _SIGNALS}
    columns |= {signal: log[f"{name}.{signal}"].astype(np.int64) for signal in WORDS}
    true = ("theta", "omega", "i_q_true", "torque", "u_dc")
    return Trace(TICK, columns | dict(zip(true, np.array(truths).T, strict=True)), first=1)


def features(board: Board, axis: int, **switches: bool) -> None:
    """Switch features on or off by name, e.g. ``ANTI_WINDUP=False``."""
    _switch(board, "param.features", axis, switches)


def faults(board: Board, axis: int, **switches: bool) -> None:
    """Enable or disable faults by name, e.g. ``OSCILLATION=False``."""
    _switch(board, "param.faults_enabled", axis, switches)


def _switch(board: Board, parameter: str, axis: int, switches: Mapping[str, bool]) -> None:
    masks = {flag.name: flag.mask for flag in board.catalogue.flags[board.catalogue[parameter].flags or ""]}
    mask = board.read_words(parameter)[axis]
    for name, on in switches.items():
        mask = mask | masks[name] if on else mask & ~masks[name]
    write_word(board, parameter, axis, mask)


def set_up(
    board: Board,
    axis: int,
    mode: str | None = None,
    speed: float | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    **switches: bool,
) -> None:
    """Set mode, set-point, parameters and features of one axis.

    Parameters
    ----------
    board, axis
        Board and index of the axis.
    mode : str, optional
        POSITION, SPEED or TORQUE.
    speed : float, optional
        Set-point [rad/s].
    parameters : mapping, optional
        Values of parameters [SI], by name without ``param.``.
    **switches : bool
        See `features`.
    """
    if switches:
        features(board, axis, **switches)
    for name, value in (parameters or {}).items():
        write_axis(board, f"param.{name}", axis, value)
    if mode is not None:
        choose(board, "cmd.mode", axis, mode)
    if speed is not None:
        write_axis(board, "cmd.speed", axis, speed)


def largest(board: Board, parameter: str) -> float:
    """Largest value of a parameter [SI]."""
    maximum = board.catalogue[f"param.{parameter}"].maximum
    assert maximum is not None
    return maximum


def at(events: Mapping[float, Callable[[], object]]) -> Callable[[int], None]:
    """Function `act` for `record` with actions by time since the start [s]."""
    due = {round(time / TICK): do for time, do in events.items()}

    def act(k: int) -> None:
        if k in due:
            due[k]()

    return act


def until(board: Board, what: str, holds: Callable[[], bool], seconds: float, step: float = TICK) -> None:
    """Run until a condition holds; polled every `step` [s].

    Raises
    ------
    SimulationError
        On a timeout after `seconds`; the message contains `what` and the faults.
    """
    if reached(board, holds, seconds, step):
        return
    states = ", ".join(f"{axis_name(axis)} {active(board, axis) or 'no fault'}" for axis in range(AXES))
    raise SimulationError(f"timeout after {seconds:g} s: {what}; {states}")


def settling_time(recording: Trace, target: float, within: float, since: float) -> float | None:
    """Time from `since` to the last sample more than `within` counts from a target [s]; None: it does not settle."""
    time = step_response.settling_time(recording.time, recording["position"] - target, within)
    return None if time is None else max(time - recording.step - since, 0.0)
