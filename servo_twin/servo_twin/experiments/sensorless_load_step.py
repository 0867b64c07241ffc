"""Largest load step that an axis without an encoder bears, over speed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, experiment
from servo_twin.experiments.plant_limits import current_limits
from servo_twin.experiments.rig import RPM, command_speed
from servo_twin.experiments.sensorless import Trace, ended, follow, let_go, limits_of, started
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "sensorless-load-step"
HELP: Final = """\
An axis without an encoder turns steadily without load; then a torque against the motion is applied in a step, and
removed in a step. The load is active: if the motor cannot hold it, it reverses the shaft. The steps increase, over a
range of speeds, until the rotor loses synchronism. The reference design does not show this. In theory a load step T
reduces the speed by T / (J w e) if the speed loop has two poles at w and measures the speed without delay; a bound is
the step that would stop the shaft with a loop of 30 Hz, within the current limit. The notes give the speed drops."""

SPEEDS: Final = (0.05, 0.08, 0.13, 0.2, 0.4, 0.8)
"""Parts of the speed limit."""

STEPS: Final = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Parts of the torque at the current limit."""

PAPER: Final = 30.0
"""Bandwidth of the speed loop on paper [Hz]."""

HELD: Final = 0.5
"""Of the torque at the current limit a step that the bound asks for is at most: the rest brings the shaft back."""

SETTLE: Final = 0.4  # at a speed, before the first step [s]
LOADED: Final = 0.3  # [s]
BACK: Final = 0.1  # Deviation of the mean speed from the set-point at the end of that, over it, at the most


@dataclass(frozen=True)
class Borne:
    """One speed."""

    speed: float  # [rad/s]
    torque: float = 0.0  # largest step that was borne, as all smaller ones were [N m]
    lost: float = 0.0  # speed that it took [rad/s]
    trace: Trace | None = None  # of that step
    end: str = ""  # what the next one did; empty when there was none


def lost_on_paper(motor: AxisPlant, torque: float) -> float:
    """Speed that a load step takes [rad/s]."""
    # crossing at 2 w
    return torque / (motor.inertia * math.pi * PAPER * math.e)


def bear(plant: PlantConfig, seed: int, axis: int, part: float, steps: Sequence[float]) -> Borne:
    """Growing steps, as parts of the torque at the current limit, at a part of the speed limit."""
    with started(plant, seed, {axis: 1.0}) as board:
        limit, current = limits_of(board, axis)
        speed = part * limit
        command_speed(board, axis, speed)
        follow(board, [], SETTLE)
        best = Borne(speed)
        for step in steps:
            torque = step * current * plant.axes[axis].torque_constant
            trace, end = _loaded(board, axis, torque, speed)
            if end:
                return replace(best, end=end)
            best = Borne(speed, torque, speed - float(trace.omega.min()), trace)
        return best


def _loaded(board: Board, axis: int, torque: float, speed: float) -> tuple[Trace, str]:
    """A load comes and goes; why it was not borne."""
    traces: list[Trace] = []
    end = ""
    for load in (torque, 0.0):
        board.set_load(axis, load)
        traces.append(follow(board, [axis], LOADED, lambda _: let_go(board, axis))[axis])
        end = end or ended(board, axis) or _slow(traces[-1], speed)
    return traces[0], end


def _slow(trace: Trace, speed: float) -> str:
    mean = float(trace.part(0.7 * LOADED).omega.mean())
    return f"a mean of {mean / RPM:.3g} rpm" if abs(mean / speed - 1.0) > BACK else ""


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes, every speed."""
    currents = current_limits(plant, seed)
    for axis in range(AXES):
        name, motor = axis_name(axis), plant.axes[axis]
        found = [bear(plant, seed, axis, part, STEPS) for part in SPEEDS]
        maximum = 1e3 * HELD * currents[axis] * motor.torque_constant
        paper = [1e3 * it.speed / lost_on_paper(motor, 1.0) for it in found]
        for it, step in zip(found, paper, strict=True):
            where = f"{name} at {it.speed / RPM:.0f} rpm"
            yield Judge(f"{where}, ", NOT_SHOWN)("step borne", 1e3 * it.torque, "mN m", min(step, maximum))
            after = f"the next one: {it.end}" if it.end else "the largest that was tried"
            yield (
                f"{where}: {1e3 * it.torque:.0f} mN m take {it.lost / RPM:.0f} rpm, on paper "
                f"{lost_on_paper(motor, it.torque) / RPM:.0f} rpm; {after}"
            )
        x, borne = np.array([it.speed / RPM for it in found]), np.array([1e3 * it.torque for it in found])
        on_paper = Curve(f"loses all speed on paper, {PAPER:g} Hz", x, np.array(paper), "--")
        curves = Curve("borne", x, borne, "o-"), on_paper
        yield Panel(f"{name}: largest load step", "speed [rpm]", "torque [mN m]", curves, log_x=True)
        slow, trace = found[0], found[0].trace
        if trace is not None:
            curves = Curve("true", trace.time, trace.omega / RPM), Curve("observed", trace.time, trace.speed / RPM)
            title = f"{name}: {1e3 * slow.torque:.0f} mN m at {slow.speed / RPM:.0f} rpm"
            yield Panel(title, "time [s]", "speed [rpm]", curves)
