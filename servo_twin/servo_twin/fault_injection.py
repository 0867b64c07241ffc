"""Faults of the hardware of a virtual board, for `Board.inject` and `Board.clear_fault`.

Each class is one kind of fault with its location and size. The plant model determines the effects: an open phase
carries no current and puts the other two in series, a short trips the over-current comparator, which opens the switches
without software, with a stuck encoder line the decoder counts one count back and forth. Phases are ``"a"``, ``"b"``,
``"c"``; axis indices start at 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, get_args

from servo_msgs_py.catalogue import AXES

from servo_twin.plant import PlantConfig

Phase = Literal["a", "b", "c"]
Line = Literal["A", "B"]
Pin = Literal["home", "limit_min", "limit_max", "enable", "brake"]

_PHASES: Final = "abc"
_LINES: Final = "AB"
PINS: Final = get_args(Pin)
_SLIP_MAX: Final = 1_000_000


class RawFault(NamedTuple):
    """A fault as C structure ``board_fault_t``; `kind` is the name of the constant in ``board.h``."""

    kind: str
    axis: int = 0
    part: int = 0
    value: float = 0.0  # in the unit of the kind
    seconds: float = 0.0  # duration [s]


def _axis(axis: int) -> int:
    if not 0 <= axis < AXES:
        raise IndexError(f"axis {axis}: a board has the axes 0 .. {AXES - 1}")
    return axis


def _one_of(names: str, name: str, what: str) -> int:
    if len(name) != 1 or name not in names:
        raise ValueError(f"{what} {name!r} is none of {', '.join(names)}")
    return names.index(name)


def _amount(value: float, what: str) -> float:
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{what} {value} is not a finite number of at least 0")
    return float(value)


@dataclass(frozen=True)
class OpenPhase:
    """The wire between inverter and motor is broken in one phase."""

    axis: int
    phase: Phase

    def raw(self) -> RawFault:
        return RawFault("BOARD_OPEN_PHASE", _axis(self.axis), _one_of(_PHASES, self.phase, "phase"))


@dataclass(frozen=True)
class ShortedPhase:
    """Short circuit of a phase to another phase or to bus minus; one short per axis at a time."""

    axis: int
    phase: Phase
    to: Phase | Literal["minus"] = "minus"

    def raw(self) -> RawFault:
        phase = _one_of(_PHASES, self.phase, "phase")
        to = -1 if self.to == "minus" else _one_of(_PHASES, self.to, "phase")
        if to == phase:
            raise ValueError(f"phase {self.phase} cannot be shorted to itself")
        return RawFault("BOARD_SHORTED_PHASE", _axis(self.axis), phase, to)


@dataclass(frozen=True)
class StuckConverter:
    """The ADC result of a phase current is constant, 0 .. 4095."""

    axis: int
    phase: Phase
    code: int

    def raw(self) -> RawFault:
        if not 0 <= self.code <= 4095:
            raise ValueError(f"code {self.code} is not within 0 .. 4095")
        return RawFault("BOARD_STUCK_CONVERTER", _axis(self.axis), _one_of(_PHASES, self.phase, "phase"), self.code)


@dataclass(frozen=True)
class StuckLine:
    """A line of the encoder is constant."""

    axis: int
    line: Line
    high: bool = False

    def raw(self) -> RawFault:
        return RawFault("BOARD_STUCK_LINE", _axis(self.axis), _one_of(_LINES, self.line, "line"), float(self.high))


@dataclass(frozen=True)
class LockedRotor:
    """The shaft is blocked, from one moment to the next."""

    axis: int

    def raw(self) -> RawFault:
        return RawFault("BOARD_LOCKED_ROTOR", _axis(self.axis))


@dataclass(frozen=True)
class SupplyDip:
    """The open-circuit voltage of the supply changes for some time [V], [s]; 0 V: disconnected."""

    volts: float = 0.0  # open-circuit voltage meanwhile; 0: disconnected [V]
    seconds: float = math.inf  # duration [s]

    def raw(self) -> RawFault:
        if not self.seconds > 0.0:
            raise ValueError(f"dip of {self.seconds} s: the time must be above 0")
        return RawFault("BOARD_SUPPLY_DIP", value=_amount(self.volts, "voltage"), seconds=self.seconds)


@dataclass(frozen=True)
class CurrentNoise:
    """Changed standard deviation of the current samples of an axis [A]."""

    axis: int
    amperes: float  # [A]

    def raw(self) -> RawFault:
        return RawFault("BOARD_CURRENT_NOISE", _axis(self.axis), value=_amount(self.amperes, "noise"))


@dataclass(frozen=True)
class BusNoise:
    """Changed standard deviation of the samples of the bus voltage [V]."""

    volts: float  # [V]

    def raw(self) -> RawFault:
        return RawFault("BOARD_BUS_NOISE", value=_amount(self.volts, "noise"))


@dataclass(frozen=True)
class EncoderGlitches:
    """Pulses on a line of the encoder at random times; each pulse has two edges."""

    axis: int
    line: Line
    per_second: float  # mean rate [1/s]

    def raw(self) -> RawFault:
        line = _one_of(_LINES, self.line, "line")
        return RawFault("BOARD_ENCODER_GLITCHES", _axis(self.axis), line, _amount(self.per_second, "rate"))


@dataclass(frozen=True)
class StalledCore:
    """The core stops for some time [s], or until the watchdog resets the board."""

    seconds: float  # duration [s]

    def raw(self) -> RawFault:
        return RawFault("BOARD_STALLED_CORE", seconds=_amount(self.seconds, "time"))


@dataclass(frozen=True)
class SlippedEncoder:
    """The encoder disc slips on the shaft by `counts`; `Board.clear_fault` does not reverse it."""

    axis: int
    counts: int

    def raw(self) -> RawFault:
        if not -_SLIP_MAX <= self.counts <= _SLIP_MAX:
            raise ValueError(f"{self.counts} counts are more than {_SLIP_MAX}")
        return RawFault("BOARD_SLIPPED_ENCODER", _axis(self.axis), value=float(self.counts))


@dataclass(frozen=True)
class CutWire:
    """Broken wire of a switch, of the enable circuit or of the coil of the holding brake: reads as an open contact."""

    axis: int
    pin: Pin

    def raw(self) -> RawFault:
        if self.pin not in PINS:
            raise ValueError(f"pin {self.pin!r} is none of {', '.join(PINS)}")
        return RawFault("BOARD_CUT_WIRE", _axis(self.axis), PINS.index(self.pin))


@dataclass(frozen=True)
class WeakMagnet:
    """Partial demagnetisation; `part` is the remaining fraction of the flux, 0 .. 1."""

    axis: int
    part: float  # of the flux that is left, 0 .. 1

    def applied(self, plant: PlantConfig) -> PlantConfig:
        if not 0.0 <= self.part <= 1.0:
            raise ValueError(f"part {self.part} is not within 0 .. 1")
        return plant.with_axis(_axis(self.axis), psi_m=self.part * plant.axes[self.axis].psi_m)


@dataclass(frozen=True)
class BadContact:
    """Additional resistance in all phases, as from a corroded connector [ohm]."""

    axis: int
    ohms: float  # additional resistance of each phase [ohm]

    def applied(self, plant: PlantConfig) -> PlantConfig:
        return plant.with_axis(_axis(self.axis), r_s=plant.axes[self.axis].r_s + _amount(self.ohms, "resistance"))


@dataclass(frozen=True)
class WornShaft:
    """Additional backlash of a shaft with a second mass [rad]."""

    axis: int
    radians: float  # additional play [rad]

    def applied(self, plant: PlantConfig) -> PlantConfig:
        shaft = plant.axes[_axis(self.axis)]
        if shaft.load_inertia == 0.0:
            raise ValueError(f"axis {self.axis} has no second mass (load_inertia), so no backlash")
        return plant.with_axis(self.axis, backlash=shaft.backlash + _amount(self.radians, "backlash"))


@dataclass(frozen=True)
class ShiftedDisc:
    """Eccentric encoder disc: amplitude of the error with one period per revolution, and its phase [rad]."""

    axis: int
    radians: float  # amplitude [rad]
    phase: float = 0.0  # [rad]

    def applied(self, plant: PlantConfig) -> PlantConfig:
        return plant.with_axis(_axis(self.axis), disc_eccentricity=self.radians, disc_phase=self.phase)


@dataclass(frozen=True)
class DryBearing:
    """Coulomb and viscous friction are multiplied by `times`."""

    axis: int
    times: float  # factor of both

    def applied(self, plant: PlantConfig) -> PlantConfig:
        shaft = plant.axes[_axis(self.axis)]
        times = _amount(self.times, "factor")
        return plant.with_axis(self.axis, friction=times * shaft.friction, viscous=times * shaft.viscous)


@dataclass(frozen=True)
class HotPowerStage:
    """The power stage of an axis has a constant temperature [deg C]."""

    axis: int
    celsius: float  # [deg C]

    def raw(self) -> RawFault:
        return RawFault("BOARD_HEAT", _axis(self.axis), value=float(self.celsius))


ChangedValue = WeakMagnet | BadContact | WornShaft | ShiftedDisc | DryBearing
"""Faults that change values of the plant; `applied` returns the changed plant."""

NativeFault = (
    OpenPhase
    | ShortedPhase
    | StuckConverter
    | StuckLine
    | LockedRotor
    | SupplyDip
    | CurrentNoise
    | BusNoise
    | EncoderGlitches
    | HotPowerStage
    | SlippedEncoder
    | CutWire
    | StalledCore
)
"""Faults that the plant model in C implements."""

InjectedFault = NativeFault | ChangedValue
"""All faults."""
