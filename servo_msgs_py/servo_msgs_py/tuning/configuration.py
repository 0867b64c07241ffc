"""Nominal values of the controller for the board and its axes, as immutable objects; defaults merged in."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.tuning.errors import ConfigError, refused
from servo_msgs_py.tuning.passwords import password_entries
from servo_msgs_py.tuning.schema import (
    AXIS_GROUPS,
    BOARD_GROUPS,
    check_group,
    check_switches,
    check_table,
    unknown_name,
)
from servo_msgs_py.tuning.stops import Stops
from servo_msgs_py.tuning.temperature import Temperature

FEEDBACKS: Final = ("encoder", "observer")
"""Where an axis may take its angle and speed from; the first one unless the file says otherwise."""

PINS: Final = ("home", "limit_min", "limit_max", "enable", "brake")
"""Pins that an axis may have, in the order of the bits of ``pins.fitted``."""


@dataclass(frozen=True)
class Scales:
    """Full scales of the contract, SI."""

    u_dc: float  # bus voltage [V]
    u_s: float  # stator voltage [V]
    i: float  # current [A]
    speed: float  # mechanical speed [rad/s]
    torque_constant: float  # torque per current [N m/A]

    @classmethod
    def of(cls, catalogue: Catalogue) -> Scales:
        def full(name: str) -> float:
            value = catalogue.scales[name].full_scale
            assert value is not None, name
            return value

        return cls(full("bus_voltage"), full("stator_voltage"), full("current"), full("speed"), full("torque_per_amp"))


@dataclass(frozen=True)
class Board:
    """The group [board]; ``board("dead_time")`` and ``board("brake.power")`` are two of its values."""

    values: Mapping[str, float]  # by key, or by group and key
    temperature: Temperature  # of the heat sinks
    brake: bool  # whether there is a brake resistor
    passwords: Mapping[str, str]  # entry of each level that has one: a hash, or the name of an environment variable
    complete: bool = True
    """Whether the groups are there that no configuration block of an axis depends on, [board.brake] and
    [board.regeneration]; both or neither."""

    def __call__(self, key: str) -> float:
        return self.values[key]

    @property
    def period(self) -> float:
        """Fast loop [s]."""
        return 1.0 / self("pwm_frequency")

    @property
    def tick(self) -> float:
        """Slow loop [s]."""
        return self("slow_divider") * self.period

    @property
    def voltage_max(self) -> float:
        """Longest stator voltage at the nominal bus [V]: what the modulation is allowed of u_dc / sqrt 3."""
        return self("nominal_voltage") / math.sqrt(3.0) * self("voltage_use")

    @classmethod
    def of(cls, table: object) -> Board:
        """Check the numbers of the group, each by itself.

        Raises
        ------
        ConfigError
            If an entry is missing, unknown or cannot make sense.
        """
        plain = dict(check_table("board", table))
        temperature = Temperature.of(plain.pop("temperature", {}))
        passwords = password_entries(plain.pop("passwords", {}))
        absent = all(group not in plain for group in BOARD_GROUPS)
        if absent:
            return cls(
                check_group("board", "board", plain), temperature, brake=False, passwords=passwords, complete=False
            )
        groups = {group: dict(check_table(f"board.{group}", plain.pop(group, {}))) for group in BOARD_GROUPS}
        values = check_group("board", "board", plain)
        switch = {key: groups["brake"].pop(key) for key in ["fitted"] if key in groups["brake"]}
        for group, entries in groups.items():
            checked = check_group(f"board.{group}", group, entries)
            values |= {f"{group}.{key}": value for key, value in checked.items()}
        return cls(values, temperature, check_switches("board.brake", switch, ["fitted"])["fitted"], passwords)

    def refused(self, key: str, reason: str, remedy: str) -> ConfigError:
        """Error about one entry of the group."""
        return refused(f"board.{key}", self(key), reason, remedy)


@dataclass(frozen=True)
class Axis:
    """One axis with the defaults merged in; ``axis("motor.r_s")`` is one of its values."""

    name: str  # ``axis1`` or ``axis2``
    groups: Mapping[str, Mapping[str, float]]  # numbers by group and key
    features: Mapping[str, bool]  # what is enabled after reset
    stops: Stops  # stop category by command and fault
    inherited: frozenset[str]  # entries that come from [defaults]
    feedback: str  # source of angle and speed after reset, ``encoder`` or ``observer``
    pins: Mapping[str, bool]  # which of `PINS` are fitted
    exact: Mapping[str, int] = field(default_factory=dict)
    """Raw numbers of members of the configuration block, by C path, in the place of what is computed."""

    def __call__(self, path: str) -> float:
        group, key = path.split(".")
        return self.groups[group][key]

    def given(self, path: str) -> bool:
        """Whether an entry that may be left out is there."""
        group, key = path.split(".")
        return key in self.groups[group]

    def entry(self, path: str) -> str:
        """Full name of an entry, and where it stands."""
        return _place(self.name, path, self.inherited)

    def refused(self, path: str, reason: str, remedy: str) -> ConfigError:
        """Error about one entry of this axis."""
        return refused(self.entry(path), self(path), reason, remedy)

    @property
    def torque_constant(self) -> float:
        """Torque per q current at ``i_d = 0`` [N m/A]."""
        return 1.5 * self("motor.pole_pairs") * self("motor.psi_m")

    @property
    def counts(self) -> float:
        """Encoder counts per turn: four per line."""
        return 4.0 * self("encoder.lines")

    @classmethod
    def of(
        cls, table: Mapping[str, Any], name: str, feature_names: Collection[str], fault_names: Collection[str]
    ) -> Axis:
        """Merge and check the groups of one axis.

        Raises
        ------
        ConfigError
            If an entry is missing, unknown or cannot make sense by itself.
        """
        if name not in table:
            raise ConfigError(f"[{name}.motor] is missing; every axis needs its motor")
        groups: dict[str, dict[str, Any]] = {group: {} for group in (*AXIS_GROUPS, "features")}
        inherited: set[str] = set()
        feedback = FEEDBACKS[0]
        exact: dict[str, int] = {}
        for owner in ("defaults", name):
            for group, value in check_table(owner, table.get(owner, {})).items():
                if group == "feedback":
                    feedback = _feedback(f"{owner}.feedback", value)
                    continue
                if group == "exact":
                    exact |= _exact(f"{owner}.exact", value)
                    continue
                if group not in groups:
                    raise unknown_name(f"{owner}.{group}", group, (*groups, "feedback", "exact"))
                entries = check_table(f"{owner}.{group}", value)
                groups[group].update(entries)
                paths = {f"{group}.{key}" for key in entries}
                inherited = inherited | paths if owner == "defaults" else inherited - paths
        features = check_switches(f"{name}.features", groups.pop("features"), feature_names)
        origin = frozenset(inherited)
        stops = Stops.taken_from(
            groups["stop"], fault_names, lambda key: _place(name, f"stop.{key}", origin), AXIS_GROUPS["stop"]
        )
        switches = {key: groups["pins"].pop(key) for key in PINS if key in groups["pins"]}
        pins = check_switches(f"{name}.pins", switches, PINS)
        checked = {
            group: check_group(
                f"{name}.{group}", group, entries, {key: _place(name, f"{group}.{key}", origin) for key in entries}
            )
            for group, entries in groups.items()
        }
        return cls(name, checked, features, stops, origin, feedback, pins, exact)


def _exact(where: str, value: object) -> dict[str, int]:
    members = AxisConfigTable.load().members
    found = check_table(where, value)
    for path, raw in found.items():
        if path not in members:
            raise unknown_name(f"{where}.{path}", path, members)
        if isinstance(raw, bool) or not isinstance(raw, int) or not members[path].accepts(raw):
            low, high = members[path].minimum, members[path].maximum
            raise refused(f"{where}.{path}", repr(raw), "not what a board takes", f"write one of {low} .. {high}")
    return dict(found)


def _feedback(where: str, value: object) -> str:
    if not isinstance(value, str) or value not in FEEDBACKS:
        raise refused(where, repr(value), "no source of angle and speed", f"write one of {', '.join(FEEDBACKS)}")
    return value


def _place(axis: str, path: str, inherited: Collection[str]) -> str:
    suffix = f" (in [defaults.{path.split('.')[0]}])" if path in inherited else ""
    return f"{axis}.{path}{suffix}"


@dataclass(frozen=True)
class Configuration:
    """All of ``servo.toml``; `tuning.reading` makes it."""

    board: Board
    axes: tuple[Axis, ...]
    scales: Scales
