"""The tests that find out the values of a motor of which only voltage and current limit are known. Pure.

The order is one of growing knowledge. A current vector at a fixed angle holds the rotor: resistance and lost voltage,
then inductances, with current controllers that get better with every estimate. The vector turns: pole pairs, direction,
flux.
Then the rotor search of the firmware can work, and torque pulses give a first inertia; at last the axis runs at several
speeds under control: friction, load, inertia, and flux again. Sub-states, limits and faults are the board's own.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import BlockRefusedError, read_block
from servo_msgs_py.catalogue import axis_name
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
from servo_msgs_py.measurement.motor_config import configured, fitted, tuned_axis
from servo_msgs_py.measurement.motor_values import Estimate, Limits
from servo_msgs_py.measurement.spinning import balance
from servo_msgs_py.measurement.standstill import PERIOD, impedance
from servo_msgs_py.tuning.configuration import Scales
from servo_msgs_py.tuning.errors import ConfigError
from servo_msgs_py.tuning.formats import GAIN

__all__ = ["PULSES", "TURN", "MotorTest"]

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
VOLTAGE_USE: Final = 0.6  # part of the voltage that the resistance may take; the rest turns the rotor
TURN: Final = "turn"
PULSES: Final = "pulses"
"""Stages that a simulation of the measurement may leave out: they begin and end at rest."""
ROUNDS: Final = 7
LOOP: Final = 400.0  # Hz, of the current loop once the inductance is known
TURN_SLOW: Final = 2.0 * math.pi * 2.0  # electrical [rad/s]
TURN_FAST: Final = tuple(2.0 * math.pi * turns for turns in (12.0, 6.0, 3.0))
"""Tried in this order until the rotor follows."""
TURN_RAMP: Final = 120.0  # electrical [rad/s^2]
REST_MAX: Final = 6.0  # until a shaft without current stands [s]
PULSE: Final = 0.5  # part of the current limit
SPEEDS: Final = (0.3, 0.6, 1.0)
SEARCHED: Final = 0.5
"""Time between the rotor search and the first run [s]: where the test is simulated, the search may take longer."""
ALONG: Final = 0.4  # current along the flux at constant speed, part of the limit
ALONG_VOLTAGE: Final = 0.3  # part of the voltage that it may take
ALONG_FREQUENCY: Final = 0.4  # [Hz]
ALONG_TIME: Final = 0.8  # [s]
HOLD_SAMPLES: Final = 640  # of every second slow tick, from the beginning of that current
SETTLE: Final = 0.3  # s, at a new speed
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
        self._current = limits.current  # largest, less where the resistance takes too much voltage [A]
        self._turns_at = 0.0  # electrical speed of the vector [rad/s]

    # ---- what a caller runs ------------------------------------------------------------------------------------------

    def run(self) -> MeasurementLog:
        """Make all tests; the board is left as it was found, outputs off.

        Raises
        ------
        MeasurementError, BlockRefusedError
            If a test cannot be made; the reason names what to do.
        """
        block = read_block(self.access, self.axis)
        saved = {
            name: self.access.read_words(name)[self.axis]
            for name in ("param.features", "param.i_q_limit", "param.faults_enabled", "param.acceleration_limit")
        }
        timeout = self.access.read_words("param.command_timeout")
        self._check()
        self.access.write("param.command_timeout", [0.0])
        monitors = saved["param.faults_enabled"]
        try:
            # they judge voltages by a resistance and current controllers that are not known yet
            self._write_raw("param.faults_enabled", monitors & ~self._faults(*BLIND))
            self._standstill()
            self._turn()
            # without dead-time compensation small currents look like none to the monitors of phases and converters; all
            # have shown their current by now
            self._write_raw("param.faults_enabled", monitors & ~self._faults("PHASE_LOST", "CURRENT_SENSE"))
            self._spin()
        finally:
            self.access.stage = ""
            with contextlib.suppress(MeasurementError, BlockRefusedError):  # what has gone wrong before is the reason
                self._off()
                send_configuration(self.access, {self.axis: block})
            for name, raw in saved.items():
                self.access.write_words(name, [raw], self.axis)
            self.access.write_words("param.command_timeout", timeout)
        return self.log

    # ---- steps -------------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        volts = self.access.read("u_dc")[0]
        if abs(volts / self.limits.voltage - 1.0) > 0.2:
            raise MeasurementError(
                f"the bus has {volts:.3g} V, and {self.limits.voltage:g} V were named: correct --voltage, or the supply"
            )
        refuse_faults(self.access, self.axis)
        self._stand(2.0)  # a cogging rotor swings when the board has just been switched on
        if abs(self._read("speed")) > 0.5:
            raise MeasurementError("the shaft turns before the test begins: take the load off, or balance it")

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
            self._turn_at(way * TURN_SLOW)
            self._slow("turn_slow", names, 450, 4)
        r = self.values["r_s"].value + self.limits.r_on
        self.values.update(turning_of(self.log, r))
        for electrical in TURN_FAST:
            made = []
            for way in (1.0, -1.0):
                self._turn_at(way * electrical)
                made.append(self._slow("turn_fast", names, 250, 2))
            if all(follows(one, self.name, self.values["pole_pairs"].value) for one in made):
                break
        self._turn_at(0.0)
        self.access.wait(0.3)
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
        self._write("param.acceleration_limit", table[self.name]["limits"]["acceleration"])
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
            start = self._position()
            self._write("cmd.i_q", part * self.limits.current)
            time = 0.0
            while time < 1.5:
                self.access.wait(0.002)
                time += 0.002
                moved = abs(self._position() - start)
                if abs(self._read("speed")) > target or moved > way_max:
                    break
            self._write("cmd.i_q", 0.0)
            refuse_faults(self.access, self.axis)
            if moved > 0.03:
                break
            part *= 1.4
        else:
            raise MeasurementError("the shaft does not move with full torque: it is held, or the load is too large")
        self._stand(2.0)
        seconds = max(time, 0.01)
        every = max(math.ceil(4.5 * seconds / TICK / self.access.capacity(self._columns_of(self._SPIN))), 1)
        recordings = []
        for way in (-1.0, 1.0):

            def pulse(way: float = way) -> None:
                self._write("cmd.i_q", way * part * self.limits.current)
                self.access.wait(seconds)
                self._write("cmd.i_q", -way * part * self.limits.current)
                self.access.wait(0.7 * seconds)
                self._write("cmd.i_q", 0.0)

            samples = max(int(2.2 * seconds / TICK / every), 12)
            recordings.append(self._slow("pulse", self._SPIN, samples, every, pulse))
            self._stand(2.0)
        found, coulomb = balance(
            recordings, self.name, (round(motor["pole_pairs"]), motor["psi_m"], motor["l_d"], motor["l_q"]), None
        )
        if found.value <= 0.0:
            raise MeasurementError("torque pulses give no inertia: the shaft is held, or something else turns it")
        return found.value, coulomb.value

    def _speeds(self, limits: Mapping[str, float], inertia: float) -> None:
        acceleration = limits["acceleration"]
        most = min(limits["speed"], self._speed_max())
        # a reversal returns the energy of the shaft to the bus
        most = min(most, math.sqrt(2.0 * self.limits.energy / inertia))
        # a run from standstill to one side stays within the turns
        room = 2.0 * math.pi * self.limits.turns
        while most * (PLAIN + ALONG_TIME + SETTLE) + most**2 / (2.0 * acceleration) > room:
            most *= 0.8
        r = self.values["r_s"].value + self.limits.r_on
        along = min(ALONG * self.limits.current, ALONG_VOLTAGE * self.limits.voltage / math.sqrt(3.0) / r)
        before = 0.0
        for part in SPEEDS:
            for way in (1.0, -1.0):
                speed = way * part * most
                seconds = abs(speed - before) / acceleration + SETTLE
                every = math.ceil(seconds / TICK / self.access.capacity(self._columns_of(self._SPIN)))
                samples = int(seconds / TICK / every)
                self._slow("speed", self._SPIN, samples, every, partial(self._write, "cmd.speed", speed))
                self._slow("plain", self._PLAIN, round(PLAIN / TICK), 1)
                # a current along the flux: the phase currents hardly come near zero, where dead time takes a voltage
                # that is not known well; a slow sine does not step
                self._signal(along, ALONG_FREQUENCY * PERIOD, 0.0, round(ALONG_TIME / PERIOD))
                self._slow("hold", self._HELD, HOLD_SAMPLES, 2, partial(self._start_signal, "d"), trigger="test_point")
                self.access.wait(max(ALONG_TIME - 2.0 * HOLD_SAMPLES * TICK, 0.0) + TICK)
                before = speed
        self._write("cmd.speed", 0.0)
        self.access.wait(abs(before) / acceleration + 0.1)

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
        full = self.access.catalogue[f"{self.name}.i_d"].full_scale
        assert full is not None
        self._write("cmd.test_amplitude", min(amplitude / full, 0.5))
        self._write("cmd.test_step", first)
        self._write("cmd.test_growth", growth)
        self._write("cmd.test_calls", float(calls))

    def _start_signal(self, point: str) -> None:
        points = self.access.catalogue.enums["test_point_t"]
        self._write("cmd.test_point", float(points[f"I_{point.upper()}"]))

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
        """Only what keeps voltages what they are asked to be: no compensation of what is measured."""
        flags = {flag.name: flag.mask for flag in self.access.catalogue.flags["features"]}
        self._write_raw("param.features", flags["BUS_COMPENSATION"] | flags["ANTI_WINDUP"] | flags["ENHANCED_MT"])

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
            if self._read("state") in (stop, fault) and abs(self._read("speed")) < 0.5:
                self.access.wait(0.1)
                return
        raise MeasurementError(
            f"with its outputs off the shaft does not come to rest within {REST_MAX:g} s: something turns it; take the"
            " load off, or balance it"
        )

    def _stand(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            if abs(self._read("speed")) < 0.5:
                return
            self.access.wait(0.02)

    def _turn_at(self, electrical: float) -> None:
        """Electrical speed of the vector [rad/s]; returns when it is reached."""
        self._write("cmd.speed", electrical / NOMINAL["pole_pairs"])
        self.access.wait(abs(electrical - self._turns_at) / TURN_RAMP + 0.1)
        self._turns_at = electrical

    def _position(self) -> float:
        return self._read("position")

    def _read(self, name: str) -> float:
        return self.access.read(f"{self.name}.{name}")[0]

    def _write(self, name: str, value: float) -> None:
        self.access.write(name, [value], self.axis)

    def _write_raw(self, name: str, raw: int) -> None:
        if not self.access.write_words(name, [raw], self.axis):
            raise MeasurementError(f"{name}: the board refuses {raw}")
