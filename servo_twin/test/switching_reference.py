"""Independent reference for the plant at switching level.

It uses other methods than the plant: one joint state of both axes and the bus in rotor coordinates, Runge-Kutta steps
below 1 us, the conduction state of the legs by trial of all combinations, and bisection for zero crossings of currents,
limits of floating legs and stops of shafts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from servo_twin.plant import AxisPlant, BusPlant, PlantConfig

CLOCK = 1e-8
OPEN, HIGH, LOW = 0, 1, 2

STATES = 6  # of an axis
BUS = 2 * STATES  # index of the bus voltage, after the states of both axes

Edge = tuple[int, int, int, int]
"""Clock, axis, phase, gates."""

_AXIS = [(1.0, 0.0), (-0.5, math.sqrt(0.75)), (-0.5, -math.sqrt(0.75))]


def clarke(v: Sequence[float]) -> tuple[float, float]:
    return (2 * v[0] - v[1] - v[2]) / 3, (v[1] - v[2]) / math.sqrt(3)


def iron(inductance: float, i_s: float, current: float) -> tuple[float, float]:
    """Flux and differential inductance for i = flux / L (1 + (flux / (L i_s))^2 / 3), by Cardano's formula."""
    x = 2.0 * math.sinh(math.asinh(1.5 * current / i_s) / 3.0) if i_s > 0.0 else 0.0
    return (inductance * i_s * x, inductance / (1.0 + x * x)) if i_s > 0.0 else (inductance * current, inductance)


@dataclass
class Machine:
    """One axis: state and conduction pattern."""

    plant: AxisPlant
    i_d: float = 0.0  # [A]
    i_q: float = 0.0  # [A]
    omega: float = 0.0  # speed of the rotor [rad/s]
    theta: float = 0.0  # angle of the rotor [rad]
    gates: list[int] = field(default_factory=lambda: [OPEN] * 3)
    sign: list[int] = field(default_factory=lambda: [0] * 3)
    moving: int = 0
    load: float = 0.0  # external torque against positive motion [N m]
    omega_load: float = 0.0  # speed of the load [rad/s]
    theta_load: float = math.nan  # angle of the load [rad]; default: `theta`

    def __post_init__(self) -> None:
        self.theta_load = self.theta if math.isnan(self.theta_load) else self.theta_load

    def phases(self) -> list[float]:
        angle = self.plant.pole_pairs * self.theta
        c, s = math.cos(angle), math.sin(angle)
        a, b = self.i_d * c - self.i_q * s, self.i_d * s + self.i_q * c
        return [a * x + b * y for x, y in _AXIS]

    def torque(self) -> float:
        return self.torque_of(self.i_d, self.i_q)

    def torque_of(self, i_d: float, i_q: float) -> float:
        p = self.plant
        flux_d, _ = iron(p.l_d, p.i_saturation_d, i_d)
        flux_q, _ = iron(p.l_q, p.i_saturation_q, i_q)
        return 1.5 * p.pole_pairs * ((p.psi_m + flux_d) * i_q - flux_q * i_d)

    def pull(self, x: Sequence[float]) -> float:
        """Cogging torque and shaft torque on the rotor [N m]."""
        p = self.plant
        omega, theta, omega_load, theta_load = x[2:]
        return p.cogging_torque * math.sin(p.cogging_periods * theta + p.cogging_phase) - self.twist(
            theta - theta_load, omega - omega_load
        )

    def twist(self, angle: float, speed: float) -> float:
        """Torque of the elastic shaft [N m]."""
        p = self.plant
        deep = math.copysign(max(abs(angle) - 0.5 * p.backlash, 0.0), angle)
        torque = p.shaft_stiffness * deep + p.shaft_damping * speed
        return torque if torque * deep > 0.0 and p.load_inertia > 0.0 else 0.0

    def limits(self, k: int, u: float) -> tuple[float, float]:
        v = self.plant.v_drop
        return {OPEN: (-v, u + v), HIGH: (u - v, u + v), LOW: (-v, v)}[self.gates[k]]

    def rates(self, x: Sequence[float], u: float, sign: Sequence[int]) -> tuple[list[float], list[float], float]:
        """Derivatives of `x`, leg voltages, current out of the bus."""
        p = self.plant
        i_d, i_q, omega, theta, omega_load, theta_load = x
        flux_d, l_d = iron(p.l_d, p.i_saturation_d, i_d)
        flux_q, l_q = iron(p.l_q, p.i_saturation_q, i_q)
        angle = p.pole_pairs * theta
        c, s = math.cos(angle), math.sin(angle)
        w = p.pole_pairs * omega
        r = p.r_s + p.r_on

        def slopes(v: Sequence[float]) -> tuple[float, float]:
            a, b = clarke(v)
            return (
                (a * c + b * s - r * i_d + w * flux_q) / l_d,
                (b * c - a * s - r * i_q - w * (flux_d + p.psi_m)) / l_q,
            )

        def phase_slope(k: int, v: Sequence[float]) -> float:
            d, q = slopes(v)
            da = d * c - q * s - w * (i_d * s + i_q * c)
            db = d * s + q * c + w * (i_d * c - i_q * s)
            return da * _AXIS[k][0] + db * _AXIS[k][1]

        v = [0.0, 0.0, 0.0]
        for k in range(3):
            low, high = self.limits(k, u)
            v[k] = low if sign[k] > 0 else high if sign[k] < 0 else 0.0
        floating = [k for k in range(3) if sign[k] == 0]
        if len(floating) == 3:
            emf = [-w * p.psi_m * s, w * p.psi_m * c]
            v = [emf[0] * a + emf[1] * b for a, b in _AXIS]
        elif len(floating) == 1:
            k = floating[0]
            zero = phase_slope(k, v)
            v[k] = 1.0
            v[k] = -zero / (phase_slope(k, v) - zero)
        d, q = (0.0, 0.0) if len(floating) == 3 else slopes(v)
        two = p.load_inertia > 0.0
        accel = accel_load = 0.0
        if self.moving:
            torque = self.torque_of(i_d, i_q) + self.pull(x) - (0.0 if two else self.load)
            accel = (torque - self.moving * p.friction - p.viscous * omega) / p.inertia
        if two:
            accel_load = (self.twist(theta - theta_load, omega - omega_load) - self.load) / p.load_inertia
        current = 0.0
        for k, (a, b) in enumerate(_AXIS):
            upper = self.gates[k] == HIGH or (self.gates[k] == OPEN and sign[k] < 0)
            if upper and sign[k] != 0:
                current += a * (i_d * c - i_q * s) + b * (i_d * s + i_q * c)
        return [d, q, accel, omega, accel_load, omega_load], v, current

    @property
    def x(self) -> list[float]:
        return [self.i_d, self.i_q, self.omega, self.theta, self.omega_load, self.theta_load]

    @x.setter
    def x(self, value: Sequence[float]) -> None:
        self.i_d, self.i_q, self.omega, self.theta, self.omega_load, self.theta_load = value

    def decide(self, u: float) -> None:
        """Find the signs of zero currents by trial, and the direction of motion."""
        zero = [k for k in range(3) if self.sign[k] == 0]
        if zero:
            for trial in sorted(itertools.product((0, 1, -1), repeat=len(zero)), key=lambda t: sum(map(abs, t))):
                sign = list(self.sign)
                for k, value in zip(zero, trial, strict=True):
                    sign[k] = value
                if sorted(sign) in ([-1, 0, 0], [0, 0, 1], [1, 1, 1], [-1, -1, -1]) or not self._consistent(
                    u, sign, zero
                ):
                    continue
                self.sign = sign
                break
            else:
                raise AssertionError(f"no conduction pattern found: {self}")
        if abs(self.omega) > 1e-9:
            self.moving = 1 if self.omega > 0 else -1
        else:
            self.omega = 0.0
            drive = self.drive()
            self.moving = 0 if abs(drive) <= self.plant.friction else 1 if drive > 0 else -1

    def _consistent(self, u: float, sign: Sequence[int], zero: Sequence[int]) -> bool:
        rates, v, _ = self.rates(self.x, u, sign)
        if all(s == 0 for s in sign):
            span = [
                (low - e, high - e) for (low, high), e in zip((self.limits(k, u) for k in range(3)), v, strict=True)
            ]
            return max(s[0] for s in span) <= min(s[1] for s in span)
        p = self.plant
        angle = p.pole_pairs * self.theta
        c, s = math.cos(angle), math.sin(angle)
        w = p.pole_pairs * self.omega
        da = rates[0] * c - rates[1] * s - w * (self.i_d * s + self.i_q * c)
        db = rates[0] * s + rates[1] * c + w * (self.i_d * c - self.i_q * s)
        for k in zero:
            slope = da * _AXIS[k][0] + db * _AXIS[k][1]
            low, high = self.limits(k, u)
            if sign[k] == 0 and not low <= v[k] <= high:
                return False
            if sign[k] != 0 and slope * sign[k] <= 0.0:
                return False
        return True

    def violated(self, u: float) -> float:
        """Violation of the conduction pattern by the state (0: none)."""
        worst = 0.0
        for current, sign in zip(self.phases(), self.sign, strict=True):
            if sign != 0:
                worst = max(worst, -current * sign)
        if self.moving and self.omega * self.moving < 0.0:
            worst = max(worst, abs(self.omega))
        floating = [k for k in range(3) if self.sign[k] == 0]
        _, v, _ = self.rates(self.x, u, self.sign)
        if len(floating) == 1:
            low, high = self.limits(floating[0], u)
            worst = max(worst, low - v[floating[0]], v[floating[0]] - high)
        elif floating:
            span = [(self.limits(k, u)[0] - v[k], self.limits(k, u)[1] - v[k]) for k in range(3)]
            worst = max(worst, max(s[0] for s in span) - min(s[1] for s in span))
        if not self.moving:
            worst = max(worst, abs(self.drive()) - self.plant.friction)
        return worst

    def drive(self) -> float:
        """Torque on a rotor at standstill, without friction [N m]."""
        return self.torque() + self.pull(self.x) - (0.0 if self.plant.load_inertia > 0.0 else self.load)

    def cross(self) -> None:
        """Set the currents that crossed zero to zero, after a violation."""
        for k, current in enumerate(self.phases()):
            if self.sign[k] != 0 and abs(current) < 1e-7 and current * self.sign[k] < 1e-9:
                self.sign[k] = 0
        if sum(map(abs, self.sign)) < 2:
            self.sign = [0, 0, 0]
            self.i_d = self.i_q = 0.0
        if self.moving and self.omega * self.moving < 1e-9:
            self.omega = 0.0


class Reference:
    """Two axes on one bus."""

    def __init__(self, plant: PlantConfig, step: float = 5e-7) -> None:
        self.axes = [Machine(axis, theta=float(axis.theta_start)) for axis in plant.axes]
        self.bus: BusPlant = plant.bus
        self.u = plant.bus.u_source
        self.step = step
        self.clock = 0
        self.energy = [0.0, 0.0]
        self.volt_seconds = np.zeros((2, 3))

    def _rates(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        rates = np.zeros_like(x)
        u = float(x[BUS])
        load = 0.0
        for n, axis in enumerate(self.axes):
            part = slice(STATES * n, STATES * (n + 1))
            rates[part], v, current = axis.rates([float(value) for value in x[part]], u, axis.sign)
            rates[BUS + 1 + n] = u * current
            rates[BUS + 3 + 3 * n : BUS + 6 + 3 * n] = v
            load += current
        source = max(0.0, (self.bus.u_source - u) / self.bus.r_source)
        rates[BUS] = (source - load) / self.bus.capacitance
        return rates

    def _state(self) -> NDArray[np.float64]:
        state = [value for axis in self.axes for value in axis.x]
        return np.array([*state, self.u, *self.energy, *self.volt_seconds.ravel()])

    def _put(self, x: NDArray[np.float64]) -> None:
        for n, axis in enumerate(self.axes):
            axis.x = [float(value) for value in x[STATES * n : STATES * (n + 1)]]
        self.u = float(x[BUS])
        self.energy = [float(x[BUS + 1]), float(x[BUS + 2])]
        self.volt_seconds = x[BUS + 3 :].reshape(2, 3).copy()

    def _try(self, x: NDArray[np.float64], h: float) -> None:
        k1 = self._rates(x)
        k2 = self._rates(x + 0.5 * h * k1)
        k3 = self._rates(x + 0.5 * h * k2)
        k4 = self._rates(x + h * k3)
        self._put(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))

    def _advance(self, seconds: float) -> None:
        while seconds > 1e-16:
            for axis in self.axes:
                axis.decide(self.u)
            h = min(seconds, self.step)
            x = self._state()
            self._try(x, h)
            if any(axis.violated(self.u) > 1e-12 for axis in self.axes):
                early, late = 0.0, h
                for _ in range(45):
                    h = 0.5 * (early + late)
                    self._try(x, h)
                    if any(axis.violated(self.u) > 1e-12 for axis in self.axes):
                        late = h
                    else:
                        early = h
                h = late
                self._try(x, h)
                for axis in self.axes:
                    axis.cross()
            seconds -= h

    def run(self, edges: Iterable[Edge], until: int) -> None:
        """Execute the edges, in order of time, and run until a clock."""
        for clock, axis, phase, gates in edges:
            self._advance((clock - self.clock) * CLOCK)
            self.clock = clock
            self.axes[axis].gates[phase] = gates
        self._advance((until - self.clock) * CLOCK)
        self.clock = until


def centred_edges(start: int, period: int, duty: Sequence[float], dead: int, axis: int) -> list[Edge]:
    """Edges of one period that starts at a low-side centre, with `dead` clocks of dead time."""
    edges: list[Edge] = []
    for phase, part in enumerate(duty):
        low = round(0.5 * period * (1.0 - part))
        rise, fall = start + low, start + period - low
        edges += [(rise, axis, phase, OPEN), (rise + dead, axis, phase, HIGH)]
        edges += [(fall, axis, phase, OPEN), (fall + dead, axis, phase, LOW)]
    return edges
