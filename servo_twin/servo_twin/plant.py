"""What is really there: the plant of the virtual board (``plant.toml``) as checked, immutable objects."""

from __future__ import annotations

import dataclasses
import difflib
import math
import random
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeVar, cast, get_type_hints

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

STIFFEST: Final = 0.06
"""Of an end stop, over inertia and the square of the PWM frequency: it swings in 25 periods, and its torque is worked
out once in each."""

FASTEST: Final = 8000.0
"""Resonance of a shaft with a second mass [Hz]: 16 steps of it, in which its frequency is off by 0.6 %."""

DAMPED: Final = 5e4
"""Of a twist, at most [1/s]: a shaft's torque is worked out every 6 to 8 us."""

DEFAULT_FILE: Final = Path(__file__).with_name("plant.toml")


AXIS_NAMES: Final = ("axis1", "axis2")


class PlantError(ValueError):
    """A description of the plant is not usable; the message names the value and what it should be."""


class _Rule(NamedTuple):
    """What a number of the plant has to be."""

    text: str
    holds: Callable[[float], bool]


_T = TypeVar("_T")
_FINITE: Final = _Rule("a finite number", math.isfinite)
_FIXED: Final = "fixed"

Positive = Annotated[float, _Rule("above 0", lambda x: 0.0 < x < math.inf)]
NotNegative = Annotated[float, _Rule("0 or more", lambda x: 0.0 <= x < math.inf)]
Whole = Annotated[float, _Rule("a whole number from 1", lambda x: 1.0 <= x < math.inf and x == int(x))]
Finite = Annotated[float, _FINITE]
Angle = Annotated[float, _Rule("an angle, finite or infinite", lambda x: not math.isnan(x))]
Switch = Annotated[float, _Rule("0 or 1", lambda x: x in (0.0, 1.0))]
MagnetChange = Annotated[float, _Rule("between -0.01 and 0.01", lambda x: -0.01 < x < 0.01)]
Eccentricity = Annotated[float, _Rule("0 or more and below 0.2", lambda x: 0.0 <= x < 0.2)]
DutyError = Annotated[float, _Rule("between -0.2 and 0.2", lambda x: -0.2 < x < 0.2)]
Hysteresis = Annotated[float, _Rule("between 0 and 0.5", lambda x: 0.0 <= x < 0.5)]

Fixed = Annotated[_T, _FIXED]
"""As it is from power-on, at both levels; all other numbers of a plant can change while a board runs."""


@cache
def _marks(part: type) -> Sequence[tuple[str, object]]:
    """Rules and other marks of the fields, in their order, with the name of the field."""
    hints = get_type_hints(part, include_extras=True).items()
    return [(name, mark) for name, hint in hints for mark in getattr(hint, "__metadata__", ())]


def _check(where: str, value: object, rule: _Rule) -> None:
    """Raise a `PlantError` unless `value` is a number that fulfils the rule."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise PlantError(f"{where}: {value!r} is not a number")
    if not rule.holds(value):
        raise PlantError(f"{where}: {value!r} is not {rule.text}")


def _check_fields(part: Any) -> None:
    """The same for all fields that have a rule."""
    for name, mark in _marks(part.__class__):
        if isinstance(mark, _Rule):
            _check(name, getattr(part, name), mark)


@dataclass(frozen=True)
class PinsPlant:
    """What is wired to the pins of one axis."""

    home_from: Angle = math.inf  # mechanical angle from which the home switch is closed [rad]
    home_to: Angle = -math.inf  # mechanical angle up to which it is closed [rad]
    limit_min: Angle = -math.inf  # mechanical angle below which the lower limit switch opens [rad]; infinite: never
    limit_max: Angle = math.inf  # mechanical angle above which the upper one opens [rad]; infinite: never
    enable_closed: Switch = 1.0  # 1: the enable circuit is closed; 0: it is open
    brake_torque: NotNegative = 0.0  # of the holding brake; 0: there is none [N m]
    brake_open_time: NotNegative = 0.0  # from energising the coil to the open brake [s]
    brake_close_time: NotNegative = 0.0  # from de-energising the coil to the closed brake [s]

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class AxisPlant:
    """Motor, shaft, encoder, inverter and current sensors of one axis."""

    r_s: Positive  # stator resistance [ohm]
    l_d: Positive  # stator inductance, d axis [H]
    l_q: Positive  # stator inductance, q axis [H]
    psi_m: NotNegative  # permanent-magnet flux linkage, electrical [V s]
    pole_pairs: Fixed[Whole]  # electrical turns per mechanical turn

    inertia: Positive  # total inertia [kg m^2]
    friction: NotNegative  # Coulomb friction [N m]
    viscous: NotNegative  # viscous friction [N m s]

    load_torque: Finite  # external, slows positive motion, drives negative; on the second mass if there is one [N m]
    load_inertia: NotNegative  # second mass at the end of an elastic shaft; 0: there is none, `inertia` is all [kg m^2]
    shaft_stiffness: NotNegative  # of the elastic shaft [N m/rad]
    shaft_damping: NotNegative  # of the elastic shaft [N m s]
    backlash: NotNegative  # of the elastic shaft, from one flank to the other [rad]
    load_friction: NotNegative  # Coulomb friction of the second mass [N m]

    cogging_torque: NotNegative  # amplitude [N m]
    cogging_periods: Whole  # per turn
    cogging_phase: Finite  # [rad]

    i_saturation_d: NotNegative  # current scale of the saturation of `l_d`, which is that without current; 0: none [A]
    i_saturation_q: NotNegative  # the same of `l_q` [A]
    winding_warms: Switch  # 1: `r_s` follows the winding's temperature at level ``ideal`` too; at ``registers`` always
    magnet_coefficient: MagnetChange  # relative change of `psi_m`, which is that at the ambient temperature [1/K]
    magnet_time: NotNegative  # time constant with which the magnet follows the winding's temperature [s]

    disc_eccentricity: Eccentricity  # amplitude of the encoder's error once per turn [rad]
    disc_phase: Finite  # phase of that error [rad]

    stop_min: Finite  # mechanical rotor angle of the lower end stop [rad]
    stop_max: Finite  # mechanical rotor angle of the upper end stop [rad]
    stop_stiffness: NotNegative  # of both end stops; 0: there are none [N m/rad]
    stop_damping: NotNegative  # of both end stops [N m s]

    encoder_lines: Fixed[Whole]  # lines per turn; counts are four times as many
    theta_start: Fixed[float | Literal["random"]]  # mechanical rotor angle at time zero [rad]; random: by the seed

    i_full_scale: Positive  # range of the ADC: ``-i_full_scale .. +i_full_scale`` [A]
    i_offset: tuple[float, float, float]  # offset of each current amplifier [A]
    i_noise: NotNegative  # standard deviation of a current sample [A]
    i_break: Positive  # hardware over-current threshold of a phase [A]

    dead_time: Fixed[NotNegative]  # time for which both switches of a leg are open at every edge [s]
    v_drop: NotNegative  # forward drop of switch and diode [V]
    r_on: NotNegative  # resistance of switch and diode [ohm]

    dead_time_min: NotNegative
    """Shortest dead time of the switches: with less the leg is a short for the rest of it, which trips the comparator
    [s]. This and all that follows has an effect at switching level only."""
    i_settle: Fixed[NotNegative]  # time constant of the current amplifiers [s]
    encoder_jitter: Fixed[NotNegative]  # standard deviation of an edge of the encoder [counts]
    encoder_duty_error: Fixed[DutyError]  # part of its period for which an encoder line is high, minus 1/2
    encoder_hysteresis: Fixed[Hysteresis]  # distance of an edge between the two directions, against chattering [counts]

    winding_capacity: Positive  # thermal capacity of the winding [J/K]
    winding_resistance: Positive  # thermal resistance from the winding to the air [K/W]
    sink_capacity: Positive  # thermal capacity of the inverter's heatsink [J/K]
    sink_resistance: Positive  # thermal resistance from the heatsink to the air [K/W]

    pins: PinsPlant = field(default_factory=PinsPlant)  # what is wired to the pins

    def __post_init__(self) -> None:
        pins: object = self.pins
        if isinstance(pins, Mapping):
            object.__setattr__(self, "pins", _part(PinsPlant, "pins", {"pins": pins}))
        _check_fields(self)
        if self.stop_min > self.stop_max:
            raise PlantError(f"stop_min: {self.stop_min!r} is not below stop_max = {self.stop_max!r}")
        if self.load_inertia > 0.0 and self.shaft_stiffness == 0.0:
            raise PlantError("shaft_stiffness: 0 does not couple a second mass (load_inertia) to the rotor")
        if self.resonance > FASTEST:
            raise PlantError(
                f"shaft_stiffness: {self.shaft_stiffness!r} N m/rad lets the masses swing with {self.resonance:.3g} Hz;"
                f" the most that is followed is {FASTEST:g} Hz"
            )
        if self.shaft_damping * self._per_mass > DAMPED:
            raise PlantError(
                f"shaft_damping: {self.shaft_damping!r} N m s stops a twist within a step of the plant;"
                f" with these masses the most is {DAMPED / self._per_mass:.3g}"
            )
        if self.theta_start != "random":
            _check("theta_start", self.theta_start, _FINITE)
        offsets: object = self.i_offset
        if not isinstance(offsets, (tuple, list)) or len(offsets) != 3:
            raise PlantError(f"i_offset: {offsets!r} is not a list of three currents")
        for value in offsets:
            _check("i_offset", value, _FINITE)
        object.__setattr__(self, "i_offset", tuple(map(float, offsets)))

    def members(self) -> dict[str, Any]:
        """Values by the names of the C structure ``plant_axis_t``."""
        return {name: value for name, value in (vars(self) | vars(self.pins)).items() if name != "pins"}

    @property
    def resonance(self) -> float:
        """Frequency at which rotor and second mass swing against each other, both free [Hz]; 0 without one."""
        return math.sqrt(self.shaft_stiffness * self._per_mass) / (2.0 * math.pi)

    @property
    def _per_mass(self) -> float:
        """One over the mass that a twist moves [1 / (kg m^2)]; 0 without a second mass."""
        return 1.0 / self.inertia + 1.0 / self.load_inertia if self.load_inertia > 0.0 else 0.0

    @property
    def torque_constant(self) -> float:
        """Torque per q current at ``i_d = 0`` [N m/A]."""
        return 1.5 * self.pole_pairs * self.psi_m


@dataclass(frozen=True)
class BusPlant:
    """Supply and capacitor that both axes share, and the voltage sensor."""

    u_source: NotNegative  # open-circuit voltage of the supply [V]
    r_source: Positive  # its resistance [ohm]; it takes no energy back
    capacitance: Positive  # capacitance of the bus [F]
    u_full_scale: Positive  # full scale of the ADC [V]
    u_noise: NotNegative  # standard deviation of a voltage sample [V]
    r_brake: NotNegative  # brake resistor [ohm]; 0: there is none
    brake_capacity: Positive  # heat capacity of the brake resistor [J/K]
    brake_resistance: Positive  # thermal resistance from the brake resistor to the air [K/W]

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class PlantConfig:
    """The whole plant: two axes on one bus."""

    axes: tuple[AxisPlant, AxisPlant]  # axis 1 and axis 2
    bus: BusPlant  # the DC bus
    pwm_frequency: Fixed[Positive]  # carrier of the inverters [Hz]
    ambient: Fixed[Finite]  # temperature of the air around motors and heatsinks [deg C]

    def __post_init__(self) -> None:
        _check_fields(self)
        if len(self.axes) != 2:
            raise PlantError(f"axes: {len(self.axes)} given, a board has two")
        quarter_ns = 1e9 / self.pwm_frequency / 4.0
        if abs(quarter_ns - round(quarter_ns)) > 1e-6 or quarter_ns < 1.0:
            raise PlantError(
                f"pwm_frequency: {self.pwm_frequency!r} Hz does not divide into quarter periods of whole nanoseconds"
            )
        for name, axis in zip(AXIS_NAMES, self.axes, strict=True):
            maximum = STIFFEST * axis.inertia * self.pwm_frequency**2
            if axis.stop_stiffness > maximum:
                raise PlantError(
                    f"{name}.stop_stiffness: {axis.stop_stiffness!r} N m/rad swings faster than a PWM period shows;"
                    f" with this inertia the most is {maximum:.3g}"
                )

    @classmethod
    def load(cls, path: Path | str | None = None) -> PlantConfig:
        """Read a description of the plant.

        Parameters
        ----------
        path : path-like, optional
            A TOML file that names what differs from the packaged ``plant.toml``; without it, that file itself.

        Raises
        ------
        PlantError
            If the file is not TOML, names something unknown or holds an impossible value.
        OSError
            If it cannot be read.
        """
        if path is None:
            return _packaged()
        source = Path(path)
        return _named(source, _merge(source, _packaged_table(), _read(source)))

    @classmethod
    def parse(cls, table: Mapping[str, Any]) -> PlantConfig:
        """Build the plant from a complete parsed table."""
        return cls(
            axes=(_part(AxisPlant, "axis1", table), _part(AxisPlant, "axis2", table)),
            bus=_part(BusPlant, "bus", table),
            pwm_frequency=table["pwm_frequency"],
            ambient=table["ambient"],
        )

    def drawn(self, seed: int) -> PlantConfig:
        """Copy with every random start angle drawn; the same seed draws the same angles."""
        plant = self
        for axis, entry in enumerate(self.axes):
            if entry.theta_start == "random":
                angle = random.Random(f"theta_start {axis} {seed}").uniform(-math.pi, math.pi)
                plant = plant.with_axis(axis, theta_start=angle)
        return plant

    def fill(self, config: Any) -> None:
        """Write everything into a C ``board_config_t``; random start angles have to be drawn before."""
        for target, axis in zip(config.axis, self.axes, strict=True):
            for name, value in axis.members().items():
                setattr(target, name, value)
        for name, value in vars(self.bus).items():
            setattr(config.bus, name, value)
        config.pwm_frequency, config.ambient = self.pwm_frequency, self.ambient

    def with_axis(self, axis: int, **changes: Any) -> PlantConfig:
        """Copy with some values of one axis (index 0 or 1) replaced."""
        axes = list(self.axes)
        axes[axis] = dataclasses.replace(axes[axis], **changes)
        return dataclasses.replace(self, axes=(axes[0], axes[1]))

    def with_value(self, name: str, value: float) -> PlantConfig:
        """Copy with one number [SI] replaced, by its name in the plant file: ``axis1.r_s``, ``bus.u_source``.

        Raises
        ------
        PlantError
            If there is no such number, or the plant cannot have this value.
        """
        part, _, rest = name.partition(".")
        try:
            if part in AXIS_NAMES and rest:
                axes = list(self.axes)
                axis = AXIS_NAMES.index(part)
                axes[axis] = _replaced(axes[axis], rest, value)
                return dataclasses.replace(self, axes=(axes[0], axes[1]))
            return cast(PlantConfig, _replaced(self, name, value))
        except PlantError as error:
            raise PlantError(f"{name}: {error}") from None

    def with_bus(self, **changes: Any) -> PlantConfig:
        """Copy with some values of the bus replaced."""
        return dataclasses.replace(self, bus=dataclasses.replace(self.bus, **changes))


BUILT_IN: Final = frozenset(name for part in (AxisPlant, PlantConfig) for name, mark in _marks(part) if mark == _FIXED)
"""Names of the fixed numbers."""


def _replaced(place: Any, name: str, value: float) -> Any:
    """Copy of one of the dataclasses with a number replaced, in it or in a part of it."""
    key, _, rest = name.partition(".")
    known = [field.name for field in dataclasses.fields(place)]
    present = getattr(place, key) if key in known else None
    if dataclasses.is_dataclass(present) and rest:
        return dataclasses.replace(place, **{key: _replaced(present, rest, value)})
    if key not in known or rest or not isinstance(present, (int, float, str)):
        near = difflib.get_close_matches(name, known, n=3)
        raise PlantError("no number of the plant has this name" + (f"; near are {', '.join(near)}" if near else ""))
    return dataclasses.replace(place, **{key: value})


@lru_cache(maxsize=1)
def _packaged_table() -> Mapping[str, Any]:
    return _read(DEFAULT_FILE)


@lru_cache(maxsize=1)
def _packaged() -> PlantConfig:
    """Plant of the packaged file; parsing takes longer than everything else that a new board needs."""
    return _named(DEFAULT_FILE, _packaged_table())


def _read(path: Path) -> dict[str, Any]:
    try:
        table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlantError(f"{path}: {error}") from error
    return table


def _named(path: Path, table: Mapping[str, Any]) -> PlantConfig:
    """Plant from a table, with the file in front of every complaint."""
    try:
        return PlantConfig.parse(table)
    except PlantError as error:
        raise PlantError(f"{path}: {error}") from None


def _merge(path: Path, base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Table `base` with the entries of `changes`, all of which must have a counterpart."""
    merged = dict(base)
    for key, value in changes.items():
        if key not in base:
            raise PlantError(f"{path}: unknown name {key!r}; known are {', '.join(base)}")
        if isinstance(base[key], dict):
            if not isinstance(value, dict):
                raise PlantError(f"{path}: {key} is not a table")
            value = _merge(path, base[key], value)
        merged[key] = value
    return merged


def _part(kind: type[Any], name: str, table: Mapping[str, Any]) -> Any:
    """One of the dataclasses from its table, with the table's name in front of every complaint."""
    entries = table.get(name, {})
    fields = [field.name for field in dataclasses.fields(kind)]
    missing = [field for field in fields if field not in entries]
    unknown = [entry for entry in entries if entry not in fields]
    if missing or unknown:
        problem = f"{missing[0]} is missing" if missing else f"unknown name {unknown[0]!r}"
        raise PlantError(f"{name}: {problem}")
    try:
        return kind(**entries)
    except PlantError as error:
        raise PlantError(f"{name}.{error}") from None
