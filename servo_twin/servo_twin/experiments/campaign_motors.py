"""Motors of the experiment fault-campaign: those of the plant, and others, each with a firmware tuned for it."""

from __future__ import annotations

import functools
import random
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board, Firmware
from servo_twin.experiments.rig import fresh_board, level
from servo_twin.firmware_build import as_toml, build_firmware, servo_table
from servo_twin.level import Level
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

OWN: Final = ("axis1", "axis2")
"""The motors of the plant, as the experiment names them."""

_TABLES: Final[Mapping[str, Mapping[str, Any]]] = tomllib.loads(
    Path(__file__).with_name("motors.toml").read_text(encoding="utf-8")
)

OTHERS: Final = tuple(_TABLES)
"""The motors of ``motors.toml``."""

MOTORS: Final = OWN + OTHERS
"""All of them."""

OBSERVED_MIN: Final = 0.2
"""Part of the speed limit from which on an axis without an encoder has to bear its full current."""

SLOWEST: Final = 1.1
"""Slowest speed without an encoder, over the one at which the start-up gives the axis up."""

DEVIATION: Final[Mapping[str, tuple[float, float]]] = {
    "r_s": (0.9, 1.25),  # a warm winding has a quarter more
    "l_d": (0.85, 1.15),
    "l_q": (0.85, 1.15),
    "psi_m": (0.95, 1.05),
    "inertia": (0.8, 1.25),
    "friction": (0.5, 1.5),
    "viscous": (0.5, 1.5),
}
"""Range of a motor's true values, as parts of the nominal ones."""


@dataclass(frozen=True)
class Motor:
    """One motor on its board."""

    name: str  # one of `MOTORS`
    axis: int  # index of its axis
    plant: PlantConfig  # nominal values of both motors of the board
    group: str  # names the board: that of the plant, or the plant that the firmware is tuned for

    @classmethod
    def of(cls, name: str, plant: PlantConfig) -> Motor:
        """A motor by its name; `plant` has those that are not in ``motors.toml``, and bus and sensors of all.

        Raises
        ------
        SimulationError
            If there is none of that name.
        """
        if name in OWN:
            return cls(name, OWN.index(name), plant, "")
        if name not in OTHERS:
            raise SimulationError(f"no motor {name!r}; there are {', '.join(MOTORS)}")
        first = OTHERS.index(name) // AXES * AXES
        pair = [OTHERS[(first + k) % len(OTHERS)] for k in range(AXES)]
        for axis, other in enumerate(pair):
            plant = plant.with_axis(axis, **_truth(_TABLES[other]))
        return cls(name, pair.index(name), plant, " ".join(pair))

    @property
    def nominal(self) -> AxisPlant:
        """What the controller takes this motor for."""
        return self.plant.axes[self.axis]

    @property
    def observable(self) -> bool:
        """Whether the observer can tell its back-EMF from what a warm winding takes besides the nominal resistance."""
        if not self.group:
            return True  # the experiments without an encoder show that
        motor, limits = self.nominal, _TABLES[self.name]["limits"]
        unknown = (DEVIATION["r_s"][1] - 1.0) * motor.r_s * float(limits["current"])
        return motor.pole_pairs * motor.psi_m * OBSERVED_MIN * float(limits["speed"]) > unknown

    @property
    def slowest(self) -> float:
        """Lowest set-point without an encoder, as a part of the speed limit."""
        servo = servo_table()
        own = _TABLES[self.name] if self.group else servo[self.name]
        start_up = {**servo["defaults"]["start_up"], **own.get("start_up", {})}
        return SLOWEST * float(start_up["minimum_speed"])

    def firmware(self) -> Firmware | None:
        """The firmware for its board, of the level of this bench; None: the usual one."""
        return _firmware(self.group, level()) if self.group else None

    def board(self, plant: PlantConfig, seed: int) -> Board:
        """Its board, just switched on, on a plant that may deviate from the nominal values."""
        return fresh_board(plant, seed, self.firmware())


def _truth(table: Mapping[str, Any]) -> dict[str, float]:
    motor, friction = table["motor"], table["friction"]
    values = {name: motor[name] for name in ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia")}
    return {**values, "friction": friction["coulomb"], "viscous": friction["viscous"]}


@functools.cache
def _firmware(group: str, kind: Level) -> Firmware:
    """Built once: a campaign is of one state of the sources."""
    return build_firmware(_configuration(group), kind)


def _configuration(group: str) -> str:
    """Text of the ``servo.toml`` for two motors."""
    motors = {axis_name(axis): {"feedback": "encoder", **_TABLES[name]} for axis, name in enumerate(group.split())}
    return as_toml({**servo_table(), **motors})


def deviating(plant: PlantConfig, rng: random.Random) -> PlantConfig:
    """Copy of a plant whose motors deviate from their nominal values."""
    for axis, nominal in enumerate(plant.axes):
        changes = {name: getattr(nominal, name) * rng.uniform(*part) for name, part in DEVIATION.items()}
        plant = plant.with_axis(axis, **changes)
    return plant
