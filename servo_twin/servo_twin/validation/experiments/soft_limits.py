"""Soft limits of position, speed and current: runs without and with each limit."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.plant_limits import move_speeds, path_settles, ripple
from servo_twin.validation.experiments.rig import COUNT, shaft_counts

NAME: Final = "soft-limits"
HELP: Final = """\
Beyond the reference design, which limits only the current of one experiment (F21: i_q to 1 A). Shown, without and with
each limit: the shaft is commanded beyond a limit of its position (feature POSITION_LIMITS), in position, speed and
torque mode, and back; in torque mode a load drives it to the limit and keeps acting; a limit is set behind a shaft at
rest, which must not move; a limit of the speed (param.speed_limit) and of the current (param.i_q_limit). Every active
limit must be reported in axisN.limits."""

AWAY: Final = 2.0  # from the start to the limit of the position [turns]
FAR: Final = 4.0  # to the target beyond it [turns]
TORQUE: Final = 1.0  # set-point in torque mode [A]
OUT: Final = 2.0  # [s]
BACK: Final = 0.4  # [s]
BACK_SPEED: Final = 20.0  # [rad/s]
LOAD: Final = 1.0  # load torque towards the limit, as current [A]
LOAD_AWAY: Final = 0.25  # from the start to the limit [turns]
LOAD_SPEED: Final = 20.0  # speed limit; low, because braking the load feeds the bus [rad/s]
LOAD_TIME: Final = 1.0  # [s]
BEHIND: Final = 0.1  # distance of a limit set behind the shaft [turns]
SETTLE: Final = 0.3  # [s]; longer for a large inertia, because the path filter is slower
FLAG_LAST: Final = 0.5  # final time in which the limit must be reported [s]

BEYOND_MAX: Final = 2.0
"""Permitted overtravel in position mode [counts]."""

BEYOND_UNHELD_MAX: Final = 4.0
"""Permitted overtravel in speed and torque mode, without position control: two edges of track B [counts]."""

NEAR_MAX: Final = 0.01 * COUNTS_PER_TURN
"""Largest distance from the limit after the stop [counts]; in torque mode the remaining current equals the friction."""

PASSES_MIN: Final = 0.5 * COUNTS_PER_TURN  # smallest overtravel without the limit [counts]
BACK_MIN: Final = 0.01 * COUNTS_PER_TURN  # smallest motion back from the limit [counts]

SPEED_LIMIT: Final = 100.0  # [rad/s]
SPEED_COMMANDED: Final = 150.0  # [rad/s]
ACCELERATION: Final = 1000.0  # [rad/s^2]
SPEED_MAX: Final = 1.1  # relative to the limit: overshoot of the speed controller at the end of the ramp
CURRENT_LIMIT: Final = 1.0  # [A]
CURRENT_MAX: Final = 1.15
"""Largest true current, mean over a slow loop, relative to the limit: ripple by dead time, and noise."""


Command = Callable[[Board, int, int], None]
"""Command to an axis (index) for a limit [counts]."""

MODES: Final[dict[str, tuple[Command, Command]]] = {
    "POSITION": (
        lambda board, axis, limit: write_word(
            board, "cmd.position", axis, limit + round((FAR - AWAY) * COUNTS_PER_TURN)
        ),
        lambda board, axis, limit: write_word(board, "cmd.position", axis, limit - COUNTS_PER_TURN),
    ),
    "SPEED": (
        lambda board, axis, limit: write_axis(board, "cmd.speed", axis, SPEED_COMMANDED),
        lambda board, axis, limit: write_axis(board, "cmd.speed", axis, -BACK_SPEED),
    ),
    "TORQUE": (
        lambda board, axis, limit: write_axis(board, "cmd.i_q", axis, TORQUE),
        lambda board, axis, limit: write_axis(board, "cmd.i_q", axis, -TORQUE),
    ),
}
"""Modes with the commands beyond the limit and back."""


@dataclass(frozen=True)
class Run:
    """Run of one axis into a limit."""

    limit: int  # position limit [counts]
    out: Trace
    reported: float  # fraction of the time in which axisN.limits reported the limit
    back: Trace | None = None  # motion away from the limit

    @property
    def beyond(self) -> float:
        """Largest overtravel of the true position [counts]; negative: limit not reached."""
        return float((shaft_counts(self.out) - self.limit).max())


def _reported(recording: Trace, mask: int, seconds: float = FLAG_LAST) -> float:
    words = recording["limits"][-round(seconds / TICK) :]
    return float(np.mean((words & mask) != 0))


def run_to_position_limit(plant: PlantConfig, seed: int, mode: str, limited: bool, speeds: list[float]) -> list[Run]:
    """Move both axes to their position limits and back, with speed limits `speeds` [rad/s]."""
    with rig.spinning(plant, seed) as board:
        limits = [word(board, axis, "position") + round(AWAY * COUNTS_PER_TURN) for axis in range(AXES)]
        for axis, limit in enumerate(limits):
            parameters = {"position_max": limit * COUNT, "speed_limit": speeds[axis]}
            rig.set_up(board, axis, mode, parameters=parameters, POSITION_LIMITS=limited)

        def all_at_once(command: Command) -> None:
            for axis, limit in enumerate(limits):
                command(board, axis, limit)

        out, back = (
            rig.record(board, range(AXES), seconds, rig.at({0.0: functools.partial(all_at_once, command)}))
            for seconds, command in zip((OUT, BACK), MODES[mode], strict=True)
        )
        mask = board.catalogue.flag("limits", "POSITION").mask
    return [Run(limit, out[axis], _reported(out[axis], mask), back[axis]) for axis, limit in enumerate(limits)]


def load_overtravel(plant: PlantConfig, seed: int, limited: bool) -> list[float]:
    """Overtravel of both shafts, driven by a load, in torque mode without current set-point [counts]."""
    with rig.spinning(plant, seed) as board:
        limits = [word(board, axis, "position") + round(LOAD_AWAY * COUNTS_PER_TURN) for axis in range(AXES)]
        for axis, limit in enumerate(limits):
            parameters = {"position_max": limit * COUNT, "speed_limit": LOAD_SPEED}
            rig.set_up(board, axis, "TORQUE", parameters=parameters, POSITION_LIMITS=limited)
            board.set_load(axis, -LOAD * plant.axes[axis].torque_constant)  # a load opposes positive motion
        both = rig.record(board, range(AXES), LOAD_TIME)
    return [float((shaft_counts(both[axis]) - limit).max()) for axis, limit in enumerate(limits)]


def set_behind(plant: PlantConfig, seed: int) -> list[dict[int, Trace]]:
    """Set the upper limit below the present position of both shafts; then a target beyond it, and one inside."""
    settle = max(path_settles(plant, seed, SETTLE))
    with rig.spinning(plant, seed) as board:
        here = [word(board, axis, "position") for axis in range(AXES)]
        step = round(BEHIND * COUNTS_PER_TURN)
        for axis, position in enumerate(here):
            parameters = {"position_max": (position - step) * COUNT}
            rig.set_up(board, axis, parameters=parameters, POSITION_LIMITS=True)
        found = [rig.record(board, range(AXES), settle)]
        for target in (step, -2 * step):
            for axis, position in enumerate(here):
                write_word(board, "cmd.position", axis, position + target)
            found.append(rig.record(board, range(AXES), settle))
    return found


def run_to_speed_limit(plant: PlantConfig, seed: int, mode: str, limit: float | None) -> list[Run]:
    """Command both axes to a speed above the limit [rad/s], in speed or torque mode."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            speed = SPEED_COMMANDED if limit is None else limit
            rig.set_up(board, axis, mode, parameters={"speed_limit": speed, "acceleration_limit": ACCELERATION})
            MODES[mode][0](board, axis, 0)
        both = rig.record(board, range(AXES), OUT)
        mask = board.catalogue.flag("limits", "SPEED").mask
    return [Run(0, r, _reported(r, mask)) for r in both.values()]


def run_to_current_limit(plant: PlantConfig, seed: int, limit: float | None) -> list[Run]:
    """Command both axes to a current above the limit [A], in torque mode."""
    with rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            parameters = {"speed_limit": SPEED_LIMIT} | ({} if limit is None else {"i_q_limit": limit})
            rig.set_up(board, axis, "TORQUE", parameters=parameters)
            board.lock_shaft(axis)
            write_axis(board, "cmd.i_q", axis, 2.0 * CURRENT_LIMIT)
        both = rig.record(board, range(AXES), SETTLE)
        mask = board.catalogue.flag("limits", "CURRENT").mask
    return [Run(0, r, _reported(r, mask, SETTLE)) for r in both.values()]


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every limit, without and with, both axes simultaneously."""
    speeds, lowered = move_speeds(plant, seed, together=True)
    yield "overtravel: true shaft past the limit"
    yield lowered
    names = [axis_name(axis) for axis in range(AXES)]
    for mode in MODES:
        free, limited = (run_to_position_limit(plant, seed, mode, on, speeds) for on in (False, True))
        for name, *pair in zip(names, free, limited, strict=True):
            maximum = BEYOND_MAX if mode == "POSITION" else BEYOND_UNHELD_MAX
            yield from _rows_visit(Judge(f"{name}, position, {mode.lower()} mode: "), maximum, *pair)
        yield _panel(f"position limit, {mode.lower()} mode", free, limited)
    for name, overtravel, limited_overtravel in zip(
        names, load_overtravel(plant, seed, False), load_overtravel(plant, seed, True), strict=True
    ):
        judge = Judge(f"{name}, position, load towards the limit: ")
        yield judge("overtravel without the feature", overtravel, "counts", PASSES_MIN)
        yield judge("overtravel with the feature", limited_overtravel, "counts", maximum=BEYOND_UNHELD_MAX)
    alone, farther, nearer = set_behind(plant, seed)
    for axis, name in enumerate(names):
        judge, back = Judge(f"{name}, limit set behind the shaft"), shaft_counts(nearer[axis])
        moved, off = 2.0 * BEHIND * COUNTS_PER_TURN, BEYOND_MAX + 1.0
        yield judge(": motion", np.ptp(shaft_counts(alone[axis])), "counts", maximum=BEYOND_MAX)
        yield judge(
            ", target further outside: motion", np.ptp(shaft_counts(farther[axis])), "counts", maximum=BEYOND_MAX
        )
        yield judge.near(", target inside: motion", back[0] - back[-1], "counts", moved, off)
    for mode in ("SPEED", "TORQUE"):
        free, limited = (run_to_speed_limit(plant, seed, mode, limit) for limit in (None, SPEED_LIMIT))
        for name, *pair in zip(names, free, limited, strict=True):
            maximum, minimum = SPEED_MAX * SPEED_LIMIT, 1.2 * SPEED_LIMIT
            without, with_it = (float(np.abs(one_run.out["omega"]).max()) for one_run in pair)
            judge = Judge(f"{name}, speed, {mode.lower()} mode: ")
            yield judge("highest speed without the limit", without, "rad/s", minimum)
            yield judge("highest speed with the limit", with_it, "rad/s", maximum=maximum)
            yield judge("limit flag set", pair[1].reported, "of the time", 1.0, 1.0)
    free, limited = (run_to_current_limit(plant, seed, limit) for limit in (None, CURRENT_LIMIT))
    for axis, name in enumerate(names):
        judge, pair = Judge(f"{name}, current, torque mode: "), [free[axis], limited[axis]]
        without, with_it = (float(np.abs(one_run.out["i_q_true"]).max()) for one_run in pair)
        maximum = CURRENT_MAX * CURRENT_LIMIT + ripple(plant, axis, CURRENT_LIMIT)
        yield judge("largest current without the limit", without, "A", 1.5 * CURRENT_LIMIT)
        yield judge("largest current with the limit", with_it, "A", maximum=maximum)
        yield judge("limit flag set", pair[1].reported, "of the time", 0.9, 1.0)


def _rows_visit(judge: Judge, maximum: float, free: Run, limited: Run) -> Iterator[Row]:
    assert limited.back is not None
    last = shaft_counts(limited.out)[-1]
    yield judge("overtravel without the feature", free.beyond, "counts", PASSES_MIN)
    yield judge("overtravel with the feature", limited.beyond, "counts", maximum=maximum, apart=maximum + NEAR_MAX)
    yield judge("distance to the limit at standstill", limited.limit - last, "counts", -maximum, NEAR_MAX)
    yield judge("limit flag set", limited.reported, "of the time", 1.0, 1.0)
    yield judge("return motion after reversal", last - shaft_counts(limited.back)[-1], "counts", BACK_MIN)


def _panel(title: str, free: list[Run], limited: list[Run]) -> Panel:
    curves: list[Curve] = []
    for axis, (label, runs) in itertools.product(range(AXES), (("without", free), ("with", limited))):
        time, beyond = runs[axis].out.time, shaft_counts(runs[axis].out) - runs[axis].limit
        shown = beyond < 1.5 * COUNTS_PER_TURN
        curves.append(Curve(f"{axis_name(axis)} {label}", time[shown], beyond[shown] / COUNTS_PER_TURN))
    return Panel(title, "time [s]", "beyond the limit [turns]", curves)
