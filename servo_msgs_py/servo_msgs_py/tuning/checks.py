"""What a single number of the configuration cannot tell: whether it goes together with the others."""

from __future__ import annotations

import itertools
import math

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.tuning.configuration import Axis, Board, Configuration, Scales
from servo_msgs_py.tuning.field_weakening import idle_speed
from servo_msgs_py.tuning.sensorless_checks import check_sensorless
from servo_msgs_py.tuning.winding import check_winding
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, SLOW_PERIODS


def check(configuration: Configuration, catalogue: Catalogue) -> None:
    """Check everything that can be seen before a gain is computed.

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
        check_sensorless(axis, board)
        _home(axis)


def _board(board: Board, scales: Scales, catalogue: Catalogue) -> None:
    """Its timing is fixed by the contract."""
    for key, wanted in (("pwm_frequency", 1e9 / PERIOD_NS), ("slow_divider", SLOW_PERIODS)):
        if board(key) != wanted:
            raise board.refused(key, "not what the firmware is written for", f"write {wanted:g}")
    order = ("under_voltage", "nominal_voltage", "over_voltage")
    for lower, higher in itertools.pairwise(order):
        if board(lower) >= board(higher):
            reason = f"not below {higher} = {board(higher):g} V"
            raise board.refused(lower, reason, "write voltages in ascending order")
    if board("over_voltage") >= scales.u_dc:
        reason = f"the ADC ends at {scales.u_dc:g} V and could not tell"
        raise board.refused("over_voltage", reason, "write a voltage below that")
    if board("dead_time") >= 0.5 * board.period:
        reason = f"nothing is left of a period of {board.period:g} s"
        raise board.refused("dead_time", reason, "write seconds, some 1e-6")
    for key in ("host_timeout", "command_timeout"):
        timeout = catalogue[f"param.{key}"]
        if not timeout.minimum <= board(key) <= timeout.maximum:
            reason = f"outside the contract's {timeout.minimum:g} .. {timeout.maximum:g} s (param.{key})"
            raise board.refused(key, reason, "stay within it")


def _contract(axis: Axis, catalogue: Catalogue) -> None:
    """Defaults have to lie within what the contract lets a host write."""
    names = {"current": "i_q_limit", "speed": "speed_limit", "acceleration": "acceleration_limit"}
    names |= {"position": "position_max", "following_error": "following_error", "over_speed": "over_speed"}
    for key, name in names.items():
        variable, value = catalogue[f"param.{name}"], axis(f"limits.{key}")
        if not variable.minimum <= value <= variable.maximum:
            span = f"{variable.minimum:g} .. {variable.maximum:g} {variable.unit}"
            raise axis.refused(f"limits.{key}", f"outside the contract's {span} (param.{name})", "stay within it")


def _axis(axis: Axis) -> None:
    """Encoder, limits, friction and inertia."""
    if axis.counts != COUNTS_PER_TURN:
        remedy = f"write {COUNTS_PER_TURN // 4}"
        raise axis.refused("encoder.lines", f"the contract counts {COUNTS_PER_TURN} per turn, 4 per line", remedy)
    if axis("control.anti_windup") >= 1.0:
        raise axis.refused("control.anti_windup", "Kc of DRM E35 lies between 0 and 1", "write 0.5")
    if axis("limits.over_speed") <= axis("limits.speed"):
        reason = f"set-points may ask for {axis('limits.speed'):g} rad/s (limits.speed)"
        raise axis.refused("limits.over_speed", reason, "write a speed above that")
    if axis("timing.stop_speed") >= axis("limits.speed"):
        reason = f"a stop would be over at the speed limit of {axis('limits.speed'):g} rad/s"
        raise axis.refused("timing.stop_speed", reason, "write a speed next to standstill")
    push = axis.torque_constant * axis("limits.current")
    if axis("friction.coulomb") >= push:
        reason = f"the current limit gives {push:.3g} N m and could not turn the shaft"
        raise axis.refused("friction.coulomb", reason, "correct it, motor.psi_m or limits.current")
    if axis("motor.rotor_inertia") > axis("motor.inertia"):
        reason = f"more than motor.inertia = {axis('motor.inertia'):g} kg m^2, of which it is a part"
        raise axis.refused("motor.rotor_inertia", reason, "correct one of them")


def _voltage(axis: Axis, board: Board) -> None:
    maximum = idle_speed(axis, board)
    if axis("limits.speed") > maximum:
        reason = f"{board('nominal_voltage'):g} V reach {maximum:.4g} rad/s without load"
        remedy = (
            "lower it, switch field_weakening on, or correct motor.psi_m, motor.pole_pairs or board.nominal_voltage"
        )
        raise axis.refused("limits.speed", reason, remedy)


def _order(axis: Axis, board: Board) -> None:
    """Every loop is slower than the one inside it, and the innermost slower than its sampling."""
    speed, current = (2.0 * math.pi * axis(f"control.{key}_bandwidth") for key in ("speed", "current"))
    if axis("control.position_gain") >= speed:
        reason = f"not below the bandwidth of the speed loop inside it, {speed:.4g} rad/s"
        remedy = "write a quarter of that or less, or raise control.speed_bandwidth"
        raise axis.refused("control.position_gain", reason, remedy)
    if speed >= current:
        reason = f"not below control.current_bandwidth = {axis('control.current_bandwidth'):g} Hz"
        raise axis.refused("control.speed_bandwidth", reason, "write a fifth of that or less")
    if 2.0 * axis("control.current_bandwidth") >= board("pwm_frequency"):
        reason = f"{board('pwm_frequency'):g} Hz is too low a sampling rate for it"
        raise axis.refused("control.current_bandwidth", reason, "write a tenth of that or less")
    minimum, maximum = axis("control.position_gain") / math.pi, 0.5 / board.tick
    if not minimum <= axis("control.observer_bandwidth") < maximum:
        reason = f"not within {minimum:.4g} .. {maximum:.4g} Hz: twice the position loop, half the slow loop"
        raise axis.refused("control.observer_bandwidth", reason, "write that of the speed loop, or twice that")


def _search(axis: Axis) -> None:
    """The search has to be able to see what it looks for, to end in time, and to spare the motor."""
    maximum = axis("limits.current")
    if axis("rotor_search.current") > maximum:
        reason = f"more than the motor may carry, {maximum:g} A (limits.current)"
        raise axis.refused("rotor_search.current", reason, f"write {maximum:g} A or less")
    count = 360.0 * axis("motor.pole_pairs") / axis.counts
    if not count <= axis("rotor_search.interval") < 60.0:
        reason = f"a count is {count:.3g} degrees, and 60 would leave the torque to chance"
        raise axis.refused("rotor_search.interval", reason, "write some 1.5 degrees")
    if axis("rotor_search.move_counts") < 3.0:
        reason = "an edge that dithers moves by one count, and a shaft that it lies on by one more"
        raise axis.refused("rotor_search.move_counts", reason, "write some 3 counts")
    if axis("rotor_search.move_counts") * count >= 0.25 * axis("rotor_search.verify_angle"):
        reason = "so much is no twitch: a quarter of rotor_search.verify_angle is taken for a shaft that runs away"
        raise axis.refused("rotor_search.move_counts", reason, "write some 3 counts")
    halvings = math.ceil(math.log2(360.0 / axis("rotor_search.interval")))
    longest = halvings * sum(axis(f"rotor_search.{key}_time") for key in ("ramp", "hold", "rest"))
    longest += 4.0 * axis("rotor_search.verify_time")  # to one side, to the other one, and back
    if axis("rotor_search.time_max") < longest:
        reason = f"{halvings} vectors and the verification may take {longest:.3g} s"
        raise axis.refused("rotor_search.time_max", reason, "write more than that, or shorter times")


def _bus(configuration: Configuration) -> None:
    """The voltages at which the bus is looked after, in their order; and whether the resistor can do it."""
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
    burnt = board("brake.on_voltage") ** 2 / board("brake.resistance")
    returned = sum(_returned(axis, board) for axis in configuration.axes)
    if burnt < returned:
        reason = (
            f"at {board('brake.on_voltage'):g} V it burns {burnt:.3g} W, and all axes braking return {returned:.3g} W"
        )
        remedy = f"write {board('brake.on_voltage') ** 2 / returned:.3g} ohm or less"
        raise board.refused("brake.resistance", reason, remedy)
    kinetic = sum(0.5 * axis("motor.inertia") * axis("limits.speed") ** 2 for axis in configuration.axes)
    if board("brake.energy") < kinetic:
        reason = f"all axes braking once from their speed limits return up to {kinetic:.3g} J"
        raise board.refused("brake.energy", reason, "write more, or fit another resistor")
    if board("brake.power") >= burnt:
        reason = (
            f"at {board('brake.on_voltage'):g} V it burns no more than {burnt:.3g} W, so there is nothing to budget"
        )
        raise board.refused("brake.power", reason, "write its continuous rating")


def _returned(axis: Axis, board: Board) -> float:
    """What an axis returns to the bus at most when it brakes from its speed limit [W]: less the copper's losses."""
    emf, r_s = axis("motor.pole_pairs") * axis("motor.psi_m") * axis("limits.speed"), axis("motor.r_s")
    current = min(axis("limits.current"), 0.5 * emf / r_s)  # more current burns more than it returns
    return 1.5 * current * (emf - r_s * current)


def _home(axis: Axis) -> None:
    """A homing has to see that the shaft stands, and to leave the places apart that it compares."""
    if axis("home.speed") < 1.0:
        raise axis.refused("home.speed", "a quarter of it shows too few counts to tell a contact", "write 1 or more")
    if axis("home.spread") >= axis("home.back_off"):
        reason = f"not below home.back_off = {axis('home.back_off'):g} rad"
        raise axis.refused("home.spread", reason, "write some counts of the encoder")


def _stops(axis: Axis, scales: Scales) -> None:
    if axis("stop.short_current") > scales.i:
        reason = f"the shunts end at {scales.i:g} A and could not tell"
        raise axis.refused("stop.short_current", reason, "stay within it")
    ramp = axis("limits.speed") / axis("limits.acceleration") + axis("timing.stop_max")
    if axis("stop.time_max") < ramp:
        reason = f"a ramp from the speed limit at limits.acceleration and timing.stop_max take {ramp:.3g} s"
        raise axis.refused("stop.time_max", reason, "write more than that")
