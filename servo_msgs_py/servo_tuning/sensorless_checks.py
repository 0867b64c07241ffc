"""Refusals of sensorless configurations: observer, PLL, reliability, start-up."""

from __future__ import annotations

import math
from typing import Final

from servo_tuning.configuration import Axis, Board
from servo_tuning.errors import ConfigError, exactly, higher, lower
from servo_tuning.sensorless import BackEmfObserver, Pll, StartUp

SPEEDS: Final = 64
"""Samples in the FIFO of observed speeds."""

OBSERVER_TO_PLL_MIN: Final = 2.0
"""Smallest ratio of the observer bandwidth to the natural frequency of the PLL."""

LAG_MAX: Final = math.radians(30.0)
"""Largest lag of the PLL behind the ramp of the start-up [rad, electrical]."""


def check_sensorless(axis: Axis, board: Board) -> None:
    """Check observer, phase-locked loop (PLL), reliability and start-up; `check_observer_entries` has accepted them.

    Raises
    ------
    ConfigError
        If the axis cannot work without an encoder.
    """
    pll, start_up = Pll.of(axis), StartUp.of(axis)
    _observer(axis, board, pll)
    _ramps(axis, start_up)
    _pll(axis, board, pll, start_up)
    _reliability(axis)
    _criterion(axis, board, start_up)


def _top(axis: Axis) -> float:
    """Electrical speed at limits.speed [rad/s]."""
    return axis("motor.pole_pairs") * axis("limits.speed")


def check_observer_entries(axis: Axis) -> None:
    """Check that either bandwidth and damping or K1 and K2 are given.

    Raises
    ------
    ConfigError
        If one is missing, or both are given.
    """
    poles, gains = (("bandwidth", "damping"), ("k_1", "k_2"))
    for one, other in (gains, gains[::-1], *(() if axis.given("observer.k_1") else (poles, poles[::-1]))):
        if axis.given(f"observer.{one}") and not axis.given(f"observer.{other}"):
            raise axis.refused(f"observer.{one}", f"observer.{other} is missing", f"write observer.{other}, too")
    if not axis.given("observer.k_1") and not axis.given("observer.bandwidth"):
        raise ConfigError(f"{axis.name}.observer.bandwidth is missing; add it with damping, or k_1 and k_2")
    if axis.given("observer.k_1") and axis.given("observer.bandwidth"):
        own = {key: key not in axis.inherited for key in ("observer.k_1", "observer.bandwidth")}
        if own["observer.k_1"] == own["observer.bandwidth"]:
            reason = f"observer.bandwidth = {axis('observer.bandwidth'):g} Hz specifies the same quantity"
            raise axis.refused("observer.k_1", reason, "remove one of them")


def _observer(axis: Axis, board: Board, pll: Pll) -> None:
    nyquist, locked = 0.5 * board("pwm_frequency"), pll.omega_n(_top(axis)) / (2.0 * math.pi)
    if axis.given("observer.k_1"):
        _signs(axis, board)
    elif axis("observer.bandwidth") >= 0.25 * nyquist:
        reason = f"too fast for a sampling rate of {board('pwm_frequency'):g} Hz"
        raise axis.refused("observer.bandwidth", reason, lower("observer.bandwidth"))
    elif axis("observer.bandwidth") < OBSERVER_TO_PLL_MIN * locked:
        reason = (
            f"below {OBSERVER_TO_PLL_MIN:g} times the natural frequency of the PLL, {locked:.3g} Hz at limits.speed"
        )
        raise axis.refused("observer.bandwidth", reason, higher("observer.bandwidth"), lower("observer.pll_i"))
    _poles(axis, board, locked)


def _signs(axis: Axis, board: Board) -> None:
    """Check K1 and K2 given as numbers."""
    k1, k2, rate = axis("observer.k_1"), axis("observer.k_2"), board("pwm_frequency")
    if k1 >= 0.0:
        reason = "not below 0: the estimate of the current would be unstable"
        raise axis.refused("observer.k_1", reason, exactly("observer.k_1", -0.2 * rate))
    if k1 < -rate:
        reason = f"below -{rate:g} 1/s (-1/T): the estimate overshoots the measured current at every sample"
        raise axis.refused("observer.k_1", reason, lower("observer.k_1"))
    if k2 <= 0.0:
        reason = "not above 0: the estimate of the back-EMF would be unstable"
        raise axis.refused("observer.k_2", reason, exactly("observer.k_2", -k2 if k2 else 1.0))


def _poles(axis: Axis, board: Board, locked: float) -> None:
    """Check the poles of the sampled observer at standstill and at limits.speed."""
    typed = axis.given("observer.k_1")
    entry = "observer.k_2" if typed else "observer.damping"
    changes = (lower("observer.k_2"), lower("observer.k_1")) if typed else (lower("observer.damping"),)
    observer = BackEmfObserver.of(axis, board)
    slowest = math.exp(-2.0 * math.pi * OBSERVER_TO_PLL_MIN * locked * board.period)
    for where, omega_e in (("standstill", 0.0), (f"{axis('limits.speed'):g} rad/s", _top(axis))):
        radius = observer.radius(omega_e)
        if not radius < 1.0:
            reason = f"at {where} a pole of the observer has the magnitude {radius:.3f}, outside the unit circle"
            raise axis.refused(entry, reason, *changes)
        if radius > slowest and (typed or omega_e == 0.0):
            reason = (
                f"at {where} a pole of the observer has the magnitude {radius:.4f}; it must be below {slowest:.4f}: "
                f"{OBSERVER_TO_PLL_MIN:g} times the natural frequency of the PLL, {locked:.3g} Hz"
            )
            others = (higher("observer.k_2"), higher("observer.k_1")) if typed else (higher("observer.bandwidth"),)
            raise axis.refused(entry, reason, *changes, *others, lower("observer.pll_i"))


def _pll(axis: Axis, board: Board, pll: Pll, start_up: StartUp) -> None:
    if 2.0 * pll.damping * pll.omega_n(_top(axis)) * board.period >= 0.5:
        reason = (
            f"at limits.speed the PLL has {pll.omega_n(_top(axis)) / 2.0 / math.pi:.4g} Hz, too fast for its sampling"
        )
        raise axis.refused("observer.pll_i", reason, lower("observer.pll_i"))
    if pll.load >= pll.damping:
        reason = f"not below observer.pll_damping = {pll.damping:g}: the PLL oscillates, undamped at twice that value"
        raise axis.refused("observer.pll_load", reason, lower("observer.pll_load"))
    p = axis("motor.pole_pairs")
    lag = p * start_up.acceleration / pll.omega_n(p * start_up.speed_final) ** 2
    if lag > LAG_MAX:
        reason = f"the PLL would lag the start-up ramp by {math.degrees(min(lag, 1e3)):.3g} degrees"
        longer = "start_up.speed_time" if axis.given("start_up.speed_time") else "start_up.swings"
        raise axis.refused("observer.pll_i", reason, higher("observer.pll_i"), higher(longer))


def _reliability(axis: Axis) -> None:
    if axis("reliability.variance_threshold") >= 0.5:
        reason = "not below 0.5, the normalised variance of a speed that oscillates between 0 and twice its mean"
        raise axis.refused("reliability.variance_threshold", reason, lower("reliability.variance_threshold"))


def _ramps(axis: Axis, start_up: StartUp) -> None:
    """Check the current limit, and that the rotor can follow the ramp."""
    along = max(axis(f"start_up.current_{key}") for key in ("first", "final"))
    across = axis("start_up.current_final") * axis("start_up.swing_current")
    if math.hypot(along, across) > 1.0:
        total = math.hypot(along, across) * axis("limits.current")
        reason = f"the largest start-up current is {total:.3g} A, more than limits.current"
        reduced = (lower(f"start_up.{key}") for key in ("swing_current", "current_final", "current_first"))
        raise axis.refused("start_up.swing_current", reason, *reduced)
    entry = "start_up.speed_time" if axis.given("start_up.speed_time") else "start_up.swings"
    friction = axis("friction.coulomb") + axis("friction.viscous") * start_up.speed_final
    for key, current in (("first", start_up.current_first), ("final", start_up.current_final)):
        torque = axis.torque_constant * current
        if friction >= torque:
            reason = f"its torque of {torque:.3g} N m does not overcome the friction, {friction:.3g} N m"
            changes = higher(f"start_up.current_{key}"), higher("limits.current"), lower("friction.coulomb")
            raise axis.refused(f"start_up.current_{key}", reason, *changes, lower("friction.viscous"))
    if start_up.torque >= 1.0:
        speed, seconds = start_up.speed_final, start_up.speed_time
        required = f"{speed:.3g} rad/s in {seconds:.3g} s require {start_up.acceleration:.4g} rad/s^2"
        reason = f"{required}, with friction {start_up.torque:.3g} times the torque of the start-up current"
        others = (higher(f"start_up.current_{key}") for key in ("first", "final"))
        raise axis.refused(entry, reason, higher(entry), *others, "correct motor.inertia")


def _criterion(axis: Axis, board: Board, start_up: StartUp) -> None:
    """Check that the conditions of the start-up criterion do not contradict each other."""
    if axis("start_up.mean_max") <= 1.0:
        reason = "not above 1, the value of a following rotor"
        raise axis.refused("start_up.mean_max", reason, higher("start_up.mean_max"))
    if axis("start_up.mean_min") >= 1.0:
        reason = "not below 1, the value of a following rotor"
        raise axis.refused("start_up.mean_min", reason, lower("start_up.mean_min"))
    if axis("start_up.minimum_speed") >= axis("start_up.mean_min") * axis("start_up.speed_final"):
        passing = axis("start_up.mean_min") * start_up.speed_final
        minimum = start_up.minimum_speed
        reason = f"{minimum:.4g} rad/s, not below start_up.mean_min at the end of the ramp, {passing:.4g} rad/s"
        changes = lower("start_up.minimum_speed"), higher("start_up.speed_final")
        raise axis.refused("start_up.minimum_speed", reason, *changes)
    whole = (SPEEDS + axis("start_up.consecutive_tests")) * axis("reliability.period") * board.tick
    if whole > start_up.time_max:
        reason = f"{SPEEDS} speeds and the tests take {whole:.3g} s; the start-up fails after {start_up.time_max:.3g} s"
        fewer = lower("reliability.period"), lower("start_up.consecutive_tests")
        raise axis.refused("start_up.wait_max", reason, higher("start_up.wait_max"), *fewer)
