"""The control loops as they run: sampled, delayed, with the integers of the firmware.

Fast loop, from one sample of the currents to the next (DRM F34): the duties computed from a sample are loaded half a
period later and held for a whole one. Slow loop: its set-point is used by the fast loop half a period later, eight
times; the speed comes from one of the `sensors`.

All currents and speeds are small signals: no limit is active, the direction of motion does not change, i_d is 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from servo_msgs_py.tuning.configuration import Axis, Board
from servo_msgs_py.tuning.gains import Gains, Pi
from servo_msgs_py.tuning.linear import Margins, Matrix, Omega, System, held, margins
from servo_msgs_py.tuning.sensors import EdgeDelay, SpeedSensor


@dataclass(frozen=True)
class CurrentLoop:
    """One current controller with its winding at standstill."""

    resistance: float  # of the winding [ohm]
    inductance: float  # of the winding [H]
    gains: Pi  # of the controller
    period: float  # of the fast loop [s]

    @property
    def open(self) -> System:
        """From the error to the current, both at the sampling instants. States: current, voltage, integral."""
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
        """From the set-point to the current."""
        return self.open.fed_back(0, 0)

    def margins(self) -> Margins:
        loop = self.open
        return margins(loop.response, loop.nyquist)


class In(IntEnum):
    """Inputs of the loops around the shaft."""

    CURRENT = 0
    """Current set-point that reaches the motor in an open loop, or is added in a closed one [A]."""
    SET_POINT = 1
    """Speed [rad/s] or angle [rad]."""
    LOAD = 2
    """Torque against the motion [N m]."""


class Out(IntEnum):
    """Their outputs, at the slow ticks."""

    CURRENT = 0
    """What the speed controller asks for [A]."""
    PROPORTIONAL = 1
    """Its proportional part [A]."""
    MEASURED = 2
    """Speed that the controller sees [rad/s]."""
    SPEED = 3
    """Speed of the shaft [rad/s]."""
    ANGLE = 4
    """Its angle [rad]."""


@dataclass(frozen=True)
class ShaftLoops:
    """Speed and position loop around the q current loop of one axis."""

    axis: Axis  # of the configuration
    board: Board  # of the configuration
    gains: Gains  # after rounding to integers
    back_emf: float  # decoupling of the controller [V s/rad]
    inertia: float  # of the shaft [kg m^2]; it may differ from that of the design
    sensor: SpeedSensor  # source of the speed

    def _motor(self) -> tuple[Matrix, Matrix]:
        """Half a PWM period: states current, speed, angle; inputs voltage, load torque."""
        r, l_q = self.axis("motor.r_s"), self.axis("motor.l_q")
        k_t, psi = self.axis.torque_constant, self.axis("motor.pole_pairs") * self.axis("motor.psi_m")
        a = np.array(
            [
                [-r / l_q, -psi / l_q, 0.0],
                [k_t / self.inertia, -self.axis("friction.viscous") / self.inertia, 0.0],
                [0.0, 1.0, 0.0],
            ]
        )
        b = np.array([[1.0 / l_q, 0.0], [0.0, -1.0 / self.inertia], [0.0, 0.0]])
        return held(a, b, 0.5 * self.board.period)

    @cached_property
    def open(self) -> System:
        """The speed loop, opened at the current set-point: what the controller asks for does not reach the motor.

        Inputs are those of `In`, outputs those of `Out`. States: angle, speed, current, voltage, integrals of current
        and speed controller, movement and current set-point of the last slow period, and those of the sensor.
        """
        f, g = self._motor()
        tick, pi, gains = self.board.tick, self.gains.current_q, self.gains.speed
        periods = round(tick / self.board.period)

        def step(x: Matrix, u: Matrix) -> tuple[Matrix, Matrix]:
            angle, speed, current, voltage, integral, speed_integral, moved, reference = x[:8]
            injected, set_point, load = u
            measured, sensor = self.sensor.step(x[8:], moved, reference, tick)
            # The integral part sums the way that the encoder has counted.
            speed_integral = speed_integral + gains.ki * (set_point - moved / tick)
            proportional = gains.kp * (set_point - measured)
            outputs = np.vstack([proportional + speed_integral, proportional, measured, speed, angle])
            motor = np.vstack([current, speed, np.zeros_like(angle)])
            for _ in range(periods):
                inputs = np.vstack([voltage, load])
                motor = f @ motor + g @ inputs
                current_error = injected - motor[0]
                integral = integral + pi.ki * current_error
                loaded = pi.kp * current_error + integral + self.back_emf * measured
                motor = f @ motor + g @ inputs
                voltage = loaded
            current, speed, movement = motor
            states = (angle + movement, speed, current, voltage, integral, speed_integral, movement, injected)
            return np.vstack([*states, *sensor]), outputs

        return System.of(step, 8 + self.sensor.states, len(In), tick)

    @cached_property
    def speed(self) -> System:
        """Speed loop closed; the set-point is a speed [rad/s]."""
        return self.open.fed_back(Out.CURRENT, In.CURRENT, -1.0)

    @cached_property
    def position(self) -> System:
        """Position loop closed around it; the set-point is an angle [rad]."""
        return self.speed.scaled(In.SET_POINT, self.gains.position).fed_back(Out.ANGLE, In.SET_POINT)

    @property
    def speed_alone(self) -> Matrix:
        """Matrix of the speed loop without the angle, which nothing holds while only the speed is controlled."""
        return self.speed.a[1:, 1:]

    def speed_open(self, omega: Omega, delay: EdgeDelay | None = None) -> NDArray[np.complex128]:
        """Open-loop frequency response at `omega` [rad/s]; `delay` replaces that of M/T while edges are frequent."""
        loop = self.open
        whole = -loop.channel(Out.CURRENT, In.CURRENT).response(omega)
        if delay is None:
            return whole
        frequent = EdgeDelay(loop.dt, 1.5 * loop.dt)
        part = -loop.channel(Out.PROPORTIONAL, In.CURRENT).response(omega)
        return whole + part * (delay.response(omega) / frequent.response(omega) - 1.0)

    def position_open(self, omega: Omega) -> NDArray[np.complex128]:
        """Open-loop frequency response of the position loop at `omega` [rad/s], the speed loop closed."""
        return self.gains.position * self.speed.channel(Out.ANGLE, In.SET_POINT).response(omega)

    def speed_margins(self, delay: EdgeDelay | None = None) -> Margins:
        """Margins of the speed loop; `delay` as in `speed_open`."""
        return margins(lambda omega: self.speed_open(omega, delay), math.pi / self.board.tick)

    def position_margins(self) -> Margins:
        """Margins of the position loop."""
        return margins(self.position_open, math.pi / self.board.tick)
