"""Plant and configuration with replaced values.

``plant.axis1.inertia``, ``plant.bus.u_source``, ``plant.ambient``: a value of the plant file.
``servo.axis1.limits.current``, ``servo.defaults.timing.settle``: a value of ``servo.toml``, from which the tuning code
calculates the configuration blocks of the board.
``param.i_q_limit[0]``: a parameter of the board, by its name in the contract and the index of the axis.
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Final

from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXIS_NAMES, Catalogue, axis_name
from servo_tuning.errors import ConfigError
from servo_tuning.reading import parse
from servo_tuning.remedies import explained

from servo_msgs_py import board_parameters
from servo_twin.board import Board
from servo_twin.lockstep.blocks import Blocks, write_blocks
from servo_twin.lockstep.replica import Replica
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import blocks_of_configuration
from servo_twin.simulation import SimulationError
from servo_twin.validation.sweep.space import SpaceError, Varied

_PLANT: Final = "plant."
_SERVO: Final = "servo."


@dataclass(frozen=True)
class Base:
    """Nominal plant and configuration."""

    plant: PlantConfig  # true parameters
    servo: Mapping[str, Any]  # parsed ``servo.toml``; empty if not varied

    def resolved(self, varied: Varied) -> Varied:
        """Convert factors to values.

        Raises
        ------
        SpaceError
            If the value does not exist, or factors are not possible for it.
        """
        if not varied.name.startswith(board_parameters.PREFIX):
            nominal = self.nominal(varied.name)
            return varied.times(nominal) if varied.factor else varied
        _parameter(varied.name)
        if varied.factor:
            raise SpaceError(f"{varied.name}: factors are possible for values of plant and servo.toml only")
        return varied

    def nominal(self, name: str) -> float:
        """Nominal value of a name, in the unit of its file.

        Raises
        ------
        SpaceError
            If the number does not exist.
        """
        if name.startswith(_PLANT):
            return _number(name, self.plant)
        if name.startswith(_SERVO):
            return _number(name, _with_defaults(self.servo))
        raise SpaceError(f"{name}: the name must start with {_PLANT}, {_SERVO} or {board_parameters.PREFIX}")

    def variant(self, point: Mapping[str, float]) -> Variant:
        """Variant with these values, by name."""
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
    """Plant of a trial, and configuration and parameters of its boards."""

    plant: PlantConfig
    servo: Mapping[str, Any]  # changed ``servo.toml``, parsed; empty: configuration of the firmware
    parameters: Mapping[str, float]  # values by name

    def prepare(self, board: Board) -> None:
        """Write configuration and parameters to a new board.

        Raises
        ------
        SimulationError
            If the configuration is invalid, or the board refuses a value.
        """
        if self.servo:
            write_blocks(Replica(board), self._blocks(board.catalogue))
        for name, value in self.parameters.items():
            variable, element = _parameter(name)
            try:
                write_axis(board, variable, element, value)
            except ValueError as error:
                raise SimulationError(str(error)) from None

    def _blocks(self, catalogue: Catalogue) -> Blocks:
        try:
            return blocks_of_configuration(parse(self.servo, catalogue))
        except ConfigError as error:
            raise SimulationError(f"servo.toml: {explained(error)}") from None


def _children(node: object) -> Mapping[str, object]:
    if isinstance(node, Mapping):
        return node
    if isinstance(node, PlantConfig):
        axes = {axis_name(k): axis for k, axis in enumerate(node.axes)}
        return {**axes, "bus": node.bus, "pwm_frequency": node.pwm_frequency, "ambient": node.ambient}
    if is_dataclass(node):
        return {field.name: getattr(node, field.name) for field in fields(node)}
    return {}


def _number(name: str, root: object) -> float:
    node: object = root
    walked, *path = name.split(".")
    for key in path:
        children = _children(node)
        if key not in children:
            similar = difflib.get_close_matches(key, children, n=3) or list(children)
            raise SpaceError(f"{name}: {walked} has no {key!r}; names: {', '.join(similar)}")
        node, walked = children[key], f"{walked}.{key}"
    if isinstance(node, bool) or not isinstance(node, (int, float)):
        raise SpaceError(f"{name} is not a number and cannot be varied")
    return float(node)


def _with_defaults(servo: Mapping[str, Any]) -> dict[str, Any]:
    """Table with the inherited values of each axis."""
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
    node = table
    for key in path:
        node = node.setdefault(key, {})
    node[last] = value


def _parameter(name: str) -> tuple[str, int]:
    """Variable and element of a name."""
    try:
        variable, element = board_parameters.find(name, Catalogue.load())
    except ValueError as error:
        raise SpaceError(str(error)) from None
    if element is None and variable.count > 1:
        raise SpaceError(f"{name}: index of the axis missing: {name}[0] .. {name}[{variable.count - 1}]")
    return variable.name, element or 0
