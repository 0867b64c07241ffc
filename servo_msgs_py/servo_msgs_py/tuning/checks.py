"""Consistency checks between entries of the configuration."""

from __future__ import annotations

import itertools
import math

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.tuning.configuration import Axis, Board, Configuration, Scales
from servo_msgs_py.tuning.field_weakening import idle_speed
from servo_msgs_py.tuning.sensorless_checks import check_observer_entries
from servo_msgs_py.tuning.winding import check_winding
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, SLOW_PERIODS


def check(configuration: Configuration, catalogue: Catalogue) -> None:
    """Check everything that does not depend on the gains.

    Raises
    ------
    ConfigError
        If the configuration cannot work.
    """
    board = configuration.board
    _board(board, configuration.scales, catalogue)
    if board.complete:
        _bus(configuration)
    for axis in configuration.axes:
        _contract(axis, catalogue)
        _axis(axis)
        _voltage(axis, board)
        _order(axis, board)
        _search(axis)
        _stops(axis, configuration.scales)
        check_winding(axis)
        check_observer_entries(axis)
        _home(axis)


def _board(board: Board, scales: Scales, catalogue: Catalogue) -> None:
    """Check frequencies, voltages, dead time and timeouts."""
    for key, expected in (("pwm_frequency", 1e9 / PERIOD_NS), ("slow_divider", SLOW_PERIODS)):
        if board(key) != expected:
            raise board.refused(key, "fixed by the firmware", f"write {expected:g}")
    order = ("under_voltage", "nominal_voltage", "over_voltage")
    for lower, higher in itertools.pairwise(order):
        if board(lower) >= board(higher):
            reason = f"not below {higher} = {board(higher):g} V"
            raise board.refused(lower, reason, "write voltages in ascending order")
    if board("over_voltage") >= scales.u_dc:
        reason = f"not below the ADC range of {scales.u_dc:g} V"
        raise board.refused("over_voltage", reason, "write a lower voltage")
    if board("dead_time") >= 0.5 * board.period:
        reason = f"two dead times fill the PWM period of {board.period:g} s"
        raise board.refused("dead_time", reason, "write seconds, about 1e-6")
    for key in ("host_timeout", "command_timeout"):
        timeout = catalogue[f"param.{key}"]
        if not timeout.minimum <= board(key) <= timeout.maximum:
            reason = f"outside the range {timeout.minimum:g} .. {timeout.maximum:g} s of param.{key}"
            raise board.refused(key, reason, "write a value within this range")


def _contract(axis: Axis, catalogue: Catalogue) -> None:
    """Check that the defaults lie within the ranges of the table of variables."""
    names = {"current": "i_q_limit", "speed": "speed_limit", "acceleration": "acceleration_limit"}
    names |= {"position": "position_max", "following_error": "following_error", "over_speed": "over_speed"}
    for key, name in names.items():
        variable, value = catalogue[f"param.{name}"], axis(f"limits.{key}")
        if not variable.minimum <= value <= variable.maximum:
            span = f"{variable.minimum:g} .. {variable.maximum:g} {variable.unit}"
            raise axis.refused(
                f"limits.{key}", f"outside the range {span} of param.{name}", "write a value within this range"
            )


def _axis(axis: Axis) -> None:
    """Check encoder, limits, friction and inertia."""
    if axis.counts != COUNTS_PER_TURN:
        remedy = f"write {COUNTS_PER_TURN // 4}"
        raise axis.refused(
            "encoder.lines", f"the firmware is built for {COUNTS_PER_TURN} counts per turn, 4 per line", remedy
        )
    if axis("control.anti_windup") >= 1.0:
        raise axis.refused("control.anti_windup", "Kc of DRM E35 lies between 0 and 1", "write 0.5")
    if axis.features["over_speed"] and axis("limits.over_speed") <= axis("limits.speed"):
        reason = f"not above the largest speed set-point, {axis('limits.speed'):g} rad/s (limits.speed)"
        raise axis.refused("limits.over_speed", reason, "write a higher speed")
    if axis("timing.stop_speed") >= axis("limits.speed"):
        reason = f"not below the speed limit, {axis('limits.speed'):g} rad/s: a stop would be complete at any speed"
        raise axis.refused("timing.stop_speed", reason, "write a speed close to standstill")
    torque = axis.torque_constant * axis("limits.current")
    if axis("friction.coulomb") >= torque:
        reason = f"the current limit gives {torque:.3g} N m, too little to rotate the shaft"
        raise axis.refused("friction.coulomb", reason, "correct it, motor.psi_m or limits.current")
    if axis("motor.rotor_inertia") > axis("motor.inertia"):
        reason = f"more than motor.inertia = {axis('motor.inertia'):g} kg m^2, which includes it"
        raise axis.refused("motor.rotor_inertia", reason, "correct one of them")


def _voltage(axis: Axis, board: Board) -> None:
    maximum = idle_speed(axis, board)
    if axis("limits.speed") > maximum:
        reason = f"above the no-load speed of {maximum:.4g} rad/s at {board('nominal_voltage'):g} V"
        remedy = (
            "lower it, switch field_weakening on, or correct motor.psi_m, motor.pole_pairs or board.nominal_voltage"
        )
        raise axis.refused("limits.speed", reason, remedy)


def _order(axis: Axis, board: Board) -> None:
    """Check that each loop is slower than its inner loop, and the innermost loop slower than its sampling."""
    speed, current = (2.0 * math.pi * axis(f"control.{key}_bandwidth") for key in ("speed", "current"))
    if axis("control.position_gain") >= speed:
        reason = f"not below the bandwidth of the inner speed loop, {speed:.4g} rad/s"
        remedy = "write a quarter of it or less, or raise control.speed_bandwidth"
        raise axis.refused("control.position_gain", reason, remedy)
    if speed >= current:
        reason = f"not below control.current_bandwidth = {axis('control.current_bandwidth'):g} Hz"
        raise axis.refused("control.speed_bandwidth", reason, "write a fifth of it or less")
    if 2.0 * axis("control.current_bandwidth") >= board("pwm_frequency"):
        reason = f"too high for the sampling rate of {board('pwm_frequency'):g} Hz"
        raise axis.refused("control.current_bandwidth", reason, "write a tenth of it or less")


def _search(axis: Axis) -> None:
    """Check current, resolution and duration of the rotor search."""
    maximum = axis("limits.current")
    if axis("rotor_search.current") > maximum:
        reason = f"above the current limit of {maximum:g} A (limits.current)"
        raise axis.refused("rotor_search.current", reason, f"write {maximum:g} A or less")
    count = 360.0 * axis("motor.pole_pairs") / axis.counts
    if not count <= axis("rotor_search.interval") < 60.0:
        reason = f"not at least one count ({count:.3g} deg) and below 60 deg, otherwise the torque is uncertain"
        raise axis.refused("rotor_search.interval", reason, "write about 1.5 degrees")
    if axis("rotor_search.move_counts") < 3.0:
        reason = "below 3: dither at an encoder edge gives up to 2 counts without rotation"
        raise axis.refused("rotor_search.move_counts", reason, "write about 3 counts")
    if axis("rotor_search.move_counts") * count >= 0.25 * axis("rotor_search.verify_angle"):
        reason = "not below a quarter of rotor_search.verify_angle, the criterion of a shaft that runs away"
        raise axis.refused("rotor_search.move_counts", reason, "write about 3 counts")
    halvings = math.ceil(math.log2(360.0 / axis("rotor_search.interval")))
    longest = halvings * sum(axis(f"rotor_search.{key}_time") for key in ("ramp", "hold", "rest"))
    longest += 4.0 * axis("rotor_search.verify_time")  # to one side, to the other side, and back
    if axis("rotor_search.time_max") < longest:
        reason = f"{halvings} vectors and the verification take up to {longest:.3g} s"
        raise axis.refused("rotor_search.time_max", reason, "write more, or shorten the times of the search")


def _bus(configuration: Configuration) -> None:
    """Check the order of the bus voltage thresholds and the ratings of the brake resistor."""
    board = configuration.board
    order = ["regeneration.start_voltage", "regeneration.full_voltage", "over_voltage"]
    if board.brake:
        order = ["brake.off_voltage", "brake.on_voltage", *order]
    for lower, higher in itertools.pairwise(["nominal_voltage", *order]):
        if board(lower) >= board(higher):
            reason = f"not above {lower} = {board(lower):g} V"
            raise board.refused(higher, reason, f"write voltages in the order nominal, {', '.join(order)}")
    if not board.brake:
        return
    dissipated = board("brake.on_voltage") ** 2 / board("brake.resistance")
    returned = sum(_returned(axis, board) for axis in configuration.axes)
    if dissipated < returned:
        reason = (
            f"at {board('brake.on_voltage'):g} V it dissipates {dissipated:.3g} W, less than the {returned:.3g} W that"
            " all braking axes return"
        )
        remedy = f"write {board('brake.on_voltage') ** 2 / returned:.3g} ohm or less"
        raise board.refused("brake.resistance", reason, remedy)
    kinetic = sum(0.5 * axis("motor.inertia") * axis("limits.speed") ** 2 for axis in configuration.axes)
    if board("brake.energy") < kinetic:
        reason = f"all axes together return up to {kinetic:.3g} J when they brake from their speed limits"
        raise board.refused("brake.energy", reason, "write more, or fit another resistor")
    if board("brake.power") >= dissipated:
        reason = (
            f"at {board('brake.on_voltage'):g} V it dissipates {dissipated:.3g} W, not more than the continuous rating"
        )
        raise board.refused("brake.power", reason, "write its continuous rating")


def _returned(axis: Axis, board: Board) -> float:
    """Largest power that an axis returns to the bus when it brakes from its speed limit, less copper losses [W]."""
    emf, r_s = axis("motor.pole_pairs") * axis("motor.psi_m") * axis("limits.speed"), axis("motor.r_s")
    current = min(axis("limits.current"), 0.5 * emf / r_s)  # above this current the copper losses grow faster
    return 1.5 * current * (emf - r_s * current)


def _home(axis: Axis) -> None:
    """Check contact detection and spread of a homing."""
    if axis("home.speed") < 1.0:
        reason = "too slow: the later approaches use a quarter of it, too few counts for the contact detection"
        raise axis.refused("home.speed", reason, "write 1 or more")
    if axis("home.spread") >= axis("home.back_off"):
        reason = f"not below home.back_off = {axis('home.back_off'):g} rad"
        raise axis.refused("home.spread", reason, "write the angle of a few encoder counts")


def _stops(axis: Axis, scales: Scales) -> None:
    if axis("stop.short_current") > scales.i:
        reason = f"above the range of the shunts, {scales.i:g} A"
        raise axis.refused("stop.short_current", reason, "write a current within this range")
    ramp = axis("limits.speed") / axis("limits.acceleration") + axis("timing.stop_max")
    if axis("stop.time_max") < ramp:
        reason = f"a ramp from the speed limit at limits.acceleration and timing.stop_max take {ramp:.3g} s"
        raise axis.refused("stop.time_max", reason, "write more")
