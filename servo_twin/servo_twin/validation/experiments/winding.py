"""Overloaded motors: estimated and true winding temperature, derating, steady state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_tuning.reading import parse
from servo_tuning.winding import STEP_TICKS, Winding

from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig, servo_table
from servo_twin.simulation import enable
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.rig import SETTLED, fresh_board, set_up

NAME: Final = "winding"
HELP: Final = """\
Both motors turn against a brake at a speed that they cannot reach, so that the current is at its limit: 4 A into
windings rated for 2 A continuously. The current limit must be constant until the winding reaches the derating
temperature, and then fall to the rated current, with the temperature settling at its maximum, without a fault.
Estimated and true temperature are compared; also for motors with other windings and heat capacities, and for a
controller with nominal thermal resistance and heat capacity wrong by 30 %. The reference design does not show
this. The heat capacities are small, so that half a minute is sufficient. The bounds follow from the
heat balance."""

SECONDS: Final = 40.0
STEP: Final = 0.02  # [s]
SPEED: Final = 300.0  # set-point [rad/s]
REACHED: Final = 100.0  # speed against the brake with 4 A [rad/s]
ERROR_MAX: Final = 0.5
"""Permitted error of the estimate with a right configuration, in addition to the heating in a step of the model [K]:
losses by ripple and offsets."""

FINAL_ERROR_MAX: Final = 2.5
"""Permitted deviation of the final temperature from the heat balance [K]."""

REMAINING_RISE_MAX: Final = 0.05
"""Permitted remaining temperature rise at the end, relative to the total rise."""


@dataclass(frozen=True)
class Motor:
    """A motor and the nominal values of its winding."""

    rated: float  # continuous current at the maximum temperature [A]
    capacity: float  # nominal heat capacity of the winding [J/K]
    r_s: float | None = None  # phase resistance, instead of the plant's [ohm]
    resistance_error: float = 1.0  # nominal thermal resistance relative to the true one
    capacity_error: float = 1.0  # nominal heat capacity relative to the true one


@dataclass(frozen=True)
class Case:
    """Two motors on a board."""

    name: str
    motors: tuple[Motor, ...]


MATCHED: Final = (Motor(2.0, 0.5), Motor(2.0, 0.9))
CASES: Final = (
    Case("nominal", MATCHED),
    Case("other windings", (Motor(1.5, 0.3, r_s=0.9), Motor(2.6, 0.8, r_s=0.3))),
    Case(
        "wrong by 30 %",
        (
            replace(MATCHED[0], resistance_error=0.7, capacity_error=1.3),
            replace(MATCHED[1], resistance_error=1.3, capacity_error=0.7),
        ),
    ),
)


def derated_from(series: Trace) -> float | None:
    """Time of the first derating [s]."""
    derated = series["winding_current"] < 0.99 * series["winding_current"].max()
    return float(series.time[np.argmax(derated)]) if derated.any() else None


def configured(
    plant: PlantConfig, motors: Sequence[Motor]
) -> tuple[PlantConfig, ServoConfig, list[Winding], list[Winding]]:
    """Plant with these motors, its configuration, and the nominal and true windings.

    The nominal thermal resistance follows from rated current, maximum temperature and ambient temperature of the plant.
    """
    table = {**servo_table()}
    table["defaults"] = {**table["defaults"], "winding": {**table["defaults"]["winding"], "ambient": plant.ambient}}
    for axis, motor in enumerate(motors):
        entry = dict(table[axis_name(axis)])
        entry["motor"] = {**entry["motor"], "rated_current": motor.rated, "r_s": motor.r_s or plant.axes[axis].r_s}
        entry["winding"] = {"heat_capacity": motor.capacity}
        table[axis_name(axis)] = entry
    configuration = parse(table, Catalogue.load())
    nominal = [Winding.of(axis) for axis in configuration.axes]
    true: list[Winding] = []
    for axis, (motor, winding) in enumerate(zip(motors, nominal, strict=True)):
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
    return plant, ServoConfig.of(configuration), nominal, true


def time_series(plant: PlantConfig, seed: int, servo: ServoConfig, seconds: float = SECONDS) -> list[Trace]:
    """Run cold motors for `seconds` [s] with the largest current from the start.

    Columns of the trace of an axis: ``winding_temperature`` estimated by the firmware and ``truth`` [deg C], the
    set-point ``i_q_ref`` and the limit ``winding_current`` of the firmware [A], ``faults``.
    """
    with fresh_board(plant, seed, servo) as board:
        enable(board)
        board.run(SETTLED)
        for axis in range(AXES):
            set_up(board, axis, "SPEED", SPEED, WINDING_MODEL=True)
            board.set_winding(axis, plant.ambient)
        return _record(board, seconds)


def _record(board: Board, seconds: float) -> list[Trace]:
    names = ("winding_temperature", "i_q_ref", "winding_current", "faults")
    samples: list[list[list[float]]] = [[] for _ in range(AXES)]
    for _ in range(round(seconds / STEP)):
        board.run(STEP)
        for axis, rows in enumerate(samples):
            values = [float(np.asarray(board.read(f"{axis_name(axis)}.{name}")).item()) for name in names]
            rows.append([*values, board.truth(axis).t_winding])
    return [Trace(STEP, dict(zip((*names, "truth"), np.array(rows).T, strict=True)), first=1) for rows in samples]


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes, every case."""
    for case in CASES:
        changed_plant, servo, nominal, true = configured(plant, case.motors)
        found = time_series(changed_plant, seed, servo, SECONDS)
        for axis, (series, model, winding) in enumerate(zip(found, nominal, true, strict=True)):
            name = f"{axis_name(axis)}, {case.name}"
            yield from figures(Judge(f"{name}: "), series, model, winding)
            beyond = float(series["truth"][-1]) - winding.maximum
            yield f"{name}: the winding ends {beyond:+.1f} K from its maximum of {winding.maximum:g} deg C"
            curves = (
                Curve("winding [deg C]", series.time, series["truth"]),
                Curve("estimate [deg C]", series.time, series["winding_temperature"], "--"),
                Curve("current [0.1 A]", series.time, 10.0 * series["i_q_ref"]),
            )
            yield Panel(name, "time [s]", "", curves)


def figures(judge: Judge, series: Trace, model: Winding, winding: Winding) -> Iterator[Row]:
    """Expected values: controller from its nominal values (`model`), winding from the resulting current."""
    until = model.time_to(model.derating, model.current)
    current, estimate = model.settled()
    truth = winding.equilibrium(current)
    rest = max(FINAL_ERROR_MAX, REMAINING_RISE_MAX * (truth - winding.ambient))
    late = 0.05 * until + 2.0 * STEP
    yield judge("time until derating", derated_from(series), "s", until - late, until + late)
    yield judge.near("final current", series["i_q_ref"][-1], "A", current, 0.02 * current)
    yield judge.near("final estimate", series["winding_temperature"][-1], "deg C", estimate, FINAL_ERROR_MAX)
    yield judge("final winding temperature", series["truth"][-1], "deg C", truth - rest, truth + FINAL_ERROR_MAX)
    yield judge.none("faults", int(np.count_nonzero(series["faults"])))
    if winding == model:
        step = model.loss(model.current, model.derating) / model.capacity * STEP_TICKS * TICK
        yield judge(
            "error of the estimate",
            np.abs(series["winding_temperature"] - series["truth"]).max(),
            "K",
            0.0,
            step + ERROR_MAX,
        )
