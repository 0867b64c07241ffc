"""Motion of several joints: polynomials of at most fifth degree between common breakpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from servo_bridge.trajectory.errors import TrajectoryError
from servo_bridge.trajectory.waypoints import Array

DEGREE = 5
_HOLD = 1.0e-3
"""Duration of a path that only holds [s]: the shortest segment of the board."""


@dataclass(frozen=True, eq=False)
class State:
    """State of several joints at one or several times."""

    position: Array  # (..., joints) [rad]
    velocity: Array  # (..., joints) [rad/s]
    acceleration: Array  # (..., joints) [rad/s^2]
    effort: Array  # (..., joints), torque added to that of the controller [N m]

    @classmethod
    def at_rest(cls, position: ArrayLike) -> State:
        """State at rest at a position [rad] of any shape."""
        position_ = np.array(position, dtype=np.float64)
        zero = np.zeros_like(position_)
        return cls(position_, zero, zero, zero)


class Path:
    """Piecewise polynomials of several joints.

    Times are seconds from an origin chosen by the caller, which should be recent, such as the start of the program:
    times since 1970 have a resolution of 0.2 us only.

    Parameters
    ----------
    joints : sequence of str
        Names.
    times : (n + 1,) array_like
        Breakpoints, strictly increasing, n >= 1 [s].
    coefficients : (n, joints, 6) array_like
        Position as powers of the time since the begin of a piece, constant term first [rad/s^k].
    end : (joints,) array_like
        Position at the end [rad]: exact, whereas the last polynomial has rounding errors.
    efforts : (n + 1, joints) array_like, optional
        Torque at the breakpoints, linear between them [N m].

    Raises
    ------
    TrajectoryError
        If shapes do not match, a number is not finite, or times do not increase.
    """

    def __init__(
        self,
        joints: Sequence[str],
        times: ArrayLike,
        coefficients: ArrayLike,
        end: ArrayLike,
        efforts: ArrayLike | None = None,
    ) -> None:
        self.joints = tuple(joints)
        self.times = np.array(times, dtype=np.float64)
        self.coefficients = np.array(coefficients, dtype=np.float64)
        self.end = np.array(end, dtype=np.float64)
        knots, axes = len(self.times), len(self.joints)
        self.efforts = np.zeros((knots, axes)) if efforts is None else np.array(efforts, dtype=np.float64)
        shapes = (self.coefficients.shape, self.end.shape, self.efforts.shape)
        if knots < 2 or shapes != ((knots - 1, axes, DEGREE + 1), (axes,), (knots, axes)):
            raise TrajectoryError(f"a path of {axes} joints and {knots} breakpoints cannot have arrays of {shapes}")
        for array in (self.times, self.coefficients, self.end, self.efforts):
            if not np.isfinite(array).all():
                raise TrajectoryError("a path has a number that is not finite; use finite waypoints")
            array.setflags(write=False)
        if (np.diff(self.times) <= 0.0).any():
            raise TrajectoryError("breakpoints of a path do not increase strictly")

    @classmethod
    def hold(cls, joints: Sequence[str], position: ArrayLike, time: float = 0.0, until: float | None = None) -> Path:
        """Path that holds a position [rad] from `time` [s]."""
        fixed = np.array(position, dtype=np.float64)
        coefficients = np.zeros((1, len(joints), DEGREE + 1))
        coefficients[0, :, 0] = fixed
        return cls(joints, [time, time + _HOLD if until is None else until], coefficients, fixed)

    @property
    def start_time(self) -> float:
        """First breakpoint [s]."""
        return float(self.times[0])

    @property
    def end_time(self) -> float:
        """Last breakpoint [s]."""
        return float(self.times[-1])

    @property
    def duration(self) -> float:
        """Time from the first breakpoint to the last [s]."""
        return self.end_time - self.start_time

    def state(self, t: ArrayLike) -> State:
        """State at any time; before the start and after the end the path holds.

        Parameters
        ----------
        t : (...) array_like
            Times [s].

        Returns
        -------
        State
            Arrays of shape (..., joints). The acceleration at a breakpoint is that of the following piece.
        """
        time = np.asarray(t, dtype=np.float64)
        state = self.continued(np.clip(time, self.start_time, self.end_time))
        outside = ((time < self.start_time) | (time > self.end_time))[..., None]
        held = [np.where(outside, 0.0, x) for x in (state.velocity, state.acceleration)]
        return State(state.position, held[0], held[1], state.effort)

    def continued(self, t: ArrayLike) -> State:
        """State at any time [s]; the first and last piece are extrapolated.

        Used for times that rounding has moved out of the path by less than a PWM period.
        """
        time = np.asarray(t, dtype=np.float64)
        last = len(self.times) - 2
        piece = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, last)
        begin = self.times[piece]
        length = self.times[piece + 1] - begin
        s = (time - begin)[..., None]
        c = np.moveaxis(self.coefficients[piece], -1, 0)
        position, velocity, acceleration = c[DEGREE], DEGREE * c[DEGREE], DEGREE * (DEGREE - 1) * c[DEGREE]
        for k in range(DEGREE - 1, -1, -1):
            position = position * s + c[k]
            if k >= 1:
                velocity = velocity * s + k * c[k]
            if k >= 2:
                acceleration = acceleration * s + k * (k - 1) * c[k]
        position = np.where((time == self.end_time)[..., None], self.end, position)
        share = np.clip((time - begin) / length, 0.0, 1.0)[..., None]
        effort = self.efforts[piece] * (1.0 - share) + self.efforts[piece + 1] * share
        return State(position, velocity, acceleration, effort)

    def select(self, joints: Sequence[str]) -> Path:
        """Path of some of the joints, in the order given."""
        columns = [self.joints.index(joint) for joint in joints]
        return Path(joints, self.times, self.coefficients[:, columns], self.end[columns], self.efforts[:, columns])

    def shifted(self, by: float) -> Path:
        """Path shifted by a time [s]."""
        return Path(self.joints, self.times + by, self.coefficients, self.end, self.efforts)

    def in_time(self, duration: float) -> Path:
        """Path over the same positions, from the same start, in another duration [s]: all speeds change alike."""
        factor = duration / self.duration
        times = self.start_time + factor * (self.times - self.start_time)
        return Path(self.joints, times, self.coefficients / factor ** np.arange(DEGREE + 1), self.end, self.efforts)
