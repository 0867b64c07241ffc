"""Integers of the sensorless part of ``axis_config_t``, and their conversion back to SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Final

from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.configuration import Axis, Board, Scales
from servo_tuning.conversion import Converter, Field, Fraction, PiRaw, Value
from servo_tuning.errors import ConfigError, either
from servo_tuning.sensorless import BackEmfObserver, Pll, Sensorless, StartUp
from servo_tuning.sensorless_checks import check_sensorless
from servo_tuning.sensors import AMPLITUDE_OFFSET_TIME

F2: Final = 11
"""Fraction bits of the observed back-EMF beyond 15; F1 of the observed current is at most F2."""
F1_MIN: Final = 6

_WINDING: Final = "correct motor.r_s, motor.l_d or motor.l_q"
_SLOWER: Final = either("observer.bandwidth")
_MOTOR: Final = "correct motor.psi_m or motor.pole_pairs"


def needs_observer(axis: Axis) -> bool:
    """Whether the axis needs the back-EMF observer after reset."""
    return axis.feedback == "observer" or axis.features.get("angle_check", False)


def sensorless_constants(to: Converter) -> dict[str, Value]:
    """Fields of ``axis_config_t``.

    Raises
    ------
    ConfigError
        If the axis cannot work without an encoder.
    """
    check_sensorless(to.axis, to.board)
    design = Sensorless.of(to.axis, to.board)
    return {
        **_observer(to, design.observer),
        **_pll(to, design),
        **_reliability(to),
        **_start_up(to, design.start_up),
        "observed_speed": to.pi(
            "observed_speed",
            "sensorless speed controller",
            design.speed,
            to.s.speed / to.s.i,
            either("observer.speed_part"),
        ),
    }


def _observer(to: Converter, observer: BackEmfObserver) -> dict[str, Value]:
    admittance = to.s.u_s / to.s.i
    loss = to.of(
        "R T / L of the observer", 1.0 - observer.a, f"the current decays within one sampling period: {_WINDING}"
    )
    f1 = min(F2, math.ceil(F2 - 1 - math.log2(observer.b * admittance)) - 1)  # the largest with a factor below 1/2
    if f1 < F1_MIN:
        name = f"{to.axis.name}: current by full voltage in one period"
        raise ConfigError(f"{name} = {observer.b * admittance:g} full scales: the observer cannot follow; {_WINDING}")
    return {
        "observer.f1": f1,
        "observer.f2": F2,
        "observer.loss": loss,
        "observer.drive": to.of("T / L of the observer", math.ldexp(observer.b * admittance, f1 - F2), _WINDING),
        "observer.k1": to.of("observer K1 T", observer.k1, _SLOWER),
        "observer.k2": to.of("observer K2 T", math.ldexp(observer.k2 / admittance, F2 - f1), _SLOWER),
    }


def _pll(to: Converter, design: Sensorless) -> dict[str, Value]:
    axis, board, s, pll = to.axis, to.board, to.s, design.pll
    p = axis("motor.pole_pairs")
    omega_n = pll.omega_n(s.u_s / axis("motor.psi_m"))  # at a back-EMF of full scale
    turn = p * s.speed * board.period / (2.0 * math.pi)  # at full-scale speed
    pll_i = either("observer.pll_i")
    acceleration = pll.acceleration * s.i * p * board.tick * board.period / (2.0 * math.pi)
    e_min = 0.5 * p * axis("motor.psi_m") * design.start_up.minimum_speed / s.u_s
    per_emf = _step_per_emf(axis, board, s)
    amplitude_gain, amplitude_load_gain = pll.size_gains(board.tick)
    slower = axis.named(either("observer.pll_size"))
    return {
        "pll.amplitude_gain": Fraction(axis.entry("observer.pll_size", "speed"), amplitude_gain * per_emf, (slower,)),
        "pll.amplitude_load_gain": Fraction(
            axis.entry("observer.pll_size", "load"), amplitude_load_gain * per_emf, (slower,)
        ),
        "pll.offset_gain": to.of("back-EMF per step of the PLL", board.tick / AMPLITUDE_OFFSET_TIME / per_emf, _MOTOR),
        "pll.kp": to.of("PLL Kp", _pll_gain(2.0 * pll.damping * omega_n * board.period), pll_i),
        "pll.ki": to.of("PLL Ki", _pll_gain((omega_n * board.period) ** 2), pll_i),
        "pll.e_min": to.of(
            "half the back-EMF at start_up.minimum_speed", e_min, either("start_up.minimum_speed"), _MOTOR
        ),
        "pll.step_max": to.of("rotation per period, above full speed", 1.25 * 2.0**32 * turn, "fewer motor.pole_pairs"),
        "pll.speed_per_step": to.of("speed per step of the PLL", 0.5 / turn, "more motor.pole_pairs"),
        "pll.step_per_speed": to.of("rotation per period at full speed", 2.0**32 * turn, "fewer motor.pole_pairs"),
        "pll.counts_per_turn": to.of("counts per electrical turn", COUNTS_PER_TURN / p, _MOTOR),
        "pll.acceleration": Fraction(
            axis.entry("observer.pll_torque", "change of the rotation per period in a tick"),
            2.0**32 * acceleration,
            (axis.named(either("observer.pll_torque")), "correct motor.inertia or motor.psi_m"),
        ),
        "pll.load_gain": Fraction(
            axis.entry("observer.pll_load", "change in a tick"),
            pll.load * omega_n**3 * _steps_per_acceleration(board) * board.tick,
            (axis.named(either("observer.pll_load")),),
        ),
    }


def _step_per_emf(axis: Axis, board: Board, s: Scales) -> float:
    """Angle per PWM period (2^32 a turn) of the speed whose back-EMF is one unit of 23 fraction bits."""
    return math.ldexp(s.u_s / axis("motor.psi_m") * board.period / (2.0 * math.pi), 32 - 23)


def _steps_per_acceleration(board: Board) -> float:
    """Change of the angle per PWM period (2^32 a turn) in a slow tick, per rad/s^2."""
    return math.ldexp(board.tick * board.period / (2.0 * math.pi), 32)


def _pll_gain(radians: float) -> float:
    """Step (2^32 a turn) per error; errors have 14 + F2 fraction bits."""
    return math.ldexp(radians / (2.0 * math.pi), 32 - 14 - F2)


def _reliability(to: Converter) -> dict[str, Value]:
    axis, s = to.axis, to.s
    resistance = axis("emf_check.resistance") * axis("motor.r_s") * s.i / s.u_s
    return {
        "reliability.period": to.at("reliability.period", 1.0),
        "reliability.variance_threshold": to.at("reliability.variance_threshold", 1.0),
        "reliability.hysteresis": to.at("reliability.hysteresis", 1.0),
        "emf_check.floor": to.at("emf_check.floor", 1.0 / s.u_s),
        "emf_check.floor_spin": to.at("emf_check.spin_floor", 1.0 / s.u_s),
        "emf_check.resistance": to.of("resistance of the back-EMF check", resistance, "correct motor.r_s"),
        "emf_check.part": to.at("emf_check.part", 1.0),
        "emf_check.ticks_spin": to.ticks("emf_check.spin_time"),
        "emf_check.ticks_stand": to.ticks("emf_check.stand_time"),
        "emf_check.ticks_check": to.ticks("emf_check.check_time"),
    }


def _start_up(to: Converter, start_up: StartUp) -> dict[str, Value]:
    axis, board, s = to.axis, to.board, to.s
    slew = (start_up.current_final - start_up.current_first) / s.i * board.tick / start_up.current_time
    speed_step = start_up.speed_final / s.speed * board.tick / start_up.speed_time
    across = start_up.current_final * axis("start_up.swing_current") / s.i
    fade = axis("limits.current") / s.i * board.tick / axis("start_up.fade_time")
    ramp = either("start_up.speed_time" if axis.given("start_up.speed_time") else "start_up.swings")
    return {
        "startup.first_current": to.of(
            "start_up.current_first", start_up.current_first / s.i, either("start_up.current_first")
        ),
        "startup.final_current": to.of(
            "start_up.current_final", start_up.current_final / s.i, either("start_up.current_final")
        ),
        "startup.current_step": to.of(
            "change of the start-up current per slow tick", slew, either("start_up.current_time")
        ),
        "startup.final_speed": to.of(
            "start_up.speed_final", start_up.speed_final / s.speed, either("start_up.speed_final")
        ),
        "startup.speed_step": to.of("change of the forced speed per slow tick", speed_step, ramp),
        "startup.duration_ticks": to.of("slow ticks of the start-up", start_up.time_max / board.tick, ramp),
        "startup.tests": to.at("start_up.consecutive_tests", 1.0),
        "startup.minimum_speed": to.of(
            "start_up.minimum_speed", start_up.minimum_speed / s.speed, either("start_up.minimum_speed")
        ),
        "startup.mean_min": to.at("start_up.mean_min", 1.0),
        "startup.mean_max": to.at("start_up.mean_max", 1.0),
        "startup.damping": to.of(
            "damping of the oscillation", start_up.damping * s.u_s / s.i, either("start_up.swing_damping")
        ),
        "startup.damping_limit": to.of("start_up.swing_current", across, either("start_up.swing_current")),
        "startup.catch_ticks": to.ticks("start_up.catch_time"),
        "startup.fade_step": to.of("start_up.fade_time: current per slow tick", fade, either("start_up.fade_time")),
    }


FIELDS: Final = (
    *(f"observer.{key}" for key in ("f1", "f2", "loss", "drive", "k1", "k2")),
    *(f"pll.{key}" for key in ("kp", "ki", "e_min", "step_max", "speed_per_step", "step_per_speed", "counts_per_turn")),
    "pll.acceleration",
    "pll.load_gain",
    "pll.amplitude_gain",
    "pll.amplitude_load_gain",
    "pll.offset_gain",
    *(f"reliability.{key}" for key in ("period", "variance_threshold", "hysteresis")),
    *(
        f"emf_check.{key}"
        for key in ("floor", "floor_spin", "resistance", "part", "ticks_spin", "ticks_stand", "ticks_check")
    ),
    *(f"startup.{key}" for key in ("first_current", "final_current", "current_step", "final_speed", "speed_step")),
    *(f"startup.{key}" for key in ("duration_ticks", "tests", "minimum_speed", "mean_min", "mean_max")),
    *(f"startup.{key}" for key in ("damping", "damping_limit", "catch_ticks", "fade_step")),
)
"""Fields that are 0 without an observer."""

OFF: Final[Mapping[str, Field]] = {
    **dict.fromkeys(FIELDS, 0),
    "observer.f2": F2,  # used as a shift count
    "observed_speed": PiRaw(0, 0, 0),
}
"""All fields of an axis that cannot work without an encoder."""


def used_observer(block: Mapping[str, int], design: BackEmfObserver, scales: Scales) -> BackEmfObserver:
    """Observer in SI units, computed from the integers."""
    value = partial(AxisConfigTable.load().value, block=block)
    admittance, shift = scales.u_s / scales.i, block["observer.f2"] - block["observer.f1"]
    a = 1.0 - value("observer.loss")
    r_s = (1.0 - a) / (math.ldexp(value("observer.drive"), shift) / admittance)
    k2 = math.ldexp(value("observer.k2"), -shift) * admittance
    return BackEmfObserver(r_s, -r_s * design.period / math.log(a), value("observer.k1"), k2, design.period)


def used_pll(block: Mapping[str, int], axis: Axis, board: Board, scales: Scales) -> Pll:
    """PLL in SI units, computed from the integers."""
    value = partial(AxisConfigTable.load().value, block=block)
    full = scales.u_s / axis("motor.psi_m")
    kp, ki = (math.ldexp(value(f"pll.{key}"), 14 + F2 - 32) * 2.0 * math.pi for key in ("kp", "ki"))
    omega_n = math.sqrt(ki) / board.period
    per_tick = math.ldexp(value("pll.acceleration"), -32)
    per_current = per_tick * 2.0 * math.pi / (scales.i * axis("motor.pole_pairs") * board.tick * board.period)
    load = value("pll.load_gain") / (_steps_per_acceleration(board) * board.tick) / omega_n**3
    follow = value("pll.amplitude_gain") / _step_per_emf(axis, board, scales)
    size = -0.5 * math.log(1.0 - follow) / board.tick
    return Pll(omega_n**2 / full, kp / (2.0 * omega_n * board.period), per_current, load, size)
