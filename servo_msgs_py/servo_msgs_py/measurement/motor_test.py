"""The tests that find out the values of a motor of which only voltage and current limit are known. Pure.

The order is one of growing knowledge. A current vector at a fixed angle holds the rotor: resistance and lost voltage,
then inductances, with current controllers that get better with every estimate. The vector turns: pole pairs, direction,
flux.
Then the rotor search of the firmware can work, and torque pulses give a first inertia; at last the axis runs at several
speeds under control: friction, load, inertia, and flux again. Sub-states, limits and faults are the board's own.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.measurement.access import BoardAccess, MeasurementError, Recording, refuse_faults, send_configuration
from servo_msgs_py.measurement.estimation import (
    BAND,
    PLAIN,
    flux_of,
    follows,
    inductances_of,
    resistance_of,
    turning_of,
)
from servo_msgs_py.measurement.log import LoggedAccess, MeasurementLog
from servo_msgs_py.measurement.motor_config import SPEED_RATIO, configured, fitted, tuned_axis
from servo_msgs_py.measurement.motor_values import Estimate, Limits
from servo_msgs_py.measurement.restoring import AxisState
from servo_msgs_py.measurement.spinning import balance
from servo_msgs_py.measurement.standstill import PERIOD, impedance
from servo_msgs_py.measurement.test_signal import full_scale, start_test_signal
from servo_msgs_py.tuning.configuration import Scales
from servo_msgs_py.tuning.errors import ConfigError
from servo_msgs_py.tuning.formats import GAIN
from servo_msgs_py.units import PERIOD_NS

__all__ = ["PROTECTION", "PULSES", "TURN", "MotorTest"]

TICK: Final = 0.5e-3  # [s]
SAMPLES: Final = 1280
SWEEP_CALLS: Final = 1100  # of a test signal; the rest of the recording is its decay
FIRST_KP: Final = 0.05  # V/A; stable from 0.03 mH on
FIRST_KI: Final = 10.0  # V/(A s); stable from 0.05 ohm on
LEVELS: Final = tuple(float(level) for level in np.linspace(0.2, 1.0, 9))
"""Currents for the resistance, parts of the limit."""
VECTOR: Final = 0.7  # part of the current limit that holds the rotor while it is tested
SWEEP: Final[Mapping[str, float]] = {"d": 0.28, "q": 0.2}
"""Amplitudes, parts of the current limit: the currents of all phases keep their signs."""
SWEEPS: Final = 3
VECTOR_LOW: Final = 0.35  # part of the current limit at which the inductance is compared
SWEEP_LOW: Final = 0.2  # amplitude of the test signal there
VOLTAGE_USE: Final = 0.6  # part of the voltage that the resistance may take; the rest turns the rotor
TURN: Final = "turn"
PULSES: Final = "pulses"
"""Stages that a simulation of the measurement may leave out: they begin and end at rest."""
PROTECTION: Final = "protection"
"""Limits around the place of the shaft, and what brings the board back: of the board that was measured only."""
ROUNDS: Final = 7
LOOP: Final = 400.0  # Hz, of the current loop once the inductance is known
TURN_SLOW: Final = 2.0 * math.pi * 2.0  # electrical [rad/s]
TURN_FAST: Final = tuple(2.0 * math.pi * turns for turns in (12.0, 6.0, 3.0))
"""Tried in this order until the rotor follows."""
TURN_RAMP: Final = 120.0  # electrical [rad/s^2]
TURN_SETTLE: Final = 0.1  # [s]
TURNS_MIN: Final = 3.0  # to both sides: the vector turns a rotor of one pole pair so far
LATENCY: Final = 0.05
"""For the exchanges of a serial line, in which a shaft turns on [s]."""
REST_MAX: Final = 6.0  # until a shaft without current stands [s]
REST_SPEED: Final = 0.5  # of a shaft that stands [rad/s]
PULSE: Final = 0.5  # part of the current limit
PULSE_SPEED: Final = 0.5  # that the board permits meanwhile, part of the largest
PULSE_MAX: Final = 1.5  # [s]
MOVED: Final = 0.03  # by a shaft that is not held [rad]
BRAKED: Final = 0.15  # time constant with which torque brakes the shaft after a pulse [s]
MARK: Final = 0.1
"""Length of a test signal without amplitude, which marks the beginning of a recording [s]."""
SPEEDS: Final = (0.3, 0.6, 1.0)
SEARCHED: Final = 0.5
"""Time between the rotor search and the first run [s]: where the test is simulated, the search may take longer."""
ALONG: Final = 0.4  # current along the flux at constant speed, part of the limit
ALONG_VOLTAGE: Final = 0.3  # part of the voltage that it may take
ALONG_FREQUENCY: Final = 0.4  # [Hz]
ALONG_TIME: Final = 0.8  # [s]
HOLD_SAMPLES: Final = 640  # of every second slow tick, from the beginning of that current
ROOM_USE: Final = 0.9  # of the way to the limits
OVERSHOOT: Final = 1.18  # speed over its set-point after a reversal
STOPPED: Final = 0.1  # after the set-point has reached 0 [s]
SETTLE: Final = 0.3  # s, at a new speed
SETTLE_BEFORE: Final = 0.15  # before the speed is changed [s]
SETTLE_HOLD: Final = 0.45  # before a current along the flux: what is left of a change acts as flux [s]
APPROACH_MAX: Final = 1.2  # time in which a speed is reached [s]
NOMINAL: Final[Mapping[str, float]] = {
    "r_s": 0.5,
    "l_d": 0.4e-3,
    "l_q": 0.4e-3,
    "psi_m": 0.015,
    "pole_pairs": 1.0,
    "inertia": 1e-5,
    "friction": 0.0,
    "viscous": 0.0,
}
"""What the controller is told before anything is known; only the current controllers work with it, with other gains."""
POSSIBLE: Final[Sequence[Mapping[str, float]]] = ({"inertia": 1e-6}, {"inertia": 1e-5}, {"inertia": 1e-3})
"""Motors for which there has to be a configuration before anything moves."""

BLIND: Final = ("PHASE_LOST", "ENCODER_LOST", "ANGLE_MISMATCH", "STALLED", "CURRENT_SENSE")
"""Faults whose monitors need to know the motor; the tests at standstill look for what these stand for themselves."""

Report = Callable[[str], None]


class MotorTest:
    """One axis of a board, from unknown to estimated.

    Parameters
    ----------
    access : BoardAccess
        The board, at rest with its outputs off.
    axis : int
        Index of the axis.
    limits : Limits
        What the test keeps to.
    base : mapping
        Parsed ``servo.toml`` for what is not of the motor.
    report : callable, optional
        Gets a line for each step.
    """

    def __init__(
        self,
        access: BoardAccess,
        axis: int,
        limits: Limits,
        base: Mapping[str, Any],
        report: Report = lambda text: None,
    ) -> None:
        self.log = MeasurementLog(axis)
        self.access = LoggedAccess(access, self.log)
        self.axis, self.limits, self.base, self.report = axis, limits, base, report
        self.name = axis_name(axis)
        self.log.notes["limits"] = dataclasses.asdict(limits)
        self.values: dict[str, Estimate] = {}
        self.unrestored: list[str] = []
        self._low = self._high = 0.0  # where the shaft stays between [rad]
        self._over_speed = math.inf  # of the board's protection [rad/s]
        self._kept = 0  # features that protect and that the user has switched on
        self._current = limits.current  # largest, less where the resistance takes too much voltage [A]

    # ---- what a caller runs ------------------------------------------------------------------------------------------

    def run(self) -> MeasurementLog:
        """Make all tests; the board is left as it was found, outputs off.

        What could not be brought back is in `unrestored`, whatever else happens, and is reported.

        Raises
        ------
        MeasurementError, BlockRefusedError
            If a test cannot be made; the reason names what to do.
        """
        self._check()
        found = AxisState(self.access, self.axis)
        self._keep_protection(found)
        try:
            self.access.write("param.command_timeout", [0.0])
            monitors = found.word("param.faults_enabled")
            # they judge voltages by a resistance and current controllers that are not known yet
            self._write_raw("param.faults_enabled", monitors & ~self._faults(*BLIND))
            self._standstill()
            self._turn()
            # without dead-time compensation small currents look like none to the monitors of phases and converters; all
            # have shown their current by now
            self._write_raw("param.faults_enabled", monitors & ~self._faults("PHASE_LOST", "CURRENT_SENSE"))
            self._spin()
        finally:
            self.access.stage = PROTECTION
            self.unrestored = found.restore(self._off, self._stand)
            for what in self.unrestored:
                self.report(f"NOT RESTORED: {what}")
        if self.unrestored:
            raise MeasurementError(self.restoring_text)
        return self.log

    @property
    def restoring_text(self) -> str:
        """What to do about `unrestored`; empty if there is nothing."""
        if not self.unrestored:
            return ""
        return (
            f"{self.name} is not as it was before: {'; '.join(self.unrestored)}. Do not enable it: bring the shaft to"
            " rest and restart the board, which then takes the configuration that it has stored"
        )

    # ---- steps -------------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        """Refuse what cannot be tested; nothing is written."""
        states = self.access.catalogue.enums["state_t"]
        for axis in range(AXES):
            if self.access.read(f"{axis_name(axis)}.state")[0] != states["RUN"]:
                continue
            reason = (
                "its configuration can only be changed with outputs off"
                if axis == self.axis
                else "the set-points of both axes would not expire during the test"
            )
            raise MeasurementError(f"{axis_name(axis)} is enabled: disable it first, {reason}")
        refuse_faults(self.access, self.axis)
        state = int(self._read("state"))
        if state != states["STOP"]:
            label = self.access.catalogue.label("state_t", state)
            raise MeasurementError(f"{self.name} is in {label}, not in STOP: wait, or clear its faults")
        volts = self.access.read("u_dc")[0]
        if abs(volts / self.limits.voltage - 1.0) > 0.2:
            raise MeasurementError(
                f"the bus has {volts:.3g} V, and {self.limits.voltage:g} V were named: correct --voltage, or the supply"
            )
        # a cogging rotor swings when the board has just been switched on; a load takes its time to turn the shaft
        if not (self._stands(2.0) and self._stays()):
            raise MeasurementError("the shaft turns before the test begins: take the load off, or balance it")

    def _keep_protection(self, found: AxisState) -> None:
        """Stay within what protects the axis already; a `MeasurementError` if that leaves too little room."""
        catalogue = self.access.catalogue
        flags = {flag.name: flag.mask for flag in catalogue.flags["features"]}
        features = found.word("param.features")

        def value(name: str) -> float:
            return float(catalogue[name].scale(found.word(name)))

        self._kept = features & flags["OVER_SPEED"]
        speed = min(self.limits.speed, value("param.speed_limit"))
        if self._kept:
            self._over_speed = value("param.over_speed")
            speed = min(speed, self._over_speed / SPEED_RATIO)
        here, room = self._position(), 2.0 * math.pi * self.limits.turns
        self._low = max(here - room, catalogue["param.position_min"].minimum)
        self._high = min(here + room, catalogue["param.position_max"].maximum)
        if features & flags["POSITION_LIMITS"]:
            self._low = max(self._low, value("param.position_min"))
            self._high = min(self._high, value("param.position_max"))
        turns = min(here - self._low, self._high - here) / (2.0 * math.pi)
        if turns < TURNS_MIN * (1.0 - 1e-6):
            raise MeasurementError(
                f"{max(turns, 0.0):.3g} turns to both sides are too few, {TURNS_MIN:g} are needed: raise --turns-max,"
                " or widen param.position_min and param.position_max"
            )
        self.limits = dataclasses.replace(self.limits, speed=speed, turns=turns)
        for motor in POSSIBLE:
            try:
                self._fitted({**NOMINAL, **motor})
            except MeasurementError as error:
                raise MeasurementError(
                    f"{speed:.3g} rad/s is too slow for the test: raise --speed-max and param.speed_limit ({error})"
                ) from None

    def _standstill(self) -> None:
        current = self._current
        self.report("holding the rotor: resistance")
        self._configure(FIRST_KP, FIRST_KI)
        self._mode("TEST")
        self._write("cmd.speed", 0.0)
        self._write("cmd.i_q", 0.0)
        self._enable("TEST", 1.0)
        self._write("cmd.i_q", VECTOR * current)
        self._follow(VECTOR * current, 4.0)
        self.access.wait(0.3)
        r = self._ratio()
        reach = VOLTAGE_USE * self.limits.voltage / math.sqrt(3.0)
        current = self._current = min(self.limits.current, reach / r)
        self._write("cmd.i_q", VECTOR * current)
        self.access.wait(0.1)
        self._first_inductance(r)
        self.report("holding the rotor: current by current")
        self._levels()
        found = resistance_of(self.log)
        self.values["r_s"] = Estimate(found.resistance.value - self.limits.r_on, found.resistance.sigma)
        self.values["dead_voltage"] = found.lost
        self.report("holding the rotor: inductances")
        self._write("cmd.i_q", VECTOR * current)
        self.access.wait(0.1)
        for point in ("d", "q"):
            for _ in range(SWEEPS):
                self._sweep(f"sweep_{point}", point, SWEEP[point] * current)
        self.values.update(inductances_of(self.log, found.resistance.value))
        # with less current along the flux: does the iron saturate?
        self._write("cmd.i_q", VECTOR_LOW * current)
        self.access.wait(0.1)
        self._sweep("sweep_d_low", "d", SWEEP_LOW * current)
        self.log.notes["bias"] = {"l_d": VECTOR * current, "l_d_low": VECTOR_LOW * current}

    def _first_inductance(self, r: float) -> None:
        """Current controllers made for the inductance of the d axis."""
        kp = FIRST_KP
        for _ in range(ROUNDS):
            recording = self._sweep("first", "d", SWEEP["d"] * self._current)
            try:
                found = impedance([recording], self._columns("d"), r, BAND["d"], delay=0.5 * PERIOD).inductance
            except (ValueError, np.linalg.LinAlgError):
                found = Estimate(kp / (2.0 * math.pi * LOOP), math.inf)
            known = found.part < 0.3
            least = found.value - 2.0 * found.sigma if known else kp / (2.0 * math.pi * LOOP)
            wanted = 2.0 * math.pi * LOOP * found.value
            self._gains(wanted if known else min(3.0 * kp, 2.0 * math.pi * LOOP * max(least, kp / 1e4)), r, found.value)
            if known and wanted < 4.0 * kp:
                return
            kp = wanted if known else 3.0 * kp
        raise MeasurementError(
            "the current does not answer to a test signal: is the motor connected, and all three of its wires?"
        )

    def _levels(self) -> None:
        for part in LEVELS:
            self._write("cmd.i_q", part * self._current)
            self.access.wait(0.06)
            self._slow("level", ("i_d", "u_d"), 100, 1)

    def _turn(self) -> None:
        self.report("turning the rotor: pole pairs, direction, flux")
        self.access.stage = TURN
        self._write("cmd.i_q", self._current)
        self.access.wait(0.1)
        names = ("position", "test_angle", "u_d", "u_q", "i_d", "i_q")
        self._write("param.acceleration_limit", TURN_RAMP / NOMINAL["pole_pairs"])
        for way in (1.0, -1.0):
            self._turned("turn_slow", names, 450, 4, way * TURN_SLOW)
        r = self.values["r_s"].value + self.limits.r_on
        self.values.update(turning_of(self.log, r))
        pairs = self.values["pole_pairs"].value
        room = 2.0 * math.pi * self.limits.turns * pairs
        for electrical in TURN_FAST:
            if electrical**2 / TURN_RAMP + electrical * (TURN_SETTLE + 500 * TICK + LATENCY) > room:
                continue
            made = [self._turned("turn_fast", names, 250, 2, way * electrical) for way in (1.0, -1.0)]
            if all(follows(one, self.name, pairs) for one in made):
                break
        self.values.update(flux_of(self.log, self.values["l_d"].value, self.values["pole_pairs"].value))
        self.access.stage = ""
        self._write("cmd.i_q", 0.0)
        self.access.wait(0.05)
        self._off()

    def _spin(self) -> None:
        self.report("torque pulses: first inertia")
        self.access.stage = PULSES
        pairs, psi = round(self.values["pole_pairs"].value), self.values["psi_m"].value
        torque = 1.5 * pairs * psi * self.limits.current
        motor = {
            **{name: self.values[name].value for name in ("l_d", "l_q", "psi_m", "pole_pairs")},
            "r_s": self.values["r_s"].value + self.limits.r_on,
            "inertia": torque / 3000.0,
            "friction": 0.02 * torque,
            "viscous": 0.0,
        }
        self._send(self._fitted(motor))
        self._features()
        self._mode("TORQUE")
        self._write("param.speed_limit", PULSE_SPEED * self._speed_max())
        self._write("cmd.i_q", 0.0)
        self._enable("SPIN", 8.0)
        inertia, coulomb = self._pulses(motor)
        self._off()
        self.access.stage = ""
        motor |= {"inertia": inertia, "friction": min(max(coulomb, 0.0), 0.5 * torque)}
        self.report("running at several speeds")
        table = self._fitted(motor)
        self._send(table)
        self._features()
        for name in ("speed", "acceleration"):
            self._write(f"param.{name}_limit", table[self.name]["limits"][name])
        self._mode("SPEED")
        self._write("cmd.speed", 0.0)
        self._enable("SPIN", 8.0)
        self.access.wait(SEARCHED)
        self._speeds(table[self.name]["limits"], inertia)
        self._off()

    def _pulses(self, motor: Mapping[str, float]) -> tuple[float, float]:
        """Inertia and Coulomb friction, from torque to both sides."""
        part, way_max = PULSE, 0.25 * self.limits.turns * 2.0 * math.pi
        target = 0.25 * self._speed_max()
        for _ in range(3):
            start, begin = self._position(), self.access.read("tick")[0]
            self._write("cmd.i_q", part * self.limits.current)
            seconds = reached = moved = 0.0
            while seconds < PULSE_MAX and moved < way_max and (reached < target or moved < MOVED):
                self.access.wait(0.002)
                reached = abs(self._read("speed"))
                seconds = ((self.access.read("tick")[0] - begin) % 2**32) * PERIOD_NS * 1e-9
                moved = abs(self._position() - start)
            self._write("cmd.i_q", 0.0)
            refuse_faults(self.access, self.axis)
            if moved >= MOVED:
                break
            part *= 1.4
        else:
            raise MeasurementError("the shaft does not move with full torque: it is held, or the load is too large")
        current = part * self.limits.current
        braking = current * seconds / (max(reached, 1.0) * BRAKED)
        self._brake(braking, current)
        seconds = max(seconds, 0.01)
        every = max(math.ceil(4.5 * seconds / TICK / self.access.capacity(self._columns_of(self._SPIN))), 1)
        samples = max(int(2.2 * seconds / TICK / every), 12)
        recordings = []
        for way in (-1.0, 1.0):

            def pulse(way: float = way) -> None:
                self._start_signal("d")
                for part_of_time, torque in ((1.0, way), (0.7, -way)):
                    self._write("cmd.i_q", torque * current)
                    self.access.wait(part_of_time * seconds)
                self._write("cmd.i_q", 0.0)
                self.access.wait(max(samples * every * TICK - 1.7 * seconds, 0.0))
                self._brake(braking, current)

            self._signal(0.0, 0.0, 0.0, round(MARK / PERIOD))
            recordings.append(self._slow("pulse", self._SPIN, samples, every, pulse, trigger="test_point"))
        found, coulomb = balance(
            recordings, self.name, (round(motor["pole_pairs"]), motor["psi_m"], motor["l_d"], motor["l_q"]), None
        )
        if found.value <= 0.0:
            raise MeasurementError("torque pulses give no inertia: the shaft is held, or something else turns it")
        return found.value, coulomb.value

    def _brake(self, gain: float, most: float) -> None:
        """Bring the shaft to rest by torque.

        Parameters
        ----------
        gain : float
            Current over speed [A s/rad].
        most : float
            Largest current [A].
        """
        for _ in range(400):
            speed = self._read("speed")
            if abs(speed) < 2.0 * REST_SPEED:
                break
            self._write("cmd.i_q", -math.copysign(min(gain * abs(speed), most), speed))
            self.access.wait(0.005)
        self._write("cmd.i_q", 0.0)
        self._stand()

    def _speeds(self, limits: Mapping[str, float], inertia: float) -> None:
        acceleration = limits["acceleration"]
        most = min(limits["speed"], self._speed_max(), self.limits.speed / OVERSHOOT)
        # a reversal returns the energy of the shaft to the bus
        most = min(most, math.sqrt(2.0 * self.limits.energy / inertia))
        most = min(most, APPROACH_MAX * acceleration)
        # each recording begins and ends at rest, and those to both sides take turns
        here = self._position()
        room = ROOM_USE * min(self._high - here, here - self._low)
        longest = max(SETTLE + PLAIN, SETTLE_HOLD + ALONG_TIME) + LATENCY
        while most * longest + most**2 / acceleration > room:
            most *= 0.95
        r = self.values["r_s"].value + self.limits.r_on
        along = min(ALONG * self.limits.current, ALONG_VOLTAGE * self.limits.voltage / math.sqrt(3.0) / r)
        before = 0.0
        for part in SPEEDS:
            speeds = [way * part * most for way in (1.0, -1.0)]
            for speed in speeds:
                seconds = abs(speed - before) / acceleration + SETTLE
                every = math.ceil(seconds / TICK / self.access.capacity(self._columns_of(self._SPIN)))
                change = partial(self._write, "cmd.speed", speed)
                times = abs(before) / acceleration + SETTLE_BEFORE, abs(speed) / acceleration + STOPPED
                self._moving("speed", self._SPIN, int(seconds / TICK / every), every, before, times, change)
                before = speed
            for speed in speeds:
                ramp = abs(speed) / acceleration
                self._moving("plain", self._PLAIN, round(PLAIN / TICK), 1, speed, (ramp + SETTLE, ramp + STOPPED))
            for speed in speeds:
                # a current along the flux: the phase currents hardly come near zero, where dead time takes a voltage
                # that is not known well; a slow sine does not step
                ramp = abs(speed) / acceleration
                times = ramp + SETTLE_HOLD, ramp + STOPPED
                self._signal(along, ALONG_FREQUENCY * PERIOD, 0.0, round(ALONG_TIME / PERIOD))
                begin = partial(self._start_signal, "d")
                self._moving("hold", self._HELD, HOLD_SAMPLES, 2, speed, times, begin, mark=False)
                self.access.wait(max(ALONG_TIME - 2.0 * HOLD_SAMPLES * TICK - times[1], 0.0) + TICK)

    # ---- parts of them -----------------------------------------------------------------------------------------------

    _SPIN: Final = ("position", "speed", "speed_ref", "i_q", "i_d")
    _PLAIN: Final = ("position", "i_q", "i_d")
    _HELD: Final = ("position", "i_q", "i_d", "u_q", "u_d")

    def _speed_max(self) -> float:
        pairs, psi = self.values["pole_pairs"].value, self.values["psi_m"].value
        return min(self.limits.speed, 0.8 * self.limits.voltage / math.sqrt(3.0) / (pairs * psi))

    def _columns_of(self, names: Sequence[str]) -> list[str]:
        return [f"{self.name}.{name}" for name in names]

    def _columns(self, point: str) -> tuple[str, str, str]:
        return f"{self.name}.i_{point}", f"{self.name}.u_{point}", f"{self.name}.test_signal"

    def _signal(self, amplitude: float, first: float, growth: float, calls: int) -> None:
        """Describe a test signal: amplitude [A], frequency [turns per PWM period] and its growth, length."""
        self._write("cmd.test_amplitude", min(amplitude / full_scale(self.access, "I_D"), 0.5))
        self._write("cmd.test_step", first)
        self._write("cmd.test_growth", growth)
        self._write("cmd.test_calls", float(calls))

    def _start_signal(self, point: str) -> None:
        start_test_signal(self.access, self.axis, f"I_{point.upper()}")

    def _sweep(self, label: str, point: str, amplitude: float) -> Recording:
        first, last = 150.0 * PERIOD, 3000.0 * PERIOD
        self._signal(amplitude, first, math.log(last / first) / SWEEP_CALLS, SWEEP_CALLS)
        recording = self.access.labelled(
            label,
            list(self._columns(point)),
            SAMPLES,
            1,
            False,
            lambda: self._start_signal(point),
            trigger=f"{self.name}.test_point",
        )
        refuse_faults(self.access, self.axis)
        return recording

    def _slow(
        self,
        label: str,
        names: Sequence[str],
        samples: int,
        every: int,
        start: Callable[[], None] | None = None,
        trigger: str | None = None,
    ) -> Recording:
        trigger = None if trigger is None else f"{self.name}.{trigger}"
        columns = self._columns_of(names)
        recording = self.access.labelled(label, columns, samples, every, True, start, trigger=trigger)
        refuse_faults(self.access, self.axis)
        return recording

    def _ratio(self) -> float:
        recording = self._slow("ratio", ("i_d", "u_d"), 100, 1)
        i_d, u_d = (float(np.nanmean(recording.columns[f"{self.name}.{name}"])) for name in ("i_d", "u_d"))
        return max(u_d / i_d, 0.02)

    def _follow(self, current: float, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.access.wait(0.02)
            refuse_faults(self.access, self.axis)
            if abs(self._read("i_d") - current) < 0.05 * current + 0.02:
                return
        flows, volts = self._read("i_d"), self._read("u_d")
        raise MeasurementError(
            f"{flows:.2f} A flow instead of {current:.2f} A at {volts:.1f} V: the winding is open or takes more voltage"
            " than there is; check the wires, or lower --current"
        )

    def _gains(self, kp: float, r: float, inductance: float) -> None:
        omega = kp / max(inductance, 1e-6)
        self._configure(kp, omega * r, live=True)

    def _configure(self, kp: float, ki: float, *, live: bool = False) -> None:
        """Current controllers with these gains [V/A], [V/(A s)]."""
        scales = Scales.of(self.access.catalogue)
        to = scales.i / scales.u_s
        raw = {"kp": round(math.ldexp(kp * to, 24)), "ki": max(round(math.ldexp(ki * PERIOD * to, 24)), 1)}
        most = GAIN.high // 4
        gains = {f"current_loop.{axis}.{gain}": min(value, most) for axis in "dq" for gain, value in raw.items()}
        self._send(configured(self.base, self.axis, self.limits, NOMINAL), gains)
        if not live:
            self._features()
            self._write("param.i_q_limit", self.limits.current)

    def _send(self, table: Mapping[str, Any], members: Mapping[str, int] | None = None) -> None:
        """Let the board take a configuration, with some members of the block replaced."""
        try:
            block = {**tuned_axis(table, self.axis).block, **(members or {})}
        except ConfigError as error:
            raise MeasurementError(f"the controller cannot be tuned for the test: {error}") from None
        AxisConfigTable.load().check(block)
        send_configuration(self.access, {self.axis: block})
        self._write("param.i_q_limit", self.limits.current)

    def _fitted(self, motor: Mapping[str, float]) -> dict[str, Any]:
        try:
            return fitted(self.base, self.axis, self.limits, motor, gentle=True)
        except ConfigError as error:
            raise MeasurementError(f"the controller cannot be tuned for the test: {error}") from None

    def _features(self) -> None:
        """Only what keeps voltages what they are asked to be, no compensation of what is measured; and protection."""
        flags = {flag.name: flag.mask for flag in self.access.catalogue.flags["features"]}
        plain = flags["BUS_COMPENSATION"] | flags["ANTI_WINDUP"] | flags["ENHANCED_MT"]
        self._write_raw("param.features", plain)
        stage, self.access.stage = self.access.stage, PROTECTION
        self._write("param.position_min", self._low)
        self._write("param.position_max", self._high)
        if self._kept:
            self._write("param.over_speed", min(self._over_speed, SPEED_RATIO * self.limits.speed))
        self._write_raw("param.features", plain | flags["POSITION_LIMITS"] | self._kept)
        self.access.stage = stage

    def _faults(self, *names: str) -> int:
        return sum(flag.mask for flag in self.access.catalogue.flags["faults"] if flag.name in names)

    def _mode(self, mode: str) -> None:
        self._write_raw("cmd.mode", self.access.catalogue.enums["control_mode_t"][mode])

    def _enable(self, substate: str, seconds: float) -> None:
        wanted = self.access.catalogue.enums["substate_t"][substate]
        run = self.access.catalogue.enums["state_t"]["RUN"]
        self._write_raw("cmd.enable", 1)
        for _ in range(round(seconds / 0.02)):
            self.access.wait(0.02)
            refuse_faults(self.access, self.axis)
            if self._read("state") == run and self._read("substate") == wanted:
                return
        raise MeasurementError(f"{self.name} did not come to {substate} within {seconds:g} s: is the board in order?")

    def _off(self) -> None:
        """Outputs off, and the shaft at rest.

        Raises
        ------
        MeasurementError
            If it does not come to rest.
        """
        self._write_raw("cmd.enable", 0)
        stop = self.access.catalogue.enums["state_t"]["STOP"]
        fault = self.access.catalogue.enums["state_t"]["FAULT"]
        for _ in range(round(REST_MAX / 0.02)):
            self.access.wait(0.02)
            if self._read("state") in (stop, fault) and abs(self._read("speed")) < REST_SPEED:
                self.access.wait(0.1)
                return
        raise MeasurementError(
            f"with its outputs off the shaft does not come to rest within {REST_MAX:g} s: something turns it; take the"
            " load off, or balance it"
        )

    def _stands(self, seconds: float) -> bool:
        """Wait for rest; False if it does not come within so many seconds."""
        for _ in range(round(seconds / 0.02)):
            if abs(self._read("speed")) < REST_SPEED:
                return True
            self.access.wait(0.02)
        return abs(self._read("speed")) < REST_SPEED

    def _stays(self) -> bool:
        """Whether a shaft that stands goes on to do so."""
        begin = self._position()
        self.access.wait(0.2)
        return abs(self._position() - begin) < MOVED and abs(self._read("speed")) < REST_SPEED

    def _stand(self) -> None:
        if not self._stands(REST_MAX):
            raise MeasurementError(f"{self.name} is not at rest after {REST_MAX:g} s: something turns the shaft")

    def _turned(self, label: str, names: Sequence[str], samples: int, every: int, electrical: float) -> Recording:
        """A recording while the vector turns with an electrical speed [rad/s]."""
        times = abs(electrical) / TURN_RAMP + TURN_SETTLE, abs(electrical) / TURN_RAMP + STOPPED
        return self._moving(label, names, samples, every, electrical / NOMINAL["pole_pairs"], times)

    def _moving(
        self,
        label: str,
        names: Sequence[str],
        samples: int,
        every: int,
        speed: float,
        times: tuple[float, float],
        begin: Callable[[], None] = lambda: None,
        *,
        mark: bool = True,
    ) -> Recording:
        """A recording that begins when a speed [rad/s] is reached; the shaft stops before samples are read.

        Parameters
        ----------
        times : tuple of float
            For reaching the speed, and for stopping [s].
        begin : callable
            What is done at the first sample.
        mark : bool
            Whether a test signal without amplitude marks the first sample; otherwise `begin` starts one.
        """

        def start() -> None:
            self._write("cmd.speed", speed)
            self.access.wait(times[0])
            if mark:
                self._start_signal("d")
            begin()
            self.access.wait((samples * every + 4) * TICK)
            self._write("cmd.speed", 0.0)
            self.access.wait(times[1])

        if mark:
            self._signal(0.0, 0.0, 0.0, round(MARK / PERIOD))
        return self._slow(label, names, samples, every, start, trigger="test_point")

    def _position(self) -> float:
        return self._read("position")

    def _read(self, name: str) -> float:
        return self.access.read(f"{self.name}.{name}")[0]

    def _write(self, name: str, value: float) -> None:
        self.access.write(name, [value], self.axis)

    def _write_raw(self, name: str, raw: int) -> None:
        if not self.access.write_words(name, [raw], self.axis):
            raise MeasurementError(f"{name}: the board refuses {raw}")
