"""A plant and a configuration with some values replaced.

``plant.axis1.inertia``, ``plant.bus.u_source``, ``plant.ambient``: a value of the plant file.
``servo.axis1.limits.current``, ``servo.defaults.timing.settle``: one of ``servo.toml``, from which the tuning code
computes the blocks that the board takes.
``param.i_q_limit[0]``: a parameter of the board, by its name in the contract and the index of the axis.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.tuning.errors import ConfigError
from servo_msgs_py.tuning.reading import AXIS_NAMES, parse

from servo_msgs_py import board_parameters
from servo_twin.board import Board
from servo_twin.experiments.rig import set_axis
from servo_twin.lockstep.blocks import Blocks, blocks_of_configuration, bring
from servo_twin.lockstep.replica import Replica
from servo_twin.plant import PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.sweep.space import SpaceError, Varied

_PLANT: Final = "plant."
_SERVO: Final = "servo."


@dataclass(frozen=True)
class Base:
    """What variants differ from."""

    plant: PlantConfig  # true parameters
    servo: Mapping[str, Any]  # parsed ``servo.toml``; empty where none can be varied

    def resolved(self, varied: Varied) -> Varied:
        """The same with values instead of factors.

        Raises
        ------
        SpaceError
            If there is no such value, or none of which there could be factors.
        """
        if not varied.name.startswith(board_parameters.PREFIX):
            nominal = self.nominal(varied.name)
            return varied.times(nominal) if varied.factor else varied
        _parameter(varied.name)
        if varied.factor:
            raise SpaceError(f"{varied.name}: factors are for values of plant and servo.toml")
        return varied

    def nominal(self, name: str) -> float:
        """Value of a name without a variation, in the unit of its file.

        Raises
        ------
        SpaceError
            If there is no such number.
        """
        if name.startswith(_PLANT):
            return _number(name, self.plant)
        if name.startswith(_SERVO):
            return _number(name, _with_defaults(self.servo))
        raise SpaceError(f"{name}: what is varied begins with {_PLANT}, {_SERVO} or {board_parameters.PREFIX}")

    def variant(self, point: Mapping[str, float]) -> Variant:
        """Plant and board with these values, by name."""
        plant = self.plant
        servo: dict[str, Any] = {}
        parameters: dict[str, float] = {}
        for name, value in point.items():
            if name.startswith(_PLANT):
                plant = plant.with_value(name.removeprefix(_PLANT), value)
            elif name.startswith(_SERVO):
                servo = servo or copy.deepcopy(dict(self.servo))
                _put(servo, name, value)
            else:
                parameters[name] = value
        return Variant(plant, servo, parameters)


@dataclass(frozen=True)
class Variant:
    """One trial's plant, and what its boards get before they run."""

    plant: PlantConfig
    servo: Mapping[str, Any]  # parsed ``servo.toml`` with other values; empty: that of the firmware
    parameters: Mapping[str, float]  # values by name

    def prepare(self, board: Board) -> None:
        """Give a fresh board its configuration and parameters.

        Raises
        ------
        SimulationError
            If the configuration cannot work, or the board refuses a value.
        """
        if self.servo:
            bring(Replica(board), self._blocks(board.catalogue))
        for name, value in self.parameters.items():
            variable, element = _parameter(name)
            try:
                set_axis(board, variable, element, value)
            except ValueError as error:
                raise SimulationError(str(error)) from None

    def _blocks(self, catalogue: Catalogue) -> Blocks:
        try:
            return blocks_of_configuration(parse(self.servo, catalogue))
        except ConfigError as error:
            raise SimulationError(f"servo.toml: {error}") from None


def _children(place: object) -> Mapping[str, object]:
    if isinstance(place, Mapping):
        return place
    if isinstance(place, PlantConfig):
        axes = {axis_name(k): axis for k, axis in enumerate(place.axes)}
        return {**axes, "bus": place.bus, "pwm_frequency": place.pwm_frequency, "ambient": place.ambient}
    if is_dataclass(place):
        return {field.name: getattr(place, field.name) for field in fields(place)}
    return {}


def _number(name: str, root: object) -> float:
    place: object = root
    walked, *path = name.split(".")
    for key in path:
        children = _children(place)
        if key not in children:
            near = difflib.get_close_matches(key, children, n=3) or list(children)
            raise SpaceError(f"{name}: {walked} has no {key!r}; there are {', '.join(near)}")
        place, walked = children[key], f"{walked}.{key}"
    if isinstance(place, bool) or not isinstance(place, (int, float)):
        raise SpaceError(f"{name} is no number that could be varied")
    return float(place)


def _with_defaults(servo: Mapping[str, Any]) -> dict[str, Any]:
    """The table with what each axis inherits."""
    return {
        name: _merged(servo.get("defaults", {}), part) if name in AXIS_NAMES else part for name, part in servo.items()
    }


def _merged(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(base)
    for key, value in own.items():
        inherited = base.get(key, {})
        both = isinstance(value, Mapping) and isinstance(inherited, Mapping)
        result[key] = _merged(inherited, value) if both else value
    return result


def _put(table: dict[str, Any], name: str, value: float) -> None:
    _, *path, last = name.split(".")
    place = table
    for key in path:
        place = place.setdefault(key, {})
    place[last] = value


def _parameter(name: str) -> tuple[str, int]:
    """Variable and element that a name means."""
    try:
        variable, element = board_parameters.find(name, Catalogue.load())
    except ValueError as error:
        raise SpaceError(str(error)) from None
    if element is None and variable.count > 1:
        raise SpaceError(f"{name}: of which axis? {name}[0] .. {name}[{variable.count - 1}]")
    return variable.name, element or 0
