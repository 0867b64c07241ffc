"""The motion in which an open loop is measured: how an axis is brought into it, kept in it, and brought back. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from servo_msgs_py.measurement.access import BoardAccess, MeasurementError, Recording, refuse_faults
from servo_msgs_py.measurement.axis_under_test import HELD_SPEED, LOOK, AxisUnderTest
from servo_msgs_py.measurement.bode_plan import BASE_PART, SETTLE, Band, Settings
from servo_msgs_py.measurement.test_signal import end_test_signal, start_test_signal
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_msgs_py.units import PERIOD_NS

_TEST_TIME: Final = 5.0  # until mode TEST has begun [s]
_SEARCH_TIME: Final = 8.0  # until the rotor has been found [s]
_STILL_TIME: Final = 5.0  # until a rotor swings no more [s]
_STILL_LOOKS: Final = 10
_SETTLE_LOOK: Final = 0.05  # [s]
_SPEED_TOLERANCE: Final = 0.1  # of the constant speed
_AHEAD: Final = 0.25  # of their time, that points are sent, on a slow line too [s]
_RAMP: Final = 0.3  # longest way to the constant speed in a trajectory [s]
_TICKS_TIME: Final = (1 << 32) * PERIOD_NS * 1e-9  # after which the time of the board begins anew [s]


class BodeRig(AxisUnderTest):
    """The axis whose loop is measured.

    Parameters
    ----------
    access : BoardAccess
        The board.
    settings : Settings
        What is measured.
    report : callable
        Gets a sentence.
    """

    def __init__(self, access: BoardAccess, settings: Settings, report: Callable[[str], None]) -> None:
        super().__init__(access, settings.axis, report)
        self._settings = settings

    @property
    def spins(self) -> bool:
        return self.substate == "SPIN"

    @contextmanager
    def prepared(self, enable: bool) -> Iterator[None]:
        """The axis in SPIN and at rest, or in TEST; afterwards at rest, in mode and state from before.

        An axis in mode TORQUE holds its position after its set-point has expired. It is left in mode POSITION: mode
        TORQUE would begin anew with no current, and a load would fall.
        """
        tested = not self._settings.loop.slow
        refuse_faults(self.access, self.axis)
        mode, spun = self.label("mode"), self.spins
        if spun and tested:
            raise MeasurementError(
                f"{self.name} is enabled; a current loop is measured in mode TEST: disable the axis first"
            )
        if not spun and not enable:
            raise MeasurementError(
                f"{self.name} is not enabled; enable it before, or let this command do it with --enable"
            )
        if not (abs(self.value("speed")) < HELD_SPEED and self.value("speed_ref") == 0.0):
            raise MeasurementError(f"{self.name} is in motion; bring it to rest first")

        def rest() -> None:
            end_test_signal(self.access, self.axis)
            if self.spins:
                self.hold()

        def outputs() -> None:
            if not spun:
                self.write("cmd.i_q", 0.0)
                self.off(rest=False)  # a load may turn the shaft now, as before

        def mode_before() -> None:
            if mode == "TORQUE" and self.spins:
                self.report(
                    f"{self.name} holds its position in mode POSITION; it was in mode TORQUE, without a set-point"
                )
            else:
                self.mode(mode)
            self.access.wait(LOOK)  # until all of it is in force

        with self.restored((("shaft at rest", rest), ("outputs", outputs), ("mode", mode_before))):
            if not spun:
                self.mode("TEST" if tested else "POSITION")
                self.enable("TEST" if tested else "SPIN", _TEST_TIME if tested else _SEARCH_TIME)
            yield

    def recorded(self, band: Band, speed: float, columns: Sequence[str] | None = None) -> Recording:
        """One recording of one sweep, in motion or at rest; the shaft turns until the memory of the recorder is full.

        Parameters
        ----------
        band : Band
            Frequencies of the sweep.
        speed : float
            Constant speed meanwhile [rad/s].
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
                self._settle()
            elif speed:
                self._travel(speed, band.turning_seconds)
                self._settle()
            begun = self._place()
            self.renew()
            start_test_signal(self.access, self.axis, loop.point)

        def meanwhile(full: bool) -> None:
            nonlocal begun
            if begun is None:
                return
            self.refuse_limits()
            if not loop.slow:
                return
            here = self._place()
            if full:
                self._refuse_motion(begun, here, speed)
                begun = None
                self.hold()
            elif abs(here[0] - begun[0]) > settings.way_turning(band):
                raise MeasurementError(f"{self.name} has turned farther than it should while it was recorded")

        if loop.slow:
            self.hold()
        else:
            self.release()  # a current that has expired since the last recording still holds the rotor
            self.command("cmd.i_q", BASE_PART * self.access.read("param.i_q_limit")[self.axis])
            self._stand_still()
        return self.record(
            settings.columns if columns is None else columns,
            band.samples,
            band.every,
            loop.slow,
            start,
            meanwhile=meanwhile,
        )

    def _settle(self) -> None:
        """Let the shaft reach its constant speed."""
        for _ in range(math.ceil(SETTLE / _SETTLE_LOOK)):
            self.wait(_SETTLE_LOOK)
            self.refuse_limits()

    def _stand_still(self) -> None:
        """Wait until a rotor that is held by a current swings no more."""
        count = self.access.catalogue[f"{self.name}.position"].lsb
        for _ in range(math.ceil(_STILL_TIME / (_STILL_LOOKS * LOOK))):
            places = []
            for _ in range(_STILL_LOOKS):
                self.wait(LOOK)
                places.append(self.value("position"))
            if max(places) - min(places) < 1.5 * count:
                return
        raise MeasurementError(f"{self.name} still swings after {_STILL_TIME:g} s; keep the shaft from being driven")

    def _place(self) -> tuple[float, float]:
        """Position and board time [rad, s]."""
        return self.value("position"), self.access.read("tick")[0] * PERIOD_NS * 1e-9

    def _travel(self, speed: float, seconds: float) -> None:
        """Turn at a constant speed under position control for a time [s], then hold."""
        acceleration = 0.5 * self.access.read("param.acceleration_limit")[self.axis]
        ramp = max(0.01, min(1.5 * abs(speed) / acceleration, _RAMP))
        place = self.value("position_ref")
        tick = int(self.access.read("tick")[0])
        path = ((_AHEAD, 0.0, 0.0), (ramp, 0.5 * ramp * speed, speed), (seconds, seconds * speed, speed))
        points = []
        for duration, way, velocity in (*path, (ramp, 0.5 * ramp * speed, 0.0)):
            tick += round(duration * 1e9 / PERIOD_NS)
            place += way
            points.append(TimedPoint(self.axis, tick % (1 << 32), place, velocity))
        self.mode("TRAJECTORY")
        self.access.wait(LOOK)
        if not self.access.write_words("cmd.points", encode_points(self.access.catalogue, points)):
            self.access.wait(LOOK)
            reason = self.access.catalogue.label("point_refusal_t", int(self.access.read("point_refusal")[0]))
            raise MeasurementError(f"{self.name} refuses to turn at {speed:g} rad/s: {reason}; give a lower speed")
        self.access.wait(_AHEAD + ramp)

    def _refuse_motion(self, begun: tuple[float, float], ended: tuple[float, float], speed: float) -> None:
        """Refuse a recording in which the shaft has not turned as it should; places from `_place`."""
        turned = (ended[0] - begun[0]) / ((ended[1] - begun[1]) % _TICKS_TIME)
        if speed and abs(turned - speed) > _SPEED_TOLERANCE * abs(speed) + HELD_SPEED:
            raise MeasurementError(
                f"{self.name} turned at {turned:.3g} rad/s instead of {speed:.3g} rad/s while it was recorded; give a"
                " speed that it keeps under its load, or a higher lowest frequency"
            )
