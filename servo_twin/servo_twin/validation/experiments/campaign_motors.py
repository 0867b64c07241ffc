"""Motors of the experiment fault-campaign: the plant's and others, each with a configuration tuned for it."""

from __future__ import annotations

import functools
import random
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.text_file import read_toml

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.servo_config import ServoConfig, servo_table
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments.rig import fresh_board

OWN: Final = ("axis1", "axis2")
"""Names of the motors of the plant."""

_TABLES: Final[Mapping[str, Mapping[str, Any]]] = read_toml(Path(__file__).with_name("motors.toml"))

OTHERS: Final = tuple(_TABLES)
"""Names of the motors in ``motors.toml``."""

MOTORS: Final = OWN + OTHERS
"""Names of all motors."""

OBSERVED_MIN: Final = 0.2
"""Speed, relative to the limit, above which a sensorless axis must support its full current."""

SLOWEST: Final = 1.1
"""Lowest sensorless speed, relative to the minimum speed of the start-up."""

DEVIATION: Final[Mapping[str, tuple[float, float]]] = {
    "r_s": (0.9, 1.25),  # 25 % by a warm winding
    "l_d": (0.85, 1.15),
    "l_q": (0.85, 1.15),
    "psi_m": (0.95, 1.05),
    "inertia": (0.8, 1.25),
    "friction": (0.5, 1.5),
    "viscous": (0.5, 1.5),
}
"""Range of the true values of a motor, relative to the nominal values."""


@dataclass(frozen=True)
class Motor:
    """One motor on its board."""

    name: str  # one of `MOTORS`
    axis: int  # index of the axis
    plant: PlantConfig  # nominal values of both motors of the board
    group: str  # motors of the board's firmware; empty: the motors of the plant

    @classmethod
    def of(cls, name: str, plant: PlantConfig) -> Motor:
        """Motor by name; `plant` contains the motors that are not in ``motors.toml``, and bus and sensors for all.

        Raises
        ------
        SimulationError
            If the name is unknown.
        """
        if name in OWN:
            return cls(name, OWN.index(name), plant, "")
        if name not in OTHERS:
            raise SimulationError(f"unknown motor {name!r}; motors: {', '.join(MOTORS)}")
        first = OTHERS.index(name) // AXES * AXES
        pair = [OTHERS[(first + k) % len(OTHERS)] for k in range(AXES)]
        for axis, other in enumerate(pair):
            plant = plant.with_axis(axis, **_truth(_TABLES[other]))
        return cls(name, pair.index(name), plant, " ".join(pair))

    @property
    def nominal(self) -> AxisPlant:
        """Nominal values of the controller for this motor."""
        return self.plant.axes[self.axis]

    @property
    def observable(self) -> bool:
        """True if the back-EMF exceeds the voltage error of the observer by the resistance of a warm winding."""
        if not self.group:
            return True  # shown by the sensorless experiments
        motor, limits = self.nominal, _TABLES[self.name]["limits"]
        unknown = (DEVIATION["r_s"][1] - 1.0) * motor.r_s * float(limits["current"])
        return motor.pole_pairs * motor.psi_m * OBSERVED_MIN * float(limits["speed"]) > unknown

    @property
    def slowest(self) -> float:
        """Lowest sensorless set-point, relative to the speed limit."""
        servo = servo_table()
        own = _TABLES[self.name] if self.group else servo[self.name]
        start_up = {**servo["defaults"]["start_up"], **own.get("start_up", {})}
        return SLOWEST * float(start_up["minimum_speed"])

    def board(self, plant: PlantConfig, seed: int) -> Board:
        """New board with a plant that may deviate from the nominal values."""
        return fresh_board(plant, seed, _configuration(self.group) if self.group else None)


def _truth(table: Mapping[str, Any]) -> dict[str, float]:
    motor, friction = table["motor"], table["friction"]
    values = {name: motor[name] for name in ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia")}
    return {**values, "friction": friction["coulomb"], "viscous": friction["viscous"]}


@functools.cache
def _configuration(group: str) -> ServoConfig:
    """Configuration for the two motors of a group."""
    motors = {axis_name(axis): {"feedback": "encoder", **_TABLES[name]} for axis, name in enumerate(group.split())}
    return ServoConfig.of_table({**servo_table(), **motors})


def deviating(plant: PlantConfig, rng: random.Random) -> PlantConfig:
    """Copy of a plant with random deviations from the nominal values."""
    for axis, nominal in enumerate(plant.axes):
        changes = {name: getattr(nominal, name) * rng.uniform(*part) for name, part in DEVIATION.items()}
        plant = plant.with_axis(axis, **changes)
    return plant
