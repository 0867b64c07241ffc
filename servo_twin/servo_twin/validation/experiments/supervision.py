"""Following-error and over-speed faults: time to outputs off, and no false alarms in permitted moves."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import current_limits, move_speeds

NAME: Final = "supervision"
HELP: Final = """\
Beyond the reference design, which does not monitor the motion: following error too large (feature
FOLLOWING_ERROR, param.following_error) or speed too high (OVER_SPEED, param.over_speed). Shown, without and with each:
the shaft is blocked during a move; a load of 1.25 times the peak torque stops a move and drives the shaft back; such a
load drives the shaft of an axis in torque mode; a set-point commands more speed than the machine permits. Time from
the cause to outputs off, and the reported fault. Then the most demanding permitted moves and load steps of half the
peak torque must cause no fault."""

FOLLOWING: Final = 1.0
"""Threshold of the following error [rad]."""

LOAD: Final = 1.25  # relative to the torque at the current limit
PERMITTED_LOAD: Final = 0.5  # relative to the torque at the current limit
CAUSE: Final = 0.3  # time of the cause [s]
OBSERVED: Final = 1.0  # time after the cause [s]
FOLLOWING_TIME: Final = 0.01  # confirmation time of a following error [s]
OVER_SPEED_TIME: Final = 0.002  # confirmation time of an over-speed [s]
REACTION_TIME: Final = 4.0 * TICK
"""Time for measuring, computing and switching off [s]."""

SPEED: Final = 0.5  # relative to the speed limit, in speed and torque mode
OVER_SPEED: Final = 1.2  # relative to the commanded speed, or to the limit in torque mode
EXCESSIVE_SPEED: Final = 1.5  # set-point that is too high, relative to the commanded speed
ACCELERATION: Final = 1000.0  # [rad/s^2]

TIME_RATIO_MAX: Final = 0.8
"""Largest detection time relative to the time without the feature, if there is any."""

CURRENT_FRACTION: Final = 0.55
"""Current for the acceleration, relative to the current limit: a reversal during a move needs twice as much."""

REVERSING_MOVES: Final = (5.0, -5.0, 100.0)  # [turns], forth and back without standstill
REVERSAL: Final = 0.12  # until the second set-point overrides the first [s]
REST: Final = 0.6  # [s]


@dataclass(frozen=True)
class Response:
    """Response of one axis to a cause."""

    time: float | None  # from the cause to outputs off [s]
    fault: int  # faults at this time
    turned: float  # motion of the shaft from the cause to outputs off, or to the end [turns]
    recording: Trace

    @classmethod
    def of(cls, recording: Trace, cause: float) -> Response:
        """Evaluate a recording; `cause` in seconds."""
        run = Catalogue.load().enums["state_t"]["RUN"]
        off = (recording["state"] != run) & (recording.time > cause)
        first = int(np.argmax(off)) if off.any() else recording.time.size - 1
        begin = int(np.argmax(recording.time >= cause))
        time = float(recording.time[first] - cause) if off.any() else None
        turned = float(np.ptp(recording["theta"][begin : first + 1])) / (2.0 * math.pi)
        return cls(time, int(recording["faults"][first]), turned, recording)


@dataclass(frozen=True)
class Bench:
    """A plant and its limits."""

    plant: PlantConfig
    seed: int
    speeds: list[float]  # feasible speed limits for moves, by axis [rad/s]
    peaks: list[float]  # torque of each axis at its current limit [N m]

    @classmethod
    def of(cls, plant: PlantConfig, seed: int) -> Bench:
        speeds, _ = move_speeds(plant, seed, together=True, share=CURRENT_FRACTION)
        currents = current_limits(plant, seed)
        peaks = [axis.torque_constant * current for axis, current in zip(plant.axes, currents, strict=True)]
        return cls(plant, seed, speeds, peaks)


Action = Callable[[Bench, Board, int], None]
"""Action on one axis (index)."""


def play(
    bench: Bench, on: bool, prepare: Action, act: Callable[[Board, int], None], seconds: float
) -> dict[int, Trace]:
    """Run both axes with the features on or off; `act` is called with the number of each slow tick."""
    with rig.spinning(bench.plant, bench.seed) as board:
        for axis in range(AXES):
            parameters = {"following_error": FOLLOWING, "speed_limit": bench.speeds[axis]}
            rig.set_up(board, axis, parameters=parameters, FOLLOWING_ERROR=on, OVER_SPEED=on)
            prepare(bench, board, axis)
        return rig.record(board, range(AXES), seconds, lambda k: act(board, k), may_fail=True)


# ---- motions and causes ----------------------------------------------------------------------------------------------


def _long_move(_: Bench, board: Board, axis: int) -> None:
    """Command a very long move."""
    write_word(board, "cmd.position", axis, word(board, axis, "position") + 1000 * COUNTS_PER_TURN)


def _turn(bench: Bench, board: Board, axis: int) -> None:
    """Command half the speed, and set the over-speed threshold."""
    speed = SPEED * bench.speeds[axis]
    parameters = {"acceleration_limit": ACCELERATION, "over_speed": OVER_SPEED * speed}
    rig.set_up(board, axis, "SPEED", speed, parameters=parameters)


def _torque_mode(bench: Bench, board: Board, axis: int) -> None:
    """Torque mode with a current set-point, with half of the speed as limit."""
    _turn(bench, board, axis)
    rig.set_up(board, axis, "TORQUE", parameters={"speed_limit": SPEED * bench.speeds[axis]})
    write_axis(board, "cmd.i_q", axis, 0.25 * bench.peaks[axis] / bench.plant.axes[axis].torque_constant)


def blocked_max(bench: Bench, axis: int) -> float:
    """Largest detection time: the set-point moves at the speed limit, the shaft is blocked [s]."""
    return FOLLOWING / bench.speeds[axis] + FOLLOWING_TIME + REACTION_TIME


def overloaded_max(bench: Bench, axis: int) -> float:
    """Largest detection time: the excess of the load over the drive torque decelerates the shaft [s]."""
    braking = (LOAD - 1.0) * bench.peaks[axis] / bench.plant.axes[axis].inertia
    return math.sqrt(2.0 * FOLLOWING / braking) + FOLLOWING_TIME + REACTION_TIME


@dataclass(frozen=True)
class Cause:
    """A cause on both axes, and the expected fault."""

    name: str
    fault: str
    prepare: Action  # motion before the cause
    do: Action
    maximum: Callable[[Bench, int], float] = lambda bench, axis: OVER_SPEED_TIME + REACTION_TIME
    """Largest time to outputs off [s]; for OVER_SPEED from the time at which the true speed exceeds the threshold."""

    def responses(self, bench: Bench, on: bool) -> list[Response]:
        """Responses of both axes."""

        def act(board: Board, k: int) -> None:
            if k == round(CAUSE / TICK):
                for axis in range(AXES):
                    self.do(bench, board, axis)

        both = play(bench, on, self.prepare, act, CAUSE + OBSERVED)
        return [Response.of(r, self._since(bench, axis, r)) for axis, r in both.items()]

    def _since(self, bench: Bench, axis: int, r: Trace) -> float:
        if self.fault != "OVER_SPEED":
            return CAUSE
        beyond = np.abs(r["omega"]) > OVER_SPEED * SPEED * bench.speeds[axis]
        return float(r.time[int(np.argmax(beyond))] if beyond.any() else r.time[-1])


BLOCKED: Final = Cause(
    "shaft blocked in a move", "FOLLOWING_ERROR", _long_move, lambda _, board, axis: board.lock_shaft(axis), blocked_max
)
CAUSES: Final = (
    BLOCKED,
    Cause(
        "too large load in a move", "FOLLOWING_ERROR", _long_move,
        lambda bench, board, axis: board.set_load(axis, LOAD * bench.peaks[axis]), overloaded_max,
    ),
    Cause(
        "driven by a load", "OVER_SPEED", _torque_mode,
        lambda bench, board, axis: board.set_load(axis, -LOAD * bench.peaks[axis]),
    ),
    Cause(
        "set-point too fast", "OVER_SPEED", _turn,
        lambda bench, board, axis: write_axis(board, "cmd.speed", axis, EXCESSIVE_SPEED * SPEED * bench.speeds[axis]),
    ),
)  # fmt: skip


def permitted_operation(bench: Bench, forward: bool) -> int:
    """Both features on: demanding moves forth and back, load steps at standstill; returns all faults."""
    faults, turns = 0, list(REVERSING_MOVES)

    def begin(_: Bench, board: Board, axis: int) -> None:
        rig.features(board, axis, SPEED_FORWARD=forward, ACCELERATION_FORWARD=forward, FRICTION=forward)

    def move(board: Board, k: int) -> None:
        if k % round(REVERSAL / TICK) == 0 and turns:
            far = turns.pop(0)
            for axis in range(AXES):
                write_word(board, "cmd.position", axis, word(board, axis, "position") + round(far * COUNTS_PER_TURN))

    def load(board: Board, k: int) -> None:
        share = {
            round(REST / TICK): PERMITTED_LOAD,
            round(2.0 * REST / TICK): -PERMITTED_LOAD,
            round(3.0 * REST / TICK): 0.0,
        }
        if k in share:
            for axis in range(AXES):
                board.set_load(axis, share[k] * bench.peaks[axis])

    distance = sum(map(abs, REVERSING_MOVES)) * 2.0 * math.pi
    for act, seconds in ((move, distance / min(bench.speeds) + REST), (load, 4.0 * REST)):
        both = play(bench, True, begin, act, seconds)
        faults |= int(np.bitwise_or.reduce([np.bitwise_or.reduce(r["faults"]) for r in both.values()]))
    return faults


# ---- the experiment --------------------------------------------------------------------------------------------------


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Every cause without and with the features, then the test for false alarms."""
    bench = Bench.of(plant, seed)
    masks = {flag.name: flag.mask for flag in Catalogue.load().flags["faults"]}
    yield f"following error {FOLLOWING:g} rad; moves at {min(bench.speeds):.3g} rad/s"
    for cause in CAUSES:
        curves: list[Curve] = []
        for axis, pair in enumerate(zip(*(cause.responses(bench, on) for on in (False, True)), strict=True)):
            what, (without, supervised) = f"{axis_name(axis)}, {cause.name}: ", pair
            judge, time = Judge(what), supervised.time
            sooner = math.inf if without.time is None else without.time
            yield judge("time until outputs off", time, "s", 0.0, cause.maximum(bench, axis))
            yield judge.true("expected fault reported", supervised.fault == masks[cause.fault])
            yield judge(
                "time with / without the feature", None if time is None else time / sooner, maximum=TIME_RATIO_MAX
            )
            yield f"{what}without {_description(without, masks)}; with {_description(supervised, masks)}"
            ends = {"without": without, "with": supervised}
            curves += [_until_off(f"{axis_name(axis)} {how}", end) for how, end in ends.items()]
        yield Panel(f"{cause.name}: until the outputs are off", "time [s]", "speed [rad/s]", curves)
    for how, forward in (("", False), (", with feed-forward", True)):
        yield Judge().none(f"hard moves and load steps{how}: faults", permitted_operation(bench, forward))


def _description(event: Response, masks: Mapping[str, int]) -> str:
    if event.time is None:
        return f"no fault, {event.turned:.3g} turns"
    faults = " and ".join(name for name, mask in masks.items() if event.fault & mask)
    return f"{faults} after {1e3 * event.time:.3g} ms, {event.turned:.3g} turns"


def _until_off(label: str, event: Response) -> Curve:
    r = event.recording
    end = r.time[-1] if not r["faults"].any() else r.time[int(np.argmax(r["faults"] != 0))]
    shown = (r.time > CAUSE - 0.05) & (r.time <= end)
    return Curve(label, r.time[shown], r["omega"][shown])
