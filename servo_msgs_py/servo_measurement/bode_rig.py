"""Motion of an axis during an open-loop measurement: start, supervision, restoration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

from servo_msgs_py.timed_points import POINTS_MEASURING, TimedPoint, encode_points
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS

from servo_measurement.access import OSCILLATION, BoardAccess, Capture, MeasurementError
from servo_measurement.axis_under_test import HELD_SPEED, POLL_TIME
from servo_measurement.bode_plan import BASE_PART, GAIN_MIN, Band, Settings
from servo_measurement.running_axis import RunningAxis
from servo_measurement.test_signal import TRIGGER, start_test_signal

_STILL_TIME: Final = 5.0  # timeout for the decay of rotor oscillations [s]
_STILL_READS: Final = 10
_SPEED_TOLERANCE: Final = 0.1  # of the constant speed
_LEAD_TIME: Final = 0.25  # lead of trajectory points, sufficient for a slow line [s]
_RAMP: Final = 0.3  # longest acceleration time in a trajectory [s]
_TICKS_TIME: Final = (1 << 32) * PERIOD_NS * 1e-9  # period of the wrapping board time [s]


class BodeRig(RunningAxis):
    """The axis of the measured loop.

    Parameters
    ----------
    access : BoardAccess
        The board.
    settings : Settings
        Settings of the measurement.
    report : callable
        Called with a sentence.
    """

    def __init__(self, access: BoardAccess, settings: Settings, report: Callable[[str], None]) -> None:
        super().__init__(access, settings.axis, report)
        self._settings = settings

    def recorded(self, band: Band, speed: float, columns: Sequence[str] | None = None) -> Trace:
        """Record one sweep, in motion or at standstill; the shaft rotates until the recorder memory is full.

        Parameters
        ----------
        band : Band
            Frequencies of the sweep.
        speed : float
            Constant speed during the recording [rad/s].
        columns : sequence of str, optional
            Variables of the axis instead of those of the loop.
        """
        settings, loop = self._settings, self._settings.loop
        begun: tuple[float, float] | None = None

        def start() -> None:
            nonlocal begun
            if loop.name == "speed":
                self.mode("SPEED")
                self.command("cmd.speed", speed)
                self.settle()
            elif speed:
                self._run_at_speed(speed, band.rotation_seconds)
                self.settle()
            begun = self._position_and_time()
            self.renew()
            start_test_signal(self.access, self.axis, loop.point)

        def meanwhile(full: bool) -> None:
            nonlocal begun
            if begun is None:
                return
            self.refuse_limits()
            if not loop.slow:
                return
            self._refuse_reduced_gains()
            here = self._position_and_time()
            if full:
                self._refuse_motion(begun, here, speed)
                begun = None
                self.hold()
            elif abs(here[0] - begun[0]) > settings.travel_per_recording(band):
                raise MeasurementError(f"{self.name} has rotated too far during the recording")

        if loop.slow:
            self.hold()
        else:
            self.release()  # after its expiry a current still holds the rotor
            self.command("cmd.i_q", BASE_PART * self.access.read("param.i_q_limit")[self.axis])
            self._wait_for_standstill()
        names = settings.columns if columns is None else columns
        return self.record(Capture(names, band.samples, band.every, loop.slow, start, TRIGGER, meanwhile=meanwhile))

    def _refuse_reduced_gains(self) -> None:
        """Raise an error if the board may have reduced the gains because of an oscillation."""
        if not self.is_limited("OSCILLATION"):
            return
        remedies = []
        if (part := 0.125 * self._settings.gain) >= GAIN_MIN:
            remedies.append(f"measure with a part of them (--gain {part:g})")
        if self._settings.gain == 1.0:
            remedies.append(f"measure the load (servo-tool resonance {self.name})")
        remedies.append("if cogging forces it, remove OSCILLATION from param.faults_enabled for the measurement")
        raise MeasurementError(
            f"{self.name} oscillates at {self.value('oscillation'):.0f} Hz, and the board reduces its gains: "
            f"{', or '.join(remedies)}",
            about=OSCILLATION,
        )

    def _wait_for_standstill(self) -> None:
        """Wait for the decay of oscillations of a rotor held by a current."""
        count = self.access.catalogue[f"{self.name}.position"].lsb
        for _ in range(math.ceil(_STILL_TIME / (_STILL_READS * POLL_TIME))):
            positions = []
            for _ in range(_STILL_READS):
                self.wait(POLL_TIME)
                positions.append(self.value("position"))
            if max(positions) - min(positions) < 1.5 * count:
                return
        raise MeasurementError(
            f"{self.name} still oscillates after {_STILL_TIME:g} s; remove external torques from the shaft"
        )

    def _position_and_time(self) -> tuple[float, float]:
        """Position [rad] and board time [s]."""
        return self.value("position"), self.access.read("tick")[0] * PERIOD_NS * 1e-9

    def _run_at_speed(self, speed: float, seconds: float) -> None:
        """Run at a constant speed under position control for a time [s], then hold."""
        acceleration = 0.5 * self.access.read("param.acceleration_limit")[self.axis]
        ramp = max(0.01, min(1.5 * abs(speed) / acceleration, _RAMP))
        place = self.value("position_ref")
        begun, tick = self.access.clock(), int(self.access.read("tick")[0])
        path = ((_LEAD_TIME, 0.0, 0.0), (ramp, 0.5 * ramp * speed, speed), (seconds, seconds * speed, speed))
        points = []
        for duration, travel, velocity in (*path, (ramp, 0.5 * ramp * speed, 0.0)):
            tick += round(duration * 1e9 / PERIOD_NS)
            place += travel
            points.append(TimedPoint(self.axis, tick % (1 << 32), place, velocity))
        self.mode("TRAJECTORY")
        self.access.wait(POLL_TIME)
        for first in range(0, len(points), POINTS_MEASURING):
            words = encode_points(self.access.catalogue, points[first : first + POINTS_MEASURING])
            queued = self.access.write_words("cmd.points", words)
            self.access.wait(POLL_TIME)  # until the board has taken the points or has told its refusal
            if queued:
                continue
            reason = self.access.catalogue.label("point_refusal_t", int(self.access.read("point_refusal")[0]))
            raise MeasurementError(f"{self.name} refuses to run at {speed:g} rad/s: {reason}; use a lower speed")
        self.access.wait(max(begun + _LEAD_TIME + ramp - self.access.clock(), 0.0))

    def _refuse_motion(self, begun: tuple[float, float], ended: tuple[float, float], speed: float) -> None:
        """Raise an error if the mean speed during the recording is wrong; arguments from `_position_and_time`."""
        measured = (ended[0] - begun[0]) / ((ended[1] - begun[1]) % _TICKS_TIME)
        if speed and abs(measured - speed) > _SPEED_TOLERANCE * abs(speed) + HELD_SPEED:
            raise MeasurementError(
                f"{self.name} ran at {measured:.3g} rad/s instead of {speed:.3g} rad/s during the recording; use a"
                " speed that is possible under its load, or a higher lowest frequency"
            )
