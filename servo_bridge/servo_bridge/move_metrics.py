"""Figures of a move from recorded telemetry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Series = NDArray[np.float64]


@dataclass(frozen=True)
class MoveFigures:
    """Figures of one axis in one move."""

    commanded: float  # set-point at the end [rad]
    reached: float  # mean position at the end [rad]
    error: float  # `reached` minus `commanded` [rad]
    settling_time: float | None  # from the effect of the set-point until the position settles [s]; None: never
    overshoot: float  # largest overshoot in the direction of the move [rad]; not negative
    tracking_rms: float | None  # position minus shaped set-point over the move [rad]; None: no shaped set-point
    tracking_max: float | None  # largest magnitude of that difference [rad]; None: no shaped set-point
    arrived: bool  # the position stayed in the tolerance for the last `hold` seconds


def settling_time(time: Series, error: Series, tolerance: float) -> float | None:
    """First time after which the error stays within the tolerance.

    Parameters
    ----------
    time : array
        Rising times [s].
    error : array
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


def rms(values: Series) -> float:
    """Root mean square, in the unit of `values`, shape (samples,)."""
    return float(np.sqrt(np.mean(np.square(values))))


def measure_move(
    time: Series,
    position: Series,
    target: float,
    tolerance: float,
    *,
    reference: Series | None = None,
    hold: float = 0.1,
) -> MoveFigures:
    """Compute the figures of a move from the samples after its set-point took effect.

    Parameters
    ----------
    time : array
        Time since the set-point took effect [s]; rising, at least two samples.
    position : array
        Measured position [rad].
    target : float
        Set-point [rad].
    tolerance : float
        Half width of the band that counts as reached [rad].
    reference : array, optional
        Shaped set-point [rad].
    hold : float
        Duration of the last part: averaged, and checked against the band [s].

    Raises
    ------
    ValueError
        If there are fewer than two samples or lengths differ.
    """
    if len(time) < 2 or len(position) != len(time) or (reference is not None and len(reference) != len(time)):
        raise ValueError("at least two samples and series of equal length are needed")
    error = position - target
    last = time >= time[-1] - hold
    reached = float(np.mean(position[last]))
    direction = np.sign(target - position[0])
    # Without a distance every deviation counts as overshoot.
    beyond = float(np.max(error * direction)) if direction else float(np.max(np.abs(error)))
    lag = None if reference is None else position - reference
    return MoveFigures(
        commanded=target,
        reached=reached,
        error=reached - target,
        settling_time=settling_time(time, error, tolerance),
        overshoot=max(0.0, beyond),
        tracking_rms=None if lag is None else rms(lag),
        tracking_max=None if lag is None else float(np.max(np.abs(lag))),
        arrived=bool(np.all(np.abs(error[last]) <= tolerance)),
    )
