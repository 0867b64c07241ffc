"""Lowest steady speed of a sensorless axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import RPM
from servo_twin.validation.experiments.sensorless import (
    angle_error,
    back_emf,
    dead_voltage,
    ended,
    follow,
    limits_of,
    remove_load_if_ended,
    started,
)

NAME: Final = "minimum-speed"
HELP: Final = """\
Speed control without an encoder, from 0.3 of the speed limit downwards in steps: without load, and with loads of a
quarter and half of the current limit against the motion. The reference design states a minimum speed of 5 % of the
maximum (ST document, performance). Measured: the lowest set-point, as a fraction of the speed limit, that is
maintained: the mean true speed within 3 % of it, without standstill. The largest speed must stay below 1.5 times the
first set-point."""

STEPS: Final = (0.3, 0.15, 0.1, 0.08, 0.07, 0.06, 0.05, 0.045, 0.04, 0.035, 0.03, 0.025, 0.02)
"""Set-points, relative to the speed limit."""

LOADS: Final = (0.0, 0.25, 0.5)
"""Loads, relative to the torque at the current limit."""

REFERENCE_MAX: Final = 5.0
"""Minimum speed of the reference design [% of the maximum]."""

EMF_MIN: Final = 0.4
"""Smallest back-EMF for the bound, relative to the voltage of dead time and drops."""

MEAN_MAX: Final = 0.03
"""Permitted relative error of the true mean speed."""

SETTLE: Final = 0.5  # settling time after each step [s]
MEASURED: Final = 0.75  # time of the measurement [s]
LOADING: Final = 0.4  # ramp of the load, slow enough for a small speed drop [s]

RUNAWAY_MAX: Final = 1.5
"""Largest speed relative to the highest set-point: no runaway when the rotor is not observable."""


@dataclass(frozen=True)
class Descent:
    """Decreasing speeds of one axis."""

    speeds: tuple[float, ...]  # maintained speeds [rad/s]
    end: str  # reason of the end
    fastest: float  # largest magnitude of the true speed [rad/s]
    trace: Trace  # trace at the lowest maintained speed


def loaded(board: Board, axis: int, torque: float) -> None:
    """Increase a load [N m] against positive motion."""
    ticks = round(LOADING / TICK)
    follow(board, [], LOADING, lambda k: board.set_load(axis, torque * (k + 1) / ticks))


def descend(plant: PlantConfig, seed: int, axis: int, load: float, steps: Sequence[float]) -> Descent:
    """Decrease the speed in steps (relative to the limit), with a load relative to the torque at the current limit."""
    motor = plant.axes[axis]
    with started(plant, seed, {axis: 1.0}) as board:
        limit, current = limits_of(board, axis)
        write_axis(board, "cmd.speed", axis, steps[0] * limit)
        follow(board, [], SETTLE)
        loaded(board, axis, load * current * motor.torque_constant)
        held: list[float] = []
        last, fastest, end = None, 0.0, "the last step"
        for part in steps:
            speed = part * limit
            write_axis(board, "cmd.speed", axis, speed)
            trace = follow(board, [axis], SETTLE + MEASURED, lambda _: remove_load_if_ended(board, axis))[axis]
            fastest = max(fastest, float(np.abs(trace["omega"]).max()))
            if why := ended(board, axis) or _not_held(trace, speed):
                end = why
                break
            held.append(speed)
            last = trace.part(SETTLE)
        board.set_load(axis, 0.0)
    return Descent(tuple(held), end, fastest, last or trace)


def _not_held(trace: Trace, speed: float) -> str:
    """Reason why a speed is not maintained; empty: it is."""
    omega = trace.part(SETTLE)["omega"]
    mean = float(omega.mean())
    if abs(mean / speed - 1.0) > MEAN_MAX:
        return f"a mean of {mean / RPM:.3g} rpm"
    return "standstill" if float(omega.min()) <= 0.0 else ""


def _lowest_speed_max(plant: PlantConfig, axis: int, limit: float) -> float:
    """Bound of the lowest speed: reference design, or limit by a small back-EMF [% of the speed limit]."""
    minimum = EMF_MIN * dead_voltage(plant, axis) / back_emf(plant.axes[axis], limit)
    return max(REFERENCE_MAX, 100.0 * minimum)


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes, every load."""
    for axis in range(AXES):
        name, curves = axis_name(axis), []
        for load in LOADS:
            descent = descend(plant, seed, axis, load, STEPS)
            label = f"{name}, load {100.0 * load:.0f} %" if load else f"{name}, no load"
            judge, reference = Judge(f"{label}, ", NOT_SHOWN), "5 % of the maximum"
            if not descent.speeds:
                yield judge("lowest speed", None, "% of limit", maximum=REFERENCE_MAX, reference=reference)
                continue
            limit, lowest, trace = descent.speeds[0] / STEPS[0], descent.speeds[-1], descent.trace
            part, maximum = 100.0 * lowest / limit, _lowest_speed_max(plant, axis, limit)
            yield judge("lowest speed", part, "% of limit", maximum=maximum, reference=reference)
            yield judge("largest speed", descent.fastest / descent.speeds[0], maximum=RUNAWAY_MAX)
            ripple = float(trace["omega"].std()) / lowest
            yield (
                f"{label}: down to {lowest / RPM:.3g} rpm, ripple {100.0 * ripple:.2g} %, "
                f"angle error up to {float(np.abs(angle_error(trace)).max()):.2g} deg; ended by {descent.end}"
            )
            curves.append(Curve(f"load {100.0 * load:.0f} %", trace.time, trace["omega"] / RPM))
        yield Panel(f"{name}: true speed at the lowest set-points", "time [s]", "speed [rpm]", curves)
