"""Control loops of an axis with the gains of a configuration block, in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD, TICK

from servo_tuning.gains import Gains, Pi
from servo_tuning.loops import CurrentLoop, ShaftLoops
from servo_tuning.motor import Load, Motor, acceleration_per_current, motor_of
from servo_tuning.sensors import MtSpeed, Observer


@dataclass(frozen=True)
class ControlLoops:
    """Gains as the firmware uses them, and the models of the loops with them."""

    motor: Motor  # nominal
    used: Gains  # after rounding to integers
    back_emf: float  # gain of the back-EMF decoupling after rounding [V s/rad]
    observer: Observer  # the speed observer after rounding
    observed: bool  # whether the speed observer is on after reset

    def current_loop(self, which: str) -> CurrentLoop:
        """Current loop of the ``d`` or ``q`` axis."""
        gains, inductance = {
            "d": (self.used.current_d, self.motor.l_d),
            "q": (self.used.current_q, self.motor.l_q),
        }[which]
        return CurrentLoop(self.motor.r_s, inductance, gains, PERIOD)

    def shaft(self, inertia: float = 1.0, observed: bool | None = None) -> ShaftLoops:
        """Models of speed and position loop.

        Parameters
        ----------
        inertia : float
            Inertia of the shaft, over the nominal value.
        observed : bool
            True: with the speed observer; False: with the M/T method; None: as after reset.
        """
        sensor = self.observer if (self.observed if observed is None else observed) else MtSpeed()
        return ShaftLoops(self.with_inertia(inertia), self.used, self.back_emf, sensor)

    @property
    def speed_bandwidth(self) -> float:
        """Bandwidth of the speed loop from its proportional gain, as it is designed [Hz]."""
        return self.used.speed.kp * self.motor.torque_constant / self.motor.inertia / (2.0 * math.pi)

    def sprung(self, load: Load, observed: bool | None = None) -> ShaftLoops:
        """Models of speed and position loop with a part of the inertia behind a spring; `observed` as in `shaft`."""
        return replace(self.shaft(observed=observed), load=load)

    def with_inertia(self, inertia: float) -> Motor:
        """The motor with a shaft of another inertia, over the nominal value."""
        return replace(self.motor, inertia=inertia * self.motor.inertia)


def pi_of(block: Mapping[str, int], path: str) -> Pi:
    """Gains of a PI controller of a block."""
    table = AxisConfigTable.load()
    return Pi(*(table.value(f"{path}.{gain}", block) for gain in ("kp", "ki", "kc")))


def softened(block: Mapping[str, int], part: float) -> dict[str, int]:
    """Block with a part of the bandwidths of speed and position control, as the oscillation monitor reduces them."""
    factors = {"speed.kp": part, "speed.ki": part**2, "position_gain": part}
    return {**block, **{name: max(round(factor * block[name]), 1) for name, factor in factors.items()}}


def control_loops(block: Mapping[str, int], motor: Motor | None = None) -> ControlLoops:
    """Loops of a configuration block.

    Parameters
    ----------
    block : mapping
        Raw numbers by member.
    motor : Motor, optional
        Nominal motor; None: that of the block.
    """
    table = AxisConfigTable.load()
    (mask,) = (flag.mask for flag in Catalogue.load().flags["features"] if flag.name == "SPEED_OBSERVER")
    return ControlLoops(
        motor=motor or motor_of(block),
        used=Gains(
            current_d=pi_of(block, "current_loop.d"),
            current_q=pi_of(block, "current_loop.q"),
            speed=pi_of(block, "speed"),
            position=table.value("position_gain", block) * COUNTS_PER_TURN / (2.0 * math.pi),
            path_omega_n=table.value("path_omega_n_ts", block) / TICK,
        ),
        back_emf=table.value("current_loop.omega_psi", block),
        observer=Observer(
            torque=acceleration_per_current(block),
            l_position=table.value("speed_observer.l_position", block),
            l_speed=table.value("speed_observer.l_speed", block),
            l_acceleration=table.value("speed_observer.l_acceleration", block),
        ),
        observed=bool(block["features"] & mask),
    )
