"""Plant of the virtual board (``plant.toml``) as validated, immutable objects."""

from __future__ import annotations

import dataclasses
import difflib
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, cast, get_type_hints

from servo_msgs_py.catalogue import AXIS_NAMES
from servo_msgs_py.quantity import ABOVE_0, Quantity
from servo_msgs_py.text_file import TextFileError, read_toml, toml_text

STOP_STIFFNESS_MAX: Final = 0.06
"""Largest stiffness of an end stop, relative to inertia times PWM frequency squared: the oscillation takes 25 periods,
and its torque is calculated once per period."""

RESONANCE_MAX: Final = 8000.0
"""Highest resonance of a shaft with a second mass [Hz]: 16 integration steps per period, frequency error 0.6 %."""

DAMPING_MAX: Final = 5e4
"""Largest damping rate of the twist of a shaft [1/s]: its torque is calculated every 6 to 8 us."""

DEFAULT_FILE: Final = Path(__file__).with_name("plant.toml")


class PlantError(ValueError):
    """Invalid plant data; the message contains the value and the valid range."""


_T = TypeVar("_T")
_FINITE: Final = Quantity()
_FIXED: Final = "fixed"

Positive = Annotated[float, Quantity(minimum=ABOVE_0)]
NotNegative = Annotated[float, Quantity(minimum=0.0)]
Whole = Annotated[float, Quantity(minimum=1.0, whole=True)]
Finite = Annotated[float, _FINITE]
Angle = Annotated[float, Quantity(minimum=-math.inf, maximum=math.inf)]
Switch = Annotated[float, Quantity(minimum=0.0, maximum=1.0, whole=True)]
MagnetChange = Annotated[float, Quantity(minimum=-0.01, maximum=0.01)]
Eccentricity = Annotated[float, Quantity(minimum=0.0, maximum=0.2)]
DutyError = Annotated[float, Quantity(minimum=-0.2, maximum=0.2)]
Hysteresis = Annotated[float, Quantity(minimum=0.0, maximum=math.nextafter(0.5, 0.0))]

Fixed = Annotated[_T, _FIXED]
"""Marks a value that cannot be changed while a board runs; all other numbers of a plant can."""


@cache
def _marks(part: type) -> Sequence[tuple[str, object]]:
    """Names of the fields with their ranges and other marks, in the order of the fields."""
    hints = get_type_hints(part, include_extras=True).items()
    return [(name, mark) for name, hint in hints for mark in getattr(hint, "__metadata__", ())]


def ranges(part: type) -> dict[str, Quantity]:
    """Valid values of the numbers of a part of the plant, by name; numbers without a range are left out."""
    return {name: mark for name, mark in _marks(part) if isinstance(mark, Quantity)}


def _check(where: str, value: object, valid: Quantity) -> None:
    """Raise a `PlantError` unless `value` is valid."""
    if problem := valid.problem(value):
        raise PlantError(f"{where}: {value!r} is {problem}; write {valid.expected}")


def _check_fields(part: Any) -> None:
    """Check all fields with a range."""
    for name, valid in ranges(part.__class__).items():
        _check(name, getattr(part, name), valid)


@dataclass(frozen=True)
class PinsPlant:
    """Devices at the pins of one axis."""

    home_from: Angle = math.inf  # mechanical angle from which the home switch is closed [rad]
    home_to: Angle = -math.inf  # mechanical angle up to which the home switch is closed [rad]
    limit_min: Angle = -math.inf  # mechanical angle below which the lower limit switch opens [rad]; infinite: never
    limit_max: Angle = math.inf  # mechanical angle above which the upper limit switch opens [rad]; infinite: never
    enable_closed: Switch = 1.0  # 1: the enable circuit is closed; 0: it is open
    brake_torque: NotNegative = 0.0  # torque of the holding brake; 0: no brake [N m]
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
    pole_pairs: Fixed[Whole]  # pole pairs (electrical per mechanical revolutions)

    inertia: Positive  # total inertia [kg m^2]
    friction: NotNegative  # Coulomb friction [N m]
    viscous: NotNegative  # viscous friction [N m s]

    load_torque: Finite  # external torque, opposes positive motion; acts on the second mass if there is one [N m]
    load_inertia: NotNegative  # inertia of the second mass at the elastic shaft; 0: no second mass [kg m^2]
    shaft_stiffness: NotNegative  # stiffness of the elastic shaft [N m/rad]
    shaft_damping: NotNegative  # damping of the elastic shaft [N m s]
    backlash: NotNegative  # total backlash of the elastic shaft [rad]
    load_friction: NotNegative  # Coulomb friction of the second mass [N m]

    cogging_torque: NotNegative  # amplitude of the cogging torque [N m]
    cogging_periods: Whole  # cogging periods per revolution
    cogging_phase: Finite  # phase of the cogging torque [rad]

    i_saturation_d: NotNegative  # saturation current of `l_d` (the unsaturated inductance); 0: no saturation [A]
    i_saturation_q: NotNegative  # saturation current of `l_q`; 0: no saturation [A]
    winding_warms: Switch  # 1: `r_s` follows the winding temperature at level ``ideal``, as at ``registers``
    magnet_coefficient: MagnetChange  # relative change of `psi_m` (given at ambient temperature) [1/K]
    magnet_time: NotNegative  # time constant between winding and magnet temperature [s]

    disc_eccentricity: Eccentricity  # amplitude of the encoder error with one period per revolution [rad]
    disc_phase: Finite  # phase of the eccentricity error [rad]

    stop_min: Finite  # mechanical rotor angle of the lower end stop [rad]
    stop_max: Finite  # mechanical rotor angle of the upper end stop [rad]
    stop_stiffness: NotNegative  # stiffness of both end stops; 0: no end stops [N m/rad]
    stop_damping: NotNegative  # damping of both end stops [N m s]

    encoder_lines: Fixed[Whole]  # lines per revolution; four counts per line
    theta_start: Fixed[float | Literal["random"]]  # mechanical rotor angle at time zero [rad]; random: from the seed

    i_full_scale: Positive  # range of the ADC: ``-i_full_scale .. +i_full_scale`` [A]
    i_offset: tuple[float, float, float]  # offset of each current amplifier [A]
    i_noise: NotNegative  # standard deviation of a current sample [A]
    i_break: Positive  # hardware over-current threshold of a phase [A]

    dead_time: Fixed[NotNegative]  # time with both switches of a leg open, at every edge [s]
    v_drop: NotNegative  # forward drop of switch and diode [V]
    r_on: NotNegative  # resistance of switch and diode [ohm]

    dead_time_min: NotNegative
    """Shortest permitted dead time of the switches: with less, the leg shorts the bus for the difference, which trips
    the comparator [s]. This value and the four that follow have an effect at level ``registers`` only."""
    i_settle: Fixed[NotNegative]  # time constant of the current amplifiers [s]
    encoder_jitter: Fixed[NotNegative]  # standard deviation of an edge of the encoder [counts]
    encoder_duty_error: Fixed[DutyError]  # duty cycle of an encoder line, minus 1/2
    encoder_hysteresis: Fixed[Hysteresis]  # hysteresis of an edge between the two directions [counts]

    winding_capacity: Positive  # thermal capacity of the winding [J/K]
    winding_resistance: Positive  # thermal resistance from the winding to the ambient air [K/W]
    sink_capacity: Positive  # thermal capacity of the inverter's heatsink [J/K]
    sink_resistance: Positive  # thermal resistance from the heatsink to the ambient air [K/W]

    pins: PinsPlant = field(default_factory=PinsPlant)  # devices at the pins

    def __post_init__(self) -> None:
        pins: object = self.pins
        if isinstance(pins, Mapping):
            object.__setattr__(self, "pins", _part(PinsPlant, "pins", {"pins": pins}))
        _check_fields(self)
        if self.stop_min > self.stop_max:
            raise PlantError(f"stop_min: {self.stop_min!r} is above stop_max = {self.stop_max!r}")
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

    u_source: NotNegative  # open-circuit voltage of the supply [V]
    r_source: Positive  # internal resistance of the supply [ohm]; the supply cannot absorb energy
    capacitance: Positive  # capacitance of the bus [F]
    u_full_scale: Positive  # full scale of the ADC [V]
    u_noise: NotNegative  # standard deviation of a voltage sample [V]
    r_brake: NotNegative  # brake resistor [ohm]; 0: none
    brake_capacity: Positive  # heat capacity of the brake resistor [J/K]
    brake_resistance: Positive  # thermal resistance from the brake resistor to the ambient air [K/W]

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class PlantConfig:
    """The whole plant: two axes on one bus."""

    axes: tuple[AxisPlant, AxisPlant]  # axis 1 and axis 2
    bus: BusPlant  # the DC bus
    pwm_frequency: Fixed[Positive]  # carrier of the inverters [Hz]
    ambient: Fixed[Finite]  # temperature of the ambient air [deg C]

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

    def text(self) -> str:
        """All values as TOML, which `parse` takes."""
        table = dataclasses.asdict(self)
        axes = dict(zip(AXIS_NAMES, table.pop("axes"), strict=True))
        return toml_text({**table, **axes})

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


FIXED_NAMES: Final = frozenset(
    name for part in (AxisPlant, PlantConfig) for name, mark in _marks(part) if mark == _FIXED
)
"""Names of the values marked `Fixed`."""


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
        return read_toml(path)
    except TextFileError as error:
        raise PlantError(f"{path}: {error}") from None


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
