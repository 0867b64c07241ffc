"""What the sensorless part of one axis amounts to: poles, angle errors, the loop over speed, the start-up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from servo_msgs_py.tuning.linear import Margins, Pole, pole_of, spectral_radius
from servo_msgs_py.tuning.sensorless import angle_error, slide_damping
from servo_msgs_py.tuning.tuned import Tuned

WINDINGS: Final = ((1.0, 1.0), (0.5, 1.0), (1.5, 1.0), (1.0, 0.5), (1.0, 1.5))
"""Resistance and inductance that are tried, over the nominal values."""

SPEEDS: Final = (1.0, 2.0, 4.0, 8.0)
"""Of the minimum speed, as far as they lie below the limit, which comes last."""


WARM: Final = 1.25
"""Resistance of a winding that is 60 K warmer, over the cold one."""

GONE: Final = 1e-9
"""A pole so near to 0 has no time constant any more."""


@dataclass(frozen=True)
class ObserverPoles:
    """Poles of the sampled observer.

    Attributes
    ----------
    r_s, inductance : float
        Of the winding in its equations, over the nominal value; K1 and K2 stay.
    speed : float
        Mechanical [rad/s].
    poles : tuple of Pole
        The slower first. They turn with the stator frame: none has a conjugate one.
    """

    r_s: float
    inductance: float
    speed: float
    poles: tuple[Pole, ...]


@dataclass(frozen=True)
class AngleError:
    """Steady error of the observed angle at the rated current, when the winding is not the nominal one.

    Attributes
    ----------
    r_s, inductance : float
        True values over nominal ones.
    speed : float
        Mechanical [rad/s].
    degrees : float
        Electrical.
    """

    r_s: float
    inductance: float
    speed: float
    degrees: float


@dataclass(frozen=True)
class Lock:
    """The phase-locked loop and the speed loop behind it at one speed.

    Attributes
    ----------
    speed : float
        Mechanical [rad/s].
    back_emf : float
        [V]
    frequency, damping : float
        Natural frequency [Hz] and damping of the phase-locked loop.
    slide_damping : float
        With the slide's P gain.
    speed_margins : Margins
        Of the sensorless speed loop.
    half_inertia, twice_inertia : bool
        Whether it is stable on such a shaft.
    """

    speed: float
    back_emf: float
    frequency: float
    damping: float
    slide_damping: float
    speed_margins: Margins
    half_inertia: bool
    twice_inertia: bool


@dataclass(frozen=True)
class SensorlessFigures:
    """All figures of one axis.

    Attributes
    ----------
    feedback : str
        After reset.
    trouble : str or None
        Why the motor cannot be observed; then there is nothing else.
    unexplained_speed : float
        What `emf_check.floor` makes of the back-EMF's size, mechanical [rad/s].
    blind_speed : float
        Below it `limits.current` takes more voltage in a warm winding, besides the nominal one, than there is back-EMF:
        while it brakes the observed angle turns round. Mechanical [rad/s].
    """

    feedback: str
    trouble: str | None
    poles: tuple[ObserverPoles, ...]
    errors: tuple[AngleError, ...]
    locks: tuple[Lock, ...]
    unexplained_speed: float = 0.0
    blind_speed: float = 0.0


def sensorless_figures(it: Tuned) -> SensorlessFigures:
    """Compute all figures."""
    if it.trouble is not None:
        return SensorlessFigures(it.axis.feedback, str(it.trouble), (), (), ())
    return SensorlessFigures(
        it.axis.feedback,
        None,
        tuple(_poles(it)),
        tuple(_errors(it)),
        tuple(_lock(it, speed) for speed in _speeds(it)),
        _speed_of(it, it.axis("emf_check.floor")),
        _speed_of(it, (WARM - 1.0) * it.axis("motor.r_s") * it.axis("limits.current")),
    )


def _speed_of(it: Tuned, back_emf: float) -> float:
    return back_emf / (it.axis("motor.pole_pairs") * it.axis("motor.psi_m"))


def _speeds(it: Tuned) -> list[float]:
    minimum, maximum = it.sensorless.start_up.minimum_speed, it.axis("limits.speed")
    return [*(factor * minimum for factor in SPEEDS if factor * minimum < maximum), maximum]


def _poles(it: Tuned) -> Iterator[ObserverPoles]:
    p, top = it.axis("motor.pole_pairs"), it.axis("limits.speed")
    for r_s, inductance in WINDINGS:
        observer = it.sensorless.observer.winding(r_s, inductance)
        for speed in (0.0, top):
            found = tuple(pole_of(z if abs(z) > GONE else GONE, it.board.period) for z in observer.poles(p * speed))
            yield ObserverPoles(r_s, inductance, speed, found)


def _errors(it: Tuned) -> Iterator[AngleError]:
    p, current = it.axis("motor.pole_pairs"), it.axis("motor.rated_current")
    for r_s, inductance in WINDINGS:
        for speed in (it.sensorless.start_up.minimum_speed, it.axis("limits.speed")):
            radians = angle_error(it.axis, p * speed, current, r_s, inductance)
            yield AngleError(r_s, inductance, speed, math.degrees(radians))


def _lock(it: Tuned, speed: float) -> Lock:
    omega_e = it.axis("motor.pole_pairs") * speed
    pll = it.sensorless.pll
    stable = [spectral_radius(it.sensorless_shaft(speed, factor).speed_alone) < 1.0 for factor in (0.5, 2.0)]
    return Lock(
        speed=speed,
        back_emf=it.axis("motor.psi_m") * omega_e,
        frequency=pll.omega_n(omega_e) / (2.0 * np.pi),
        damping=pll.damping,
        slide_damping=slide_damping(omega_e),
        speed_margins=it.sensorless_shaft(speed).speed_margins(),
        half_inertia=stable[0],
        twice_inertia=stable[1],
    )
