"""A move of an axis under position control and back, recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_measurement.access import OSCILLATION, Capture, MeasurementError
from servo_measurement.running_axis import RunningAxis
from servo_measurement.step_response import StepFigures, measure_step

TOLERANCE: Final = 0.02
"""Largest distance to the target of a shaft that has arrived, unless another one is wanted [rad]."""

OVERSHOOT_MAX: Final = 0.1
"""Largest overshoot of a move, relative."""

COLUMNS: Final = ("position", "position_ref")

HOLD: Final = 0.1
"""Time for which it has to have arrived [s]."""

_FIRST: Final = 1.0  # length of the first recording [s]
_LONGER: Final = 2.0  # of the next one, if the path is longer
_LONGEST: Final = 30.0  # [s]
_SETTLING: Final = 10.0  # recorded after the end of the path, over the time constant of the position loop
_AFTER: Final = 0.25  # the same at least [s]
_RETURN: Final = 5.0  # timeout of the way back after a recording that was too short, over its length


@dataclass(frozen=True)
class Move:
    """A recorded move."""

    trace: Trace  # `COLUMNS`, from before the start to after the end of the path
    target: float  # [rad]
    figures: StepFigures  # since the start of the path

    @property
    def start(self) -> float:
        """Time at which the path begins, in the trace [s]."""
        return float(self.trace.time[_changes(self.trace)[0]])

    @property
    def end(self) -> float:
        """Time at which the path ends, in the trace [s]."""
        return float(self.trace.time[_changes(self.trace)[-1] + 1])

    @property
    def distance(self) -> float:
        """Length of the path [rad]."""
        return abs(self.target - float(self.trace["position_ref"][0]))

    @property
    def rest(self) -> NDArray[np.float64]:
        """Distance to the target at the end, where the shaft has to have arrived, shape (samples,) [rad]."""
        return np.asarray(self.trace.part(float(self.trace.time[-1]) - HOLD)["position"] - self.target)

    @property
    def settling(self) -> float | None:
        """Time from the end of the path until the shaft has arrived [s]; None: it has not."""
        settled = self.figures.settling_time
        return None if settled is None else max(self.start + settled - self.end, 0.0)


def _changes(trace: Trace) -> NDArray[np.intp]:
    """Samples after which the set-point changes."""
    return np.nonzero(np.diff(trace["position_ref"]))[0]


def move_and_back(
    rig: RunningAxis,
    distance: float,
    position_gain: float,
    tolerance: float = TOLERANCE,
    block: Mapping[str, int] | None = None,
    observed: bool | None = None,
) -> list[Move]:
    """Enable an axis, move it by a distance [rad] and back, and disable it.

    Parameters
    ----------
    rig : RunningAxis
        The axis, disabled.
    distance : float
        Of the move [rad].
    position_gain : float
        Of the position loop [1/s].
    tolerance : float
        Largest distance to the target of a shaft that has arrived [rad].
    block : mapping, optional
        Configuration during the move; None: that of the board.
    observed : bool, optional
        Whether the speed is that of the observer; None: as on the board.

    Returns
    -------
    list of Move
        There and back.

    Raises
    ------
    MeasurementError
        If the move is not possible, or the board finds an oscillation.
    """
    with rig.prepared(True, block=block, observed=observed):
        start, after, moves = rig.value("position"), max(_SETTLING / position_gain, _AFTER), []
        seconds = _FIRST + after
        for target in (start + distance, start):
            move, seconds = _recorded(rig, target, tolerance, seconds, after)
            moves.append(move)
    return moves


def _recorded(rig: RunningAxis, target: float, tolerance: float, seconds: float, after: float) -> tuple[Move, float]:
    """Move to a target [rad]; the recording [s] is repeated, and longer, until it contains the path and some time."""
    begin = rig.value("position_ref")
    while True:
        trace = _trace(rig, target, seconds)
        changes = _changes(trace)
        if changes.size and trace.time[-1] - trace.time[changes[-1] + 1] >= after:
            break
        if not changes.size:
            rig.refuse_limits()
            raise MeasurementError(f"{rig.name} does not follow its set-point: another program commands it")
        if seconds >= _LONGEST:
            raise MeasurementError(
                f"a move by {target - begin:.3g} rad takes {rig.name} longer than {seconds:g} s: raise "
                "limits.acceleration or limits.speed, or use a smaller --range"
            )
        rig.command("cmd.position", begin)
        rig.until(lambda: rig.value("position_ref") == begin, _RETURN * seconds, "does not return")
        seconds *= _LONGER
    first = int(changes[0])
    time, position = trace.time[first:] - trace.time[first], trace["position"][first:]
    figures = measure_step(time, position, target, tolerance, reference=trace["position_ref"][first:], hold=HOLD)
    return Move(trace, target, figures), seconds


def _trace(rig: RunningAxis, target: float, seconds: float) -> Trace:
    capacity = rig.access.capacity([f"{rig.name}.{column}" for column in COLUMNS])
    every = math.ceil(seconds / TICK / capacity)

    def refuse_oscillation() -> None:
        if rig.is_limited("OSCILLATION"):
            text = f"{rig.name} oscillates at {rig.value('oscillation'):.0f} Hz during the move"
            raise MeasurementError(text, about=OSCILLATION)

    capture = Capture(
        COLUMNS,
        min(capacity, math.ceil(seconds / (every * TICK))),
        every,
        slow=True,
        start=lambda: rig.command("cmd.position", target),
        meanwhile=lambda _: refuse_oscillation(),
    )
    recorded = rig.record(capture)
    refuse_oscillation()  # the limit stays active while the axis is enabled
    return Trace(recorded.step, {column: recorded[f"{rig.name}.{column}"] for column in COLUMNS})
