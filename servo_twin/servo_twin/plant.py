"""Plant of the virtual board (``plant.toml``) as validated, immutable objects."""

from __future__ import annotations

import dataclasses
import difflib
import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Literal, cast

from servo_msgs_py.board_description import BoardDescription
from servo_msgs_py.catalogue import AXIS_NAMES
from servo_msgs_py.quantity import ABOVE_0, FINITE, Quantity
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


def _number(
    unit: str,
    text: str,
    *,
    minimum: float = -FINITE,
    maximum: float = FINITE,
    whole: bool = False,
    fixed: bool = False,
    default: object = dataclasses.MISSING,
) -> Any:
    """Field of a plant: a number with unit, description and range; `fixed`: it cannot be changed while a board runs."""
    valid = Quantity(unit=unit, text=text, minimum=minimum, maximum=maximum, whole=whole)
    return field(default=default, metadata={"valid": valid, "fixed": fixed})


_positive = partial(_number, minimum=ABOVE_0)
_not_negative = partial(_number, minimum=0.0)
_whole = partial(_number, minimum=1.0, whole=True)
_angle = partial(_number, minimum=-math.inf, maximum=math.inf)
_switch = partial(_number, minimum=0.0, maximum=1.0, whole=True)


def quantities(part: type) -> dict[str, Quantity]:
    """Unit, description and range of the numbers of a part of the plant, by name, in the order of the fields."""
    return {one.name: one.metadata["valid"] for one in dataclasses.fields(part) if one.metadata}


def _check(where: str, value: object, valid: Quantity) -> None:
    """Raise a `PlantError` unless `value` is valid."""
    if problem := valid.problem(value):
        raise PlantError(f"{where}: {value!r} is {problem}; write {valid.expected}")


def _check_fields(part: Any, *checked: str) -> None:
    """Check all numbers that are not `checked` elsewhere."""
    for name, valid in quantities(part.__class__).items():
        if name not in checked:
            _check(name, getattr(part, name), valid)


@dataclass(frozen=True)
class PinsPlant:
    """Devices at the pins of one axis."""

    home_from: float = _angle("rad", "mechanical angle from which the home switch is closed", default=math.inf)
    home_to: float = _angle("rad", "mechanical angle up to which the home switch is closed", default=-math.inf)
    limit_min: float = _angle(
        "rad", "mechanical angle below which the lower limit switch opens; infinite: never", default=-math.inf
    )
    limit_max: float = _angle(
        "rad", "mechanical angle above which the upper limit switch opens; infinite: never", default=math.inf
    )
    enable_closed: float = _switch("", "1: the enable circuit is closed; 0: it is open", default=1.0)
    brake_torque: float = _not_negative("N m", "torque of the holding brake; 0: no brake", default=0.0)
    brake_open_time: float = _not_negative("s", "from energising the coil to the open brake", default=0.0)
    brake_close_time: float = _not_negative("s", "from de-energising the coil to the closed brake", default=0.0)

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class AxisPlant:
    """Motor, shaft, encoder, inverter and current sensors of one axis, in the order of the C structure."""

    r_s: float = _positive("ohm", "stator resistance")
    l_d: float = _positive("H", "stator inductance, d axis")
    l_q: float = _positive("H", "stator inductance, q axis")
    psi_m: float = _not_negative("V s", "permanent-magnet flux linkage, electrical")
    pole_pairs: float = _whole("", "pole pairs (electrical per mechanical revolutions)", fixed=True)

    inertia: float = _positive("kg m^2", "total inertia")
    friction: float = _not_negative("N m", "Coulomb friction")
    viscous: float = _not_negative("N m s", "viscous friction")

    load_inertia: float = _not_negative("kg m^2", "inertia of the second mass at the elastic shaft; 0: no second mass")
    shaft_stiffness: float = _not_negative("N m/rad", "stiffness of the elastic shaft")
    shaft_damping: float = _not_negative("N m s", "damping of the elastic shaft")
    backlash: float = _not_negative("rad", "total backlash of the elastic shaft")
    load_friction: float = _not_negative("N m", "Coulomb friction of the second mass")

    cogging_torque: float = _not_negative("N m", "amplitude of the cogging torque")
    cogging_periods: float = _whole("", "cogging periods per revolution")
    cogging_phase: float = _number("rad", "phase of the cogging torque")

    i_saturation_d: float = _not_negative(
        "A", "saturation current of `l_d` (the unsaturated inductance); 0: no saturation"
    )
    i_saturation_q: float = _not_negative("A", "saturation current of `l_q`; 0: no saturation")
    winding_warms: float = _switch(
        "", "1: `r_s` follows the winding temperature at level ``ideal``, as at ``registers``"
    )
    magnet_coefficient: float = _number(
        "1/K", "relative change of `psi_m` (given at ambient temperature)", minimum=-0.01, maximum=0.01
    )
    magnet_time: float = _not_negative("s", "time constant between winding and magnet temperature")

    disc_eccentricity: float = _number(
        "rad", "amplitude of the encoder error with one period per revolution", minimum=0.0, maximum=0.2
    )
    disc_phase: float = _number("rad", "phase of the eccentricity error")

    load_torque: float = _number(
        "N m", "external torque, opposes positive motion; acts on the second mass if there is one"
    )

    stop_min: float = _number("rad", "mechanical rotor angle of the lower end stop")
    stop_max: float = _number("rad", "mechanical rotor angle of the upper end stop")
    stop_stiffness: float = _not_negative("N m/rad", "stiffness of both end stops; 0: no end stops")
    stop_damping: float = _not_negative("N m s", "damping of both end stops")

    encoder_lines: float = _whole("", "lines per revolution; four counts per line", fixed=True)
    theta_start: float | Literal["random"] = _number(
        "rad", "mechanical rotor angle at time zero; random: from the seed", fixed=True
    )

    i_full_scale: float = _positive("A", "range of the ADC: ``-i_full_scale .. +i_full_scale``")
    i_offset: tuple[float, float, float] = _number("A", "offset of each current amplifier")
    i_noise: float = _not_negative("A", "standard deviation of a current sample")
    i_break: float = _positive("A", "hardware over-current threshold of a phase")

    dead_time: float = _not_negative("s", "time with both switches of a leg open, at every edge", fixed=True)
    v_drop: float = _not_negative("V", "forward drop of switch and diode")
    r_on: float = _not_negative("ohm", "resistance of switch and diode")

    # The next five have an effect at level ``registers`` only.
    dead_time_min: float = _not_negative(
        "s",
        "shortest permitted dead time of the switches; with less, the leg shorts the bus for the difference, which "
        "trips the comparator",
    )
    i_settle: float = _not_negative("s", "time constant of the current amplifiers", fixed=True)
    encoder_jitter: float = _not_negative("counts", "standard deviation of an edge of the encoder", fixed=True)
    encoder_duty_error: float = _number(
        "", "duty cycle of an encoder line, minus 1/2", minimum=-0.2, maximum=0.2, fixed=True
    )
    encoder_hysteresis: float = _number(
        "counts",
        "hysteresis of an edge between the two directions",
        minimum=0.0,
        maximum=math.nextafter(0.5, 0.0),
        fixed=True,
    )

    winding_capacity: float = _positive("J/K", "thermal capacity of the winding")
    winding_resistance: float = _positive("K/W", "thermal resistance from the winding to the ambient air")
    sink_capacity: float = _positive("J/K", "thermal capacity of the inverter's heatsink")
    sink_resistance: float = _positive("K/W", "thermal resistance from the heatsink to the ambient air")

    pins: PinsPlant = field(default_factory=PinsPlant)  # devices at the pins

    def __post_init__(self) -> None:
        pins: object = self.pins
        if isinstance(pins, Mapping):
            object.__setattr__(self, "pins", _part(PinsPlant, "pins", {"pins": pins}))
        _check_fields(self, "theta_start", "i_offset")
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
            _check("theta_start", self.theta_start, Quantity())
        offsets: object = self.i_offset
        if not isinstance(offsets, (tuple, list)) or len(offsets) != 3:
            raise PlantError(f"i_offset: {offsets!r} is not a list of three currents")
        for value in offsets:
            _check("i_offset", value, Quantity())
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

    u_source: float = _not_negative("V", "open-circuit voltage of the supply")
    r_source: float = _positive("ohm", "internal resistance of the supply; the supply cannot absorb energy")
    capacitance: float = _positive("F", "capacitance of the bus")
    u_full_scale: float = _positive("V", "full scale of the ADC")
    u_noise: float = _not_negative("V", "standard deviation of a voltage sample")
    r_brake: float = _not_negative("ohm", "brake resistor; 0: none")
    brake_capacity: float = _positive("J/K", "heat capacity of the brake resistor")
    brake_resistance: float = _positive("K/W", "thermal resistance from the brake resistor to the ambient air")

    def __post_init__(self) -> None:
        _check_fields(self)


@dataclass(frozen=True)
class PlantConfig:
    """The whole plant: two axes on one bus."""

    axes: tuple[AxisPlant, AxisPlant]  # axis 1 and axis 2
    bus: BusPlant  # the DC bus
    pwm_frequency: float = _positive("Hz", "carrier of the inverters", fixed=True)
    ambient: float = _number("deg C", "temperature of the ambient air", fixed=True)

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
    one.name
    for part in (AxisPlant, PlantConfig)
    for one in dataclasses.fields(part)
    if one.metadata.get("fixed", False)
)
"""Names of the numbers that cannot be changed while a board runs."""


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
    return on_board(_read(DEFAULT_FILE), BoardDescription.load())


def on_board(table: Mapping[str, Any], board: BoardDescription) -> dict[str, Any]:
    """Table of a plant with the numbers of the board that it does not have."""
    axis = {
        "i_full_scale": board.ranges["current"],
        "dead_time": board.dead_time,
        "v_drop": board.switch_drop,
    }
    axes = {name: {**table[name], **axis, **table[name]} for name in AXIS_NAMES}  # in the order of the file
    bus = {"u_full_scale": board.ranges["bus_voltage"], **table["bus"]}
    return {"pwm_frequency": board.pwm_frequency, **table, **axes, "bus": bus}


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
