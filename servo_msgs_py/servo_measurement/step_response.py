"""Figures of the response to a step or a move, from samples of set-point and measured value in any unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Series = NDArray[np.float64]

_RISE: tuple[float, float] = (0.1, 0.9)
"""Parts of the distance between which the rise time is measured."""


@dataclass(frozen=True)
class StepFigures:
    """Figures of one step or move, in the unit of the value."""

    commanded: float  # set-point at the end
    reached: float  # mean value at the end
    error: float  # `reached` minus `commanded`
    rise_time: float | None  # from 10 to 90 % of the distance [s]; None: not reached, or no distance
    settling_time: float | None  # until the value stays within the tolerance [s]; None: never
    overshoot: float  # largest one in the direction of the step; not negative
    lag: float | None  # mean delay behind the set-point [s]; None: no set-point, no distance, or not settled
    tracking_rms: float | None  # value minus set-point; None: no set-point
    tracking_max: float | None  # largest magnitude of that difference; None: no set-point
    arrived: bool  # the value stayed in the tolerance for the last `hold` seconds


def settling_time(time: Series, error: Series, tolerance: float) -> float | None:
    """First time from which the error stays within the tolerance.

    Parameters
    ----------
    time : (samples,) array
        Rising times [s].
    error : (samples,) array
        Deviation from the target.
    tolerance : float
        In the unit of `error`, inclusive.

    Returns
    -------
    float or None
        None if the last sample is outside.
    """
    outside = np.flatnonzero(np.abs(error) > tolerance)
    if outside.size == 0:
        return float(time[0])
    last = int(outside[-1])
    return None if last + 1 == len(time) else float(time[last + 1])


def overshoot(value: Series, target: float) -> float:
    """Largest distance beyond a target in the direction from the first value; without a distance: of any sign.

    Parameters
    ----------
    value : (samples,) array
        In the unit of `target`.
    target : float
        Final set-point.
    """
    error = value - target
    direction = np.sign(target - value[0])
    return max(0.0, float(np.max(error * direction)) if direction else float(np.max(np.abs(error))))


def rms(values: Series) -> float:
    """Root mean square, in the unit of `values`, shape (samples,)."""
    return float(np.sqrt(np.mean(np.square(values))))


def measure_step(
    time: Series,
    value: Series,
    target: float,
    tolerance: float,
    *,
    reference: Series | None = None,
    hold: float = 0.1,
) -> StepFigures:
    """Compute the figures from the samples after a set-point took effect.

    The lag is the area between set-point and value over the distance. For a linear loop without steady-state error it
    is the delay of slow signals, whatever the shape of the set-point: the sum of dead time and time constants.

    Parameters
    ----------
    time : (samples,) array
        Time since the set-point took effect [s]; rising, at least two samples.
    value : (samples,) array
        Measured value.
    target : float
        Final set-point.
    tolerance : float
        Half width of the band that counts as reached.
    reference : (samples,) array, optional
        Set-point at these times.
    hold : float
        Duration of the last part: averaged, and checked against the band [s].

    Raises
    ------
    ValueError
        If there are fewer than two samples or lengths differ.
    """
    if len(time) < 2 or len(value) != len(time) or (reference is not None and len(reference) != len(time)):
        raise ValueError("at least two samples and series of equal length are needed")
    error = value - target
    last = time >= time[-1] - hold
    reached = float(np.mean(value[last]))
    settling = settling_time(time, error, tolerance)
    difference = None if reference is None else value - reference
    return StepFigures(
        commanded=target,
        reached=reached,
        error=reached - target,
        rise_time=_rise_time(time, value, target, tolerance),
        settling_time=settling,
        overshoot=overshoot(value, target),
        lag=None if reference is None or settling is None else _lag(time, value, reference, tolerance),
        tracking_rms=None if difference is None else rms(difference),
        tracking_max=None if difference is None else float(np.max(np.abs(difference))),
        arrived=bool(np.all(np.abs(error[last]) <= tolerance)),
    )


def _rise_time(time: Series, value: Series, target: float, tolerance: float) -> float | None:
    distance = target - value[0]
    if abs(distance) <= tolerance:
        return None
    done = (value - value[0]) / distance
    crossings = []
    for part in _RISE:
        beyond = np.flatnonzero(done >= part)
        if not beyond.size:
            return None
        k = int(beyond[0])  # not the first sample, where nothing is done
        crossings.append(float(np.interp(part, done[k - 1 : k + 1], time[k - 1 : k + 1])))
    return crossings[1] - crossings[0]


def _lag(time: Series, value: Series, reference: Series, tolerance: float) -> float | None:
    distance = reference[-1] - value[0]
    if abs(distance) <= tolerance:
        return None
    return float(np.sum(np.diff(time) * (reference - value)[1:])) / float(distance)
