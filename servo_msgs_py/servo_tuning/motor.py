"""Nominal motor of an axis, from a configuration or in closed form from the block of a board."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.units import COUNTS_PER_TURN, TICK


@dataclass(frozen=True)
class Load:
    """Load behind a spring."""

    inertia: float  # part of the inertia of the whole shaft [kg m^2]
    stiffness: float  # [N m/rad]
    damping: float  # of the resonance, over its critical damping

    def resonance(self, shaft: float) -> float:
        """Frequency at which motor and load oscillate against each other [Hz]; `shaft`: the whole inertia [kg m^2]."""
        return math.sqrt(self.stiffness / self._reduced(shaft)) / (2.0 * math.pi)

    def viscous(self, shaft: float) -> float:
        """Torque per speed of the twist [N m s]; `shaft`: the whole inertia [kg m^2]."""
        return 2.0 * self.damping * math.sqrt(self.stiffness * self._reduced(shaft))

    def _reduced(self, shaft: float) -> float:
        return (shaft - self.inertia) * self.inertia / shaft


@dataclass(frozen=True)
class Motor:
    """Motor with its shaft."""

    r_s: float  # stator resistance [ohm]
    l_d: float  # stator inductance, d axis [H]
    l_q: float  # stator inductance, q axis [H]
    psi_m: float  # flux linkage of the magnets, electrical [V s]
    pole_pairs: float
    inertia: float  # of the whole shaft [kg m^2]
    viscous: float  # viscous friction [N m s]

    @property
    def torque_constant(self) -> float:
        """Torque per q current at ``i_d = 0`` [N m/A]."""
        return 1.5 * self.pole_pairs * self.psi_m

    @property
    def exchange(self) -> float:
        """Natural frequency at which winding and shaft exchange energy by the back-EMF, as a resonant circuit [Hz]."""
        flux = self.pole_pairs * self.psi_m
        return flux * math.sqrt(1.5 / (self.l_q * self.inertia)) / (2.0 * math.pi)


def acceleration_per_current(block: Mapping[str, int]) -> float:
    """Nominal acceleration per q current [rad/s^2/A] of a block, as the speed observer uses it."""
    per_full_scale = AxisConfigTable.load().value("speed_observer.acceleration_per_current", block)
    per_current = per_full_scale / Catalogue.load().full_scale("current")
    return per_current / TICK**2 * 2.0 * math.pi / COUNTS_PER_TURN


def motor_of(block: Mapping[str, int]) -> Motor:
    """Nominal motor of a block, raw numbers by member: the inverse of `constants.axis_constants`.

    A block has the viscous friction only if the feature FRICTION can be used.
    """
    table, full_speed = AxisConfigTable.load(), Catalogue.load().full_scale("speed")
    pole_pairs = block["encoder.pole_pairs"]
    psi_m = table.value("current_loop.omega_psi", block) / pole_pairs
    torque_constant = 1.5 * pole_pairs * psi_m
    return Motor(
        r_s=table.value("winding.resistance", block),
        l_d=table.value("current_loop.omega_l_d", block) / (pole_pairs * full_speed),
        l_q=table.value("current_loop.omega_l_q", block) / (pole_pairs * full_speed),
        psi_m=psi_m,
        pole_pairs=pole_pairs,
        inertia=torque_constant / acceleration_per_current(block),
        viscous=table.value("friction.viscous", block) * torque_constant,
    )
