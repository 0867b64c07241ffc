"""Residual (real minus twin) and its supervision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.joints import DEFAULT_JOINTS, Joint, joint_names
from servo_msgs_py.units import PERIOD_NS

COMPARED: Final = tuple(f"{axis_name(axis)}.{name}" for axis in range(AXES) for name in ("position", "speed", "i_q"))
"""Variables of the residual; position and speed are compared in joint units."""

_FIRST_MAX: Final = 0.005  # longest time that the first sample with a large residual counts [s]
_DECAY: Final = 0.25  # rate at which the time of a large residual decreases while the residual is small [s/s]


@dataclass(frozen=True)
class Residual:
    """Real minus twin at one tick."""

    tick: int  # PWM periods since reset of the real board
    joints: Sequence[str]  # names in the order of the axes
    values: Mapping[str, float]
    """Difference by variable of `COMPARED`; position [rad] and speed [rad/s] of the joint, i_q of the motor [A]."""
    position: tuple[float, ...]  # per joint [rad]
    velocity: tuple[float, ...]  # per joint [rad/s]
    effort: tuple[float, ...]  # per joint [N m]


def residual(
    tick: int,
    real: Mapping[str, float],
    twin: Mapping[str, float],
    torque_constants: Sequence[float],
    joints: Sequence[Joint] = DEFAULT_JOINTS,
) -> Residual:
    """Residual of two samples; both must contain the variables of `COMPARED`, SI.

    Parameters
    ----------
    tick : int
        Tick of both samples.
    real, twin : mapping
        SI values by variable name.
    torque_constants : sequence of float
        Torque constants of the motors, per axis [N m/A].
    joints : sequence of Joint
        In the order of the axes.
    """
    axes = [axis_name(axis) for axis in range(AXES)]
    values = {name: real[name] - twin[name] for name in COMPARED}
    for axis, joint in zip(axes, joints, strict=True):
        # The offset of the joint cancels.
        for name in (f"{axis}.position", f"{axis}.speed"):
            values[name] = joint.velocity(values[name])
    return Residual(
        tick,
        joint_names(joints),
        values,
        tuple(values[f"{axis}.position"] for axis in axes),
        tuple(values[f"{axis}.speed"] for axis in axes),
        tuple(
            joint.effort(k * values[f"{axis}.i_q"])
            for k, axis, joint in zip(torque_constants, axes, joints, strict=True)
        ),
    )


@dataclass(frozen=True)
class Thresholds:
    """Limits of a small residual, in joint units."""

    position: float = 0.05  # largest difference of a position [rad]
    velocity: float = 10.0  # largest difference of a speed [rad/s]
    effort: float = 0.05  # largest difference of a torque [N m]
    hold: float = 0.5  # time of a small residual until the twin is healthy [s]
    grace: float = 0.1  # time of a large residual until the twin is unhealthy [s]; decays with `_DECAY`


class HealthMonitor:
    """Supervises the residual: `healthy` is true while twin and board agree.

    Parameters
    ----------
    thresholds : Thresholds
        Limits and times.
    """

    def __init__(self, thresholds: Thresholds) -> None:
        self.thresholds = thresholds
        self.healthy = False  # real board and twin agree
        self.reason = "no comparison yet"  # why the twin is not healthy; empty: healthy
        self._small_since: int | None = None
        self._large = 0.0  # time of a large residual, decreasing with `_DECAY` while it is small [s]
        self._tick: int | None = None
        self._was_large = self._differs = False

    @property
    def differs(self) -> bool:
        """True if the twin is not healthy because of a difference."""
        return not self.healthy and self._differs

    def interrupt(self, reason: str) -> None:
        """Interrupt the comparison, for this reason."""
        self.healthy = False
        self.reason = reason
        self._small_since = self._tick = None
        self._large, self._was_large, self._differs = 0.0, False, False

    def update(self, residual: Residual, stopping: Sequence[bool] = (False,) * AXES, finding: str = "") -> bool:
        """Evaluate a residual; returns `healthy`.

        Parameters
        ----------
        residual : Residual
            Real minus twin.
        stopping : sequence of bool
            Axes in an autonomous stop: positions are ignored, speeds are not.
        finding : str
            Finding of the diagnosis, effective immediately; empty: none.
        """
        seconds = 0.0 if self._tick is None else _seconds(residual.tick - self._tick)
        self._tick = residual.tick
        problem = self._problem(residual, stopping)
        if problem:
            self._large += seconds if self._was_large else min(seconds, _FIRST_MAX)
        else:
            self._large = max(self._large - _DECAY * seconds, 0.0)
        self._was_large, self._differs = bool(problem), bool(problem or finding)
        if problem or finding:
            self._small_since = None
            if finding or not self.healthy or self._large >= self.thresholds.grace:
                self.healthy, self.reason = False, finding or problem
        else:
            if self._small_since is None:
                self._small_since = residual.tick
            if _seconds(residual.tick - self._small_since) >= self.thresholds.hold:
                self.healthy, self.reason = True, ""
            elif not self.healthy:
                self.reason = f"residual small for less than {self.thresholds.hold:g} s"
        return self.healthy

    def _problem(self, residual: Residual, stopping: Sequence[bool]) -> str:
        limits = self.thresholds
        for name, unit, values, limit in (
            ("position", "rad", residual.position, limits.position),
            ("velocity", "rad/s", residual.velocity, limits.velocity),
            ("effort", "N m", residual.effort, limits.effort),
        ):
            for axis, value in enumerate(values):
                if abs(value) > limit and not (name == "position" and stopping[axis]):
                    return f"{residual.joints[axis]}: {name} differs by {value:+.3g} {unit}, limit {limit:g}"
        return ""


def _seconds(ticks: int) -> float:
    return ticks * (PERIOD_NS * 1e-9)
