"""Consistency checks between entries of the configuration."""

from __future__ import annotations

import itertools
import math
from typing import Final

from servo_msgs_py.catalogue import Catalogue, Variable
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.configuration import FEEDBACKS, Axis, Board, Configuration, Scales
from servo_tuning.constants import SIGN_FACTOR, SIGN_USE, SILENT_USE, dead_time_current, ripple_current, sign_current
from servo_tuning.errors import ConfigError, Remedy, higher, lower
from servo_tuning.field_weakening import idle_speed
from servo_tuning.gains import CURRENT_SAMPLES_MIN
from servo_tuning.rotor_search import check_rotor_search
from servo_tuning.schema import AXIS_GROUPS
from servo_tuning.sensorless_checks import check_observer_entries
from servo_tuning.winding import check_winding

RANGE_USE: Final = 0.8
"""Largest current with its ripple, over the range of the current sensors; the comparators trip in the rest."""

LOST_VOLTAGE_TIME: Final = 2.1e-3
"""Time until a speed loop of 75 Hz answers [s]."""
LOST_VOLTAGE_COUNTS_MAX: Final = 25.0
"""Largest movement of a shaft by dead time and switch drops. Of 12 random motors on the switching plant with 26 and
more, 11 oscillated by 10 .. 900 counts or had a fault; of 10 with less, three did."""

COUNT_TIME_FILTERS: Final = 2.0
"""Shortest time between two counts over that of the input filters of the encoders; half of a level is left for
tolerances of the encoder."""


def check(configuration: Configuration, catalogue: Catalogue) -> None:
    """Check everything that does not depend on the gains.

    Raises
    ------
    ConfigError
        If the configuration cannot work.
    """
    board = configuration.board
    _board(board, configuration.scales, catalogue)
    for axis in configuration.axes:
        _contract(axis, catalogue)
    if board.complete:
        _bus(configuration)
    for axis in configuration.axes:
        _axis(axis, board)
        _direction(axis, board)
        _voltage(axis, board)
        _order(axis, board)
        _ripple(axis, board, configuration.scales)
        _lost_voltage(axis, board)
        check_rotor_search(axis, board)
        _stops(axis, configuration.scales)
        check_winding(axis)
        check_observer_entries(axis)
        _home(axis)


def _board(board: Board, scales: Scales, catalogue: Catalogue) -> None:
    """Check voltages and timeouts."""
    for key in ("nominal_voltage", "over_voltage"):
        if board(key) >= scales.u_dc:
            reason = f"not below {scales.u_dc:g} V, the largest bus voltage of the board {board.description.name}"
            raise board.refused(key, reason, lower(f"board.{key}"))
    order = ("under_voltage", "nominal_voltage", "over_voltage")
    for below, above in itertools.pairwise(order):
        if board(below) >= board(above):
            reason = f"not below {above} = {board(above):g} V"
            raise board.refused(below, reason, lower(f"board.{below}"), higher(f"board.{above}"))
    most = board.description.voltage_use_max
    if board("voltage_use") > most:
        reason = f"the board {board.description.name} samples currents with {most:.4g} or less"
        raise board.refused("voltage_use", reason, lower("board.voltage_use", most))
    for key in ("host_timeout", "command_timeout"):
        timeout = catalogue[f"param.{key}"]
        if not timeout.minimum <= board(key) <= timeout.maximum:
            reason = f"outside the range {timeout.minimum:g} .. {timeout.maximum:g} s of param.{key}"
            raise board.refused(key, reason, _into(f"board.{key}", board(key), timeout))


def _contract(axis: Axis, catalogue: Catalogue) -> None:
    """Check that the defaults lie within the ranges of the table of variables."""
    names = {"current": "i_q_limit", "speed": "speed_limit", "acceleration": "acceleration_limit"}
    names |= {"position": "position_max", "following_error": "following_error", "over_speed": "over_speed"}
    for key, name in names.items():
        variable, value = catalogue[f"param.{name}"], axis(f"limits.{key}")
        if not variable.minimum <= value <= variable.maximum:
            span = f"{variable.minimum:g} .. {variable.maximum:g} {variable.unit}"
            reason = f"outside the range {span} of param.{name}"
            raise axis.refused(f"limits.{key}", reason, _into(f"limits.{key}", value, variable))


def _into(entry: str, value: float, variable: Variable) -> Remedy:
    """Change of an entry into the range of a variable."""
    return higher(entry) if value < variable.minimum else lower(entry)


def _axis(axis: Axis, board: Board) -> None:
    """Check encoder, limits, friction and inertia."""
    fastest = 2.0 * math.pi / axis.counts / (COUNT_TIME_FILTERS * board.description.encoder_filter)
    if axis("limits.speed") > fastest:
        reason = f"above {fastest:.4g} rad/s, where the input filters of the board lose counts of"
        reason = f"{reason} {axis('encoder.lines'):g} lines"
        raise axis.refused("limits.speed", reason, lower("limits.speed"), lower("encoder.lines"))
    if axis("control.anti_windup") >= 1.0:
        raise axis.refused("control.anti_windup", "Kc of DRM E35 lies between 0 and 1", lower("control.anti_windup"))
    if axis.features["over_speed"] and axis("limits.over_speed") <= axis("limits.speed"):
        reason = f"not above the largest speed set-point, {axis('limits.speed'):g} rad/s (limits.speed)"
        raise axis.refused("limits.over_speed", reason, higher("limits.over_speed"), lower("limits.speed"))
    if axis("timing.stop_speed") >= axis("limits.speed"):
        reason = f"not below the speed limit, {axis('limits.speed'):g} rad/s: a stop would be complete at any speed"
        raise axis.refused("timing.stop_speed", reason, lower("timing.stop_speed"), higher("limits.speed"))
    torque = axis.torque_constant * axis("limits.current")
    if axis("friction.coulomb") >= torque:
        reason = f"the current limit gives {torque:.3g} N m, too little to rotate the shaft"
        raise axis.refused(
            "friction.coulomb", reason, lower("friction.coulomb"), higher("limits.current"), "correct motor.psi_m"
        )
    if axis("motor.rotor_inertia") > axis("motor.inertia"):
        reason = f"more than motor.inertia = {axis('motor.inertia'):g} kg m^2, which includes it"
        raise axis.refused("motor.rotor_inertia", reason, lower("motor.rotor_inertia"), higher("motor.inertia"))
    _load(axis)


def _load(axis: Axis) -> None:
    """Check the load behind a spring."""
    given = [key for key in AXIS_GROUPS["load"] if axis.given(f"load.{key}")]
    missing = [key for key in AXIS_GROUPS["load"] if key not in given]
    if given and missing:
        raise ConfigError(
            f"{axis.name}.load.{missing[0]} is missing; add it to [{axis.name}.load], or remove the group"
        )
    if given and axis("load.inertia") >= axis("motor.inertia"):
        reason = f"not below motor.inertia = {axis('motor.inertia'):g} kg m^2, which includes it"
        raise axis.refused("load.inertia", reason, lower("load.inertia"), higher("motor.inertia"))


def _direction(axis: Axis, board: Board) -> None:
    """Check that the currents of drive and rotor search are large enough for a certain direction."""
    change, limit = dead_time_current(axis, board), axis("limits.current")
    cause = f"the current of this winding changes by {change:.3g} A during a dead time"
    # not a shorter dead time: the switches determine it, and a too short one shorts the half bridge
    inductance = "add inductance to the motor cable"
    if change > SIGN_USE * limit:
        reason = f"{cause}, more than {SIGN_USE:g} of it: its direction is not known"
        raise axis.refused("limits.current", reason, higher("limits.current"), inductance)
    if axis("sensing.sign_current") > SILENT_USE * limit:
        reason = f"more than {SILENT_USE:g} of limits.current = {limit:g} A: a phase without current is not noticed"
        changes = lower("sensing.sign_current"), higher("limits.current")
        raise axis.refused("sensing.sign_current", reason, *changes)
    least = sign_current(axis, board)
    if axis.feedback == FEEDBACKS[0] and axis("rotor_search.current") < least:
        reason = f"below {least:.3g} A its direction is not known, {cause}"
        changes = higher("rotor_search.current"), lower("sensing.sign_current")
        raise axis.refused("rotor_search.current", reason, *changes, inductance)


def _ripple(axis: Axis, board: Board, scales: Scales) -> None:
    """Check that the largest current with the ripple of the PWM can be measured, and does not trip the comparators."""
    ripple = ripple_current(axis, board)
    limit, largest = axis("limits.current"), RANGE_USE * scales.i
    if limit + ripple > largest:
        reason = (
            f"with the PWM ripple of this winding, {ripple:.3g} A, above {largest:.3g} A, {RANGE_USE:g} of the range"
        )
        inductance = "add inductance to the motor cable"
        raise axis.refused("limits.current", f"{reason} of the current sensors", lower("limits.current"), inductance)


def _lost_voltage(axis: Axis, board: Board) -> None:
    """Check that the voltage of dead time and switch drops moves a shaft little where its sign is not known.

    The fastest current loop limits the current by it, a usual speed loop the time in which it accelerates the shaft.
    """
    hidden = SIGN_FACTOR * (dead_time_current(axis, board) + ripple_current(axis, board))
    lost = board("nominal_voltage") * board("dead_time") / board.period + board("switch_drop")
    motor, loop = axis.motor, 2.0 * math.pi * board("pwm_frequency") / CURRENT_SAMPLES_MIN
    acceleration = lost / (motor.l_q * loop) * motor.torque_constant / motor.inertia
    moved = acceleration * LOST_VOLTAGE_TIME**2 * COUNTS_PER_TURN / (2.0 * math.pi)
    if hidden > axis("limits.current") and moved > LOST_VOLTAGE_COUNTS_MAX:
        reason = (
            f"too light for this winding: below {hidden:.2g} A the PWM ripple hides the direction of its current, and"
            f" dead time and switch drops move the shaft by about {moved:.0f} counts"
        )
        advice = "couple the load and write its inertia, or add inductance to the motor cable"
        raise axis.refused("motor.inertia", reason, advice)


def _voltage(axis: Axis, board: Board) -> None:
    maximum = idle_speed(axis, board)
    if axis("limits.speed") > maximum:
        reason = f"above the no-load speed of {maximum:.4g} rad/s at {board('nominal_voltage'):g} V"
        advice = "switch field_weakening on, or correct motor.psi_m, motor.pole_pairs or board.nominal_voltage"
        raise axis.refused("limits.speed", reason, lower("limits.speed"), advice)


def _order(axis: Axis, board: Board) -> None:
    """Check that each loop is slower than its inner loop, and the innermost loop slower than its sampling."""
    speed, current = (2.0 * math.pi * axis(f"control.{key}_bandwidth") for key in ("speed", "current"))
    if axis("control.position_gain") >= speed:
        reason = f"not below the bandwidth of the inner speed loop, {speed:.4g} rad/s"
        changes = lower("control.position_gain"), higher("control.speed_bandwidth")
        raise axis.refused("control.position_gain", reason, *changes)
    if speed >= current:
        reason = f"not below control.current_bandwidth = {axis('control.current_bandwidth'):g} Hz"
        raise axis.refused(
            "control.speed_bandwidth", reason, lower("control.speed_bandwidth"), higher("control.current_bandwidth")
        )
    if 2.0 * axis("control.current_bandwidth") >= board("pwm_frequency"):
        reason = f"too high for the sampling rate of {board('pwm_frequency'):g} Hz"
        raise axis.refused("control.current_bandwidth", reason, lower("control.current_bandwidth"))


def _bus(configuration: Configuration) -> None:
    """Check the order of the bus voltage thresholds and the ratings of the brake resistor."""
    board = configuration.board
    order = ["regeneration.start_voltage", "regeneration.full_voltage", "over_voltage"]
    if board.brake:
        order = ["brake.off_voltage", "brake.on_voltage", *order]
    for below, above in itertools.pairwise(["nominal_voltage", *order]):
        if board(below) >= board(above):
            reason = f"not above {below} = {board(below):g} V"
            raise board.refused(above, reason, higher(f"board.{above}"), lower(f"board.{below}"))
    if not board.brake:
        return
    dissipated = board("brake.on_voltage") ** 2 / board("brake.resistance")
    returned = sum(_returned(axis, board) for axis in configuration.axes)
    if dissipated < returned:
        reason = (
            f"at {board('brake.on_voltage'):g} V it dissipates {dissipated:.3g} W, less than the {returned:.3g} W that"
            " all braking axes return"
        )
        changes = (lower(f"{axis.name}.limits.current") for axis in configuration.axes)
        raise board.refused("brake.resistance", reason, lower("board.brake.resistance"), *changes)
    kinetic = sum(0.5 * axis("motor.inertia") * axis("limits.speed") ** 2 for axis in configuration.axes)
    if board("brake.energy") < kinetic:
        reason = f"all axes together return up to {kinetic:.3g} J when they brake from their speed limits"
        slower = (lower(f"{axis.name}.limits.speed") for axis in configuration.axes)
        raise board.refused("brake.energy", reason, higher("board.brake.energy"), *slower, "fit another resistor")
    if board("brake.power") >= dissipated:
        reason = (
            f"at {board('brake.on_voltage'):g} V it dissipates {dissipated:.3g} W, not more than the continuous rating"
        )
        raise board.refused("brake.power", reason, lower("board.brake.power"))


def _returned(axis: Axis, board: Board) -> float:
    """Largest power that an axis returns to the bus when it brakes from its speed limit, less copper losses [W]."""
    emf, r_s = axis("motor.pole_pairs") * axis("motor.psi_m") * axis("limits.speed"), axis("motor.r_s")
    current = min(axis("limits.current"), 0.5 * emf / r_s)  # above this current the copper losses grow faster
    return 1.5 * current * (emf - r_s * current)


def _home(axis: Axis) -> None:
    """Check contact detection and spread of a homing."""
    if axis("home.speed") < 1.0:
        reason = "too slow: the later approaches use a quarter of it, too few counts for the contact detection"
        raise axis.refused("home.speed", reason, higher("home.speed"))
    if axis("home.spread") >= axis("home.back_off"):
        reason = f"not below home.back_off = {axis('home.back_off'):g} rad"
        raise axis.refused("home.spread", reason, lower("home.spread"), higher("home.back_off"))


def _stops(axis: Axis, scales: Scales) -> None:
    if axis("stop.short_current") > scales.i:
        reason = f"above the range of the shunts, {scales.i:g} A"
        raise axis.refused("stop.short_current", reason, lower("stop.short_current"))
    ramp = axis("limits.speed") / axis("limits.acceleration") + axis("timing.stop_max")
    if axis("stop.time_max") < ramp:
        reason = f"a ramp from the speed limit at limits.acceleration and timing.stop_max take {ramp:.3g} s"
        shorter = higher("limits.acceleration"), lower("limits.speed"), lower("timing.stop_max")
        raise axis.refused("stop.time_max", reason, higher("stop.time_max"), *shorter)
