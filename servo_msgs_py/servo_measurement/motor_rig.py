"""Axis with an unknown motor: protection and configuration during its tests, and recordings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import send_configuration
from servo_msgs_py.rounding import rounded_up
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD, TICK
from servo_tuning.configuration import Scales
from servo_tuning.errors import ConfigError, Table, exactly, higher, lower
from servo_tuning.formats import GAIN
from servo_tuning.schema import BOARD_GROUPS

from servo_measurement.access import Capture, MeasurementError, refuse_faults
from servo_measurement.axis_under_test import HELD_SPEED, AxisUnderTest
from servo_measurement.log import LoggedAccess
from servo_measurement.motor_config import SPEED_RATIO, configured, corrected, fitted, supply
from servo_measurement.motor_values import VOLTAGE_USE, Limits
from servo_measurement.test_signal import TRIGGER, SweptSine, prepare_test_signal, start_test_signal

PROTECTION: Final = "protection"
"""Stage of a log: limits around the position of the shaft, and restoration; specific to one board."""
_REVOLUTIONS_MIN: Final = 3.0  # in each direction: rotation by a rotating vector with one pole pair
LATENCY: Final = 0.1
"""Communication time on a serial line during which a shaft continues to rotate [s]."""
_ROOM_RUNS: Final = 3  # largest number of runs to the middle of the limits
STOPPED: Final = 0.1  # wait after the set-point has reached 0 [s]
SPEED_MIN: Final = 5.0  # [rad/s]
VOLTAGE_TOLERANCE: Final = 0.2  # largest relative difference of bus voltage and --voltage
SEARCHES: Final = 3
SEARCH_FAULTS: Final = ("ENCODER_REVERSED", "ROTOR_SEARCH")
_SUPPLY_SETTLES: Final = 0.05  # filter of the bus voltage with new thresholds [s]
COMMAND_TIMEOUT: Final = 1.0
"""Timeout of set-points after which the board stops the shaft [s]: longer than any pause on a slow line."""
NOMINAL: Final[Mapping[str, float]] = {
    "r_s": 0.5,
    "l_d": 4e-3,
    "l_q": 4e-3,
    "psi_m": 0.015,
    "pole_pairs": 1.0,
    "inertia": 1e-5,
    "friction": 0.0,
    "viscous": 0.0,
}
"""Motor values before any measurement; only the current controllers use them, with other gains."""

CURRENT_STEP: Final = 1.5  # between currents that are tried for a remedy
_MARK: Final = 0.1
"""Length of a test signal with zero amplitude, which marks the beginning of a recording [s]."""
_SAMPLES: Final = 1280
_SWEEP_CALLS: Final = 1100  # length of a test signal; the remaining samples contain its decay
_SWEEP_BAND: Final = (150.0, 3000.0)  # [Hz]
SUPPLY_FAULTS: Final = ("UNDER_VOLTAGE", "OVER_VOLTAGE")
"""Faults by thresholds that follow the voltage given by the user."""


class MotorRig(AxisUnderTest):
    """The axis, within limits given by the user and enforced by the board.

    Parameters are those of `MotorTest`.
    """

    access: LoggedAccess

    def __init__(
        self, access: LoggedAccess, axis: int, limits: Limits, base: Mapping[str, Any], report: Callable[[str], None]
    ) -> None:
        super().__init__(access, axis, report)
        self.limits = limits
        # the board keeps its own brake resistor and limits of regeneration; no block depends on them
        kept = {key: value for key, value in base["board"].items() if key not in BOARD_GROUPS}
        self._base = {**base, "board": kept}
        self._low = self._high = 0.0  # position limits [rad]
        self._over_speed = math.inf  # over-speed threshold of the board [rad/s]
        self._protection_features = 0  # protective features enabled by the user

    @property
    def dead_time(self) -> float:
        """Time with both switches of a leg open, per edge [s]."""
        return self.access.catalogue.board.dead_time

    @property
    def lost_voltage(self) -> float:
        """Nominal voltage lost in a leg by dead time and drop [V]."""
        return self.dead_time / PERIOD * self.limits.voltage + self.access.catalogue.board.switch_drop

    # ---- protection --------------------------------------------------------------------------------------------------

    def check_limits(self) -> None:
        """Check current and voltage given by the user against board and supply."""
        limit, current = self.access.catalogue["param.i_q_limit"], self.limits.current
        if not limit.minimum <= current <= limit.maximum:
            bound = higher("--current", limit.minimum) if current < limit.minimum else lower("--current", limit.maximum)
            span = f"{limit.minimum:g} .. {limit.maximum:g} A"
            raise MeasurementError(
                f"--current {current:g} is outside the range of the board, {span}", bound, about="current"
            )
        if self.limits.speed < SPEED_MIN:
            raise MeasurementError(
                f"{self.limits.speed:g} rad/s is too slow for the test", higher("--speed-max", SPEED_MIN), about="speed"
            )
        volts, nominal = self.access.read("u_dc")[0], self.limits.voltage
        if abs(volts / nominal - 1.0) > VOLTAGE_TOLERANCE:
            text = f"the bus voltage is {volts:.3g} V, --voltage is {nominal:g} V: check the supply"
            remedy = exactly("--voltage", float(f"{volts:.3g}"))
            raise MeasurementError(f"{text}, or correct --voltage", remedy, about="voltage")
        before, now = (board["over_voltage"] for board in (self._base["board"], supply(self._base["board"], nominal)))
        if now > before:
            self.report(
                f"the over-voltage threshold is raised from {before:g} V to {now:g} V for --voltage {nominal:g}"
            )

    def keep_protection(self) -> None:
        """Respect the existing protection of the axis; a `MeasurementError` if its limits are too narrow."""

        def found(parameter: str) -> float:
            return self.access.read(f"param.{parameter}")[self.axis]

        catalogue, flags, features = self.access.catalogue, self.masks("features"), int(found("features"))
        self._protection_features = features & flags["OVER_SPEED"]
        speed = min(self.limits.speed, found("speed_limit"))
        if self._protection_features:
            self._over_speed = found("over_speed")
            speed = min(speed, self._over_speed / SPEED_RATIO)
        position, travel = self.value("position"), 2.0 * math.pi * self.limits.turns
        self._low = max(position - travel, catalogue["param.position_min"].minimum)
        self._high = min(position + travel, catalogue["param.position_max"].maximum)
        if features & flags["POSITION_LIMITS"]:
            self._low = max(self._low, found("position_min"))
            self._high = min(self._high, found("position_max"))
        turns = self.free_travel / (2.0 * math.pi)
        if turns < _REVOLUTIONS_MIN * (1.0 - 1e-6):
            text = f"{max(turns, 0.0):.3g} revolutions in each direction are too few, required are {_REVOLUTIONS_MIN:g}"
            if self.limits.turns < _REVOLUTIONS_MIN:
                raise MeasurementError(text, higher("--turns-max", _REVOLUTIONS_MIN), about="turns")
            raise MeasurementError(f"{text}: widen param.position_min and param.position_max")
        self.limits = dataclasses.replace(self.limits, speed=speed, turns=turns)

    def accept_supply(self) -> None:
        """Clear the faults of a bus voltage that is within the limits of the configuration of the test."""
        if self.label("state") == "FAULT":
            self.wait(_SUPPLY_SETTLES)
            self.clear_faults()
        refuse_faults(self.access, self.axis)

    def clear_faults(self) -> None:
        """Clear the faults of the axis, and wait until they are gone, or up to a second."""
        self.write_word("cmd.clear_faults", 1)
        self.reached(lambda: self.label("state") == "STOP", 1.0, refuse_on_fault=False)

    @property
    def free_travel(self) -> float:
        """Distance to the nearer limit [rad]."""
        position = self.value("position")
        return min(position - self._low, self._high - position)

    @property
    def travel(self) -> float:
        """Distance from the middle of the limits to each of them [rad]."""
        return 0.5 * (self._high - self._low)

    def make_room(self, below: float, above: float, speed: float, acceleration: float) -> None:
        """Wait until the shaft is held at rest; run to the middle of the limits if one is nearer than its room [rad].

        The recordings do not end where they began; slow ramps add up. With a bus that takes no energy the shaft coasts:
        from the distance of the first run it is known how far.
        """
        coasting = 0.0  # distance over the square of the speed [s^2/rad]
        for run in range(_ROOM_RUNS + 1):
            self.wait_for_rest(HELD_SPEED)
            position = self.value("position")
            if position - self._low >= below and self._high - position >= above:
                return
            if run == _ROOM_RUNS:
                text = f"{run} runs have not led to the middle of {self.limits.turns:.3g} revolutions to each side"
                raise MeasurementError(text, "raise --turns-max", about="turns")
            way = 0.5 * (self._low + self._high) - position
            top = min(speed, math.sqrt(abs(way) * acceleration))
            if coasting:
                top = min(top, math.sqrt(0.5 * abs(way) / coasting))
            driven = abs(way) - coasting * top**2
            self.command("cmd.speed", math.copysign(top, way))
            self.wait(driven / top)
            self.command("cmd.speed", 0.0)
            self.wait(top / acceleration + STOPPED)
            self.wait_for_rest(HELD_SPEED)
            coasting = max(abs(self.value("position") - position) - driven, 0.0) / top**2

    def enable_monitors_except(self, monitors: int, *faults: str) -> None:
        """Enable these monitors except for some faults; monitors disabled for a simulated board remain off."""
        masks = self.masks("faults")
        stage, self.access.stage = self.access.stage, PROTECTION
        self.write_word("param.faults_enabled", monitors & ~sum(masks[name] for name in faults))
        self.access.stage = stage

    def search_rotor(self) -> None:
        """Enable with a rotor search. Its faults are excluded by the rotating vector: it is repeated.

        The dead time is compensated meanwhile: with a small current it delays the current by more than the search
        permits.
        """
        features = int(self.access.read("param.features")[self.axis])
        self.write_word("param.features", features | self.masks("features")["DEAD_TIME"])
        for _ in range(SEARCHES - 1):
            self.refuse_ended_session()
            self.write_word("cmd.enable", 1)
            self.reached(lambda: self.substate == "SPIN" or self.label("state") == "FAULT", 8.0, refuse_on_fault=False)
            if self.substate == "SPIN":
                break
            refuse_faults(self.access, self.axis, *SEARCH_FAULTS)
            self.write_word("cmd.enable", 0)
            self.clear_faults()
        else:
            self.enable("SPIN", 8.0)
        self.write_word("param.features", features)

    # ---- configuration -----------------------------------------------------------------------------------------------

    def configure(self, kp: float, ki: float, *, live: bool = False) -> None:
        """Configure current controllers with these gains [V/A], [V/(A s)]."""
        scales = Scales.of(self.access.catalogue)
        to = scales.i / scales.u_s
        raw = {"kp": round(math.ldexp(kp * to, 24)), "ki": max(round(math.ldexp(ki * PERIOD * to, 24)), 1)}
        maximum = GAIN.raw_range[1] // 4
        gains = {f"current_loop.{axis}.{gain}": min(value, maximum) for axis in "dq" for gain, value in raw.items()}
        self._send(configured(self._base, self.axis, self.limits, NOMINAL), gains)
        if not live:
            self._features()

    def configure_for(self, table: Mapping[str, Any]) -> None:
        """Send the configuration of a motor, from `fitted`."""
        self._send(table, {})
        self._features()

    def fitted(self, motor: Mapping[str, float], *, inertia_known: bool) -> Table:
        """``servo.toml`` with the bandwidths possible for a motor; its values in SI by name."""
        try:
            return self._fitted(self.limits, motor, inertia_known)
        except ConfigError as error:
            text = f"the controller cannot be tuned for the test: {error.problem.fact}"
            current = self._tunable_current(motor, inertia_known)
            remedies = [] if current is None else [higher("--current", current)]
            raise MeasurementError(text, *remedies, about="tuning") from None

    def _fitted(self, limits: Limits, motor: Mapping[str, float], inertia_known: bool) -> Table:
        return fitted(
            self._base, self.axis, limits, motor, slow_loops=True, inertia_known=inertia_known, attend=self.attend
        )

    def _tunable_current(self, motor: Mapping[str, float], inertia_known: bool) -> float | None:
        """A current limit with which the controller can be tuned, if the board and its voltage can do it [A]."""
        limits = self.limits
        of_torque = () if inertia_known else ("inertia", "friction")  # guesses
        of_voltage = VOLTAGE_USE * limits.voltage / math.sqrt(3.0) / motor["r_s"]
        largest = min(self.access.catalogue["param.i_q_limit"].maximum, of_voltage)
        factor = CURRENT_STEP
        while (current := rounded_up(factor * limits.current)) <= largest:
            changed = {**motor, **{name: factor * motor[name] for name in of_torque}}
            try:
                self._fitted(dataclasses.replace(limits, current=current), changed, inertia_known)
            except ConfigError:
                factor *= CURRENT_STEP
            else:
                # more, because the values of the motor change with the current
                return current if CURRENT_STEP * current > largest else rounded_up(CURRENT_STEP * current)
        return None

    def _send(self, table: Mapping[str, Any], members: Mapping[str, int]) -> None:
        """Send a configuration to the board, with some members of the block replaced."""
        try:
            block = {**corrected(table, self.axis, self.attend)[1].block, **members}
        except ConfigError as error:
            raise MeasurementError(f"the controller cannot be tuned for the test: {error}") from None
        AxisConfigTable.load().check(block)
        self.refuse_ended_session()
        self.wait(0.0)  # refreshes the set-point before and after this long exchange
        send_configuration(self.access, {self.axis: block})
        self.wait(0.0)
        self.write("param.i_q_limit", self.limits.current)

    def _features(self) -> None:
        """Enable features for exact voltages, no compensation of measured effects; and protection."""
        flags = self.masks("features")
        plain = flags["BUS_COMPENSATION"] | flags["ANTI_WINDUP"] | flags["ENHANCED_MT"]
        self.write_word("param.features", plain)
        stage, self.access.stage = self.access.stage, PROTECTION
        self.write("param.position_min", self._low)
        self.write("param.position_max", self._high)
        if self._protection_features:
            self.write("param.over_speed", min(self._over_speed, SPEED_RATIO * self.limits.speed))
        self.write_word("param.features", plain | flags["POSITION_LIMITS"] | self._protection_features)
        self.access.stage = stage

    # ---- recordings --------------------------------------------------------------------------------------------------

    def capacity(self, columns: Sequence[str]) -> int:
        return self.access.capacity([f"{self.name}.{column}" for column in columns])

    def signal(self, point: str, amplitude: float, f_min: float, f_max: float, seconds: float) -> None:
        """Write a test signal on a current: amplitude [A], band [Hz], length [s]."""
        prepare_test_signal(self.access, self.axis, SweptSine(f"I_{point}", amplitude, f_min, f_max, seconds))

    def mark(self) -> None:
        """Write a test signal that only marks the beginning of a recording."""
        self.signal("D", 0.0, 1.0, 1.0, _MARK)

    def start_signal(self, point: str) -> None:
        start_test_signal(self.access, self.axis, f"I_{point}")

    def sweep(self, label: str, point: str, amplitude: float) -> Trace:
        """A swept sine on a current, of `amplitude` [A], sampled by the fast loop."""
        self.signal(point.upper(), amplitude, *_SWEEP_BAND, _SWEEP_CALLS * PERIOD)
        columns = (f"i_{point}", f"u_{point}", "test_signal")
        self.access.label = label
        return self.record(Capture(columns, _SAMPLES, start=partial(self.start_signal, point.upper()), trigger=TRIGGER))

    def slow(
        self,
        label: str,
        columns: Sequence[str],
        samples: int,
        every: int = 1,
        start: Callable[[], None] | None = None,
        lead: float = 0.0,
    ) -> Trace:
        """A recording of the slow loop; with `start` it begins at a test signal, at least `lead` [s] later."""
        self.access.label = label
        capture = Capture(columns, samples, every, slow=True)
        return self.record(
            capture if start is None else dataclasses.replace(capture, start=start, trigger=TRIGGER, lead=lead)
        )

    def moving(
        self,
        label: str,
        columns: Sequence[str],
        samples: int,
        every: int,
        speed: float,
        times: tuple[float, float],
        begin: Callable[[], None] = lambda: None,
        *,
        mark: bool = True,
    ) -> Trace:
        """A recording that begins at a constant speed [rad/s]; the shaft stops before the samples are read.

        Parameters
        ----------
        times : tuple of float
            Times for acceleration and for stopping [s].
        begin : callable
            Called at the first sample.
        mark : bool
            Whether a test signal with zero amplitude marks the first sample; otherwise `begin` starts one.
        """

        def start() -> None:
            self.command("cmd.speed", speed)
            self.wait(times[0])
            if mark:
                self.start_signal("D")
            begin()
            self.wait((samples * every + 4) * TICK)
            self.command("cmd.speed", 0.0)
            self.wait(times[1])

        if mark:
            self.mark()
        return self.slow(label, columns, samples, every, start, times[0])
