"""Largest load step that an axis without an encoder bears, over speed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board
from servo_twin.experiments.minimum_speed import let_go
from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import RPM, command_speed
from servo_twin.experiments.sensorless import Trace, fault_names, follow, limits_of, started, substate
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "load-step"
HELP: Final = """\
An axis without an encoder turns steadily without load; then a torque against the motion comes all at once, stays, and
goes all at once. It is active: where the motor does not hold it, it turns the shaft back. The steps grow, over a range
of speeds, until one throws the rotor out of step. The reference design does not show this. On paper a load step T takes
T / (J w e) from the speed of a shaft whose speed loop has two poles at w and knows the speed at once; a bound is the
step that would take all of it with a loop of 30 Hz, as far as the current can hold it. The notes say what was lost."""

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
    """One speed.

    Attributes
    ----------
    speed : float
        [rad/s]
    torque : float
        Largest step that was borne, as all smaller ones were [N m].
    lost : float
        Speed that it took [rad/s].
    end : str
        What the next one did; empty when there was none.
    trace : Trace or None
        Of the largest step that was borne.
    """

    speed: float
    torque: float
    lost: float
    end: str
    trace: Trace | None


def lost_on_paper(motor: AxisPlant, torque: float) -> float:
    """Speed that a load step takes [rad/s]."""
    # crossing at 2 w
    return torque / (motor.inertia * math.pi * PAPER * math.e)


def bear(plant: PlantConfig, seed: int, axis: int, part: float, steps: Sequence[float]) -> Borne:
    """Growing steps at a part of the speed limit."""
    with started(plant, seed, {axis: 1.0}) as board:
        limit, current = limits_of(board, axis)
        speed = part * limit
        command_speed(board, axis, speed)
        follow(board, [], SETTLE)
        best = Borne(speed, 0.0, 0.0, "", None)
        for step in steps:
            torque = step * current * plant.axes[axis].torque_constant
            trace, end = _loaded(board, axis, torque, speed)
            if end:
                return Borne(speed, best.torque, best.lost, end, best.trace)
            best = Borne(speed, torque, speed - float(trace.omega.min()), "", trace)
        return best


def _loaded(board: Board, axis: int, torque: float, speed: float) -> tuple[Trace, str]:
    """A load comes and goes; why it was not borne."""
    spin = substate(board, "SPIN")
    trace, end = None, ""
    for load in (torque, 0.0):
        board.set_load(axis, load)
        part = follow(board, [axis], LOADED, lambda _: let_go(board, axis, spin))[axis]
        trace = trace or part
        end = end or _ended(board, axis, part, spin, speed)
    assert trace is not None
    return trace, end


def _ended(board: Board, axis: int, trace: Trace, spin: int, speed: float) -> str:
    word = board.read_raw(f"{axis_name(axis)}.faults")[0]
    if word:
        return fault_names(board, word)
    if board.read_raw(f"{axis_name(axis)}.substate")[0] != spin:
        return "the axis has switched off"
    mean = float(trace.part(0.7 * LOADED).omega.mean())
    return f"a mean of {mean / RPM:.3g} rpm" if abs(mean / speed - 1.0) > BACK else ""


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Both axes, every speed."""
    rows: list[Row] = []
    notes: list[str] = []
    panels: list[Panel] = []
    for axis in range(AXES):
        name, motor = axis_name(axis), plant.axes[axis]
        found = [bear(plant, seed, axis, part, STEPS) for part in SPEEDS]
        rows.extend(_rows(name, motor, found, _most(plant, seed, axis)))
        notes.extend(_notes(name, motor, found))
        panels.append(_over_speed(name, motor, found))
        slow = found[0]
        if slow.trace is not None:
            time = slow.trace.time
            curves = (Curve("true", time, slow.trace.omega / RPM), Curve("observed", time, slow.trace.speed / RPM))
            title = f"{name}: {1e3 * slow.torque:.0f} mN m at {slow.speed / RPM:.0f} rpm"
            panels.append(Panel(title, "time [s]", "speed [rpm]", curves))
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _most(plant: PlantConfig, seed: int, axis: int) -> float:
    """Torque at the current limit [N m]."""
    with started(plant, seed, {}) as board:
        return limits_of(board, axis)[1] * plant.axes[axis].torque_constant


def _rows(name: str, motor: AxisPlant, found: Sequence[Borne], most: float) -> Iterator[Row]:
    for it in found:
        paper = it.speed / lost_on_paper(motor, 1.0)
        least = 1e3 * min(paper, HELD * most)
        yield Row(f"{name} at {it.speed / RPM:.0f} rpm, step borne", "not shown", 1e3 * it.torque, "mN m", Bound(least))


def _notes(name: str, motor: AxisPlant, found: Sequence[Borne]) -> Iterator[str]:
    for it in found:
        after = f"the next one: {it.end}" if it.end else "the largest that was tried"
        paper = lost_on_paper(motor, it.torque)
        yield (
            f"{name} at {it.speed / RPM:.0f} rpm: {1e3 * it.torque:.0f} mN m take {it.lost / RPM:.0f} rpm, on paper "
            f"{paper / RPM:.0f} rpm; {after}"
        )


def _over_speed(name: str, motor: AxisPlant, found: Sequence[Borne]) -> Panel:
    x = np.array([it.speed / RPM for it in found])
    paper = np.array([1e3 * it.speed / lost_on_paper(motor, 1.0) for it in found])
    borne = np.array([1e3 * it.torque for it in found])
    curves = (Curve("borne", x, borne, "o-"), Curve(f"loses all speed on paper, {PAPER:g} Hz", x, paper, "--"))
    return Panel(f"{name}: largest load step", "speed [rpm]", "torque [mN m]", curves, log_x=True)
