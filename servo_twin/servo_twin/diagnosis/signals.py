"""Balance equations of one axis: what the difference of board and twin says of the plant, sample by sample. Pure.

With ``d`` for board minus twin, values of the twin's plant with index 0 and a filter F of first order:

* torque: ``Kt0 F[d i_q_ref] - J0 s F[d w] - B0 F[d w] = -Kt0 F[i_q] a_psi + J0 s F[w] a_J + C0 F[sign w] a_C + F[1] T``
* voltage q: ``d u_q - R0 d i_q - p psi0 d w = R_s i_q a_R + p psi0 w a_psi``
* voltage d: ``d u_d + p L_q d(w i_q) = p psi0 w e``

Linear in the relative changes a of resistance, flux, inertia and Coulomb friction, the load torque T and the error e of
the encoder's angle, however large they are. What both boards do alike (dead time, ripple, delays) cancels.

Samples are 8 ms apart and alias what the loops do to noise in between. Differences of the same sample know the alias
(`ALIASES`): for the torque, those of the sampled speed against the shaft's position and of the current set-point
against its filtered value; for the voltage, that of the current against its set-point, apart at large and at small
currents, where dead time and drops change their signs. Their coefficients depend on the loops, `AxisNoise.alias` with
those of the healthy run, and are nuisances of the estimation where the loops have other ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.plant import AxisPlant, BusPlant

CHANGES: Final = ("resistance", "flux", "inertia", "friction", "load", "encoder_angle")
"""Unknowns of an axis: relative changes, a torque [N m] and an electrical angle [rad]."""

EQUATIONS: Final = ("torque", "voltage_q", "voltage_d")

ALIASES: Final = ("speed [N m s/rad]", "set-point [N m/A]", "large current [V/A]", "small current [V/A]")
"""What knows the alias, and the units of its coefficients."""

NEEDED: Final = ("position", "speed", "speed_ref", "i_q", "i_q_ref", "u_d", "u_q")
"""Variables of an axis that a sample has to carry."""

RESISTANCE: Final = CHANGES.index("resistance")
TORQUE, VOLTAGE_Q, VOLTAGE_D = range(len(EQUATIONS))

_TIME: Final = 0.03  # time constant of F [s]
_MOVES: Final = 8.0  # slowest speed at which the sign of the friction is known [rad/s]
_GAP: Final = 0.05  # longest time between two samples over which F is continued [s]
_CARRIES: Final = 0.036
"""Part of the full scale above which a current says something of the resistance, and the back-EMF [V] above which it
does of the flux: below, the errors of the compensated dead time are larger."""
_INDUCES: Final = 1.0
_DEAD_TIME: Final = 0.1
"""Part of a difference of the buses that counts as noise of a voltage: dead time and drops take 3 %, with a sign that
stays the same over some samples."""
_SMALL_CURRENT: Final = 1.5
"""Volts of noise per ampere by which two small currents differ: dead time and drops change their sign there."""
_SECOND: Final = PERIOD_NS * 1e-9
_LIFTED: Final = 0.2  # from which on a bus is lifted above its supply [V]
_POWERS: Final = tuple((f"{axis_name(axis)}.u_q", f"{axis_name(axis)}.i_q") for axis in range(AXES))

_Row = tuple[float, ...]


class AxisEquations(NamedTuple):
    """What one sample says."""

    y: _Row  # (3,), left sides, per equation [N m], [V], [V]
    phi: tuple[_Row, ...]  # (3, 6), right sides, per equation and unknown
    alias: tuple[_Row, ...]  # (3, 4), factors of the alias, per equation and entry of `ALIASES`
    share: float  # weight of the torque equation as a part of an independent sample
    current: float  # magnitude at the sample [A]
    speed: float  # magnitude at the sample [rad/s]
    error: float
    """Error of the voltage equations that different dead times of the boards cause: with the bus, and with a small
    current [V]."""


class _Filter:
    """``F = 1 / (1 + s T)`` of some inputs at once, over samples at any times; inputs run straight between them."""

    def __init__(self) -> None:
        self._started = False

    def reset(self) -> None:
        """Begin with the next sample: F starts from zero there."""
        self._started = False

    def update(self, x: Sequence[float], seconds: float) -> tuple[list[float], list[float]] | None:
        """F and ``s F`` of the inputs; None at the first sample."""
        if not self._started:
            self._started = True
            self._x0, self._x, self._f, self._rest = x, x, [0.0] * len(x), 1.0
            return None
        ratio = seconds / _TIME
        decay = math.exp(-ratio)
        new = 1.0 - (1.0 - decay) / ratio
        old = 1.0 - decay - new
        self._f = [decay * f + old * before + new * now for f, before, now in zip(self._f, self._x, x, strict=True)]
        self._x = x
        self._rest *= decay
        rate = [(now - f - self._rest * x0) / _TIME for now, f, x0 in zip(x, self._f, self._x0, strict=True)]
        return self._f, rate


class AxisSignals:
    """Equations of one axis from its samples.

    Parameters
    ----------
    axis : int
        Index.
    plant : AxisPlant
        The twin's model of the plant.
    """

    def __init__(self, axis: int, plant: AxisPlant) -> None:
        self._names = {name: f"{axis_name(axis)}.{name}" for name in NEEDED}
        self.plant = plant
        self._filter = _Filter()
        self._tick: int | None = None
        self._sign = 0.0

    def interrupt(self) -> None:
        """The next sample has nothing to do with the last one."""
        self._tick = None

    def update(self, tick: int, real: Mapping[str, float], twin: Mapping[str, float]) -> AxisEquations | None:
        """Equations of a sample; None unless both shafts move the same way, as they did at the sample before."""
        names, plant = self._names, self.plant
        speed, twin_speed = real[names["speed"]], twin[names["speed"]]
        moves = speed * twin_speed > 0.0 and min(abs(speed), abs(twin_speed)) >= _MOVES
        sign = math.copysign(1.0, speed) if moves else 0.0
        before, self._tick = self._tick, tick
        seconds = 0.0 if before is None else (tick - before) * _SECOND
        if sign == 0.0 or sign != self._sign or not 0.0 < seconds < _GAP:
            self._filter.reset()
        self._sign = sign
        if sign == 0.0:
            return None
        d = {name: real[key] - twin[key] for name, key in names.items()}
        current = real[names["i_q_ref"]]
        inputs = (d["i_q_ref"], d["speed"], d["position"], current, speed, sign, 1.0)
        filtered = self._filter.update(inputs, seconds)
        k_t, flux = plant.torque_constant, plant.pole_pairs * plant.psi_m
        resistance = plant.r_s + plant.r_on
        y_torque = alias_speed = alias_current = share = 0.0
        torque: _Row = (0.0,) * len(CHANGES)
        if filtered is not None:
            f, rate = filtered
            y_torque = k_t * f[0] - plant.inertia * rate[1] - plant.viscous * f[1]
            alias_speed, alias_current = f[1] - rate[2], d["i_q_ref"] - f[0]
            torque = (0.0, -k_t * f[3], plant.inertia * rate[4], plant.friction * f[5], f[6], 0.0)
            share = min(seconds / (2.0 * _TIME), 1.0)
        y_q = alias_q = by_resistance = by_flux = 0.0
        carries = min(abs(current), abs(twin[names["i_q_ref"]])) > _CARRIES * plant.i_full_scale
        if carries or abs(flux * speed) > _INDUCES:
            y_q = d["u_q"] - resistance * d["i_q_ref"] - flux * d["speed"]
            alias_q = d["i_q_ref"] - d["i_q"]
            by_resistance = plant.r_s * current if carries else 0.0
            by_flux = flux * speed
        y_d = d["u_d"] + plant.pole_pairs * plant.l_q * (speed * current - twin_speed * twin[names["i_q_ref"]])
        error = _DEAD_TIME * abs(real["u_dc"] - twin["u_dc"])
        if not carries:
            error += _SMALL_CURRENT * abs(d["i_q_ref"])
        return AxisEquations(
            y=(y_torque, y_q, y_d),
            phi=(torque, (by_resistance, by_flux, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, flux * speed)),
            alias=(
                (alias_speed, alias_current, 0.0, 0.0),
                (0.0, 0.0, alias_q, 0.0) if carries else (0.0, 0.0, 0.0, alias_q),
                (0.0, 0.0, 0.0, 0.0),
            ),
            share=share,
            current=abs(current),
            speed=abs(speed),
            error=error,
        )


class BusSignal:
    """Relative difference of the bus voltages while the supply feeds both boards.

    A motor that brakes lifts its bus above the supply, which cannot absorb energy. A lifted bus does not show the
    voltage of the supply until the motors have used the energy.

    Parameters
    ----------
    bus : BusPlant
        The twin's model of it.
    """

    def __init__(self, bus: BusPlant) -> None:
        self._supply, self._capacitance = bus.u_source, bus.capacitance
        self._feeds = self._energy(self._supply + _LIFTED)
        self._highest = self._energy(bus.u_full_scale)
        self._returned = [0.0, 0.0]  # by the motors of board and twin and not used since [J]
        self._tick: int | None = None

    def _energy(self, volts: float) -> float:
        """What the capacitor holds more than at the voltage of the supply [J]."""
        return 0.5 * self._capacitance * max(volts**2 - self._supply**2, 0.0)

    def interrupt(self) -> None:
        """The next sample has nothing to do with the last one."""
        self._tick = None

    def update(self, tick: int, real: Mapping[str, float], twin: Mapping[str, float]) -> float | None:
        """The difference at a sample; None where a bus may be lifted."""
        before, self._tick = self._tick, tick
        if before is None:  # what lies above the twin's supply may have been returned
            self._returned = [self._energy(values["u_dc"]) for values in (real, twin)]
            return None
        seconds = (tick - before) * _SECOND
        for k, values in enumerate((real, twin)):
            power = sum(1.5 * values[u_q] * values[i_q] for u_q, i_q in _POWERS)
            self._returned[k] = min(max(self._returned[k] - power * seconds, 0.0), self._highest)
        if max(self._returned) > self._feeds:
            return None
        return (real["u_dc"] - twin["u_dc"]) / self._supply
