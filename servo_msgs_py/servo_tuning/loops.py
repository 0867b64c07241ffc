"""Models of the control loops: sampled, with delays, with the integer gains of the firmware.

Fast loop, between two samples of the currents (DRM F34): the duties computed from a sample are loaded half a period
later and held for one period. Slow loop: the fast loop uses its set-point half a period later, for eight periods; the
speed comes from one of the `sensors`.

Currents and speeds are small signals: no limit is active, the direction of motion does not change, i_d is 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD, SLOW_PERIODS, TICK

from servo_tuning.gains import Gains, Pi
from servo_tuning.linear import Margins, Matrix, Omega, System, held, margins
from servo_tuning.motor import Load, Motor
from servo_tuning.sensors import EdgeDelay, SpeedSensor


@dataclass(frozen=True)
class CurrentLoop:
    """One current controller and the winding at standstill."""

    resistance: float  # of the winding [ohm]
    inductance: float  # of the winding [H]
    gains: Pi  # of the controller
    period: float  # of the fast loop [s]

    @property
    def open(self) -> System:
        """Open loop from error to current, both at the sampling instants. States: current, voltage, integral."""
        a, b = np.array([[-self.resistance / self.inductance]]), np.array([[1.0 / self.inductance]])
        f, g = (float(m[0, 0]) for m in held(a, b, 0.5 * self.period))

        def step(x: Matrix, u: Matrix) -> tuple[Matrix, Matrix]:
            current, voltage, integral = x
            error = u[0]
            integral = integral + self.gains.ki * error
            loaded = self.gains.kp * error + integral
            after = f * (f * current + g * voltage) + g * loaded
            return np.vstack([after, loaded, integral]), current[None, :]

        return System.of(step, 3, 1, self.period)

    @property
    def closed(self) -> System:
        """Closed loop from the set-point to the current."""
        return self.open.fed_back(0, 0)

    def margins(self) -> Margins:
        loop = self.open
        return margins(loop.response, loop.nyquist)


class In(IntEnum):
    """Inputs of the speed and position loops."""

    CURRENT = 0
    """Current set-point [A]: open loop, the one of the motor; closed loop, an added disturbance."""
    SET_POINT = 1
    """Speed [rad/s] or angle [rad] set-point."""
    LOAD = 2
    """Load torque against the motion [N m]."""


class Out(IntEnum):
    """Outputs of the loops, at the slow ticks."""

    CURRENT = 0
    """Output of the speed controller [A]."""
    PROPORTIONAL = 1
    """Proportional part of that output [A]."""
    MEASURED = 2
    """Measured speed [rad/s]."""
    SPEED = 3
    """True speed of the shaft [rad/s]."""
    ANGLE = 4
    """Angle of the shaft [rad]."""


@dataclass(frozen=True)
class ShaftLoops:
    """Speed and position loop around the q current loop of one axis."""

    motor: Motor  # with the inertia of the shaft
    gains: Gains  # after rounding to integers
    back_emf: float  # gain of the back-EMF decoupling [V s/rad]
    sensor: SpeedSensor  # source of the speed
    load: Load | None = None  # behind a spring; None: a rigid shaft

    def _motor(self) -> tuple[Matrix, Matrix]:
        """Motor over half a PWM period: states current, speed, angle; inputs voltage, load torque.

        With a load behind a spring also its twist and its speed.
        """
        it = self.motor
        if self.load is not None:
            return self._two_masses(self.load)
        a = np.array(
            [
                [-it.r_s / it.l_q, -it.pole_pairs * it.psi_m / it.l_q, 0.0],
                [it.torque_constant / it.inertia, -it.viscous / it.inertia, 0.0],
                [0.0, 1.0, 0.0],
            ]
        )
        b = np.array([[1.0 / it.l_q, 0.0], [0.0, -1.0 / it.inertia], [0.0, 0.0]])
        return held(a, b, 0.5 * PERIOD)

    def _two_masses(self, load: Load) -> tuple[Matrix, Matrix]:
        it, rotor, damping = self.motor, self.motor.inertia - load.inertia, load.viscous(self.motor.inertia)
        spring = np.array([0.0, damping, 0.0, load.stiffness, -damping])  # torque of the spring
        a = np.array(
            [
                [-it.r_s / it.l_q, -it.pole_pairs * it.psi_m / it.l_q, 0.0, 0.0, 0.0],
                np.array([it.torque_constant, -it.viscous, 0.0, 0.0, 0.0]) / rotor - spring / rotor,
                [0.0, 1.0, 0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0, 0.0, -1.0],
                spring / load.inertia,
            ]
        )
        b = np.zeros((5, 2))
        b[0, 0], b[4, 1] = 1.0 / it.l_q, -1.0 / load.inertia
        return held(a, b, 0.5 * PERIOD)

    @cached_property
    def open(self) -> System:
        """Speed loop, opened between the output of the speed controller and the current set-point.

        Inputs: `In`. Outputs: `Out`. States: angle, speed, current, voltage, integrals of current and speed controller,
        movement and current set-point of the last slow period, twist and speed of a load, states of the sensor.
        """
        f, g = self._motor()
        pi, gains = self.gains.current_q, self.gains.speed
        first = 8 if self.load is None else 10

        def step(x: Matrix, u: Matrix) -> tuple[Matrix, Matrix]:
            angle, speed, current, voltage, integral, speed_integral, moved, reference = x[:8]
            injected, set_point, load = u
            measured, sensor = self.sensor.step(x[first:], moved, reference, TICK)
            # The integral part uses the counted movement, not the measured speed.
            speed_integral = speed_integral + gains.ki * (set_point - moved / TICK)
            proportional = gains.kp * (set_point - measured)
            outputs = np.vstack([proportional + speed_integral, proportional, measured, speed, angle])
            motor = np.vstack([current, speed, np.zeros_like(angle), *x[8:first]])
            for _ in range(SLOW_PERIODS):
                inputs = np.vstack([voltage, load])
                motor = f @ motor + g @ inputs
                current_error = injected - motor[0]
                integral = integral + pi.ki * current_error
                loaded = pi.kp * current_error + integral + self.back_emf * measured
                motor = f @ motor + g @ inputs
                voltage = loaded
            current, speed, movement = motor[:3]
            states = (angle + movement, speed, current, voltage, integral, speed_integral, movement, injected)
            return np.vstack([*states, *motor[3:], *sensor]), outputs

        return System.of(step, first + self.sensor.states, len(In), TICK)

    @cached_property
    def speed(self) -> System:
        """Closed speed loop; the set-point is a speed [rad/s]."""
        return self.open.fed_back(Out.CURRENT, In.CURRENT, -1.0)

    @cached_property
    def position(self) -> System:
        """Closed position loop; the set-point is an angle [rad]."""
        return self.speed.scaled(In.SET_POINT, self.gains.position).fed_back(Out.ANGLE, In.SET_POINT)

    @property
    def speed_alone(self) -> Matrix:
        """State matrix of the closed speed loop without the angle, which is not controlled there."""
        return self.speed.a[1:, 1:]

    def speed_open(self, omega: Omega, delay: EdgeDelay | None = None) -> NDArray[np.complex128]:
        """Open-loop frequency response at `omega` [rad/s]; `delay` replaces the M/T delay with frequent edges."""
        loop = self.open
        whole = -loop.channel(Out.CURRENT, In.CURRENT).response(omega)
        if delay is None:
            return whole
        frequent = EdgeDelay(loop.dt, 1.5 * loop.dt)
        part = -loop.channel(Out.PROPORTIONAL, In.CURRENT).response(omega)
        return whole + part * (delay.response(omega) / frequent.response(omega) - 1.0)

    def position_open(self, omega: Omega) -> NDArray[np.complex128]:
        """Open-loop frequency response of the position loop at `omega` [rad/s], with the speed loop closed."""
        return self.gains.position * self.speed.channel(Out.ANGLE, In.SET_POINT).response(omega)

    def speed_margins(self, delay: EdgeDelay | None = None) -> Margins:
        """Margins of the speed loop; `delay` as in `speed_open`."""
        return margins(lambda omega: self.speed_open(omega, delay), math.pi / TICK)

    def position_margins(self) -> Margins:
        """Margins of the position loop."""
        return margins(self.position_open, math.pi / TICK)
