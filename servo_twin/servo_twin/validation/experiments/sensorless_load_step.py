"""Largest load step that a sensorless axis tolerates, over speed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.plant_limits import current_limits
from servo_twin.validation.experiments.rig import RPM
from servo_twin.validation.experiments.sensorless import ended, follow, limits_of, remove_load_if_ended, started

NAME: Final = "sensorless-load-step"
HELP: Final = """\
An axis without an encoder turns steadily without load; then a torque against the motion is applied in a step, and
removed in a step. The load is active: if the motor cannot hold it, it reverses the shaft. The steps increase, over a
range of speeds, until the rotor loses synchronism. The reference design does not show this. In theory a load step T
reduces the speed by T / (J w e) if the speed loop has two poles at w and measures the speed without delay; a bound is
the step that would stop the shaft with a loop of 30 Hz, within the current limit. The notes give the speed drops."""

SPEEDS: Final = (0.05, 0.08, 0.13, 0.2, 0.4, 0.8)
"""Speeds, relative to the speed limit."""

STEPS: Final = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Load steps, relative to the torque at the current limit."""

BANDWIDTH: Final = 30.0
"""Bandwidth of the speed loop in the theory [Hz]."""

LOAD_MAX: Final = 0.5
"""Largest required load step, relative to the torque at the current limit: the remainder accelerates the shaft."""

SETTLE: Final = 0.4  # time at a speed before the first step [s]
LOADED: Final = 0.3  # [s]
ERROR_MAX: Final = 0.1  # permitted relative error of the mean speed at the end of LOADED


@dataclass(frozen=True)
class Tolerated:
    """Result at one speed."""

    speed: float  # [rad/s]
    torque: float = 0.0  # largest tolerated step, with all smaller ones tolerated [N m]
    speed_drop: float = 0.0  # speed drop by this step [rad/s]
    trace: Trace | None = None  # trace of this step
    end: str = ""  # failure of the next step; empty: not tested


def theoretical_speed_drop(motor: AxisPlant, torque: float) -> float:
    """Theoretical speed drop by a load step [rad/s]."""
    # w is half the crossover frequency
    return torque / (motor.inertia * math.pi * BANDWIDTH * math.e)


def largest_step(plant: PlantConfig, seed: int, axis: int, part: float, steps: Sequence[float]) -> Tolerated:
    """Increasing steps, relative to the torque at the current limit, at a speed relative to the limit."""
    with started(plant, seed, {axis: 1.0}) as board:
        limit, current = limits_of(board, axis)
        speed = part * limit
        write_axis(board, "cmd.speed", axis, speed)
        follow(board, [], SETTLE)
        best = Tolerated(speed)
        for step in steps:
            torque = step * current * plant.axes[axis].torque_constant
            trace, end = _loaded(board, axis, torque, speed)
            if end:
                return replace(best, end=end)
            best = Tolerated(speed, torque, speed - float(trace["omega"].min()), trace)
        return best


def _loaded(board: Board, axis: int, torque: float, speed: float) -> tuple[Trace, str]:
    """Apply and remove a load; returns the trace and the reason of a failure."""
    traces: list[Trace] = []
    end = ""
    for load in (torque, 0.0):
        board.set_load(axis, load)
        traces.append(follow(board, [axis], LOADED, lambda _: remove_load_if_ended(board, axis))[axis])
        end = end or ended(board, axis) or _slow(traces[-1], speed)
    return traces[0], end


def _slow(trace: Trace, speed: float) -> str:
    mean = float(trace.part(0.7 * LOADED)["omega"].mean())
    return f"a mean of {mean / RPM:.3g} rpm" if abs(mean / speed - 1.0) > ERROR_MAX else ""


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes, every speed."""
    currents = current_limits(plant, seed)
    for axis in range(AXES):
        name, motor = axis_name(axis), plant.axes[axis]
        found = [largest_step(plant, seed, axis, part, STEPS) for part in SPEEDS]
        maximum = 1e3 * LOAD_MAX * currents[axis] * motor.torque_constant
        theory = [1e3 * largest.speed / theoretical_speed_drop(motor, 1.0) for largest in found]
        for largest, step in zip(found, theory, strict=True):
            where = f"{name} at {largest.speed / RPM:.0f} rpm"
            yield Judge(f"{where}, ", NOT_SHOWN)(
                "largest tolerated step", 1e3 * largest.torque, "mN m", min(step, maximum)
            )
            after = f"next step: {largest.end}" if largest.end else "largest tested step"
            yield (
                f"{where}: {1e3 * largest.torque:.0f} mN m reduce the speed by {largest.speed_drop / RPM:.0f} rpm, "
                f"theory {theoretical_speed_drop(motor, largest.torque) / RPM:.0f} rpm; {after}"
            )
        x = np.array([largest.speed / RPM for largest in found])
        tolerated = np.array([1e3 * largest.torque for largest in found])
        theory_curve = Curve(f"theoretical speed drop to standstill, {BANDWIDTH:g} Hz", x, np.array(theory), "--")
        curves = Curve("tolerated", x, tolerated, "o-"), theory_curve
        yield Panel(f"{name}: largest load step", "speed [rpm]", "torque [mN m]", curves, log_x=True)
        slow, trace = found[0], found[0].trace
        if trace is not None:
            curves = (
                Curve("true", trace.time, trace["omega"] / RPM),
                Curve("observed", trace.time, trace["speed"] / RPM),
            )
            title = f"{name}: {1e3 * slow.torque:.0f} mN m at {slow.speed / RPM:.0f} rpm"
            yield Panel(title, "time [s]", "speed [rpm]", curves)
