"""The bench that all experiments share: a board with both axes spinning, and recordings with the plant's truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, SLOW_PERIODS

from servo_twin.board import Board, Firmware
from servo_twin.level import FAST_LEVEL, Level, chosen_level
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError, enable, keep_set_points

TICK_NS: Final = PERIOD_NS * SLOW_PERIODS
"""One slow tick [ns]."""

TICK: Final = TICK_NS * 1e-9
"""One slow tick [s]."""

RPM: Final = np.pi / 30.0
"""One turn per minute [rad/s]."""

COUNT: Final = 2.0 * np.pi / COUNTS_PER_TURN
"""One encoder count [rad]."""

SETTLED: Final = 0.1
"""After the rotor search, whose last vector has moved the shaft [s]."""


SLOW: Final = 0.2 * COUNT / TICK  # hardly moves between what truth and snapshot show of one tick [rad/s]


@dataclass(frozen=True)
class Recording:
    """One axis over time, one entry per slow tick."""

    time: NDArray[np.float64]  # since the beginning of the recording [s]
    position: NDArray[np.float64]  # as the firmware reports it [counts]
    position_ref: NDArray[np.float64]  # likewise [counts]
    speed_ref: NDArray[np.float64]  # likewise [rad/s]
    speed: NDArray[np.float64]  # likewise [rad/s]
    i_q_ref: NDArray[np.float64]  # likewise [A]
    i_q: NDArray[np.float64]  # likewise [A]
    i_d: NDArray[np.float64]  # likewise [A]
    u_d: NDArray[np.float64]  # likewise [V]
    u_q: NDArray[np.float64]  # likewise [V]
    limits: NDArray[np.int64]  # words of the firmware
    faults: NDArray[np.int64]  # likewise
    state: NDArray[np.int64]  # likewise
    substate: NDArray[np.int64]  # likewise
    theta: NDArray[np.float64]  # truth of the plant: mechanical angle [rad]
    omega: NDArray[np.float64]  # truth: mechanical speed [rad/s]
    i_q_true: NDArray[np.float64]  # truth [A]
    torque: NDArray[np.float64]  # truth: of the air gap [N m]
    u_dc: NDArray[np.float64]  # truth: of the bus [V]

    @property
    def shaft(self) -> NDArray[np.float64]:
        """True angle in counts as `position` counts them: half a count about it while the shaft is slow.

        One tick alone may lie a tenth of a count beyond where an even encoder would have its edge.
        """
        counts = self.theta / COUNT
        slow = np.abs(self.omega) < SLOW
        slow[0] = True
        return np.asarray(counts - np.round(np.median((counts - self.position)[slow]) - 0.5) - 0.5)

    def part(self, start: float, end: float | None = None) -> Recording:
        """Ticks after `start` and up to `end` [s], both as in `time`, which keeps counting."""
        before = round(float(self.time[0]) / TICK) - 1
        ticks = slice(max(round(start / TICK) - before, 0), None if end is None else max(round(end / TICK) - before, 0))
        return Recording(**{name: getattr(self, name)[ticks] for name in self.__dataclass_fields__})


_level: Final[ContextVar[Level | None]] = ContextVar("level", default=None)
_prepare: Final[ContextVar[Callable[[Board], None] | None]] = ContextVar("prepare", default=None)


@contextmanager
def at_level(level: Level | None) -> Iterator[None]:
    """Let all boards made on this bench meanwhile be of one level; None: of that of `level`."""
    token = _level.set(level)
    try:
        yield
    finally:
        _level.reset(token)


def level() -> Level:
    """The level of the boards on this bench: the level asked for, or that of the environment, or `FAST_LEVEL`."""
    return chosen_level(_level.get(), default=FAST_LEVEL)


@contextmanager
def prepared(prepare: Callable[[Board], None]) -> Iterator[None]:
    """Let something be done to all boards made on this bench meanwhile, before they run."""
    token = _prepare.set(prepare)
    try:
        yield
    finally:
        _prepare.reset(token)


def fresh_board(plant: PlantConfig, seed: int, firmware: Firmware | None = None) -> Board:
    """A board of the level of this bench, just switched on; its set-points do not expire."""
    board = Board(plant, seed=seed, level=level(), firmware=firmware)
    keep_set_points(board)
    if (prepare := _prepare.get()) is not None:
        prepare(board)
    return board


JITTER_REACH: Final = math.sqrt(6.0)  # standard deviations of an edge's jitter, which go no further


def edge_shift(axis: AxisPlant) -> float:
    """How far an edge of an encoder line may lie from its place [counts]; edges of the averaged plant lie in theirs.

    A line is high for 1/2 and the duty error of its period of four counts: its rising edge comes early by half of that,
    the falling one late. Jitter comes on top, and half of the hysteresis.
    """
    if level() == "ideal":
        return 0.0
    return 2.0 * abs(axis.encoder_duty_error) + JITTER_REACH * axis.encoder_jitter + 0.5 * axis.encoder_hysteresis


@contextmanager
def spinning(plant: PlantConfig, seed: int) -> Iterator[Board]:
    """A fresh board with both axes in SPIN, holding where they are, at rest."""
    with fresh_board(plant, seed) as board:
        enable(board)
        board.run(SETTLED)
        yield board


def watch(
    board: Board,
    axes: Sequence[int],
    seconds: float,
    act: Callable[[int], None] | None = None,
    *,
    may_fail: bool = False,
) -> dict[int, Recording]:
    """Run slow tick by slow tick and keep what the firmware says and what is true.

    Parameters
    ----------
    board : Board
        On a slow-tick boundary, as `spinning` leaves it.
    axes : sequence of int
        Axes to record (index).
    seconds : float
        Length [s].
    act : callable, optional
        Called with the number of the tick before each one: writes set-points, loads, supply voltage.
    may_fail : bool
        A fault is what the run is about.

    Raises
    ------
    SimulationError
        If an axis ends in a fault and may not: nothing that is measured afterwards would mean anything.
    """
    ticks = round(seconds / TICK)
    start = board.time_ns
    if board.level == "registers":  # a slow loop, and the snapshot behind it, may last into the next PWM period
        start += (PERIOD_NS - start) % TICK_NS
        board.advance(start)
    truths: dict[int, list[tuple[float, float, float, float, float]]] = {axis: [] for axis in axes}
    rows: list[bytes] = []
    for k in range(ticks):
        if act is not None:
            act(k)
        rows.append(board.record(start + (k + 1) * TICK_NS).tobytes())
        for axis, kept in truths.items():
            t = board.truth(axis)
            kept.append((t.theta_m, t.omega_m, t.i_q, t.torque_e, t.u_dc))
    log = np.frombuffer(b"".join(rows), board.snapshot_dtype)  # concatenate() compares all fields of every row
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
) -> Recording:
    name, si = axis_name(axis), board.si(log)
    columns: dict[str, Any] = {"time": TICK * np.arange(1, log.size + 1, dtype=np.float64)}
    for signal in ("position", "position_ref"):
        columns[signal] = log[f"{name}.{signal}"].astype(np.float64)
    for signal in ("speed_ref", "speed", "i_q_ref", "i_q", "i_d", "u_d", "u_q"):
        columns[signal] = si[f"{name}.{signal}"]
    for signal in ("limits", "faults", "state", "substate"):
        columns[signal] = log[f"{name}.{signal}"].astype(np.int64)
    true = ("theta", "omega", "i_q_true", "torque", "u_dc")
    return Recording(**columns, **dict(zip(true, np.array(truths).T, strict=True)))


def set_axis(board: Board, name: str, axis: int, value: float) -> None:
    """Write one element of an array variable [SI]; for the firmware the other axis has not been written to."""
    variable = board.catalogue[name]
    _write_element(board, name, axis, variable.to_raw(value))


def _write_element(board: Board, name: str, axis: int, raw: int) -> None:
    variable = board.catalogue[name]
    data = variable.raw_type.pack(raw)
    board.write_memory(board.address(name) + axis * variable.element_size, data)


def get_axis(board: Board, name: str, axis: int) -> float:
    """One element of an array variable [SI]."""
    return float(np.asarray(board.read(name))[axis])


def features(board: Board, axis: int, **switches: bool) -> None:
    """Switch parts of the control on or off by the names of the catalogue, e.g. ``ANTI_WINDUP=False``."""
    masks = {flag.name: flag.mask for flag in board.catalogue.flags["features"]}
    word = board.read_raw("param.features")[axis]
    for name, on in switches.items():
        word = word | masks[name] if on else word & ~masks[name]
    _write_element(board, "param.features", axis, word)


def choose_mode(board: Board, axis: int, mode: str) -> None:
    """Write the mode of one axis by its name: POSITION, SPEED or TORQUE."""
    _write_element(board, "cmd.mode", axis, board.catalogue.enums["control_mode_t"][mode])


def set_up(
    board: Board,
    axis: int,
    mode: str | None = None,
    speed: float | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    **switches: bool,
) -> None:
    """Prepare one axis.

    Parameters
    ----------
    board, axis
        Which one (index).
    mode : str, optional
        POSITION, SPEED or TORQUE.
    speed : float, optional
        Set-point [rad/s].
    parameters : mapping, optional
        Values [SI] of parameters, by their names without ``param.``.
    **switches : bool
        As for `features`.
    """
    if switches:
        features(board, axis, **switches)
    for name, value in (parameters or {}).items():
        set_axis(board, f"param.{name}", axis, value)
    if mode is not None:
        choose_mode(board, axis, mode)
    if speed is not None:
        command_speed(board, axis, speed)


def largest(board: Board, parameter: str) -> float:
    """The most that a parameter can be set to [SI]."""
    maximum = board.catalogue[f"param.{parameter}"].maximum
    assert maximum is not None
    return maximum


def at(events: Mapping[float, Callable[[], object]]) -> Callable[[int], None]:
    """For `watch`: what happens at which time since the beginning [s]."""
    due = {round(time / TICK): do for time, do in events.items()}

    def act(k: int) -> None:
        if k in due:
            due[k]()

    return act


def word(board: Board, axis: int, name: str) -> int:
    """A variable of an axis as it stands in memory."""
    return board.read_raw(f"{axis_name(axis)}.{name}")[0]


def flags_of(board: Board, axis: int, name: str) -> set[str]:
    """Flags that are set in a word of an axis, such as ``faults``, by their names."""
    return {flag.name for flag in board.catalogue.active(name, word(board, axis, name))}


def until(board: Board, what: str, holds: Callable[[], bool], seconds: float, step: float = TICK) -> None:
    """Run until something holds, which is looked at every `step` [s].

    Raises
    ------
    SimulationError
        If it does not within so many `seconds`; says `what`, and where the axes are.
    """
    for _ in range(round(seconds / step)):
        if holds():
            return
        board.run(step)
    places = ", ".join(f"{axis_name(axis)} {flags_of(board, axis, 'faults') or 'no fault'}" for axis in range(AXES))
    raise SimulationError(f"not within {seconds:g} s: {what}; {places}")


def position_of(board: Board, axis: int) -> int:
    """Position that the firmware reports now [counts]."""
    return word(board, axis, "position")


def command_position(board: Board, axis: int, counts: int) -> None:
    """Position set-point [counts]."""
    _write_element(board, "cmd.position", axis, counts)


def command_speed(board: Board, axis: int, speed: float) -> None:
    """Speed set-point [rad/s]; the mode has been chosen before."""
    set_axis(board, "cmd.speed", axis, speed)


def stays_from(recording: Recording, signal: NDArray[np.float64], low: float, high: float) -> float | None:
    """Time from which on a signal stays within low .. high [s]; None when it does not."""
    outside = np.nonzero((signal < low) | (signal > high))[0]
    if outside.size == 0:
        return 0.0
    last = int(outside[-1])
    return float(recording.time[last]) if last + 1 < recording.time.size else None


def arrives(recording: Recording, target: float, within: float, since: float) -> float | None:
    """Time from `since` until the position stays within so many counts of a target [s]; None when it does not."""
    time = stays_from(recording, recording.position, target - within, target + within)
    return None if time is None else max(time - since, 0.0)


def overshoot(recording: Recording, target: float) -> float:
    """Farthest position beyond the target of a move that begins with the recording [counts]."""
    direction = 1.0 if target >= recording.position[0] else -1.0
    return max(float((direction * (recording.position - target)).max()), 0.0) + 0.0
