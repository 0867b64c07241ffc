"""Faults of the hardware of a virtual board, for `Board.inject` and `Board.clear_fault`.

Each class is one kind of fault; its values say where and how much. The physics is the plant's: an open phase carries
no current and leaves the other two in series, a short lets the over-current comparator open the switches without
software, a stuck encoder line leaves the decoder one count back and forth. Phases are ``"a"``, ``"b"``, ``"c"``; axes
count from 0.
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
_PINS: Final = get_args(Pin)
_SLIP_MAX: Final = 1_000_000


class RawFault(NamedTuple):
    """The same as the C interface takes it (``board_fault_t``); `kind` names the constant of ``board.h``."""

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
        raise ValueError(f"{what} {value} is not a finite number from 0")
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
    """A phase touches another one, or bus minus; an axis has one short at a time."""

    axis: int
    phase: Phase
    to: Phase | Literal["minus"] = "minus"

    def raw(self) -> RawFault:
        phase = _one_of(_PHASES, self.phase, "phase")
        to = -1 if self.to == "minus" else _one_of(_PHASES, self.to, "phase")
        if to == phase:
            raise ValueError(f"phase {self.phase} cannot touch itself")
        return RawFault("BOARD_SHORTED_PHASE", _axis(self.axis), phase, to)


@dataclass(frozen=True)
class StuckConverter:
    """The current of a phase reads as one code of the converter, 0 .. 4095."""

    axis: int
    phase: Phase
    code: int

    def raw(self) -> RawFault:
        if not 0 <= self.code <= 4095:
            raise ValueError(f"code {self.code} is not within 0 .. 4095")
        return RawFault("BOARD_STUCK_CONVERTER", _axis(self.axis), _one_of(_PHASES, self.phase, "phase"), self.code)


@dataclass(frozen=True)
class StuckLine:
    """A line of the encoder stays at one level."""

    axis: int
    line: Line
    high: bool = False

    def raw(self) -> RawFault:
        return RawFault("BOARD_STUCK_LINE", _axis(self.axis), _one_of(_LINES, self.line, "line"), float(self.high))


@dataclass(frozen=True)
class LockedRotor:
    """Something holds the shaft fast, all at once."""

    axis: int

    def raw(self) -> RawFault:
        return RawFault("BOARD_LOCKED_ROTOR", _axis(self.axis))


@dataclass(frozen=True)
class SupplyDip:
    """The supply has another open-circuit voltage for some time [V], [s]; 0 V: it is disconnected."""

    volts: float = 0.0  # open-circuit voltage meanwhile; 0: disconnected [V]
    seconds: float = math.inf  # duration [s]

    def raw(self) -> RawFault:
        if not self.seconds > 0.0:
            raise ValueError(f"a dip of {self.seconds} s is none")
        return RawFault("BOARD_SUPPLY_DIP", value=_amount(self.volts, "voltage"), seconds=self.seconds)


@dataclass(frozen=True)
class CurrentNoise:
    """Standard deviation of every current sample of an axis, in place of the usual one [A]."""

    axis: int
    amperes: float  # [A]

    def raw(self) -> RawFault:
        return RawFault("BOARD_CURRENT_NOISE", _axis(self.axis), value=_amount(self.amperes, "noise"))


@dataclass(frozen=True)
class BusNoise:
    """Standard deviation of every sample of the bus voltage, in place of the usual one [V]."""

    volts: float  # [V]

    def raw(self) -> RawFault:
        return RawFault("BOARD_BUS_NOISE", value=_amount(self.volts, "noise"))


@dataclass(frozen=True)
class EncoderGlitches:
    """Pulses on a line of the encoder at random moments; each is an edge there and back."""

    axis: int
    line: Line
    per_second: float  # mean rate [1/s]

    def raw(self) -> RawFault:
        line = _one_of(_LINES, self.line, "line")
        return RawFault("BOARD_ENCODER_GLITCHES", _axis(self.axis), line, _amount(self.per_second, "rate"))


@dataclass(frozen=True)
class StalledCore:
    """The software stands still for some time [s], or until the watchdog resets the board."""

    seconds: float  # duration [s]

    def raw(self) -> RawFault:
        return RawFault("BOARD_STALLED_CORE", seconds=_amount(self.seconds, "time"))


@dataclass(frozen=True)
class SlippedEncoder:
    """The disc of an encoder turns on its shaft by so many counts, now; `Board.clear_fault` does not turn it back."""

    axis: int
    counts: int

    def raw(self) -> RawFault:
        if not -_SLIP_MAX <= self.counts <= _SLIP_MAX:
            raise ValueError(f"{self.counts} counts are more than {_SLIP_MAX}")
        return RawFault("BOARD_SLIPPED_ENCODER", _axis(self.axis), value=float(self.counts))


@dataclass(frozen=True)
class CutWire:
    """The wire of a switch, of the enable circuit or of the holding brake's coil is cut: the contact reads as open."""

    axis: int
    pin: Pin

    def raw(self) -> RawFault:
        if self.pin not in _PINS:
            raise ValueError(f"pin {self.pin!r} is none of {', '.join(_PINS)}")
        return RawFault("BOARD_CUT_WIRE", _axis(self.axis), _PINS.index(self.pin))


@dataclass(frozen=True)
class WeakMagnet:
    """The magnet keeps this part of its flux, 0 .. 1."""

    axis: int
    part: float  # of the flux that is left, 0 .. 1

    def applied(self, plant: PlantConfig) -> PlantConfig:
        if not 0.0 <= self.part <= 1.0:
            raise ValueError(f"part {self.part} is not within 0 .. 1")
        return plant.with_axis(_axis(self.axis), psi_m=self.part * plant.axes[self.axis].psi_m)


@dataclass(frozen=True)
class BadContact:
    """All phases have more resistance: a connector that corrodes, turns that are lost [ohm]."""

    axis: int
    ohms: float  # additional resistance of each phase [ohm]

    def applied(self, plant: PlantConfig) -> PlantConfig:
        return plant.with_axis(_axis(self.axis), r_s=plant.axes[self.axis].r_s + _amount(self.ohms, "resistance"))


@dataclass(frozen=True)
class WornShaft:
    """A shaft with a second mass has more play [rad]."""

    axis: int
    radians: float  # additional play [rad]

    def applied(self, plant: PlantConfig) -> PlantConfig:
        shaft = plant.axes[_axis(self.axis)]
        if shaft.load_inertia == 0.0:
            raise ValueError(f"axis {self.axis} has no second mass (load_inertia) that could have play")
        return plant.with_axis(self.axis, backlash=shaft.backlash + _amount(self.radians, "play"))


@dataclass(frozen=True)
class ShiftedDisc:
    """The encoder's disc is off the shaft's centre: an error once per turn, with its phase [rad]."""

    axis: int
    radians: float  # amplitude [rad]
    phase: float = 0.0  # [rad]

    def applied(self, plant: PlantConfig) -> PlantConfig:
        return plant.with_axis(_axis(self.axis), disc_eccentricity=self.radians, disc_phase=self.phase)


@dataclass(frozen=True)
class DryBearing:
    """Coulomb and viscous friction are so many times as large."""

    axis: int
    times: float  # factor of both

    def applied(self, plant: PlantConfig) -> PlantConfig:
        shaft = plant.axes[_axis(self.axis)]
        times = _amount(self.times, "factor")
        return plant.with_axis(self.axis, friction=times * shaft.friction, viscous=times * shaft.viscous)


@dataclass(frozen=True)
class HotPowerStage:
    """The power stage of an axis is at a temperature and stays there [deg C]."""

    axis: int
    celsius: float  # [deg C]

    def raw(self) -> RawFault:
        return RawFault("BOARD_HEAT", _axis(self.axis), value=float(self.celsius))


ChangedValue = WeakMagnet | BadContact | WornShaft | ShiftedDisc | DryBearing
"""What is another value of the plant, `applied` to the one that it has without."""

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
"""What the plant in C injects."""

InjectedFault = NativeFault | ChangedValue
"""Any of them."""
