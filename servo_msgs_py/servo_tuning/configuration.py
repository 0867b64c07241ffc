"""Nominal values of the controller for the board and its axes, as immutable objects; defaults merged in."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from servo_msgs_py.board_description import DEFAULT_BOARD, BoardDescription, OtherBoardError, check_board
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import SLOW_PERIODS

from servo_tuning.errors import ConfigError, Entry, Problem, Remedy, problem, refused
from servo_tuning.members import MEMBERS, read_members
from servo_tuning.motor import Load, Motor
from servo_tuning.passwords import password_entries
from servo_tuning.schema import (
    AXIS_GROUPS,
    BOARD_GROUPS,
    check_group,
    check_switches,
    check_table,
    unknown_name,
)
from servo_tuning.stops import Stops
from servo_tuning.temperature import Temperature
from servo_tuning.torque_ripple import TORQUE_RIPPLE, Harmonic, read_harmonics

FEEDBACKS: Final = ("encoder", "observer")
"""Sources of angle and speed; the first is the default."""

PINS: Final = ("home", "limit_min", "limit_max", "enable", "brake")
"""Pins that can be fitted, in the order of the bits of ``pins.fitted``."""


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
        names = ("bus_voltage", "stator_voltage", "current", "speed", "torque_per_amp")
        return cls(*map(catalogue.full_scale, names))


@dataclass(frozen=True)
class Board:
    """The group [board] and the numbers of the hardware; values by key, such as ``board("brake.power")``."""

    values: Mapping[str, float]  # by key, or by group and key; of the hardware as in `HARDWARE`
    temperature: Temperature  # of the heat sinks
    brake: bool  # whether there is a brake resistor
    passwords: Mapping[str, str]  # entry of each level that has one: a hash, or the name of an environment variable
    description: BoardDescription  # what the hardware gives
    complete: bool = True
    """Whether [board.brake] and [board.regeneration] are present: both or neither. No configuration block of an axis
    depends on them."""

    def __call__(self, key: str) -> float:
        return self.values[key]

    @property
    def period(self) -> float:
        """Period of the fast loop [s]."""
        return 1.0 / self("pwm_frequency")

    @property
    def tick(self) -> float:
        """Period of the slow loop [s]."""
        return self("slow_divider") * self.period

    @property
    def voltage_max(self) -> float:
        """Largest stator voltage at the nominal bus voltage: ``voltage_use`` times u_dc / sqrt 3 [V]."""
        return self("nominal_voltage") / math.sqrt(3.0) * self("voltage_use")

    @classmethod
    def of(cls, table: object, description: BoardDescription) -> Board:
        """Check each number of the group by itself.

        Raises
        ------
        ConfigError
            If an entry is missing, unknown or out of range, or the file is for another board.
        """
        plain = dict(check_table("board", table))
        check_board_name(plain.pop("name", DEFAULT_BOARD), description)
        fixed = _fixed(plain, description)
        temperature = Temperature.of(plain.pop("temperature", {}))
        passwords = password_entries(plain.pop("passwords", {}))
        absent = all(group not in plain for group in BOARD_GROUPS)
        if absent:
            values = check_group("board", "board", plain) | fixed
            return cls(values, temperature, False, passwords, description, complete=False)
        groups = {group: dict(check_table(f"board.{group}", plain.pop(group, {}))) for group in BOARD_GROUPS}
        values = check_group("board", "board", plain) | fixed
        switch = {key: groups["brake"].pop(key) for key in ["fitted"] if key in groups["brake"]}
        for group, entries in groups.items():
            checked = check_group(f"board.{group}", group, entries)
            values |= {f"{group}.{key}": value for key, value in checked.items()}
        brake = check_switches("board.brake", switch, ["fitted"])["fitted"]
        return cls(values, temperature, brake, passwords, description)

    def refused(self, key: str, reason: str, *remedies: Remedy | str) -> ConfigError:
        """Error about one entry of the group; remedies with the full names of entries."""
        return refused(f"board.{key}", self(key), reason, *remedies)


HARDWARE: Final = ("pwm_frequency", "timer_clock", "dead_time", "switch_drop")
"""Numbers of the description of a board that the tuning code uses."""


def _fixed(table: dict[str, Any], description: BoardDescription) -> dict[str, float]:
    """Numbers that no file can change. Older files have them as entries of [board]: these are taken from the table.

    Raises
    ------
    ConfigError
        If such an entry has another number.
    """
    fixed = {key: float(getattr(description, key)) for key in HARDWARE} | {"slow_divider": float(SLOW_PERIODS)}
    for key, number in fixed.items():
        if key in table and (given := table.pop(key)) != number:
            raise refused(f"board.{key}", given, f"the board {description.name} has {number:g}", "remove the entry")
    return fixed


def check_board_name(name: object, expected: BoardDescription) -> None:
    """Check the entry ``board.name`` of a file.

    Raises
    ------
    ConfigError
        If the file is for another board.
    """
    try:
        check_board(str(name), expected)
    except OtherBoardError as error:
        advice = f"use a configuration for {expected.name}"
        raise refused("board.name", repr(name), f"the file is for another board: {error}", advice) from None


@dataclass(frozen=True)
class Axis:
    """One axis with the defaults merged in; values by path, such as ``axis("motor.r_s")``."""

    name: str  # ``axis1`` or ``axis2``
    groups: Mapping[str, Mapping[str, float]]  # numbers by group and key
    features: Mapping[str, bool]  # state after reset, by name
    stops: Stops  # stop category by command and fault
    inherited: frozenset[str]  # entries that come from [defaults]
    feedback: str  # source of angle and speed after reset, ``encoder`` or ``observer``
    pins: Mapping[str, bool]  # which of `PINS` are fitted
    harmonics: tuple[Harmonic, ...] = ()  # torque ripple that the board compensates
    members: Mapping[str, int] = field(default_factory=dict)
    """Raw numbers of members of the configuration block, by C path, that replace the computed ones."""

    def __call__(self, path: str) -> float:
        group, key = path.split(".")
        return self.groups[group][key]

    def given(self, path: str) -> bool:
        """Whether an optional entry is present."""
        group, key = path.split(".")
        return key in self.groups[group]

    def entry(self, path: str, quantity: str = "") -> Entry:
        """Place of an entry, or of a quantity that is computed from it."""
        return _entry(self.name, path, self.inherited, quantity)

    def refused(self, path: str, reason: str, *remedies: Remedy | str) -> ConfigError:
        """Error about one entry of this axis; remedies as for `named`."""
        return ConfigError(self.problem(path, reason, *remedies))

    def problem(self, path: str, reason: str, *remedies: Remedy | str) -> Problem:
        """Problem of one entry of this axis; remedies as for `named`."""
        return problem(self.entry(path), self(path), reason, *map(self.named, remedies))

    def named(self, remedy: Remedy | str) -> Remedy | str:
        """A remedy whose entry is a path of this axis or one of ``board.``, with the full name of the entry."""
        return remedy if isinstance(remedy, str) else self._named(remedy)

    def _named(self, remedy: Remedy) -> Remedy:
        also = None if remedy.also is None else self._named(remedy.also)
        if remedy.entry.startswith("board."):
            return replace(remedy, also=also)
        group, key = remedy.entry.split(".")
        return replace(remedy, entry=f"{self.name}.{remedy.entry}", whole=AXIS_GROUPS[group][key].whole, also=also)

    @property
    def motor(self) -> Motor:
        """The motor with its shaft."""
        entries = ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia")
        return Motor(**{key: self(f"motor.{key}") for key in entries}, viscous=self("friction.viscous"))

    @property
    def load(self) -> Load | None:
        """The load behind a spring; None: not given."""
        entries = {key: self(f"load.{key}") for key in AXIS_GROUPS["load"] if self.given(f"load.{key}")}
        return Load(**entries) if entries else None

    @property
    def torque_constant(self) -> float:
        """Torque per q current at ``i_d = 0`` [N m/A]."""
        return self.motor.torque_constant

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
            If an entry is missing, unknown or out of range.
        """
        if name not in table:
            raise ConfigError(f"[{name}.motor] is missing; every axis needs a motor")
        groups: dict[str, dict[str, Any]] = {group: {} for group in (*AXIS_GROUPS, "features", TORQUE_RIPPLE)}
        inherited: set[str] = set()
        feedback = FEEDBACKS[0]
        members: dict[str, int] = {}
        for owner in ("defaults", name):
            for group, value in check_table(owner, table.get(owner, {})).items():
                if group == "feedback":
                    feedback = _feedback(f"{owner}.feedback", value)
                    continue
                if group == MEMBERS:
                    members |= read_members(f"{owner}.{MEMBERS}", value)
                    continue
                if group not in groups:
                    raise unknown_name(f"{owner}.{group}", group, (*groups, "feedback", MEMBERS))
                entries = check_table(f"{owner}.{group}", value)
                groups[group].update(entries)
                paths = {f"{group}.{key}" for key in entries}
                inherited = inherited | paths if owner == "defaults" else inherited - paths
        features = check_switches(f"{name}.features", groups.pop("features"), feature_names)
        harmonics = read_harmonics(f"{name}.{TORQUE_RIPPLE}", groups.pop(TORQUE_RIPPLE))
        origin = frozenset(inherited)
        stops = Stops.extract(
            groups["stop"], fault_names, lambda key: _entry(name, f"stop.{key}", origin), AXIS_GROUPS["stop"]
        )
        switches = {key: groups["pins"].pop(key) for key in PINS if key in groups["pins"]}
        pins = check_switches(f"{name}.pins", switches, PINS)
        checked = {
            group: check_group(
                f"{name}.{group}", group, entries, {key: _entry(name, f"{group}.{key}", origin) for key in entries}
            )
            for group, entries in groups.items()
        }
        return cls(name, checked, features, stops, origin, feedback, pins, harmonics, members)


def _feedback(where: str, value: object) -> str:
    if not isinstance(value, str) or value not in FEEDBACKS:
        raise refused(where, repr(value), "not a source of angle and speed", f"write one of {', '.join(FEEDBACKS)}")
    return value


def _entry(axis: str, path: str, inherited: Collection[str], quantity: str = "") -> Entry:
    return Entry(f"{axis}.{path}", path.split(".")[0] if path in inherited else "", quantity)


@dataclass(frozen=True)
class Configuration:
    """Contents of ``servo.toml``; created by `tuning.reading`."""

    board: Board
    axes: tuple[Axis, ...]
    scales: Scales
    table: Mapping[str, Any] = field(default_factory=dict)  # parsed ``servo.toml``; empty: not from a file
