"""Balance equations of one axis for the difference of board and twin, per sample.

With ``d`` for board minus twin, index 0 for values of the twin's plant, and a filter F of first order:

* torque: ``Kt0 F[d i_q*] - J0 s F[d w] - B0 F[d w] = -Kt0 F[i_q*] a_psi + J0 s F[w] a_J + C0 F[sign w] a_C + F[1] T``
* voltage q: ``d u_q - R0 d i_q* - p psi0 d w = R_s i_q* a_R + p psi0 w a_psi``
* voltage d: ``d u_d + p L_q d(w i_q*) = p psi0 w sin e``

The equations are linear, for changes of any size, in the relative changes a of resistance, flux, inertia and Coulomb
friction, the load torque T and the sine of the error e of the encoder angle (`likelihood_ratio` adds the factor cos e
of the flux in torque and voltage q). Effects common to both boards (dead time, ripple, delays) cancel.

Samples are 8 ms apart; the responses of the loops to noise in between are aliased. Differences within the same sample
are regressors of the aliasing error (`ALIASES`). For the torque: the sampled speed minus the derivative of the
position, and the current set-point minus its filtered value. For the voltage: the current set-point minus the current,
separately for large and for small currents, where dead time and drops change their signs. The coefficients depend on
the loop gains. `AxisNoise.alias` are those of the healthy run; deviations are nuisance unknowns of the estimation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import PERIOD

from servo_twin.plant import AxisPlant, BusPlant

CHANGES: Final = ("resistance", "flux", "inertia", "friction", "load", "encoder_angle")
"""Unknowns of an axis: relative changes, a torque [N m] and the sine of an electrical angle."""

EQUATIONS: Final = ("torque", "voltage_q", "voltage_d")

ALIASES: Final = ("speed [N m s/rad]", "set-point [N m/A]", "large current [V/A]", "small current [V/A]")
"""Regressors of the aliasing error, and units of their coefficients."""

NEEDED: Final = ("position", "speed", "i_q", "i_q_ref", "u_d", "u_q")
"""Variables of an axis that a sample must contain."""

RESISTANCE: Final = CHANGES.index("resistance")
TORQUE, VOLTAGE_Q, VOLTAGE_D = range(len(EQUATIONS))

_TIME: Final = 0.03  # time constant of F [s]
_SPEED_MIN: Final = 8.0  # lowest speed with a known sign of the friction [rad/s]
_GAP: Final = 0.05  # longest time between two samples over which F is continued [s]
_CURRENT_MIN: Final = 0.036
"""Smallest current for the estimate of the resistance, as a fraction of full scale: below, the residual error of the
dead-time compensation is larger."""
_EMF_MIN: Final = 1.0  # smallest back-EMF for the estimate of the flux [V], for the same reason
_DEAD_TIME: Final = 0.1
"""Voltage noise as a fraction of the difference of the bus voltages: dead time and drops take 3 %, with the same sign
over several samples."""
_SMALL_CURRENT: Final = 1.5
"""Voltage noise per difference of two small currents [V/A]: dead time and drops change their sign there."""
_LIFTED: Final = 0.2  # voltage above the supply from which the bus counts as raised by braking [V]
_POWERS: Final = tuple((f"{axis_name(axis)}.u_q", f"{axis_name(axis)}.i_q") for axis in range(AXES))

_Row = tuple[float, ...]


class AxisEquations(NamedTuple):
    """Equations of one sample."""

    y: _Row  # (3,), left sides, per equation [N m], [V], [V]
    phi: tuple[_Row, ...]  # (3, 6), right sides, per equation and unknown
    alias: tuple[_Row, ...]  # (3, 4), regressors of the aliasing error, per equation and entry of `ALIASES`
    share: float  # effective number of independent samples of the torque equation
    current: float  # magnitude at the sample [A]
    speed: float  # magnitude at the sample [rad/s]
    error: float
    """Error of the voltage equations by different dead-time errors of the boards: from the difference of the bus
    voltages and, at small currents, of the currents [V]."""


class _Filter:
    """``F = 1 / (1 + s T)`` of several inputs at irregular sample times, with linear interpolation of the inputs."""

    def __init__(self) -> None:
        self._started = False

    def reset(self) -> None:
        """Restart at the next sample with F = 0."""
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
        """Restart: the next sample does not continue the last one."""
        self._tick = None

    def update(self, tick: int, real: Mapping[str, float], twin: Mapping[str, float]) -> AxisEquations | None:
        """Equations of a sample; None unless both shafts turn in the same direction.

        Without a usable previous sample the torque equation is zero.
        """
        names, plant = self._names, self.plant
        speed, twin_speed = real[names["speed"]], twin[names["speed"]]
        moving = speed * twin_speed > 0.0 and min(abs(speed), abs(twin_speed)) >= _SPEED_MIN
        sign = math.copysign(1.0, speed) if moving else 0.0
        before, self._tick = self._tick, tick
        seconds = 0.0 if before is None else (tick - before) * PERIOD
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
        current_large = min(abs(current), abs(twin[names["i_q_ref"]])) > _CURRENT_MIN * plant.i_full_scale
        if current_large or abs(flux * speed) > _EMF_MIN:
            y_q = d["u_q"] - resistance * d["i_q_ref"] - flux * d["speed"]
            alias_q = d["i_q_ref"] - d["i_q"]
            by_resistance = plant.r_s * current if current_large else 0.0
            by_flux = flux * speed
        y_d = d["u_d"] + plant.pole_pairs * plant.l_q * (speed * current - twin_speed * twin[names["i_q_ref"]])
        error = _DEAD_TIME * abs(real["u_dc"] - twin["u_dc"])
        if not current_large:
            error += _SMALL_CURRENT * abs(d["i_q_ref"])
        return AxisEquations(
            y=(y_torque, y_q, y_d),
            phi=(torque, (by_resistance, by_flux, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, flux * speed)),
            alias=(
                (alias_speed, alias_current, 0.0, 0.0),
                (0.0, 0.0, alias_q, 0.0) if current_large else (0.0, 0.0, 0.0, alias_q),
                (0.0, 0.0, 0.0, 0.0),
            ),
            share=share,
            current=abs(current),
            speed=abs(speed),
            error=error,
        )


class BusSignal:
    """Relative difference of the bus voltages while the supply feeds both boards.

    A braking motor raises the bus above the supply, which cannot absorb energy. The bus does not show the voltage of
    the supply until the motors have used the energy.

    Parameters
    ----------
    bus : BusPlant
        Bus of the twin.
    """

    def __init__(self, bus: BusPlant) -> None:
        self._supply, self._capacitance = bus.u_source, bus.capacitance
        self._feeds = self._energy(self._supply + _LIFTED)
        self._highest = self._energy(bus.u_full_scale)
        self._returned = [0.0, 0.0]  # energy returned by the motors of board and twin and not used since [J]
        self._tick: int | None = None

    def _energy(self, volts: float) -> float:
        """Energy of the capacitor above the energy at the supply voltage [J]."""
        return 0.5 * self._capacitance * max(volts**2 - self._supply**2, 0.0)

    def interrupt(self) -> None:
        """Restart: the next sample does not continue the last one."""
        self._tick = None

    def update(self, tick: int, real: Mapping[str, float], twin: Mapping[str, float]) -> float | None:
        """The difference at a sample; None if a bus may be above its supply."""
        before, self._tick = self._tick, tick
        if before is None:  # a voltage above the twin's supply counts as returned energy
            self._returned = [self._energy(values["u_dc"]) for values in (real, twin)]
            return None
        seconds = (tick - before) * PERIOD
        for k, values in enumerate((real, twin)):
            power = sum(1.5 * values[u_q] * values[i_q] for u_q, i_q in _POWERS)
            self._returned[k] = min(max(self._returned[k] - power * seconds, 0.0), self._highest)
        if max(self._returned) > self._feeds:
            return None
        return (real["u_dc"] - twin["u_dc"]) / self._supply
