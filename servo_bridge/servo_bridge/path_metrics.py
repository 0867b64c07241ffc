"""How well a path was followed: pure measurement on recorded telemetry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD_NS

from servo_bridge.move_metrics import rms
from servo_bridge.trajectory.path import Path

Series = NDArray[np.float64]

_STEPS: Final = 12  # of Newton's method; it converges from a quarter of a period away
_PERIOD: Final = PERIOD_NS * 1e-9


@dataclass(frozen=True)
class PathFigures:
    """Figures of all joints on one path."""

    duration: float  # of the path [s]
    start: float  # of the path in the set-points of the board, in the time of the samples [s]
    ticks_apart: int  # largest difference of the ticks at which the joints began [PWM periods]
    error_rms: tuple[float, ...]  # measured position minus path, at the ticks of the samples, per joint [rad]
    error_max: tuple[float, ...]  # largest magnitude of the same, per joint [rad]
    end_error: tuple[float, ...]  # mean of the same over what was recorded after the end, per joint [rad]


def measure_path(time: Series, position: Series, reference: Series, path: Path, guess: float) -> PathFigures:
    """Compare what joints did with the path that they were to follow.

    Parameters
    ----------
    time : (samples,) array
        Rising, the whole path and some of the rest after it [s].
    position, reference : (samples, joints) array
        Measured position and set-point of the board [rad].
    path : Path
        Motion.
    guess : float
        When it began, to a quarter of the shortest period of the motion, in the time of the samples [s].

    Raises
    ------
    ValueError
        If the samples end before the path, or shapes do not fit.
    """
    shape = len(time), len(path.joints)
    if position.shape != shape or reference.shape != shape:
        raise ValueError(f"positions of shape {position.shape}, set-points of {reference.shape}; {shape} are needed")
    starts = [_start(time, reference[:, k], path.select([joint]), guess) for k, joint in enumerate(path.joints)]
    start = float(np.mean(starts))
    if not time[0] <= start < start + path.duration < time[-1]:
        raise ValueError(f"samples from {time[0]:g} s to {time[-1]:g} s do not hold a path from {start:g} s on")
    error = position - path.state(time - start + path.start_time).position
    on_path = (time >= start) & (time <= start + path.duration)
    return PathFigures(
        duration=path.duration,
        start=start,
        ticks_apart=round((max(starts) - min(starts)) / _PERIOD),
        error_rms=tuple(rms(joint) for joint in error[on_path].T),
        error_max=tuple(float(x) for x in np.abs(error[on_path]).max(axis=0)),
        end_error=tuple(float(x) for x in error[time > start + path.duration].mean(axis=0)),
    )


def _start(time: Series, reference: Series, path: Path, guess: float) -> float:
    """When a joint began its path: the delay for which its set-points fit best, by least squares.

    Set-points are whole counts; over some hundred samples the delay is known to a fraction of a PWM period.
    """
    start = guess
    for _ in range(_STEPS):
        state = path.state(time - start + path.start_time)
        velocity = state.velocity[:, 0]
        step = float(np.sum((reference - state.position[:, 0]) * velocity) / np.sum(velocity**2))
        start -= step
        if abs(step) < 1e-3 * _PERIOD:
            break
    return start
