"""Identification tests of a motor of which only voltage and current limit are known.

Each test uses the results of the previous ones. A current vector at a fixed angle holds the rotor: resistance and lost
voltage, then inductances, with current controllers adapted to each estimate. The vector rotates: pole pairs, direction,
flux. Then the rotor search of the firmware is possible, and torque pulses give a first inertia; finally the axis runs
at several speeds under control: friction, load, inertia, and a better flux. Substates, limits and faults are those of
the board.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NoReturn

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.rounding import rounded_down, rounded_up
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD, PERIOD_NS, TICK
from servo_tuning.errors import higher, lower, raised
from servo_tuning.rotor_search import FRICTION_USE, SALIENT_USE

from servo_measurement.access import BoardAccess, MeasurementError, refuse_faults
from servo_measurement.axis_under_test import REST_SPEED
from servo_measurement.dead_time import BAND_MAX, LOST_MIN, band_of, check_band
from servo_measurement.estimation import (
    BAND,
    FLUX_CURRENT_TIME,
    PLAIN_TIME,
    NoVoltageError,
    current_on_vector,
    flux_of,
    friction_angle_of,
    inductance_at_low_current,
    inductances_of,
    lies_on_vector,
    resistance_of,
    rotation_of,
    shaft_follows,
    swing_of,
)
from servo_measurement.log import LoggedAccess, MeasurementLog
from servo_measurement.motor_config import SPEED_USE
from servo_measurement.motor_rig import (
    COMMAND_TIMEOUT,
    LATENCY,
    NOMINAL,
    PROTECTION,
    STOPPED,
    SUPPLY_FAULTS,
    MotorRig,
)
from servo_measurement.motor_values import VOLTAGE_USE, Estimate, Limits
from servo_measurement.rotating_vector import NotFollowingError
from servo_measurement.speed_runs import balance
from servo_measurement.standstill import RESISTANCE_MIN, Ohmic, impedance

FIRST_KP: Final = 0.05  # V/A; stable above 0.03 mH
FIRST_KI: Final = 10.0  # V/(A s); stable above 0.05 ohm
LEVELS: Final = tuple(float(level) for level in np.linspace(0.2, 1.0, 9))
"""Currents for the resistance, relative to the limit."""
VECTOR: Final = 0.7  # current that holds the rotor during its test, relative to the limit
SWEEP: Final[Mapping[str, float]] = {"d": 0.28, "q": 0.2}
"""Amplitudes relative to the current limit, small enough that no phase current changes its sign."""
SWEEPS: Final = 3
VECTOR_LOW: Final = 0.35  # current for the comparison of the inductance, relative to the limit
SWEEP_LOW: Final = 0.2  # amplitude of the test signal there
TURN: Final = "turn"
PULSES: Final = "pulses"
"""Stages that a simulation of the measurement can omit: they begin and end at rest."""
ROUNDS: Final = 7
INDUCTANCE_PART: Final = 0.3  # largest half interval of the first inductance, relative to its value
EXPLAINED_MIN: Final = 0.9  # part of the current explained by a response that is above the noise
SHARE_MIN: Final = 0.1  # the same of a response to which a current can be told that is enough
LOOP: Final = 400.0  # bandwidth of the current loop with known inductance [Hz]
TURN_SLOW: Final = ((4.0 * math.pi, 120.0, 4), (3.0 * math.pi, 30.0, 4), (math.pi, 8.0, 16))
"""Electrical speed [rad/s], acceleration [rad/s^2] and slow ticks per sample, tried in this order until the rotor
follows without a swing: a heavy one slips in a short ramp, or swings for seconds after it. The lower speeds remain
within the least travel."""
TURN_FAST: Final = tuple(2.0 * math.pi * turns for turns in (12.0, 6.0, 3.0, 2.0))
"""Speeds, tried in this order until the rotor follows."""
TURN_FASTER: Final = tuple(2.0 * math.pi * turns for turns in (24.0, 48.0))
"""The same if the voltage of the flux is not seen at these speeds."""
TURN_USE: Final = 0.5  # mean speed of a shaft that swings about the vector, relative to its largest one
TURN_REST: Final = 12.0  # longest wait for the end of a swing before the vector rotates [s]
VISIBLE: Final = 0.06  # smallest voltage of a flux that is seen, relative to the voltage lost in a leg
TURN_RAMP_MAX: Final = 2.2  # longest ramp [s]: with recording and stop less than a recording may take
TURN_EVERY: Final = 2  # slow ticks per sample
TURN_EVERY_HEAVY: Final = 8  # the same for a heavy rotor: the mean speed of several swings
TURN_FAST_SAMPLES: Final = 250
SWING_MAX: Final = 0.25  # largest standard deviation of a swing about the vector, electrical [rad]
CURRENT_MARGIN: Final = 1.2  # of a current that is named to be enough
TURN_SETTLE: Final = 0.1  # [s]
PULSE: Final = 0.5
"""Current of a pulse that turns a shaft with any inertia, relative to the current limit."""
PULSE_FIRST: Final = 0.05  # current of the first pulse beyond the friction, relative to the current limit
PULSE_GROWTH: Final = 2.0  # of the current, from pulse to pulse
PULSE_TIME: Final = 0.1  # longest pulse with less than `PULSE` [s]
PULSE_SPEED: Final = 0.5  # speed limit of the board during the pulses, relative to the largest speed
PULSE_MAX: Final = 1.5  # [s]
LIGHT: Final = 3.0  # smallest ratio of guess and inertia at which the guess is replaced
MOVED: Final = 0.03  # smallest movement of a shaft that is not blocked [rad]
BRAKE_TIME: Final = 0.15  # time constant of the deceleration after a pulse [s]
SPEEDS: Final = (0.3, 0.6, 1.0)
SEARCH_PAUSE: Final = 0.5
"""Wait between the rotor search and the first run [s], because a simulated search can take longer."""
FLUX_CURRENT: Final = 0.4  # d-axis current at constant speed, relative to the limit
FLUX_CURRENT_VOLTAGE: Final = 0.3  # its largest voltage drop, relative to the voltage
PLAIN_EVERY: Final = 2  # slow ticks per sample of a run without that current
HOLD_EVERY: Final = 4  # slow ticks per sample of the recording of that current
HOLD_SAMPLES: Final = round(FLUX_CURRENT_TIME / TICK / HOLD_EVERY)
ROOM_USE: Final = 0.9  # travel used, relative to the distance to the limits
OVERSHOOT: Final = 1.18  # of the speed after a reversal, relative to the set-point
SETTLE: Final = 0.3  # at a new speed [s]
SETTLE_BEFORE: Final = 0.15  # before the speed is changed [s]
SETTLE_HOLD: Final = 0.45  # before a d-axis current: a remaining transient would distort the flux [s]
APPROACH_MAX: Final = 1.2  # longest acceleration time [s]

MODEL_BASED_FAULTS: Final = ("PHASE_LOST", "ENCODER_LOST", "ANGLE_MISMATCH", "STALLED", "CURRENT_SENSE")
"""Faults whose monitors need motor values; the tests at standstill detect their causes themselves."""

REMEDY: Final = (
    ". The board restores configuration and parameters itself when its host is silent and the shaft at rest, and "
    "cannot be enabled before; a restart loads the stored ones"
)

_SPIN: Final = ("position", "speed", "speed_ref", "i_q", "i_d")
_PLAIN: Final = ("position", "i_q", "i_d")
_HELD: Final = ("position", "i_q", "i_d", "u_q", "u_d")


class MotorTest:
    """Identification of the motor of one axis.

    Parameters
    ----------
    access : BoardAccess
        The board, at rest with its outputs off.
    axis : int
        Index of the axis.
    limits : Limits
        Limits of the test.
    base : mapping
        Parsed ``servo.toml`` for entries other than motor values.
    report : callable, optional
        Called with a line of text for each step.
    """

    def __init__(
        self,
        access: BoardAccess,
        axis: int,
        limits: Limits,
        base: Mapping[str, Any],
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.log = MeasurementLog(axis)
        self.log.notes["limits"] = dataclasses.asdict(limits)
        self._rig = MotorRig(LoggedAccess(access, self.log), axis, limits, base, report)
        self._values: dict[str, Estimate] = {}
        self._smallest = 0.0  # current with which the dead time does not hide the winding [A]
        self._resistance = 0.0  # of winding and switch, from two currents [ohm]
        self._band = 0.0  # range of sign changes if it contains all phase currents [A]
        self._inertia_ramp = math.inf  # electrical acceleration after which a heavy rotor swings or slips [rad/s^2]
        self._coasts = False  # whether the bus takes no energy, so that only friction stops the shaft
        self._friction_current = 0.0  # that turns a shaft against its friction, from the rotating vector [A]
        self._current = limits.current  # largest current, reduced if the resistive voltage drop is too large [A]

    # ---- interface ------------------------------------------------------------------------------------------

    def run(self) -> MeasurementLog:
        """Run all tests; afterwards the board is in its initial state, outputs off.

        Failed restorations are in `unrestored` in any case, and are reported.

        Raises
        ------
        MeasurementError, BlockRefusedError
            If a test is not possible; the message contains the remedy.
        """
        self._check()
        rig = self._rig
        rig.keep_protection()
        monitors = rig.access.read_words("param.faults_enabled")[rig.axis]
        rig.access.stage = PROTECTION
        with rig.session([("outputs off and shaft at rest", rig.off)], REMEDY):
            try:
                rig.access.stage = ""
                rig.command_timeout(COMMAND_TIMEOUT)
                # these monitors depend on a resistance and current controllers that are still unknown
                rig.enable_monitors_except(monitors, *MODEL_BASED_FAULTS)
                self._standstill()
                self._rotate()
                # without dead-time compensation, monitors of phases and converters can treat small currents as zero;
                # all phases and converters have been tested by now
                rig.enable_monitors_except(monitors, "PHASE_LOST", "CURRENT_SENSE")
                self._spin()
            finally:
                rig.access.stage = PROTECTION
        return self.log

    @property
    def unrestored(self) -> Sequence[str]:
        """Failed restorations with their causes."""
        return self._rig.unrestored

    @property
    def restoring_text(self) -> str:
        """Text about failed restorations with remedy; empty if there are none."""
        return self._rig.restoring_text(REMEDY)

    # ---- steps -------------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        """Check that the axis can be tested, without writing to the board."""
        rig = self._rig
        states = rig.access.catalogue.enums["state_t"]
        for axis in range(AXES):
            if rig.access.read(f"{axis_name(axis)}.state")[0] != states["RUN"]:
                continue
            reason = (
                "its configuration can only be changed with outputs off"
                if axis == rig.axis
                else "the command timeout of both axes is changed during the test"
            )
            raise MeasurementError(f"{axis_name(axis)} is enabled: disable it first, {reason}")
        rig.check_limits()
        refuse_faults(rig.access, rig.axis, *SUPPLY_FAULTS)
        if (state := rig.label("state")) not in ("STOP", "FAULT"):
            raise MeasurementError(f"{rig.name} is in {state}, not in STOP: wait")
        # after power-on a rotor with cogging oscillates; a load needs time to move the shaft
        if not (rig.reached(rig.is_at_rest, 2.0) and self._remains_at_rest()):
            raise MeasurementError("the shaft moves before the test: remove the load, or balance it")

    def _remains_at_rest(self) -> bool:
        """True if the shaft stays at rest."""
        begin = self._rig.value("position")
        self._rig.wait(0.2)
        return abs(self._rig.value("position") - begin) < MOVED and self._rig.is_at_rest()

    def _standstill(self) -> None:
        rig = self._rig
        current = self._current
        rig.report("holding the rotor: resistance")
        rig.configure(FIRST_KP, FIRST_KI)
        rig.accept_supply()
        rig.mode("TEST")
        rig.command("cmd.speed", 0.0)
        rig.command("cmd.i_q", 0.0)
        rig.enable("TEST", 1.0)
        first, second = (self._held_at(part * current) for part in (VECTOR_LOW, VECTOR))
        # the difference does not contain the voltage lost by dead time and switches
        r = max((second[1] - first[1]) / (second[0] - first[0]), RESISTANCE_MIN)
        self._resistance, self._band = r, band_of(r, rig.lost_voltage)
        voltage_max = VOLTAGE_USE * rig.limits.voltage / math.sqrt(3.0)
        current = self._current = min(rig.limits.current, voltage_max / r)
        self.log.notes["current"] = current
        rig.command("cmd.i_q", VECTOR * current)
        rig.wait(0.1)
        self._first_inductance(r)
        rig.report("holding the rotor: series of currents")
        self._levels()
        found = resistance_of(self.log)
        self._values["r_s"] = Estimate(found.resistance.value - rig.limits.r_on, found.resistance.sigma)
        self._values["dead_voltage"] = found.lost
        self._check_band(found)
        rig.report("holding the rotor: inductances")
        rig.command("cmd.i_q", VECTOR * current)
        rig.wait(0.1)
        for point in ("d", "q"):
            for _ in range(SWEEPS):
                rig.sweep(f"sweep_{point}", point, SWEEP[point] * current)
        self._values.update(inductances_of(self.log, found.resistance.value))
        # smaller d-axis current, for saturation of the iron
        rig.command("cmd.i_q", VECTOR_LOW * current)
        rig.wait(0.1)
        rig.sweep("sweep_d_low", "d", SWEEP_LOW * current)
        smallest = 0.5 * (VECTOR_LOW - SWEEP_LOW) * current
        self.log.notes["comparable"] = smallest > found.band
        self.log.notes["bias"] = {"l_d": VECTOR * current, "l_d_low": VECTOR_LOW * current}

    def _first_inductance(self, r: float) -> None:
        """Adapt the current controllers to the inductance of the d axis."""
        rig = self._rig
        kp = FIRST_KP
        names = f"{rig.name}.i_d", f"{rig.name}.u_d", f"{rig.name}.test_signal"
        for _ in range(ROUNDS):
            recording = rig.sweep("first", "d", SWEEP["d"] * self._current)
            try:
                fit = impedance([recording], names, r, BAND["d"], delay=0.5 * PERIOD, any_resistance=True)
                found, share = fit.inductance, fit.explained
            except (ValueError, np.linalg.LinAlgError):
                found, share = Estimate(kp / (2.0 * math.pi * LOOP), math.inf), 0.0
            explained = share > EXPLAINED_MIN
            known = explained and found.part < INDUCTANCE_PART
            if explained and not known:
                self._refuse_small_current()
                text = f"the inductance is hidden with {self._current:.3g} A by the dead time of the switches"
                self._refuse_signal(text, found.part / INDUCTANCE_PART, "use a supply of a lower voltage")
            if not known and kp == FIRST_KP:  # before the gain is raised: within the range a loop with more oscillates
                self._refuse_small_current(certain=True)
            gain = 2.0 * math.pi * LOOP * found.value if known else 3.0 * kp
            # an integral part faster than the loop would make it oscillate
            rig.configure(gain, gain * min(r / max(found.value, 1e-6), math.pi * LOOP), live=True)
            if known and gain < 4.0 * kp:
                return
            kp = gain
        self._refuse_small_current()
        text = f"the current does not respond to a test signal of {SWEEP['d'] * self._current:.2g} A"
        other = "check the connection of all three motor wires"
        if share < SHARE_MIN:
            raise MeasurementError(text, other, about="test signal")
        # noise is what is not explained; its power relative to the response falls with the square of the current
        noise = (1.0 - share) / share * EXPLAINED_MIN / (1.0 - EXPLAINED_MIN)
        self._refuse_signal(text, math.sqrt(noise), other)

    def _refuse_signal(self, text: str, factor: float, other: str) -> NoReturn:
        """Refuse a test signal that is too small by a factor, with the current that is enough, if there is one."""
        rig = self._rig
        current = rounded_up(CURRENT_MARGIN * factor * self._current)
        needed = current * self._resistance * math.sqrt(3.0) / VOLTAGE_USE
        if current > rig.access.catalogue["param.i_q_limit"].maximum or needed > rig.limits.voltage:
            text = f"{text}, and {current:.3g} A, which could be enough, are beyond the board or its voltage"
            raise MeasurementError(text, other, about="test signal")
        raise MeasurementError(text, higher("--current", current), other, about="test signal")

    def _refuse_small_current(self, *, certain: bool = False) -> None:
        """Raise an error if a too small current is the reason why a test signal has no result.

        Parameters
        ----------
        certain : bool
            Only if the phase currents have not left the range of their sign changes.
        """
        self._levels(settle=0.3)
        found = resistance_of(self.log)
        if not certain or not self._is_complete(found):
            self._check_band(dataclasses.replace(found, band=max(found.band, self._band)))

    def _is_complete(self, found: Ohmic) -> bool:
        """Whether a fit has found the lost voltage; within the range it takes its slope for a resistance."""
        return found.lost.value > LOST_MIN * self._rig.lost_voltage

    def _check_band(self, found: Ohmic) -> None:
        rig = self._rig
        maximum = rig.access.catalogue["param.i_q_limit"].maximum
        complete = self._is_complete(found)
        self._smallest = found.band / BAND_MAX
        check_band(found.band, self._band, self._current, rig.limits, maximum, complete=complete)

    def _levels(self, settle: float = 0.06) -> None:
        rig = self._rig
        for part in LEVELS:
            rig.command("cmd.i_q", part * self._current)
            rig.wait(settle)
            rig.slow("level", ("i_d", "u_d"), 100)

    def _rotate(self) -> None:
        rig = self._rig
        rig.report("rotating vector: pole pairs, direction, flux")
        rig.access.stage = TURN
        rig.command("cmd.i_q", self._current)
        rig.wait(0.1)
        names = ("position", "test_angle", "u_d", "u_q", "i_d", "i_q")
        ramp = self._turn_slowly(names)
        pairs = self._values["pole_pairs"].value
        every = TURN_EVERY if ramp == TURN_SLOW[0][1] else TURN_EVERY_HEAVY
        # the vector was limited as if it turned a shaft with one pole pair
        speed_max = rig.access.catalogue["param.speed_limit"].maximum
        limit = min(TURN_USE * pairs * rig.limits.speed, speed_max)
        rig.write("param.speed_limit", limit / NOMINAL["pole_pairs"])
        self._values.update(self._flux(names, limit, ramp, every))
        self._check_on_vector()
        angle = friction_angle_of(self.log, pairs)
        self._check_friction(angle)
        self._friction_current = self._current * math.sin(angle)
        rig.access.stage = ""
        rig.command("cmd.i_q", 0.0)
        rig.wait(0.05)
        rig.off()

    def _turn_slowly(self, columns: Sequence[str]) -> float:
        """Values of a rotor that follows a slow vector; returns the acceleration with which it does [rad/s^2]."""
        rig, first = self._rig, None
        for electrical, ramp, every in TURN_SLOW:
            last = ramp == TURN_SLOW[-1][1]
            turns = [
                self._record_rotating("turn_slow", columns, 450, every, direction * electrical, ramp)
                for direction in (1.0, -1.0)
            ]
            try:
                found = rotation_of(self.log, self._values["r_s"].value + rig.limits.r_on)
            except NotFollowingError as error:
                first = first or error
                if last:
                    raise first from None
            else:
                pairs = found["pole_pairs"].value
                if last or max(swing_of(one, rig.name, pairs) for one in turns) <= SWING_MAX:
                    self._values.update(found)
                    return ramp
            self._inertia_ramp = ramp
        raise AssertionError

    def _turn_fast(self, columns: Sequence[str], speeds: Sequence[float], ramp: float, every: int) -> float:
        """Rotate the vector with the first of these electrical speeds that the rotor follows; 0: with none [rad/s]."""
        rig, pairs = self._rig, self._values["pole_pairs"].value
        for speed in speeds:
            electrical = min(speed, TURN_RAMP_MAX * ramp)
            while self._turns(electrical, ramp, every) > rig.limits.turns:
                electrical *= 0.95
            recordings = [
                self._record_rotating("turn_fast", columns, TURN_FAST_SAMPLES, every, direction * electrical, ramp)
                for direction in (1.0, -1.0)
            ]
            if all(shaft_follows(one, rig.name, pairs) for one in recordings):
                return electrical
        return 0.0

    def _turns(self, electrical: float, ramp: float, every: int) -> float:
        """Travel to both sides with which the board lets the vector rotate this fast [revolutions].

        It brakes the vector at a position limit as if it turned a shaft with one pole pair.
        """
        pairs = self._values["pole_pairs"].value
        seconds = TURN_SETTLE + TURN_FAST_SAMPLES * every * TICK + LATENCY
        braking = 0.5 * electrical**2 / ramp
        return (braking + (braking + electrical * seconds) / pairs) / (2.0 * math.pi * ROOM_USE)

    def _flux(self, columns: Sequence[str], limit: float, ramp: float, every: int) -> Mapping[str, Estimate]:
        """Flux from rotating vectors, faster ones if its voltage is not seen, up to a speed `limit` [rad/s]."""
        speeds = sorted({min(speed, limit) for speed in TURN_FAST}, reverse=True)
        for faster in (*TURN_FASTER, 0.0):
            reached = self._turn_fast(columns, speeds, ramp, every)
            try:
                found = flux_of(self.log, self._values["l_d"].value, self._values["pole_pairs"].value)
                if found["psi_m"].value * reached > VISIBLE * self._values["dead_voltage"].value:
                    return found
            except NoVoltageError:
                pass
            if reached < speeds[0] or speeds[0] >= min(faster, limit):
                break
            speeds = [min(faster, limit)]
        raise self._flux_not_seen(reached, ramp, every)

    def _flux_not_seen(self, reached: float, ramp: float, every: int) -> MeasurementError:
        """Refusal of a flux that is not seen at a speed [rad/s], with the options for a faster vector, if possible."""
        limits, maximum = self._rig.limits, self._rig.access.catalogue["param.speed_limit"].maximum
        electrical = TURN_FASTER[0]
        wanted = {
            "--turns-max": (limits.turns, rounded_up(self._turns(electrical, ramp, every))),
            "--speed-max": (limits.speed, rounded_up(electrical / (TURN_USE * self._values["pole_pairs"].value))),
        }
        possible = reached < electrical <= min(TURN_RAMP_MAX * ramp, maximum) and wanted["--speed-max"][1] <= maximum
        remedy = raised(wanted) if possible else None
        return MeasurementError(str(NoVoltageError()), *([remedy] if remedy is not None else []), about="flux")

    def _check_on_vector(self) -> None:
        along, across = self._values["l_d"], self._values["l_q"]
        total = self._values["r_s"].value + self._rig.limits.r_on
        low = inductance_at_low_current(self.log, total)
        certain = self.log.notes["comparable"] or along.value > across.value
        if lies_on_vector(along, across, low if certain else None):
            return
        held, flux = VECTOR * self._current, self._values["psi_m"].value
        largest = SALIENT_USE * current_on_vector(along.value, across.value, held, flux, self._current)
        text = (
            f"the reluctance of the rotor turns it off a current vector of {held:.2g} A: the inductance is"
            f" {along.value:.3g} H along the vector and {across.value:.3g} H across it"
        )
        if largest < self._smallest:
            text = f"{text}, and below {self._smallest:.2g} A the dead time hides the winding"
            raise MeasurementError(text, "add inductance to the motor cable", about="reluctance")
        raise MeasurementError(text, lower("--current", rounded_down(largest)), about="reluctance")

    def _check_friction(self, angle: float) -> None:
        """Check the angle by which friction holds the rotor off the vector [rad, electrical]: a search needs less."""
        if angle <= FRICTION_USE:
            return
        rig = self._rig
        current = rounded_up(CURRENT_MARGIN * angle / FRICTION_USE * self._current)
        text = f"friction holds the rotor {angle:.2g} rad (electrical) off a current vector of {self._current:.3g} A"
        saliency = self._values["l_q"].value - self._values["l_d"].value
        largest = SALIENT_USE * self._values["psi_m"].value / saliency if saliency > 0.0 else math.inf
        if current > largest:
            text = f"{text}, and above about {largest:.2g} A the reluctance of the rotor does"
            raise MeasurementError(text, "reduce the friction", about="friction")
        needed = current * (self._values["r_s"].value + rig.limits.r_on) * math.sqrt(3.0) / VOLTAGE_USE
        maximum = rig.access.catalogue["param.i_q_limit"].maximum
        if current > maximum or needed > rig.limits.voltage:
            text = f"{text}, and {current:.3g} A are beyond the board or its voltage"
            raise MeasurementError(text, "reduce the friction", about="friction")
        raise MeasurementError(text, higher("--current", current), about="friction")

    def _spin(self) -> None:
        rig = self._rig
        rig.report("torque pulses: first inertia")
        rig.access.stage = PULSES
        pairs, psi = round(self._values["pole_pairs"].value), self._values["psi_m"].value
        torque = 1.5 * pairs * psi * rig.limits.current
        motor = {
            **{name: self._values[name].value for name in ("l_d", "l_q", "psi_m", "pole_pairs")},
            "r_s": self._values["r_s"].value + rig.limits.r_on,
            "inertia": torque * max(1.0 / 3000.0, SWING_MAX * pairs / self._inertia_ramp),
            "friction": 0.02 * torque,
            "viscous": 0.0,
        }
        self._prepare_pulses(motor)
        inertia, coulomb = self._pulses(motor)
        rig.off()
        rig.access.stage = ""
        motor |= {"inertia": inertia, "friction": min(max(coulomb, 0.0), 0.5 * torque)}
        rig.report("running at several speeds")
        table = rig.fitted(motor, inertia_known=True)
        rig.configure_for(table)
        for name in ("speed", "acceleration"):
            rig.write(f"param.{name}_limit", table[rig.name]["limits"][name])
        rig.mode("SPEED")
        rig.command("cmd.speed", 0.0)
        rig.search_rotor()
        rig.wait(SEARCH_PAUSE)
        limits = table[rig.name]["limits"]
        braking = min(limits["acceleration"], max(coulomb, 0.01 * torque) / inertia)
        self._speeds(limits, inertia, braking if self._coasts else limits["acceleration"])
        rig.off()

    def _prepare_pulses(self, motor: Mapping[str, float]) -> None:
        rig = self._rig
        rig.configure_for(rig.fitted(motor, inertia_known=False))
        rig.mode("TORQUE")
        rig.write("param.speed_limit", PULSE_SPEED * self._speed_max())
        rig.command("cmd.i_q", 0.0)
        rig.search_rotor()

    def _pulses(self, motor: Mapping[str, float]) -> tuple[float, float]:
        """Inertia and Coulomb friction from torque in both directions; `motor` has a guess of the inertia."""
        rig = self._rig
        torque_constant = 1.5 * motor["pole_pairs"] * motor["psi_m"]
        travel_max, target = 0.25 * rig.limits.turns * 2.0 * math.pi, 0.25 * self._speed_max()
        # upwards, because a light shaft runs away with the current that a heavy one needs
        part, direction = min(self._friction_current / rig.limits.current + PULSE_FIRST, PULSE), 1.0
        while True:
            current, longest = part * rig.limits.current, PULSE_TIME if part < PULSE else PULSE_MAX
            start, begin = rig.value("position"), rig.access.read("tick")[0]
            rig.command("cmd.i_q", direction * current)
            seconds = reached = moved = 0.0
            while seconds < longest and moved < travel_max and (reached < target or moved < MOVED):
                rig.wait(0.002)
                reached = abs(rig.value("speed"))
                seconds = ((rig.access.read("tick")[0] - begin) % 2**32) * PERIOD_NS * 1e-9
                moved = abs(rig.value("position") - start)
            pushing, slowed = abs(rig.value("i_q")), rig.is_limited("SPEED")
            rig.command("cmd.i_q", 0.0)
            refuse_faults(rig.access, rig.axis)
            largest = torque_constant * current * seconds / max(reached, 1.0)
            if moved >= MOVED and largest < motor["inertia"] / LIGHT:
                # with the gains for a heavier shaft the speed limits of the board would make this one oscillate
                rig.off()
                motor = {**motor, "inertia": largest / 4}
                self._prepare_pulses(motor)
                continue
            braking = current * seconds / (max(reached, 1.0) * BRAKE_TIME)
            self._brake(braking, current)
            direction = -direction  # the shaft remains near the middle of its limits
            if moved >= MOVED and (reached >= target or part >= PULSE):
                break
            if part >= 1.0 and slowed:
                first = self._friction_current + PULSE_FIRST * rig.limits.current
                self._refuse_slow(min(PULSE * rig.limits.current, CURRENT_MARGIN * first) / max(pushing, 1e-3))
            if part >= 1.0:
                raise MeasurementError(
                    "the shaft does not move at full torque: it is blocked, or the load is too large"
                )
            part = min(PULSE_GROWTH * part, PULSE if part < PULSE else 1.0)
        seconds = max(seconds, 0.01)
        every = max(math.ceil(4.5 * seconds / TICK / rig.capacity(_SPIN)), 1)
        samples = max(int(2.2 * seconds / TICK / every), 12)
        recordings = []
        for first in (direction, -direction):

            def pulse(direction: float = first) -> None:
                rig.start_signal("D")
                for part_of_time, torque in ((1.0, direction), (0.7, -direction)):
                    rig.command("cmd.i_q", torque * current)
                    rig.wait(part_of_time * seconds)
                rig.command("cmd.i_q", 0.0)
                rig.wait(max(samples * every * TICK - 1.7 * seconds, 0.0))
                self._brake(braking, current)

            rig.mark()
            recordings.append(rig.slow("pulse", _SPIN, samples, every, pulse))
        found, coulomb = balance(
            recordings, rig.name, (round(motor["pole_pairs"]), motor["psi_m"], motor["l_d"], motor["l_q"]), None
        )
        if found.value <= 0.0:
            raise MeasurementError(
                "torque pulses give no inertia: the shaft is blocked, or an external torque acts on it"
            )
        return found.value, coulomb.value

    def _refuse_slow(self, factor: float) -> None:
        """Refuse a speed limit near which the board leaves too little current, if it can be raised by a factor."""
        speed = rounded_up(factor * self._rig.limits.speed)
        if speed <= min(self._speed_of_voltage(), self._rig.access.catalogue["param.speed_limit"].maximum):
            text = "the shaft does not move with the current that the board permits near the speed limit"
            raise MeasurementError(text, higher("--speed-max", speed), about="speed limit")

    def _brake(self, gain: float, maximum: float) -> None:
        """Stop the shaft by torque.

        Parameters
        ----------
        gain : float
            Current over speed [A s/rad].
        maximum : float
            Largest current [A].
        """
        rig = self._rig
        for _ in range(400):
            speed = rig.value("speed")
            if abs(speed) < 2.0 * REST_SPEED:
                break
            rig.command("cmd.i_q", -math.copysign(min(gain * abs(speed), maximum), speed))
            rig.wait(0.005)
            self._coasts = self._coasts or rig.is_limited("REGENERATION")
        rig.command("cmd.i_q", 0.0)
        rig.wait_for_rest()

    def _speeds(self, limits: Mapping[str, float], inertia: float, deceleration: float) -> None:
        rig = self._rig
        acceleration = limits["acceleration"]
        maximum = min(limits["speed"], self._speed_max(), rig.limits.speed / OVERSHOOT)
        # a reversal feeds the kinetic energy of the shaft back into the bus
        maximum = min(maximum, math.sqrt(2.0 * rig.limits.energy / inertia))
        maximum = min(maximum, APPROACH_MAX * acceleration)
        # each recording begins and ends at rest, and the direction alternates
        travel_max = ROOM_USE * rig.travel
        longest = max(SETTLE + PLAIN_TIME, SETTLE_HOLD + FLUX_CURRENT_TIME) + LATENCY
        per_square = 0.5 / acceleration + 0.5 / deceleration
        while (room := maximum * longest + maximum**2 * per_square) > travel_max:
            maximum *= 0.95
        r = self._values["r_s"].value + rig.limits.r_on
        flux_current = min(
            FLUX_CURRENT * rig.limits.current, FLUX_CURRENT_VOLTAGE * rig.limits.voltage / math.sqrt(3.0) / r
        )
        self.log.notes["runs"] = {
            "speed": maximum,
            "speed_of_voltage": self._speed_of_voltage(),
            "inertia": inertia,
            "travel": [longest, per_square],
        }
        before = 0.0
        for part in SPEEDS:
            speeds = [direction * part * maximum for direction in (1.0, -1.0)]
            for speed in speeds:
                rig.make_room(room, room, maximum, acceleration)  # from one direction to the other
                seconds = abs(speed - before) / acceleration + SETTLE
                every = math.ceil(seconds / TICK / rig.capacity(_SPIN))
                change = partial(rig.command, "cmd.speed", speed)
                times = abs(before) / acceleration + SETTLE_BEFORE, abs(speed) / acceleration + STOPPED
                rig.moving("speed", _SPIN, int(seconds / TICK / every), every, before, times, change)
                before = speed
            for speed in speeds:
                turn = math.copysign(room, speed)
                rig.make_room(max(-turn, 0.0), max(turn, 0.0), maximum, acceleration)
                ramp = abs(speed) / acceleration
                times = ramp + SETTLE, ramp + STOPPED
                rig.moving("plain", _PLAIN, round(PLAIN_TIME / TICK / PLAIN_EVERY), PLAIN_EVERY, speed, times)
            for speed in speeds:
                turn = math.copysign(room, speed)
                rig.make_room(max(-turn, 0.0), max(turn, 0.0), maximum, acceleration)
                # With a d-axis current the phase currents are rarely near zero, where the dead-time voltage is
                # uncertain. This voltage lags the current; with a current of the other sign the lag has the opposite
                # effect. A period of a slow sine has both signs, and no steps.
                ramp = abs(speed) / acceleration
                times = ramp + SETTLE_HOLD, ramp + STOPPED
                rig.signal("D", flux_current, 1.0 / FLUX_CURRENT_TIME, 1.0 / FLUX_CURRENT_TIME, FLUX_CURRENT_TIME)
                begin = partial(rig.start_signal, "D")
                rig.moving("hold", _HELD, HOLD_SAMPLES, HOLD_EVERY, speed, times, begin, mark=False)
                rig.wait(TICK)

    def _record_rotating(
        self, label: str, columns: Sequence[str], samples: int, every: int, electrical: float, ramp: float
    ) -> Trace:
        """A recording with a vector rotating at an electrical speed [rad/s], after an acceleration [rad/s^2]."""
        self._rig.write("param.acceleration_limit", ramp / NOMINAL["pole_pairs"])
        self._rig.reached(self._remains_at_rest, TURN_REST)
        times = abs(electrical) / ramp + TURN_SETTLE, abs(electrical) / ramp + STOPPED
        return self._rig.moving(label, columns, samples, every, electrical / NOMINAL["pole_pairs"], times)

    def _held_at(self, current: float) -> tuple[float, float]:
        """Mean current [A] and voltage [V] with a rotor held by this current [A]."""
        self._rig.command("cmd.i_q", current)
        self._wait_for_current(current, 4.0)
        self._rig.wait(0.3)
        columns = self._rig.slow("ratio", ("i_d", "u_d"), 100).columns
        i_d, u_d = (float(np.nanmean(column)) for column in columns.values())
        return i_d, u_d

    def _wait_for_current(self, current: float, seconds: float) -> None:
        """Wait until the current is reached."""
        rig = self._rig
        if rig.reached(lambda: abs(rig.value("i_d") - current) < 0.05 * current + 0.02, seconds):
            return
        measured, volts = rig.value("i_d"), rig.value("u_d")
        text = f"the current is {measured:.2f} A instead of {current:.2f} A at {volts:.1f} V"
        voltage_max = VOLTAGE_USE * rig.limits.voltage / math.sqrt(3.0)
        largest = voltage_max * measured / volts if volts > 0.0 else 0.0
        if largest < rig.access.catalogue["param.i_q_limit"].minimum:
            raise MeasurementError(f"{text}: the winding is open; check the wires")
        if volts < voltage_max:
            raise MeasurementError(f"{text}: it does not settle, although the bus voltage is enough; check the wires")
        text = f"{text}: the resistance of the winding is too high for the bus voltage, or a wire has a bad contact"
        raise MeasurementError(text, lower("--current", rounded_down(largest)), about="resistance")

    def _speed_max(self) -> float:
        return min(self._rig.limits.speed, self._speed_of_voltage())

    def _speed_of_voltage(self) -> float:
        """Largest speed of the runs with the voltage of the bus [rad/s]."""
        flux = self._values["pole_pairs"].value * self._values["psi_m"].value
        return SPEED_USE * self._rig.limits.voltage / math.sqrt(3.0) / flux
