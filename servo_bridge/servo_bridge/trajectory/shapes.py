"""Predefined motions: move, stop, sine, Lissajous figure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from servo_msgs_py.quantity import VALUE_MAX

from servo_bridge.trajectory.check import Limits, first_violation, least
from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.path import DEGREE, Path, State
from servo_bridge.trajectory.spline import path_through
from servo_bridge.trajectory.waypoints import DURATION_MAX, WAYPOINTS_MAX, Array, Waypoints, check_duration

_SHORTEST = 2.0e-3
"""Shortest motion [s]: two of the shortest segments of the board."""

_SHORTEST_STOP = 0.02
"""Shortest stop [s]: in a shorter one, rounding to PWM periods adds more acceleration than `_RESERVE` permits."""

_RESERVE = 0.95
"""Fraction of the acceleration limit used by motions of the shortest duration; the remainder is for the interpolation
of the board, whose cubic pieces deviate slightly from the path."""

_PER_WAVE = 24
"""Waypoints per period of a sine; the error of the quintics is at most 8e-9 of the amplitude."""


def move(
    joints: Sequence[str],
    start: ArrayLike,
    goal: ArrayLike,
    duration: float | None = None,
    limits: Sequence[Limits] | None = None,
) -> Path:
    """Quintic motion from rest to rest; all joints start and end together.

    Parameters
    ----------
    joints : sequence of str
        Names.
    start, goal : (joints,) array_like
        Positions [rad].
    duration : float, optional
        Duration [s]; default: the shortest, to a thousandth, within the limits.
    limits : sequence of Limits, optional
        Per joint, for the shortest duration. Position limits are ignored here; see `check`.

    Returns
    -------
    Path
        Starts at time 0.

    Raises
    ------
    TrajectoryError
        If the duration is not positive, or cannot be determined from the limits.
    """

    def in_time(time: float) -> Path:
        return path_through(Waypoints.of(joints, [time], [goal]), State.at_rest(start))

    if duration is not None:
        _check_positive("duration", duration, "s")
        return in_time(duration)
    bounds = [replace(limit, position_min=-math.inf, position_max=math.inf) for limit in limits or ()]
    finite = [min(b.velocity_max, b.acceleration_max, b.torque_max if b.inertia else math.inf) for b in bounds]
    if not all(map(math.isfinite, finite or [math.inf])):
        raise TrajectoryError(
            "no duration is given, and a joint has no velocity, acceleration or torque limit; "
            "write a duration, or limits of each joint"
        )
    return _shortest(in_time, bounds)


def stop(joints: Sequence[str], start: State, deceleration_max: Sequence[float], start_time: float = 0.0) -> Path:
    """Smooth stop: cubic velocity to zero, acceleration from its present value to zero.

    Parameters
    ----------
    joints : sequence of str
        Names.
    start : State
        State of shape (joints,).
    deceleration_max : sequence of float
        Per joint [rad/s^2]; a larger acceleration at the start is used as the limit instead.
    start_time : float
        Start [s].
    """
    limits = [
        Limits(acceleration_max=max(a, 1.001 * abs(b) / _RESERVE))
        for a, b in zip(deceleration_max, start.acceleration, strict=True)
    ]

    def in_time(time: float) -> Path:
        v, a = start.velocity, start.acceleration
        c = np.zeros((1, len(joints), DEGREE + 1))
        c[0, :, :3] = np.stack((start.position, v, 0.5 * a), axis=-1)
        c[0, :, 3] = (-3.0 * v / time - 2.0 * a) / time / 3.0
        c[0, :, 4] = (2.0 * v / time + a) / time**2 / 4.0
        end = start.position + time * (0.5 * v + time * a / 12.0)
        efforts = np.vstack((start.effort, np.zeros_like(start.effort)))
        return Path(joints, [start_time, start_time + time], c, end, efforts)

    return _shortest(in_time, limits, _SHORTEST_STOP)


def sine(
    joint: str, centre: float, amplitude: float, frequency: float, duration: float, ramp: float | None = None
) -> Path:
    """Sine about a position, from rest to rest at the centre; see `lissajous` for the envelope.

    Parameters
    ----------
    joint : str
        Name.
    centre, amplitude : float
        [rad]
    frequency : float
        [Hz]
    duration, ramp : float
        [s]
    """
    return _waves([joint], [centre], [amplitude], [frequency], [0.0], duration, ramp)


def lissajous(
    joints: Sequence[str],
    centre: Sequence[float],
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    duration: float,
    phase: float = 0.5 * math.pi,
    ramp: float | None = None,
) -> Path:
    """Sines of two joints with a phase shift; a circle if amplitudes and frequencies are equal.

    The amplitude rises from zero at the begin and falls to zero at the end as a quintic in time, so that the motion
    starts and ends at rest at the centre with zero acceleration. In between it is the sine, with an error of 8e-9 of
    the amplitude.

    Parameters
    ----------
    joints : sequence of str
        Two names.
    centre, amplitudes : sequence of float
        Per joint [rad].
    frequencies : sequence of float
        Per joint [Hz].
    duration : float
        Including both ramps [s].
    phase : float
        Phase of the first joint [rad].
    ramp : float, optional
        Duration of a ramp [s]; default: one period of the slowest sine, at most half the duration.

    Raises
    ------
    TrajectoryError
        If a frequency, the duration or the ramp is not positive, the ramps are longer than the duration, or
        there are not two joints.
    """
    if not len(joints) == len(centre) == len(amplitudes) == len(frequencies) == 2:
        raise TrajectoryError("a Lissajous figure has two joints; write two names, centres, amplitudes, frequencies")
    return _waves(joints, centre, amplitudes, frequencies, [phase, 0.0], duration, ramp)


def _waves(
    joints: Sequence[str],
    centre: Sequence[float],
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    phases: Sequence[float],
    duration: float,
    ramp: float | None,
) -> Path:
    for frequency in frequencies:
        _check_positive("frequency", frequency, "Hz")
    _check_positive("duration", duration, "s")
    check_duration(np.array([0.0, duration]))
    for amplitude in amplitudes:
        if not abs(amplitude) <= VALUE_MAX:
            raise TrajectoryError(f"amplitude is {amplitude:g} rad; write a number of at most {VALUE_MAX:g}")
    rise = min(1.0 / min(frequencies), 0.5 * duration) if ramp is None else ramp
    _check_positive("ramp", rise, "s")
    if 2.0 * rise > duration:
        raise TrajectoryError(f"two ramps of {rise:g} s do not fit into {duration:g} s; use a longer duration")
    step = min(1.0 / max(frequencies), rise) / _PER_WAVE
    if (count := duration / step) > WAYPOINTS_MAX - 3 * _PER_WAVE:  # before they are made
        waves = 0.99 * WAYPOINTS_MAX / _PER_WAVE
        remedy = f"use at most {waves / duration:.3g} Hz, or {waves / max(frequencies):.3g} s"
        if rise < 1.0 / max(frequencies):
            remedy = f"use a ramp of at least {duration / waves:.3g} s"
        raise TrajectoryError(
            f"{max(frequencies):g} Hz for {duration:g} s with ramps of {rise:g} s are {count:.3g} waypoints, more than "
            f"{WAYPOINTS_MAX}; {remedy}"
        )
    spans = [(0.0, rise), (rise, duration - rise), (duration - rise, duration)]
    t = np.unique(np.concatenate([np.linspace(a, b, math.ceil((b - a) / step) + 1) for a, b in spans]))
    e, de, dde = (x[:, None] for x in _envelope(t, rise, duration))
    omega = 2.0 * math.pi * np.array(frequencies)
    angle = omega * t[:, None] + np.array(phases)
    size = np.array(amplitudes)
    sine, cosine = size * np.sin(angle), size * omega * np.cos(angle)
    # Product rule; the second derivative of the sine is -omega^2 times the sine.
    rows = (
        np.array(centre) + e * sine,
        de * sine + e * cosine,
        dde * sine + 2.0 * de * cosine - e * omega**2 * sine,
    )
    return path_through(Waypoints.of(joints, t, *rows))


def _envelope(t: Array, rise: float, duration: float) -> tuple[Array, Array, Array]:
    """Quintic rise at the begin and fall at the end, with the first two derivatives."""
    s = np.clip(np.minimum(t, duration - t) / rise, 0.0, 1.0)
    slope = np.where(t < 0.5 * duration, 1.0, -1.0) / rise
    first = 30.0 * s**2 * (1.0 - s) ** 2 * slope
    second = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) * slope**2
    return s**3 * (10.0 + s * (6.0 * s - 15.0)), first, second


def _shortest(in_time: Callable[[float], Path], limits: Sequence[Limits], shortest: float = _SHORTEST) -> Path:
    """Motion of the shortest duration, to a thousandth, within the limits, with a reserve of acceleration."""
    limits = [replace(limit, acceleration_max=_RESERVE * limit.acceleration_max) for limit in limits]
    time = least(lambda time: first_violation(in_time(time), limits) is None, shortest, DURATION_MAX)
    if time is None:
        raise TrajectoryError(f"no duration is long enough: {first_violation(in_time(DURATION_MAX), limits)}")
    return in_time(time)


def _check_positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise TrajectoryError(f"{name} is {value:g} {unit}; write a finite number above 0")
