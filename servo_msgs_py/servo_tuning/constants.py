"""The integers of ``axis_config_t``: gains, limits and times in the formats of the firmware."""

from __future__ import annotations

import math
from typing import Final

from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.braking import pin_constants, stop_constants
from servo_tuning.configuration import FEEDBACKS, Axis, Board, Configuration
from servo_tuning.conversion import AxisConstants, Converter, Fraction, Switches, Value, rounded
from servo_tuning.errors import Remedy, either, higher, lower
from servo_tuning.field_weakening import field_weakening_constants
from servo_tuning.formats import FRAC16, UINT16, fixed_point
from servo_tuning.gains import Gains
from servo_tuning.rotor_search import RotorSearch
from servo_tuning.torque_ripple import HARMONICS, TORQUE_RIPPLE, ripple_members
from servo_tuning.winding import winding_constants

PI_SUM: Final = fixed_point("one sum of a PI controller and its decoupling", 24, 0, 255 * 2**24)
"""pi_sum_t holds +-256: the sum of these gains, each times a fraction, and the integral part."""

SIGN_FACTOR: Final = 1.25
"""Least current with a certain direction, over the change of the current during a dead time."""
SIGN_USE: Final = 0.5
"""Largest change of the current during a dead time, over the current limit."""
SILENT_USE: Final = 0.8
"""Largest current of a phase that is taken for silent, over the current limit."""

LINES_PER_RELOAD: Final = 8192
"""Lines of the encoder with which a turn fits the 16-bit counter; with more it reloads twice per turn."""

Changes = tuple[Remedy | str, ...]

_LINES: Final = "correct encoder.lines"
_HARDWARE: Final = "correct the description of the board"
_HOLD: Final = "correct motor.psi_m, motor.pole_pairs or motor.inertia"
_SWING: Final[Changes] = ("raise rotor_search.current, or correct motor.inertia",)
_LOST_VOLTAGE: Final[Changes] = (higher("control.current_bandwidth"), "correct motor.r_s, motor.l_d or motor.l_q")
_SLOWER_CURRENT: Final = lower("control.current_bandwidth")
_SLOWER: Final = (either("control.speed_bandwidth"), "correct motor.inertia or motor.psi_m")


def axis_constants(axis: Axis, gains: Gains, configuration: Configuration) -> AxisConstants:
    """Compute every field of one ``axis_config_t`` except those of the optional parts.

    Raises
    ------
    ConfigError
        If a value does not fit its format, or is rounded to 0.
    """
    to = Converter(axis, configuration.board, configuration.scales)
    return rounded(
        {
            **_current_loop(to, gains),
            **_sensing(to),
            **_motion(to, gains),
            **_torque_ripple(to),
            **_acceleration_forward(to),
            **_limits(to),
            **_supervision(to),
            **_monitor_constants(to),
            **winding_constants(to),
            **stop_constants(to),
            **field_weakening_constants(to),
            **_home(to),
            **pin_constants(to),
        }
    )


def _sum(to: Converter, name: str, value: float, *remedies: Remedy | str) -> None:
    """Refuse a sum of gains that the sum of a PI controller cannot hold."""
    PI_SUM.raw(f"{to.axis.name}: {name}", value, *map(to.axis.named, remedies))


def _current_loop(to: Converter, gains: Gains) -> dict[str, Value]:
    axis, board, s = to.axis, to.board, to.s
    omega_e = axis("motor.pole_pairs") * s.speed
    admittance = s.i / s.u_s
    slower = _SLOWER_CURRENT, "correct motor.r_s, motor.l_d or motor.l_q"
    drop = to.of("switch drop", board("switch_drop") / s.u_dc, _HARDWARE)
    use = to.board_at("voltage_use", math.sqrt(0.75))
    coupling, flux = "correct motor.pole_pairs, motor.l_d or motor.l_q", "correct motor.pole_pairs or motor.psi_m"
    duty = to.of("dead time", board("dead_time") / board.period, _HARDWARE)
    step = to.of("angle step", omega_e * board.period / math.pi, "fewer motor.pole_pairs")
    _sum(to, "gains added in u_d", (gains.current_d.kp + omega_e * axis("motor.l_q")) * admittance, *slower)
    emf = omega_e * axis("motor.psi_m") / s.u_s
    u_q = (gains.current_q.kp + omega_e * axis("motor.l_d")) * admittance + emf
    _sum(to, "gains added in u_q", u_q, *slower)
    sign = to.of("slope of sensing.sign_current", s.i / sign_current(axis, board), either("sensing.sign_current"))
    return {
        "current_loop.d": to.pi("current_loop.d", "current controller d", gains.current_d, admittance, *slower),
        "current_loop.q": to.pi("current_loop.q", "current controller q", gains.current_q, admittance, *slower),
        "current_loop.omega_l_d": to.of("decoupling d", omega_e * axis("motor.l_d") * admittance, coupling),
        "current_loop.omega_l_q": to.of("decoupling q", omega_e * axis("motor.l_q") * admittance, coupling),
        "current_loop.omega_psi": to.of("back-EMF", emf, flux),
        "current_loop.angle_step": step,
        "current_loop.dead_time.duty": duty,
        "current_loop.dead_time.v_drop": drop,
        "current_loop.dead_time.slope": sign,
        "current_loop.modulation_limit": use,
    }


def _sensing(to: Converter) -> dict[str, Value]:
    axis, board, s = to.axis, to.board, to.s
    p, counts = axis("motor.pole_pairs"), axis.counts
    per_rad = COUNTS_PER_TURN / (2.0 * math.pi)
    steps = s.speed * board.tick * per_rad  # position counts per slow tick at full-scale speed
    torque = (
        axis.torque_constant * s.i / axis("motor.inertia") * board.tick**2 * per_rad
    )  # used with a holding brake, too
    per_ratio = board("timer_clock") * 2.0 * math.pi / counts / s.speed
    search, found = "rotor_search", RotorSearch.of(axis, board)
    return {
        "feedback": FEEDBACKS.index(axis.feedback),
        "encoder.counts": to.at("encoder.lines", 4.0 if axis("encoder.lines") <= LINES_PER_RELOAD else 2.0),
        "encoder.pole_pairs": to.at("motor.pole_pairs", 1.0),
        "encoder.angle_per_count": to.of("angle per count", 2.0**32 / counts, _LINES),
        "speed_observer.speed_per_step": to.of("speed per step", 1.0 / steps, _LINES),
        "speed_observer.step_per_speed": to.of("step per speed", steps, _LINES),
        "speed_observer.acceleration_per_current": to.of("acceleration of the observer", torque, _HOLD),
        "mt_speed.speed_per_ratio": to.of("speed per count and clock of the edge timer", per_ratio, _LINES, _HARDWARE),
        f"{search}.current_step": Fraction(
            axis.entry("rotor_search.ramp_time", "current per slow tick"),
            axis("rotor_search.current") / s.i * board.tick / found.ramp,
            tuple(map(axis.named, _changes_of(axis, "ramp", found.ramp, _LOST_VOLTAGE))),
        ),
        f"{search}.current_slew": to.of(
            "change of the search current per slow tick",
            min(_search_slew(axis, board) / s.i, 0.5),  # larger than any search needs
            _SLOWER_CURRENT,
        ),
        f"{search}.current_limit": to.at("rotor_search.current", 1.0 / s.i),
        f"{search}.hold_ticks": to.of(
            "slow ticks of the hold", found.hold / board.tick, *_changes_of(axis, "hold", found.hold, _SWING)
        ),
        f"{search}.rest_ticks": to.ticks("rotor_search.rest_time"),
        f"{search}.move_counts": to.at("rotor_search.move_counts", 1.0),
        f"{search}.verify_angle": to.at("rotor_search.verify_angle", 65536.0 / 360.0),
        f"{search}.verify_step": to.of(
            "rotation of the vector per slow tick in the verification",
            65536.0 * axis("rotor_search.verify_angle") / 360.0 * board.tick / found.verify,
            *_changes_of(axis, "verify", found.verify, _SWING),
        ),
        f"{search}.angle_per_count": to.of("search angle", 65536.0 * p / counts, "fewer motor.pole_pairs"),
        f"{search}.interval": to.of(
            "interval of the search", 65536.0 * found.interval / 360.0, "fewer motor.pole_pairs"
        ),
        **_follow(to),
    }


def _changes_of(axis: Axis, phase: str, used: float, others: Changes) -> Changes:
    """Changes of the time of a phase of the search [s]: of its entry, or others if it is longer than the entry."""
    path = f"rotor_search.{phase}_time"
    return (either(path),) if used <= axis(path) else others


def _search_changes(axis: Axis, found: RotorSearch) -> Changes:
    """Changes of the longest part of the search."""
    if axis("rotor_search.time_max") > found.longest:
        return (lower("rotor_search.time_max"),)
    phases = {
        "ramp": (found.halvings, found.ramp, _LOST_VOLTAGE),
        "hold": (found.halvings, found.hold, _SWING),
        "rest": (found.halvings, axis("rotor_search.rest_time"), ()),
        "verify": (4, found.verify, _SWING),
    }
    longest = max(phases, key=lambda phase: phases[phase][0] * phases[phase][1])
    return _changes_of(axis, longest, *phases[longest][1:])


def _search_slew(axis: Axis, board: Board) -> float:
    """Change of the search current that takes half of the voltage, with the gain of the current controllers [A]."""
    voltage = board("nominal_voltage") / math.sqrt(3.0) * board("voltage_use")
    inductance = max(axis("motor.l_d"), axis("motor.l_q"))
    return 0.5 * voltage / (2.0 * math.pi * axis("control.current_bandwidth") * inductance)


def _follow(to: Converter) -> dict[str, Value]:
    """Rotation of the vector that distinguishes a blocked shaft from an encoder that does not count."""
    axis, board, s = to.axis, to.board, to.s
    turn, time = math.radians(axis("rotor_search.turn_angle")), axis("rotor_search.turn_time")
    inductance = 0.5 * (axis("motor.l_d") + axis("motor.l_q"))  # of a blocked rotor, mean over the rotation
    inductive = turn / time * inductance * axis("rotor_search.current") / s.u_s
    flux = axis("rotor_search.follow_flux") * axis("motor.psi_m") * turn / s.u_s / board.period
    slower = either("rotor_search.turn_time")
    follow = "rotor_search.follow"
    return {
        f"{follow}.ticks": to.of("slow ticks of rotor_search.turn_time", time / board.tick, slower),
        f"{follow}.step": to.of(
            "rotation of the vector per slow tick", 65536.0 * turn * board.tick / time / 2 / math.pi, slower
        ),
        f"{follow}.inductive": to.of(
            "inductive voltage of the rotating vector", inductive if inductive > FRAC16.lsb else 0.0, slower
        ),
        f"{follow}.flux_min": to.of("flux of a following rotor", 2.0**15 * flux, "correct motor.psi_m"),
    }


def speed_observer_constants(to: Converter) -> dict[str, Value]:
    """Gains of a fading-memory filter: the three poles of the observer error are equal.

    Raises
    ------
    ConfigError
        If the bandwidth is out of range, or a value does not fit its format.
    """
    axis, tick = to.axis, to.board.tick
    minimum, maximum = axis("control.position_gain") / math.pi, 0.5 / tick
    if not minimum <= axis("control.observer_bandwidth") < maximum:
        reason = f"not within {minimum:.4g} .. {maximum:.4g} Hz (twice the position loop .. half the slow loop rate)"
        raise axis.refused("control.observer_bandwidth", reason, either("control.observer_bandwidth"))
    p = math.exp(-2.0 * math.pi * axis("control.observer_bandwidth") * tick)
    slower = either("control.observer_bandwidth")
    return {
        "speed_observer.l_position": to.of("observer, position", 1.0 - p**3, slower),
        "speed_observer.l_speed": to.of("observer, speed", 1.5 * (1.0 - p) ** 2 * (1.0 + p), slower),
        "speed_observer.l_acceleration": to.of("observer, acceleration", (1.0 - p) ** 3, slower),
    }


def _motion(to: Converter, gains: Gains) -> dict[str, Value]:
    board, s = to.board, to.s
    step = s.speed * board.tick * COUNTS_PER_TURN / (2.0 * math.pi)  # position counts per slow tick at full-scale speed
    entries = ("control.path_current_use", "limits.current", "limits.speed")
    path: Changes = (*map(either, entries), "correct motor.inertia or motor.psi_m")
    return {
        "speed": to.pi("speed", "speed controller", gains.speed, s.speed / s.i, *_SLOWER),
        "position_gain": to.at("control.position_gain", 2.0 * math.pi / COUNTS_PER_TURN / s.speed),
        "path_omega_n_ts": to.of("omega_n Ts of the path", gains.path_omega_n * board.tick, *path),
        "path_step_per_speed": to.of("path step", step, _LINES),
        "speed_per_path_step": to.of("speed per path step", 1.0 / step, _LINES),
    }


def friction_constants(to: Converter) -> dict[str, Value]:
    """Feed-forward of the current against friction.

    Raises
    ------
    ConfigError
        If a value does not fit its format.
    """
    axis, s = to.axis, to.s
    k_t, smooth = axis.torque_constant, axis("friction.smooth")
    return {
        "friction.coulomb": to.at("friction.coulomb", 1.0 / k_t / s.i),
        "friction.viscous": to.at("friction.viscous", s.speed / k_t / s.i),
        "friction.smooth": to.at("friction.smooth", 1.0 / s.speed),
        "friction.slope": Fraction(
            axis.entry("friction.smooth", "slope"), s.speed / smooth, (axis.named(either("friction.smooth")),)
        ),
    }


RIPPLE_PERIODS: Final = 7.2
"""PWM periods from the sampling of the angle of the ripple compensation to the middle of its effect: 3.2 until the
voltage changes, half of the 8 for which it is held."""


def _torque_ripple(to: Converter) -> dict[str, Value]:
    axis, s = to.axis, to.s
    members = ripple_members(axis.harmonics, axis.torque_constant * s.i)
    bandwidth = "control.current_bandwidth"
    lead = RIPPLE_PERIODS * to.board.period + 1.0 / (2.0 * math.pi * axis(bandwidth))
    turns = lead * s.speed / 2.0 / math.pi if axis.harmonics else 0.0  # a slow loop without harmonics is permitted
    where, remedies = (
        f"{axis.name}.{TORQUE_RIPPLE}.{HARMONICS}",
        ("write an amplitude that fits, or remove the harmonic",),
    )
    return {
        **{path: Fraction(where, value, remedies) for path, value in members.items()},
        "torque_ripple.lead": to.of("angle during the delay of the ripple compensation", turns, higher(bandwidth)),
    }


def _acceleration_forward(to: Converter) -> dict[str, Value]:
    inertia = to.axis("motor.inertia") / to.axis.torque_constant * to.s.speed / to.board.tick / to.s.i
    return {"acceleration_forward": to.of("current for the acceleration", inertia, _HOLD)}


def _limits(to: Converter) -> dict[str, Value]:
    axis, board, s = to.axis, to.board, to.s
    per_rad = COUNTS_PER_TURN / (2.0 * math.pi)

    def volts(key: str) -> Fraction:
        return to.board_at(key, 1.0 / s.u_dc)

    k_t = to.of("torque constant", axis.torque_constant / s.torque_constant, _HOLD)
    return {
        "torque_constant": k_t,
        "i_q_limit": to.at("limits.current", 1.0 / s.i),
        "speed_limit": to.at("limits.speed", 1.0 / s.speed),
        "acceleration_limit": to.at("limits.acceleration", board.tick / s.speed),
        "features": Switches(key for key, on in axis.features.items() if on),
        "position_limit": to.at("limits.position", per_rad),
        "following_error": to.at("limits.following_error", per_rad),
        "over_speed": to.at("limits.over_speed", 1.0 / s.speed),
        "u_dc_nominal": volts("nominal_voltage"),
        "u_dc_max": volts("over_voltage"),
        "u_dc_min": volts("under_voltage"),
    }


def _supervision(to: Converter) -> dict[str, Value]:
    s, search = to.s, RotorSearch.of(to.axis, to.board)
    times = {
        "shaft.following_ticks_max": "timing.following_max",
        "shaft.over_speed_ticks_max": "timing.over_speed_max",
        "settle_ticks": "timing.settle",
        "shaft.runaway_ticks_max": "timing.runaway_max",
        "rest_ticks_max": "timing.rest_max",
        "shaft.stall_ticks_max": "timing.stall_max",
        "stop_ticks_max": "timing.stop_max",
    }
    return {
        "offset_tolerance": to.at("sensing.offset_tolerance", 1.0),
        "offset_duty_min": to.at("sensing.offset_duty", 1.0),
        "shaft.runaway_margin": to.at("timing.runaway_margin", 1.0 / s.speed),
        "stop_speed": to.at("timing.stop_speed", 1.0 / s.speed),
        "search_ticks_max": to.of(
            "slow ticks of the search", search.time_max / to.board.tick, *_search_changes(to.axis, search)
        ),
        **{field: to.ticks(path) for field, path in times.items()},
    }


def _home(to: Converter) -> dict[str, Value]:
    per_rad = COUNTS_PER_TURN / (2.0 * math.pi)
    counts = {"home.back_off": "home.back_off", "home.spread_max": "home.spread", "home.reach": "home.reach"}
    return {
        "home.speed": to.at("home.speed", 1.0 / to.s.speed),
        "home.current": to.at("home.current", 1.0 / to.s.i),
        "home.turns_max": to.at("home.turns_max", 1.0),
        **{field: to.at(path, per_rad) for field, path in counts.items()},
    }


def dead_time_current(axis: Axis, board: Board) -> float:
    """Change of the current during a dead time, in which only the bus voltage drives it [A]."""
    return board("nominal_voltage") * board("dead_time") / min(axis("motor.l_d"), axis("motor.l_q"))


def ripple_current(axis: Axis, board: Board) -> float:
    """Amplitude of the PWM ripple at its largest: 2/3 of the bus voltage for half of a period [A]."""
    return board("nominal_voltage") * board.period / (24.0 * min(axis("motor.l_d"), axis("motor.l_q")))


def sign_current(axis: Axis, board: Board) -> float:
    """Phase current above which its direction is certain: the entry, or more for a winding of low inductance [A]."""
    return max(axis("sensing.sign_current"), SIGN_FACTOR * dead_time_current(axis, board))


def _monitor_constants(to: Converter) -> dict[str, Value]:
    """Thresholds of the monitors of phases, current sensing, encoder and heat sink."""
    axis, board, s = to.axis, to.board, to.s
    sign = sign_current(axis, board) / s.i
    silent = min(2.0 * sign, SILENT_USE * axis("limits.current") / s.i)
    dead = 0.5 * board("dead_time") / board.period * board("nominal_voltage")
    floor = max(board("switch_drop") + dead, 0.5) / s.u_s
    turn = s.u_s / axis("motor.psi_m") * board.tick / (2.0 * math.pi)
    hot, cool = board.temperature.codes()
    inductance = max(axis("motor.l_d"), axis("motor.l_q")) * s.i / s.u_s / board.tick
    return {
        "winding.current_min": to.of(
            "current of a silent phase, twice sensing.sign_current", silent, either("sensing.sign_current")
        ),
        "winding.direction_current_min": to.of(
            "smallest current with a direction", sign, either("sensing.sign_current")
        ),
        "winding.resistance": to.of("voltage drop", axis("motor.r_s") * s.i / s.u_s, "correct motor.r_s"),
        "winding.inductance": to.of("inductive voltage", inductance, "correct motor.l_q"),
        "winding.rotation_per_voltage": to.of("rotation per back-EMF", turn, "correct motor.psi_m"),
        "winding.emf_floor": to.of("unexplained voltage", floor, _HARDWARE),
        "heat.hot": hot,
        "heat.cool": cool,
    }


def time_outs(board: Board) -> dict[str, int]:
    """Defaults of the writable timeouts [slow ticks]."""
    return {
        name: UINT16.raw(f"board.{name}", board(name) / board.tick, either(f"board.{name}"), given=board(name))
        for name in ("host_timeout", "command_timeout")
    }
