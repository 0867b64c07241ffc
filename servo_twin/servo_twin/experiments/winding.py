"""A motor that is asked for more than it bears for ever: estimate and truth of its winding, derating, the end."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.tuning.reading import loads
from servo_msgs_py.tuning.winding import STEP_TICKS, Winding

from servo_twin.board import Board
from servo_twin.experiments.outcome import BEYOND, Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import SETTLED, TICK, choose_mode, command_speed, features, fresh_board
from servo_twin.firmware_build import as_toml, servo_table
from servo_twin.lockstep.blocks import blocks_of_file, bring
from servo_twin.lockstep.replica import Replica
from servo_twin.plant import PlantConfig
from servo_twin.simulation import enable

if sys.version_info >= (3, 11):
    pass
else:
    pass

NAME: Final = "winding"
HELP: Final = """\
Both motors turn against a brake at a speed that they cannot reach, so that all the current there is flows: 4 A into
windings that bear 2 A for ever. The current limit has to stay until the winding is at the temperature of the derating,
and then to fall until the rated current is left and the temperature stands at its maximum, without a fault. Estimate
and true temperature are compared; so are motors with other windings and heat capacities, and a controller that
believes in a thermal resistance and a heat capacity that are wrong by 30 %. The reference design does not show this.
The heat capacities are those of a few grams, so that half a minute is enough. Bounds are those of the heat balance."""

SECONDS: Final = 40.0
STEP: Final = 0.02  # [s]
SPEED: Final = 300.0  # that is asked for [rad/s]
REACHED: Final = 100.0  # against the brake with 4 A [rad/s]
AGREES: Final = 0.5
"""Estimate off the truth where the configuration is right, beyond what a step of the model heats [K]: losses of ripple
and offsets."""

NEAR: Final = 2.5
"""Temperature in the end off that of the heat balance [K]."""

REST: Final = 0.05
"""Part of its way that a winding may still have to go in the end."""


@dataclass(frozen=True)
class Motor:
    """A motor, and what the controller believes of its winding.

    Attributes
    ----------
    rated : float
        That leads to the maximum for ever [A].
    capacity : float
        Of the winding, as believed [J/K].
    r_s : float or None
        Of a phase, in the place of the plant's [ohm].
    resistance_error, capacity_error : float
        What the controller believes of the thermal resistance and of the heat capacity, over what there is.
    """

    rated: float
    capacity: float
    r_s: float | None = None
    resistance_error: float = 1.0
    capacity_error: float = 1.0


@dataclass(frozen=True)
class Case:
    """Two motors on a board."""

    name: str
    motors: tuple[Motor, ...]


RIGHT: Final = (Motor(2.0, 0.5), Motor(2.0, 0.9))
CASES: Final = (
    Case("as believed", RIGHT),
    Case("other windings", (Motor(1.5, 0.3, r_s=0.9), Motor(2.6, 0.8, r_s=0.3))),
    Case(
        "wrong by 30 %",
        (
            replace(RIGHT[0], resistance_error=0.7, capacity_error=1.3),
            replace(RIGHT[1], resistance_error=1.3, capacity_error=0.7),
        ),
    ),
)


@dataclass(frozen=True)
class Course:
    """One axis over time.

    Attributes
    ----------
    time : ndarray
        [s].
    estimate, truth : ndarray
        Temperature of the winding [deg C].
    current : ndarray
        Set-point i_q [A].
    bears : ndarray
        Current that the firmware lets the winding bear [A].
    faults, limits : int
        Bits that have been there.
    """

    time: NDArray[np.float64]
    estimate: NDArray[np.float64]
    truth: NDArray[np.float64]
    current: NDArray[np.float64]
    bears: NDArray[np.float64]
    faults: int
    limits: int

    @property
    def derated_from(self) -> float | None:
        """Time of the first derating [s]."""
        derated = self.bears < 0.99 * self.bears.max()
        return float(self.time[np.argmax(derated)]) if derated.any() else None


def configured(plant: PlantConfig, motors: Sequence[Motor]) -> tuple[PlantConfig, str, list[Winding], list[Winding]]:
    """The plant with these motors, the configuration for it, and the windings as they are believed and as they are.

    The believed thermal resistance is that with which the rated current leads to the maximum in the plant's air.
    """
    table = {**servo_table()}
    table["defaults"] = {**table["defaults"], "winding": {**table["defaults"]["winding"], "ambient": plant.ambient}}
    for axis, motor in enumerate(motors):
        entry = dict(table[axis_name(axis)])
        entry["motor"] = {**entry["motor"], "rated_current": motor.rated, "r_s": motor.r_s or plant.axes[axis].r_s}
        entry["winding"] = {"heat_capacity": motor.capacity}
        table[axis_name(axis)] = entry
    text = as_toml(table)
    believed = [Winding.of(axis) for axis in loads(text, Catalogue.load()).axes]
    true: list[Winding] = []
    for axis, (motor, winding) in enumerate(zip(motors, believed, strict=True)):
        true.append(
            replace(
                winding,
                resistance=winding.resistance / motor.resistance_error,
                capacity=winding.capacity / motor.capacity_error,
            )
        )
        plant = plant.with_axis(
            axis,
            r_s=winding.r_s,
            winding_resistance=true[axis].resistance,
            winding_capacity=true[axis].capacity,
            viscous=plant.axes[axis].torque_constant * winding.current / REACHED,
        )
    return plant, text, believed, true


def courses(plant: PlantConfig, seed: int, text: str, seconds: float = SECONDS) -> list[Course]:
    """Cold motors, and all the current there is from the beginning."""
    with fresh_board(plant, seed) as board:
        bring(Replica(board), blocks_of_file(text, board.catalogue))
        enable(board)
        board.run(SETTLED)
        for axis in range(AXES):
            features(board, axis, WINDING_MODEL=True)
            choose_mode(board, axis, "SPEED")
            board.set_winding(axis, plant.ambient)
            command_speed(board, axis, SPEED)
        return _watched(board, seconds)


def _watched(board: Board, seconds: float) -> list[Course]:
    ticks = round(seconds / STEP)
    table = np.zeros((AXES, ticks, 4))
    words = np.zeros((AXES, 2), dtype=np.int64)
    for k in range(ticks):
        board.run(STEP)
        for axis in range(AXES):
            name = axis_name(axis)
            estimate, current, bears = (
                float(np.asarray(board.read(f"{name}.{of}")).item())
                for of in ("winding_temperature", "i_q_ref", "winding_current")
            )
            table[axis, k] = estimate, board.truth(axis).t_winding, current, bears
            words[axis] |= [board.read_raw(f"{name}.{word}")[0] for word in ("faults", "limits")]
    time = STEP * np.arange(1, ticks + 1, dtype=np.float64)
    found: list[Course] = []
    for part, (faults, limits) in zip(table, words.tolist(), strict=True):
        estimate_of, truth_of, current_of, bears_of = part.T
        found.append(Course(time, estimate_of, truth_of, current_of, bears_of, faults, limits))
    return found


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Both axes, every case."""
    rows: list[Row] = []
    panels: list[Panel] = []
    notes: list[str] = []
    for case in CASES:
        world, text, believed, true = configured(plant, case.motors)
        found = courses(world, seed, text)
        for axis, (it, model, winding) in enumerate(zip(found, believed, true, strict=True)):
            name = f"{axis_name(axis)}, {case.name}"
            rows.extend(_rows(name, it, model, winding))
            panels.append(_panel(name, it))
            beyond = float(it.truth[-1]) - winding.maximum
            notes.append(f"{name}: the winding ends {beyond:+.1f} K from its maximum of {winding.maximum:g} deg C")
    return Outcome(NAME, tuple(rows), tuple(panels), tuple(notes))


def _rows(name: str, it: Course, model: Winding, winding: Winding) -> Iterator[Row]:
    """What the controller does follows from what it believes, the winding from that current."""
    until = model.time_to(model.derating, model.current)
    current, estimate = model.settled()
    truth = winding.equilibrium(current)
    yield Row(f"{name}: time until derating", BEYOND, it.derated_from, "s", _about(until, 0.05 * until + 2.0 * STEP))
    yield Row(f"{name}: current in the end", BEYOND, float(it.current[-1]), "A", _about(current, 0.02 * current))
    yield Row(f"{name}: estimate in the end", BEYOND, float(it.estimate[-1]), "deg C", _about(estimate, NEAR))
    rest = max(NEAR, REST * (truth - winding.ambient))
    yield Row(f"{name}: winding in the end", BEYOND, float(it.truth[-1]), "deg C", Bound(truth - rest, truth + NEAR))
    yield Row(f"{name}: faults", BEYOND, float(it.faults), "", Bound(0.0, 0.0))
    if winding == model:
        off = float(np.abs(it.estimate - it.truth).max())
        step = model.loss(model.current, model.derating) / model.capacity * STEP_TICKS * TICK
        yield Row(f"{name}: estimate off the winding", BEYOND, off, "K", Bound(0.0, step + AGREES))


def _about(value: float, off: float) -> Bound:
    return Bound(value - off, value + off)


def _panel(name: str, it: Course) -> Panel:
    curves = (
        Curve("winding [deg C]", it.time, it.truth),
        Curve("estimate [deg C]", it.time, it.estimate, "--"),
        Curve("current [0.1 A]", it.time, 10.0 * it.current),
    )
    return Panel(name, "time [s]", "", curves)
