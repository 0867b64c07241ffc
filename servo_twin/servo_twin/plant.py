"""Plant of the virtual board (``plant.toml``) as validated, immutable objects."""

from __future__ import annotations

import dataclasses
import difflib
import math
import random
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Literal, cast

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

STOP_STIFFNESS_MAX: Final = 0.06
"""Largest stiffness of an end stop, relative to inertia times PWM frequency squared: the oscillation takes 25 periods,
and its torque is calculated once per period."""

RESONANCE_MAX: Final = 8000.0
"""Highest resonance of a shaft with a second mass [Hz]: 16 integration steps per period, frequency error 0.6 %."""

DAMPING_MAX: Final = 5e4
"""Largest damping rate of the twist of a shaft [1/s]: its torque is calculated every 6 to 8 us."""

BUILT_IN: Final = frozenset(
    {
        "ambient", "pwm_frequency", "pole_pairs", "theta_start", "dead_time", "i_settle",
        "encoder_lines", "encoder_jitter", "encoder_duty_error", "encoder_hysteresis",
    }
)  # fmt: skip
"""Values that cannot be changed while a board runs; all other numbers of a plant can."""

DEFAULT_FILE: Final = Path(__file__).with_name("plant.toml")


AXIS_NAMES: Final = ("axis1", "axis2")


class PlantError(ValueError):
    """Invalid plant data; the message contains the value and the valid range."""


_Rule = tuple[str, Callable[[float], bool]]

_POSITIVE: Final[_Rule] = ("above 0", lambda x: x > 0.0)
_NOT_NEGATIVE: Final[_Rule] = ("0 or more", lambda x: x >= 0.0)
_WHOLE: Final[_Rule] = ("a whole number from 1", lambda x: x >= 1.0 and x == int(x))
_ANY: Final[_Rule] = ("a finite number", lambda x: True)
_SWITCH: Final[_Rule] = ("0 or 1", lambda x: x in (0.0, 1.0))

_AXIS_RULES: Final[Mapping[str, _Rule]] = {
    "r_s": _POSITIVE,
    "l_d": _POSITIVE,
    "l_q": _POSITIVE,
    "psi_m": _NOT_NEGATIVE,
    "pole_pairs": _WHOLE,
    "inertia": _POSITIVE,
    "friction": _NOT_NEGATIVE,
    "viscous": _NOT_NEGATIVE,
    "load_torque": _ANY,
    "load_inertia": _NOT_NEGATIVE,
    "shaft_stiffness": _NOT_NEGATIVE,
    "shaft_damping": _NOT_NEGATIVE,
    "backlash": _NOT_NEGATIVE,
    "load_friction": _NOT_NEGATIVE,
    "cogging_torque": _NOT_NEGATIVE,
    "cogging_periods": _WHOLE,
    "cogging_phase": _ANY,
    "i_saturation_d": _NOT_NEGATIVE,
    "i_saturation_q": _NOT_NEGATIVE,
    "winding_warms": _SWITCH,
    "magnet_coefficient": ("between -0.01 and 0.01", lambda x: -0.01 < x < 0.01),
    "magnet_time": _NOT_NEGATIVE,
    "disc_eccentricity": ("0 or more and below 0.2", lambda x: 0.0 <= x < 0.2),
    "disc_phase": _ANY,
    "stop_min": _ANY,
    "stop_max": _ANY,
    "stop_stiffness": _NOT_NEGATIVE,
    "stop_damping": _NOT_NEGATIVE,
    "encoder_lines": _WHOLE,
    "i_full_scale": _POSITIVE,
    "i_noise": _NOT_NEGATIVE,
    "i_break": _POSITIVE,
    "dead_time": _NOT_NEGATIVE,
    "v_drop": _NOT_NEGATIVE,
    "r_on": _NOT_NEGATIVE,
    "dead_time_min": _NOT_NEGATIVE,
    "i_settle": _NOT_NEGATIVE,
    "encoder_jitter": _NOT_NEGATIVE,
    "encoder_duty_error": ("between -0.2 and 0.2", lambda x: -0.2 < x < 0.2),
    "encoder_hysteresis": ("between 0 and 0.5", lambda x: 0.0 <= x < 0.5),
    "winding_capacity": _POSITIVE,
    "winding_resistance": _POSITIVE,
    "sink_capacity": _POSITIVE,
    "sink_resistance": _POSITIVE,
}

_BUS_RULES: Final[Mapping[str, _Rule]] = {
    "u_source": _NOT_NEGATIVE,
    "r_source": _POSITIVE,
    "capacitance": _POSITIVE,
    "u_full_scale": _POSITIVE,
    "u_noise": _NOT_NEGATIVE,
    "r_brake": _NOT_NEGATIVE,
    "brake_capacity": _POSITIVE,
    "brake_resistance": _POSITIVE,
}


def _check(where: str, value: object, rule: _Rule) -> None:
    """Raise a `PlantError` unless `value` is a finite number that satisfies the rule."""
    text, holds = rule
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise PlantError(f"{where}: {value!r} is not a number")
    if not math.isfinite(value) or not holds(value):
        raise PlantError(f"{where}: {value!r} is not {text}")


@dataclass(frozen=True)
class PinsPlant:
    """Devices at the pins of one axis."""

    home_from: float = math.inf  # mechanical angle from which the home switch is closed [rad]
    home_to: float = -math.inf  # mechanical angle up to which the home switch is closed [rad]
    limit_min: float = -math.inf  # mechanical angle below which the lower limit switch opens [rad]; infinite: never
    limit_max: float = math.inf  # mechanical angle above which the upper limit switch opens [rad]; infinite: never
    enable_closed: float = 1.0  # 1: the enable circuit is closed; 0: it is open
    brake_torque: float = 0.0  # torque of the holding brake; 0: no brake [N m]
    brake_open_time: float = 0.0  # from energising the coil to the open brake [s]
    brake_close_time: float = 0.0  # from de-energising the coil to the closed brake [s]

    def __post_init__(self) -> None:
        for name in ("home_from", "home_to", "limit_min", "limit_max"):
            value: object = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or math.isnan(value):
                raise PlantError(f"{name}: {value!r} is not an angle (finite or infinite)")
        for name in ("brake_torque", "brake_open_time", "brake_close_time"):
            _check(name, getattr(self, name), _NOT_NEGATIVE)
        _check("enable_closed", self.enable_closed, _SWITCH)


@dataclass(frozen=True)
class AxisPlant:
    """Motor, shaft, encoder, inverter and current sensors of one axis."""

    r_s: float  # stator resistance [ohm]
    l_d: float  # stator inductance, d axis [H]
    l_q: float  # stator inductance, q axis [H]
    psi_m: float  # permanent-magnet flux linkage, electrical [V s]
    pole_pairs: float  # pole pairs
    inertia: float  # total inertia [kg m^2]
    friction: float  # Coulomb friction [N m]
    viscous: float  # viscous friction [N m s]
    load_torque: float  # external torque, opposes positive motion; acts on the second mass if there is one [N m]
    load_inertia: float  # inertia of the second mass at the elastic shaft; 0: no second mass [kg m^2]
    shaft_stiffness: float  # stiffness of the elastic shaft [N m/rad]
    shaft_damping: float  # damping of the elastic shaft [N m s]
    backlash: float  # total backlash of the elastic shaft [rad]
    load_friction: float  # Coulomb friction of the second mass [N m]
    cogging_torque: float  # amplitude of the cogging torque [N m]
    cogging_periods: float  # cogging periods per revolution
    cogging_phase: float  # phase of the cogging torque [rad]
    i_saturation_d: float  # saturation current of `l_d` (the unsaturated inductance); 0: no saturation [A]
    i_saturation_q: float  # saturation current of `l_q`; 0: no saturation [A]
    winding_warms: float  # 1: `r_s` follows the winding temperature at level ``ideal``; at ``registers`` it always does
    magnet_coefficient: float  # relative change of `psi_m` (given at ambient temperature) [1/K]
    magnet_time: float  # time constant between winding and magnet temperature [s]
    disc_eccentricity: float  # amplitude of the encoder error with one period per revolution [rad]
    disc_phase: float  # phase of the eccentricity error [rad]
    stop_min: float  # mechanical rotor angle of the lower end stop [rad]
    stop_max: float  # mechanical rotor angle of the upper end stop [rad]
    stop_stiffness: float  # stiffness of both end stops; 0: no end stops [N m/rad]
    stop_damping: float  # damping of both end stops [N m s]
    encoder_lines: float  # lines per revolution; four counts per line
    theta_start: float | Literal["random"]  # mechanical rotor angle at time zero [rad]; random: from the seed
    i_full_scale: float  # range of the ADC: ``-i_full_scale .. +i_full_scale`` [A]
    i_offset: tuple[float, float, float]  # offset of each current amplifier [A]
    i_noise: float  # standard deviation of a current sample [A]
    i_break: float  # hardware over-current threshold of a phase [A]
    dead_time: float  # time with both switches of a leg open, at every edge [s]
    v_drop: float  # forward drop of switch and diode [V]
    r_on: float  # resistance of switch and diode [ohm]
    dead_time_min: float
    """Shortest permitted dead time of the switches: with less, the leg shorts the bus for the difference, which trips
    the comparator [s]. This and all following values have an effect at level ``registers`` only."""
    i_settle: float  # time constant of the current amplifiers [s]
    encoder_jitter: float  # standard deviation of an edge of the encoder [counts]
    encoder_duty_error: float  # duty cycle of an encoder line, minus 1/2
    encoder_hysteresis: float  # hysteresis of an edge between the two directions [counts]
    winding_capacity: float  # thermal capacity of the winding [J/K]
    winding_resistance: float  # thermal resistance from the winding to the ambient air [K/W]
    sink_capacity: float  # thermal capacity of the inverter's heatsink [J/K]
    sink_resistance: float  # thermal resistance from the heatsink to the ambient air [K/W]
    pins: PinsPlant = field(default_factory=PinsPlant)  # devices at the pins

    def __post_init__(self) -> None:
        pins: object = self.pins
        if isinstance(pins, Mapping):
            object.__setattr__(self, "pins", _part(PinsPlant, "pins", {"pins": pins}))
        for name, rule in _AXIS_RULES.items():
            _check(name, getattr(self, name), rule)
        if self.stop_min > self.stop_max:
            raise PlantError(f"stop_min: {self.stop_min!r} is not below stop_max = {self.stop_max!r}")
        if self.load_inertia > 0.0 and self.shaft_stiffness == 0.0:
            raise PlantError("shaft_stiffness: must be above 0 with a second mass (load_inertia)")
        if self.resonance > RESONANCE_MAX:
            raise PlantError(
                f"shaft_stiffness: {self.shaft_stiffness!r} N m/rad gives a resonance of {self.resonance:.3g} Hz; "
                f"the model is limited to {RESONANCE_MAX:g} Hz"
            )
        if self.shaft_damping * self._inverse_reduced_inertia > DAMPING_MAX:
            raise PlantError(
                f"shaft_damping: {self.shaft_damping!r} N m s is too large for the integration step; "
                f"with these masses the maximum is {DAMPING_MAX / self._inverse_reduced_inertia:.3g}"
            )
        if self.theta_start != "random":
            _check("theta_start", self.theta_start, _ANY)
        offsets: object = self.i_offset
        if not isinstance(offsets, (tuple, list)) or len(offsets) != 3:
            raise PlantError(f"i_offset: {offsets!r} is not a list of three currents")
        for value in offsets:
            _check("i_offset", value, _ANY)
        object.__setattr__(self, "i_offset", tuple(map(float, offsets)))

    def members(self) -> dict[str, Any]:
        """Values by the names of the C structure ``plant_axis_t``."""
        return {name: value for name, value in (vars(self) | vars(self.pins)).items() if name != "pins"}

    @property
    def resonance(self) -> float:
        """Resonance of rotor and second mass, both free [Hz]; 0 without a second mass."""
        return math.sqrt(self.shaft_stiffness * self._inverse_reduced_inertia) / (2.0 * math.pi)

    @property
    def _inverse_reduced_inertia(self) -> float:
        """Inverse of the reduced inertia of the twist [1 / (kg m^2)]; 0 without a second mass."""
        return 1.0 / self.inertia + 1.0 / self.load_inertia if self.load_inertia > 0.0 else 0.0

    @property
    def torque_constant(self) -> float:
        """Torque per q current at ``i_d = 0`` [N m/A]."""
        return 1.5 * self.pole_pairs * self.psi_m


@dataclass(frozen=True)
class BusPlant:
    """Common supply and capacitor of both axes, and the voltage sensor."""

    u_source: float  # open-circuit voltage of the supply [V]
    r_source: float  # internal resistance of the supply [ohm]; the supply cannot absorb energy
    capacitance: float  # capacitance of the bus [F]
    u_full_scale: float  # full scale of the ADC [V]
    u_noise: float  # standard deviation of a voltage sample [V]
    r_brake: float  # brake resistor [ohm]; 0: none
    brake_capacity: float  # heat capacity of the brake resistor [J/K]
    brake_resistance: float  # thermal resistance from the brake resistor to the ambient air [K/W]

    def __post_init__(self) -> None:
        for name, rule in _BUS_RULES.items():
            _check(name, getattr(self, name), rule)


@dataclass(frozen=True)
class PlantConfig:
    """The whole plant: two axes on one bus."""

    axes: tuple[AxisPlant, AxisPlant]  # axis 1 and axis 2
    bus: BusPlant  # the DC bus
    pwm_frequency: float  # carrier of the inverters [Hz]
    ambient: float  # temperature of the ambient air [deg C]

    def __post_init__(self) -> None:
        _check("pwm_frequency", self.pwm_frequency, _POSITIVE)
        _check("ambient", self.ambient, _ANY)
        if len(self.axes) != 2:
            raise PlantError(f"axes: {len(self.axes)} given, a board has two")
        quarter_ns = 1e9 / self.pwm_frequency / 4.0
        if abs(quarter_ns - round(quarter_ns)) > 1e-6 or quarter_ns < 1.0:
            raise PlantError(
                f"pwm_frequency: {self.pwm_frequency!r} Hz does not divide into quarter periods of whole nanoseconds"
            )
        for name, axis in zip(AXIS_NAMES, self.axes, strict=True):
            maximum = STOP_STIFFNESS_MAX * axis.inertia * self.pwm_frequency**2
            if axis.stop_stiffness > maximum:
                raise PlantError(
                    f"{name}.stop_stiffness: {axis.stop_stiffness!r} N m/rad is too large for the integration step; "
                    f"with this inertia the maximum is {maximum:.3g}"
                )

    @classmethod
    def load(cls, path: Path | str | None = None) -> PlantConfig:
        """Read a plant file.

        Parameters
        ----------
        path : path-like, optional
            TOML file with changes of the packaged ``plant.toml``; by default no changes.

        Raises
        ------
        PlantError
            If the file is not TOML, or contains an unknown name or an invalid value.
        OSError
            If the file cannot be read.
        """
        if path is None:
            return _packaged()
        source = Path(path)
        return _named(source, _merge(source, _packaged_table(), _read(source)))

    @classmethod
    def parse(cls, table: Mapping[str, Any]) -> PlantConfig:
        """Create the plant from a complete parsed table."""
        return cls(
            axes=(_part(AxisPlant, "axis1", table), _part(AxisPlant, "axis2", table)),
            bus=_part(BusPlant, "bus", table),
            pwm_frequency=table["pwm_frequency"],
            ambient=table["ambient"],
        )

    def drawn(self, seed: int) -> PlantConfig:
        """Copy with random start angles replaced by values that depend on the seed only."""
        plant = self
        for axis, entry in enumerate(self.axes):
            if entry.theta_start == "random":
                angle = random.Random(f"theta_start {axis} {seed}").uniform(-math.pi, math.pi)
                plant = plant.with_axis(axis, theta_start=angle)
        return plant

    def fill(self, config: Any) -> None:
        """Copy all values to a C ``board_config_t``; call `drawn` before."""
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
            If the name is unknown or the value is invalid.
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


def _replaced(place: Any, name: str, value: float) -> Any:
    """Copy of a dataclass with a number replaced, also in a nested dataclass."""
    key, _, rest = name.partition(".")
    known = [field.name for field in dataclasses.fields(place)]
    present = getattr(place, key) if key in known else None
    if dataclasses.is_dataclass(present) and rest:
        return dataclasses.replace(place, **{key: _replaced(present, rest, value)})
    if key not in known or rest or not isinstance(present, (int, float, str)):
        near = difflib.get_close_matches(name, known, n=3)
        raise PlantError("no such number of the plant" + (f"; similar names: {', '.join(near)}" if near else ""))
    return dataclasses.replace(place, **{key: value})


@lru_cache(maxsize=1)
def _packaged_table() -> Mapping[str, Any]:
    return _read(DEFAULT_FILE)


@lru_cache(maxsize=1)
def _packaged() -> PlantConfig:
    """Plant of the packaged file; cached because parsing takes most of the time of a new board."""
    return _named(DEFAULT_FILE, _packaged_table())


def _read(path: Path) -> dict[str, Any]:
    try:
        table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlantError(f"{path}: {error}") from error
    return table


def _named(path: Path, table: Mapping[str, Any]) -> PlantConfig:
    """Plant from a table; error messages start with the path."""
    try:
        return PlantConfig.parse(table)
    except PlantError as error:
        raise PlantError(f"{path}: {error}") from None


def _merge(path: Path, base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Table `base` with the entries of `changes`, which must all exist in `base`."""
    merged = dict(base)
    for key, value in changes.items():
        if key not in base:
            raise PlantError(f"{path}: unknown name {key!r}; known names: {', '.join(base)}")
        if isinstance(base[key], dict):
            if not isinstance(value, dict):
                raise PlantError(f"{path}: {key} is not a table")
            value = _merge(path, base[key], value)
        merged[key] = value
    return merged


def _part(kind: type[Any], name: str, table: Mapping[str, Any]) -> Any:
    """Dataclass from its table; error messages start with the name of the table."""
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
