"""Figures of sensorless operation of one axis: poles, angle errors, PLL and speed loop over speed, start-up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from servo_tuning.linear import Margins, Pole, pole_of, spectral_radius
from servo_tuning.optional import SENSORLESS
from servo_tuning.sensorless import angle_error, st_damping
from servo_tuning.tuned import Tuned

WINDINGS: Final = ((1.0, 1.0), (0.5, 1.0), (1.5, 1.0), (1.0, 0.5), (1.0, 1.5))
"""Ratios of resistance and inductance to their nominal values, in the report."""

SPEEDS: Final = (1.0, 2.0, 4.0, 8.0)
"""Speeds of the report over the minimum speed, those below the speed limit; the limit is added as the last."""


WARM: Final = 1.25
"""Ratio of the resistance of a winding that is 60 K warmer."""

POLE_MIN: Final = 1e-9
"""Poles of a smaller magnitude are set to it: they have no time constant."""


@dataclass(frozen=True)
class ObserverPoles:
    """Poles of the sampled observer."""

    r_s: float  # resistance in the equations of the observer, over the nominal value; same K1 and K2
    inductance: float  # inductance in the equations of the observer, over the nominal value
    speed: float  # mechanical [rad/s]
    poles: tuple[Pole, ...]  # the slower first; complex vectors: they are not conjugate


@dataclass(frozen=True)
class AngleError:
    """Steady-state error of the observed angle at the rated current, with a winding that is not nominal."""

    r_s: float  # true resistance over the nominal one
    inductance: float  # true inductance over the nominal one
    speed: float  # mechanical [rad/s]
    degrees: float  # electrical [degrees]


@dataclass(frozen=True)
class Lock:
    """PLL and sensorless speed loop at one speed."""

    speed: float  # mechanical [rad/s]
    back_emf: float  # [V]
    frequency: float  # natural frequency of the PLL [Hz]
    damping: float  # damping ratio of the PLL
    slide_damping: float  # damping ratio with the P gain of the ST document
    speed_margins: Margins  # of the sensorless speed loop
    half_inertia: bool  # whether it is stable with half the inertia
    twice_inertia: bool  # whether it is stable with twice the inertia


@dataclass(frozen=True)
class SensorlessFigures:
    """Figures of sensorless operation of one axis."""

    feedback: str  # after reset
    trouble: str | None  # reason if the motor cannot be observed; the other figures are then empty
    poles: tuple[ObserverPoles, ...]
    errors: tuple[AngleError, ...]
    locks: tuple[Lock, ...]
    unexplained_speed: float = 0.0  # speed of the back-EMF of `emf_check.floor`, mechanical [rad/s]
    blind_speed: float = 0.0
    """Mechanical speed below which the additional drop of `limits.current` in a warm winding exceeds the back-EMF
    [rad/s]: during braking the observed angle reverses."""


def sensorless_figures(design: Tuned) -> SensorlessFigures:
    """Compute all figures."""
    if SENSORLESS in design.unusable:
        return SensorlessFigures(design.axis.feedback, str(design.unusable[SENSORLESS]), (), (), ())
    return SensorlessFigures(
        design.axis.feedback,
        None,
        tuple(_poles(design)),
        tuple(_errors(design)),
        tuple(_lock(design, speed) for speed in _speeds(design)),
        _speed_of(design, design.axis("emf_check.floor")),
        _speed_of(design, (WARM - 1.0) * design.axis("motor.r_s") * design.axis("limits.current")),
    )


def _speed_of(design: Tuned, back_emf: float) -> float:
    return back_emf / (design.axis("motor.pole_pairs") * design.axis("motor.psi_m"))


def _speeds(design: Tuned) -> list[float]:
    minimum, maximum = design.sensorless.start_up.minimum_speed, design.axis("limits.speed")
    return [*(factor * minimum for factor in SPEEDS if factor * minimum < maximum), maximum]


def _poles(design: Tuned) -> Iterator[ObserverPoles]:
    p, top = design.axis("motor.pole_pairs"), design.axis("limits.speed")
    for r_s, inductance in WINDINGS:
        observer = design.sensorless.observer.winding(r_s, inductance)
        for speed in (0.0, top):
            found = tuple(
                pole_of(z if abs(z) > POLE_MIN else POLE_MIN, design.board.period) for z in observer.poles(p * speed)
            )
            yield ObserverPoles(r_s, inductance, speed, found)


def _errors(design: Tuned) -> Iterator[AngleError]:
    p, current = design.axis("motor.pole_pairs"), design.axis("motor.rated_current")
    for r_s, inductance in WINDINGS:
        for speed in (design.sensorless.start_up.minimum_speed, design.axis("limits.speed")):
            radians = angle_error(design.axis, p * speed, current, r_s, inductance)
            yield AngleError(r_s, inductance, speed, math.degrees(radians))


def _lock(design: Tuned, speed: float) -> Lock:
    omega_e = design.axis("motor.pole_pairs") * speed
    pll = design.sensorless.pll
    stable = [spectral_radius(design.sensorless_shaft(speed, factor).speed_alone) < 1.0 for factor in (0.5, 2.0)]
    return Lock(
        speed=speed,
        back_emf=design.axis("motor.psi_m") * omega_e,
        frequency=pll.omega_n(omega_e) / (2.0 * np.pi),
        damping=pll.damping,
        slide_damping=st_damping(omega_e),
        speed_margins=design.sensorless_shaft(speed).speed_margins(),
        half_inertia=stable[0],
        twice_inertia=stable[1],
    )
