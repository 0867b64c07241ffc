"""Soft limits of position, speed and current: without them the shaft passes, with them it stops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_twin.board import Board
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.plant_limits import move_speeds, path_settles, ripple
from servo_twin.experiments.rig import (
    COUNT,
    TICK,
    Recording,
    choose_mode,
    command_position,
    command_speed,
    features,
    flag_mask,
    position_of,
    set_axis,
    spinning,
    watch,
)
from servo_twin.plant import PlantConfig

NAME: Final = "soft-limits"
HELP: Final = """\
Beyond the reference design, which limits nothing but the current of one experiment (F21: i_q to 1 A).
Shown, without and with each limit: the shaft is sent past a limit of its position (feature POSITION_LIMITS), in
position, speed and torque mode, and back; in torque mode a load drives it there and leans on the limit; a limit is set
behind a shaft at rest, which must not move it; a limit of the speed (param.speed_limit) and of the current
(param.i_q_limit). Every limit has to name itself in the word of limits."""

AWAY: Final = 2.0  # from the start to the limit of the position [turns]
FAR: Final = 4.0  # to the target beyond it [turns]
TORQUE: Final = 1.0  # asked for in torque mode [A]
OUT: Final = 2.0  # [s]
BACK: Final = 0.4  # [s]
BACK_SPEED: Final = 20.0  # [rad/s]
LEAN: Final = 1.0  # [A] worth of torque, by a load that leans on the limit
LEAN_AWAY: Final = 0.25  # from the start to that limit [turns]
LEAN_SPEED: Final = 20.0  # limit of the speed, low: braking the load feeds the bus [rad/s]
LEAN_TIME: Final = 1.0  # [s]
BEHIND: Final = 0.1  # the limit set behind the shaft [turns]
SETTLE: Final = 0.3  # [s]; more where a heavy shaft makes the path filter slow
FLAG_LAST: Final = 0.5  # the limit names itself all that time [s]

BEYOND_MOST: Final = 2.0
"""Past the limit in position mode [counts]."""

BEYOND_UNHELD_MOST: Final = 4.0
"""The same in speed and torque mode, where no position is held: two edges of track B [counts]."""

NEAR_MOST: Final = 0.01 * COUNTS_PER_TURN
"""The shaft stops so close to the limit [counts]; in torque mode where the current left is worth the friction."""

PASSES_LEAST: Final = 0.5 * COUNTS_PER_TURN  # without the limit [counts]
BACK_LEAST: Final = 0.01 * COUNTS_PER_TURN  # [counts]

SPEED_LIMIT: Final = 100.0  # [rad/s]
SPEED_ASKED: Final = 150.0  # [rad/s]
ACCELERATION: Final = 1000.0  # [rad/s^2]
SPEED_MOST: Final = 1.1  # of the limit: the speed controller overshoots at the end of its ramp
CURRENT_LIMIT: Final = 1.0  # [A]
CURRENT_MOST: Final = 1.15
"""Of the limit, the true current, mean over a slow loop; ripple of dead time and noise."""


@dataclass(frozen=True)
class Visit:
    """A run towards a limit of the position and back.

    Attributes
    ----------
    limit : int
        [counts].
    out, back : Recording
        Towards it and, commanded back, away from it.
    named : float
        Part of the last half second, before the way back, in which the limit named itself.
    """

    limit: int
    out: Recording
    back: Recording
    named: float

    @property
    def beyond(self) -> float:
        """Farthest true position beyond the limit [counts]; below zero when it was never reached."""
        return float((self.out.shaft - self.limit).max())

    @property
    def short(self) -> float:
        """From where the true shaft ends to the limit [counts]."""
        return float(self.limit - self.out.shaft[-1])

    @property
    def returned(self) -> float:
        """Way back after the command [counts]."""
        return float(self.out.shaft[-1] - self.back.shaft[-1])


Ask = Callable[[Board, int, int], None]
"""Command an axis (index) in view of a limit [counts]."""


def _position_out(board: Board, axis: int, limit: int) -> None:
    command_position(board, axis, limit + round((FAR - AWAY) * COUNTS_PER_TURN))


def _position_back(board: Board, axis: int, limit: int) -> None:
    command_position(board, axis, limit - COUNTS_PER_TURN)


MODES: Final[dict[str, tuple[Ask, Ask]]] = {
    "POSITION": (_position_out, _position_back),
    "SPEED": (
        lambda board, axis, limit: command_speed(board, axis, SPEED_ASKED),
        lambda board, axis, limit: command_speed(board, axis, -BACK_SPEED),
    ),
    "TORQUE": (
        lambda board, axis, limit: set_axis(board, "cmd.i_q", axis, TORQUE),
        lambda board, axis, limit: set_axis(board, "cmd.i_q", axis, -TORQUE),
    ),
}
"""Every mode, with what sends the shaft past the limit and what brings it back."""


def visit(plant: PlantConfig, seed: int, mode: str, limited: bool, speeds: list[float]) -> list[Visit]:
    """Both axes at once towards their limits, the speed limited to `speeds` [rad/s], and back."""
    go, come = MODES[mode]
    with spinning(plant, seed) as board:
        limits = [position_of(board, axis) + round(AWAY * COUNTS_PER_TURN) for axis in range(AXES)]
        for axis, limit in enumerate(limits):
            features(board, axis, POSITION_LIMITS=limited)
            set_axis(board, "param.position_max", axis, limit * COUNT)
            set_axis(board, "param.speed_limit", axis, speeds[axis])
            choose_mode(board, axis, mode)

        def once(ask: Ask) -> Callable[[int], None]:
            def act(k: int) -> None:
                if k == 0:
                    for axis, limit in enumerate(limits):
                        ask(board, axis, limit)

            return act

        out = watch(board, range(AXES), OUT, once(go))
        back = watch(board, range(AXES), BACK, once(come))
        mask = flag_mask(board, "limits", "POSITION")
    return [Visit(limit, out[a], back[a], _named(out[a], mask)) for a, limit in enumerate(limits)]


def _named(recording: Recording, mask: int) -> float:
    words = recording.limits[-round(FLAG_LAST / TICK) :]
    return float(np.mean((words & mask) != 0))


def lean(plant: PlantConfig, seed: int, limited: bool) -> list[float]:
    """Farthest that a load drives both shafts past their limits, in torque mode without torque [counts]."""
    with spinning(plant, seed) as board:
        limits = [position_of(board, axis) + round(LEAN_AWAY * COUNTS_PER_TURN) for axis in range(AXES)]
        for axis, limit in enumerate(limits):
            features(board, axis, POSITION_LIMITS=limited)
            set_axis(board, "param.position_max", axis, limit * COUNT)
            set_axis(board, "param.speed_limit", axis, LEAN_SPEED)
            choose_mode(board, axis, "TORQUE")
            board.set_load(axis, -LEAN * plant.axes[axis].torque_constant)  # a load opposes positive motion
        both = watch(board, range(AXES), LEAN_TIME)
    return [float((both[axis].shaft - limit).max()) for axis, limit in enumerate(limits)]


@dataclass(frozen=True)
class Behind:
    """A limit that is set behind a shaft at rest.

    Attributes
    ----------
    moved, farther, nearer : float
        Way after the limit has been set, after a target farther out, and after one inside [counts].
    """

    moved: float
    farther: float
    nearer: float


def set_behind(plant: PlantConfig, seed: int) -> list[Behind]:
    """Set the upper limit a little below where both shafts are."""
    settle = max(path_settles(plant, seed, SETTLE))
    with spinning(plant, seed) as board:
        here = [position_of(board, axis) for axis in range(AXES)]
        step = round(BEHIND * COUNTS_PER_TURN)
        for axis, position in enumerate(here):
            features(board, axis, POSITION_LIMITS=True)
            set_axis(board, "param.position_max", axis, (position - step) * COUNT)
        alone = watch(board, range(AXES), settle)
        for axis, position in enumerate(here):
            command_position(board, axis, position + step)
        farther = watch(board, range(AXES), settle)
        for axis, position in enumerate(here):
            command_position(board, axis, position - 2 * step)
        nearer = watch(board, range(AXES), settle)
    return [
        Behind(
            moved=float(np.ptp(alone[axis].shaft)),
            farther=float(np.ptp(farther[axis].shaft)),
            nearer=float(nearer[axis].shaft[0] - nearer[axis].shaft[-1]),
        )
        for axis in range(AXES)
    ]


@dataclass(frozen=True)
class Bounded:
    """A run into a limit of speed or current: largest true value, and whether the limit named itself."""

    most: float
    named: float
    recording: Recording


def turn(plant: PlantConfig, seed: int, mode: str, limit: float | None) -> list[Bounded]:
    """Both axes are asked for more speed than the limit [rad/s], in speed or torque mode."""
    with spinning(plant, seed) as board:
        for axis in range(AXES):
            set_axis(board, "param.speed_limit", axis, SPEED_ASKED if limit is None else limit)
            set_axis(board, "param.acceleration_limit", axis, ACCELERATION)
            choose_mode(board, axis, mode)
            MODES[mode][0](board, axis, 0)
        both = watch(board, range(AXES), OUT)
        mask = flag_mask(board, "limits", "SPEED")
    return [Bounded(float(np.abs(r.omega).max()), _named(r, mask), r) for r in both.values()]


def push(plant: PlantConfig, seed: int, limit: float | None) -> list[Bounded]:
    """Both axes are asked for more current than the limit [A], in torque mode."""
    with spinning(plant, seed) as board:
        for axis in range(AXES):
            set_axis(board, "param.speed_limit", axis, SPEED_LIMIT)
            if limit is not None:
                set_axis(board, "param.i_q_limit", axis, limit)
            choose_mode(board, axis, "TORQUE")
            board.lock_shaft(axis)
            set_axis(board, "cmd.i_q", axis, 2.0 * CURRENT_LIMIT)
        both = watch(board, range(AXES), SETTLE)
        mask = flag_mask(board, "limits", "CURRENT")
    return [Bounded(float(np.abs(r.i_q_true).max()), float(np.mean((r.limits & mask) != 0)), r) for r in both.values()]


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Every limit, without and with, both axes at once."""
    speeds, lowered = move_speeds(plant, seed, together=True)
    notes = ["beyond: true shaft past the limit", *([lowered] if lowered else [])]
    rows: list[Row] = []
    panels: list[Panel] = []
    for mode in MODES:
        free, limited = (visit(plant, seed, mode, on, speeds) for on in (False, True))
        most = BEYOND_MOST if mode == "POSITION" else BEYOND_UNHELD_MOST
        for axis in range(AXES):
            rows.extend(
                _rows_visit(f"{axis_name(axis)}, position, {mode.lower()} mode", most, free[axis], limited[axis])
            )
        panels.append(_panel(f"limit of the position, {mode.lower()} mode", free, limited))
    for axis, (free_way, way) in enumerate(zip(lean(plant, seed, False), lean(plant, seed, True), strict=True)):
        rows.extend(_rows_lean(f"{axis_name(axis)}, position, a load leans on it", free_way, way))
    for axis, behind in enumerate(set_behind(plant, seed)):
        rows.extend(_rows_behind(f"{axis_name(axis)}, limit set behind the shaft", behind))
    for mode in ("SPEED", "TORQUE"):
        rows.extend(_rows_speed(mode, turn(plant, seed, mode, None), turn(plant, seed, mode, SPEED_LIMIT)))
    rows.extend(_rows_current(plant, push(plant, seed, None), push(plant, seed, CURRENT_LIMIT)))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows_visit(what: str, most: float, free: Visit, limited: Visit) -> tuple[Row, ...]:
    return (
        Row(f"{what}: beyond without", BEYOND, free.beyond, "counts", Bound(PASSES_LEAST)),
        Row(f"{what}: beyond with", BEYOND, limited.beyond, "counts", Bound(most=most), apart=most + NEAR_MOST),
        Row(f"{what}: stops before", BEYOND, limited.short, "counts", Bound(-most, NEAR_MOST)),
        Row(f"{what}: names itself", BEYOND, limited.named, "of the time", Bound(1.0, 1.0)),
        Row(f"{what}: comes back", BEYOND, limited.returned, "counts", Bound(BACK_LEAST)),
    )


def _rows_lean(what: str, free: float, limited: float) -> tuple[Row, ...]:
    return (
        Row(f"{what}: beyond without", BEYOND, free, "counts", Bound(PASSES_LEAST)),
        Row(f"{what}: beyond with", BEYOND, limited, "counts", Bound(most=BEYOND_UNHELD_MOST)),
    )


def _rows_behind(what: str, behind: Behind) -> tuple[Row, ...]:
    still = Bound(most=BEYOND_MOST)
    step = BEHIND * COUNTS_PER_TURN
    inside = Bound(2.0 * step - BEYOND_MOST - 1.0, 2.0 * step + BEYOND_MOST + 1.0)
    return (
        Row(f"{what}: moves", BEYOND, behind.moved, "counts", still),
        Row(f"{what}, target farther out: moves", BEYOND, behind.farther, "counts", still),
        Row(f"{what}, target inside: moves", BEYOND, behind.nearer, "counts", inside),
    )


def _rows_speed(mode: str, free: list[Bounded], limited: list[Bounded]) -> list[Row]:
    rows: list[Row] = []
    for axis in range(AXES):
        what = f"{axis_name(axis)}, speed, {mode.lower()} mode"
        most = Bound(most=SPEED_MOST * SPEED_LIMIT)
        rows.append(Row(f"{what}: highest without", BEYOND, free[axis].most, "rad/s", Bound(1.2 * SPEED_LIMIT)))
        rows.append(Row(f"{what}: highest with", BEYOND, limited[axis].most, "rad/s", most))
        rows.append(Row(f"{what}: names itself", BEYOND, limited[axis].named, "of the time", Bound(1.0, 1.0)))
    return rows


def _rows_current(plant: PlantConfig, free: list[Bounded], limited: list[Bounded]) -> list[Row]:
    rows: list[Row] = []
    for axis in range(AXES):
        what = f"{axis_name(axis)}, current, torque mode"
        most = Bound(most=CURRENT_MOST * CURRENT_LIMIT + ripple(plant, axis, CURRENT_LIMIT))
        rows.append(Row(f"{what}: largest without", BEYOND, free[axis].most, "A", Bound(1.5 * CURRENT_LIMIT)))
        rows.append(Row(f"{what}: largest with", BEYOND, limited[axis].most, "A", most))
        rows.append(Row(f"{what}: names itself", BEYOND, limited[axis].named, "of the time", Bound(0.9, 1.0)))
    return rows


def _panel(title: str, free: list[Visit], limited: list[Visit]) -> Panel:
    curves: list[Curve] = []
    for axis in range(AXES):
        for label, v in (("without", free[axis]), ("with", limited[axis])):
            ticks = v.out.shaft < v.limit + 1.5 * COUNTS_PER_TURN
            curves.append(
                Curve(f"{axis_name(axis)} {label}", v.out.time[ticks], (v.out.shaft - v.limit)[ticks] / COUNTS_PER_TURN)
            )
    return Panel(title, "time [s]", "beyond the limit [turns]", tuple(curves))
