"""Measurement of the torque ripple of an axis by turns at a constant speed in both directions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_tuning.torque_ripple import fragment

from servo_measurement.access import BoardAccess, Capture, MeasurementError
from servo_measurement.bode_plan import LINE, free_travel, refuse_without_encoder
from servo_measurement.prediction import Prediction, predict
from servo_measurement.ripple_fit import ORDER_MAX, TURN, Complexes, Measured, significant, turn_ripple
from servo_measurement.running_axis import SETTLE, RunningAxis

TURNS: Final = 8
"""Recorded turns in each direction."""

_COLUMNS: Final = ("position", "speed", "i_q")
_RECORDED: Final = 1.15  # turns per recording: the mean speed of one turn differs from its set-point
_EVERY: Final = 2  # slow ticks per sample at the default speed
_SAMPLES_MIN: Final = 3.0  # per period of the highest order
_TIME_MAX: Final = 30.0  # longest recording [s]
_SPEED_PART: Final = 0.5  # of the speed limit: highest speed, because the ripple exceeds the set-point


@dataclass(frozen=True)
class RippleRequest:
    """Specification of a measurement."""

    axis: int  # index
    speed: float | None = None  # of the shaft [rad/s]; None: so that a recording holds a turn


@dataclass(frozen=True)
class Ripple:
    """Measured torque ripple."""

    axis: int  # index
    speed: float  # of the shaft [rad/s]
    torque_constant: float  # [N m/A]
    harmonics: tuple[Measured, ...]  # significant, by order

    def text(self) -> str:
        """Table of the harmonics."""
        name = axis_name(self.axis)
        head = f"{name}: {TURNS} turns in each direction at {self.speed:.3g} rad/s, orders 1 .. {ORDER_MAX}"
        if not self.harmonics:
            return f"{head}\n  no significant harmonic"
        lines = [head, f"  {'order':>5}  {'torque [N m]':<22}{'current [A]':<22}phase [rad]"]
        for one in self.harmonics:
            torque, error = one.harmonic.amplitude, one.amplitude
            constant = self.torque_constant
            lines.append(
                f"  {one.harmonic.order:>5}  {f'{torque:.5f} +- {error:.5f}':<22}"
                f"{f'{torque / constant:.4f} +- {error / constant:.4f}':<22}"
                f"{one.harmonic.phase:.3f} +- {one.phase:.3f}"
            )
        return "\n".join([*lines, "  +- is for 95 %"])

    def toml(self) -> str:
        """The group of ``servo.toml``."""
        return fragment(axis_name(self.axis), [one.harmonic for one in self.harmonics])


@dataclass(frozen=True)
class _Plan:
    """Recordings of one measurement."""

    speed: float  # [rad/s]
    every: int  # slow ticks per sample
    samples: int  # per recording
    travel: float  # longest way of a run [rad]


def measure(
    access: BoardAccess,
    request: RippleRequest,
    *,
    enable: bool = False,
    report: Callable[[str], None] = lambda _: None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Ripple:
    """Measure the torque ripple of a homed axis.

    Parameters
    ----------
    access : BoardAccess
        The board.
    request : RippleRequest
        Specification of the measurement.
    enable : bool
        Enable the axis if it is not enabled, and disable it afterwards.
    report : callable
        Called with a sentence about the motion before it begins.
    progress : callable
        Called with the current step, the number of completed turns and their total number.

    Raises
    ------
    MeasurementError
        If the measurement is not possible.
    """
    rig = _RippleRig(access, request.axis, report)
    rig.refuse_unknown_angle()
    plan = rig.plan(request.speed)
    prediction = predict(access, request.axis, "speed", plan.speed)
    if prediction.observed:
        raise MeasurementError(
            f"the speed of {rig.name} is that of the observer, which does not know the torque ripple: switch off the "
            "feature SPEED_OBSERVER (param.features) for the measurement"
        )
    report(
        f"{rig.name} makes {2 * TURNS} runs of up to {plan.travel:.3g} rad at {plan.speed:.3g} rad/s in alternating "
        "directions; Ctrl-C stops it"
    )
    turns: tuple[list[Complexes], list[Complexes]] = ([], [])
    with rig.prepared(enable):
        for run in range(2 * TURNS):
            progress("torque ripple", run, 2 * TURNS)
            backward = run % 2
            turns[backward].append(_evaluated(rig.recorded(plan, -1.0 if backward else 1.0), rig.name, prediction))
    progress("done", 2 * TURNS, 2 * TURNS)
    return Ripple(request.axis, plan.speed, prediction.loops.motor.torque_constant, tuple(significant(*turns)))


def _evaluated(recording: Trace, name: str, prediction: Prediction) -> Complexes:
    """Torque ripple of a recording; the first whole turn of it."""
    position, speed, i_q = (recording[f"{name}.{column}"] for column in _COLUMNS)
    motor, delay = prediction.loops.motor, prediction.delay
    assert delay is not None  # neither observed nor at standstill
    try:
        return turn_ripple(recording.time, position, speed, motor.torque_constant * i_q, motor.inertia, delay)
    except ValueError as error:
        raise MeasurementError(
            f"{name} did not run at its speed, {error}: use another --speed, or remove the load"
        ) from None


class _RippleRig(RunningAxis):
    """The axis, turning at a constant speed."""

    def refuse_unknown_angle(self) -> None:
        """Refuse an axis whose position is not known."""
        refuse_without_encoder(self.access, self.axis)
        state = self.label("home_state")
        if state != "KNOWN":
            raise MeasurementError(
                f"the angle of {self.name} is not known, its home state is {state}: home the axis first, with "
                f"cmd.home[{self.axis}] or `servo-command home`; the harmonics refer to its home position"
            )

    def plan(self, speed: float | None) -> _Plan:
        """Recordings at a speed [rad/s] within the limits of the axis."""
        capacity = self.access.capacity([f"{self.name}.{column}" for column in _COLUMNS])
        limit = _SPEED_PART * self.access.read("param.speed_limit")[self.axis]
        fastest = TURN / (_SAMPLES_MIN * ORDER_MAX * TICK)
        if speed is None:
            speed = min(_RECORDED * TURN / (capacity * _EVERY * TICK), limit)
        elif speed > min(limit, fastest):
            reason = "half of param.speed_limit" if limit < fastest else "samples per turn"
            raise MeasurementError(
                f"{self.name} cannot be measured at {speed:.3g} rad/s: use at most {min(limit, fastest):.3g} ({reason})"
            )
        elif speed * _TIME_MAX < _RECORDED * TURN:
            raise MeasurementError(
                f"at {speed:.3g} rad/s a run of {self.name} takes more than {_TIME_MAX:g} s: use at least "
                f"{_RECORDED * TURN / _TIME_MAX + 0.005:.2f}"
            )
        every = math.ceil(_RECORDED * TURN / (speed * capacity * TICK) - 1e-9)
        samples = min(math.ceil(_RECORDED * TURN / (speed * every * TICK)), capacity)
        deceleration = self.access.read("param.acceleration_limit")[self.axis]
        travel = speed * (SETTLE + LINE + samples * every * TICK) + 0.5 * speed**2 / deceleration
        free = free_travel(self.access, self.axis)
        if travel > free:
            raise MeasurementError(
                f"{self.name} needs {travel:.3g} rad in each direction, the nearer soft limit is {free:.3g} rad away: "
                "move it to the middle of param.position_min and param.position_max, or widen them"
            )
        return _Plan(speed, every, samples, travel)

    def recorded(self, plan: _Plan, direction: float) -> Trace:
        """A recording at constant speed; the shaft is held before the samples are read."""
        self.mode("SPEED")
        self.command("cmd.speed", direction * plan.speed)
        self.settle()
        running = True

        def meanwhile(full: bool) -> None:
            nonlocal running
            if running:
                self.refuse_limits()
            if running and full:
                running = False
                self.hold()

        return self.record(Capture(_COLUMNS, plan.samples, plan.every, slow=True, meanwhile=meanwhile))
