"""Figures of a followed path from recorded telemetry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_measurement.step_response import rms
from servo_msgs_py.units import PERIOD

from servo_bridge.trajectory.path import Path

Series = NDArray[np.float64]

_STEPS: Final = 12  # of the Gauss-Newton method; it converges from an error of up to a quarter of a period
_TRIED: Final = (
    4.0  # tried begins per time in which the fastest motion covers the range of the path: 12 per period of a sine
)
_REFERENCE_ERROR: Final = 0.01  # between the path and the set-points of a board that has received all points [rad]


@dataclass(frozen=True)
class PathFigures:
    """Figures of all joints on one path."""

    duration: float  # of the path [s]
    start: float  # begin of the path in the set-points of the board, in the time of the samples [s]
    ticks_apart: int  # largest difference between the start ticks of the joints [PWM periods]
    error_rms: tuple[float, ...]  # RMS of measured position minus path, per joint [rad]
    error_max: tuple[float, ...]  # largest magnitude of that error, per joint [rad]
    end_error: tuple[float, ...]  # mean of that error after the end of the path, per joint [rad]


def measure_path(time: Series, position: Series, reference: Series, path: Path) -> PathFigures:
    """Compare recorded positions with the commanded path.

    Parameters
    ----------
    time : (samples,) array
        Rising times of the whole path and some time after it [s].
    position, reference : (samples, joints) array
        Measured position and set-point of the board [rad].
    path : Path
        Commanded path.

    Raises
    ------
    ValueError
        If the samples end before the path, its set-points have not reached the board, or shapes do not fit.
    """
    shape = len(time), len(path.joints)
    if position.shape != shape or reference.shape != shape:
        raise ValueError(f"positions of shape {position.shape}, set-points of {reference.shape}; required {shape}")
    if time[-1] - time[0] <= path.duration:
        raise ValueError(f"samples from {time[0]:g} s to {time[-1]:g} s do not contain a path of {path.duration:g} s")
    starts = [_start(time, reference[:, k], path.select([joint])) for k, joint in enumerate(path.joints)]
    start = float(np.mean(starts))
    if not time[0] <= start < start + path.duration < time[-1]:
        raise ValueError(f"samples from {time[0]:g} s to {time[-1]:g} s do not contain the path from {start:g} s")
    for k, (joint, own) in enumerate(zip(path.joints, starts, strict=True)):
        expected = path.select([joint]).state(time - own + path.start_time).position[:, 0]
        left = float(np.abs(reference[:, k] - expected).max())
        if left > _REFERENCE_ERROR:
            raise ValueError(f"the set-points of {joint} left the path by {left:.3g} rad")
    error = position - path.state(time - start + path.start_time).position
    on_path = (time >= start) & (time <= start + path.duration)
    return PathFigures(
        duration=path.duration,
        start=start,
        ticks_apart=round((max(starts) - min(starts)) / PERIOD),
        error_rms=tuple(rms(joint) for joint in error[on_path].T),
        error_max=tuple(float(x) for x in np.abs(error[on_path]).max(axis=0)),
        end_error=tuple(float(x) for x in error[time > start + path.duration].mean(axis=0)),
    )


def _start(time: Series, reference: Series, path: Path) -> float:
    """Begin of the path of a joint: least-squares fit of the delay of its set-points.

    The first estimate is the best one of a search over all delays that the samples permit: on a busy computer the begin
    cannot be predicted. Set-points are whole counts; some hundred samples give the delay to a fraction of a PWM period.
    """

    def difference(start: float) -> float:
        return float(np.sum((reference - path.state(time - start + path.start_time).position[:, 0]) ** 2))

    whole = path.state(time - time[0] + path.start_time)
    spacing = np.ptp(whole.position) / np.abs(whole.velocity).max() / _TRIED
    start = min(np.arange(time[0], time[-1] - path.duration + spacing, spacing), key=difference)
    for _ in range(_STEPS):
        state = path.state(time - start + path.start_time)
        velocity = state.velocity[:, 0]
        step = float(np.sum((reference - state.position[:, 0]) * velocity) / np.sum(velocity**2))
        start -= step
        if abs(step) < 1e-3 * PERIOD:
            break
    return float(start)
