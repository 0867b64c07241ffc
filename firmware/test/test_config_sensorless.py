"""Sensorless part of the tuning tool: gains by hand, poles and angle errors against simulation, other motors."""

from __future__ import annotations

import cmath
import math
import re
from typing import Any

import numpy as np
import pytest
from core_library import Core, load_core
from firmware_compiler import CompileC
from hypothesis import given, settings
from hypothesis import strategies as st
from servo_tuning.assessment import assess
from servo_tuning.errors import ConfigError
from servo_tuning.findings import findings
from servo_tuning.linear import pole_of
from servo_tuning.sensorless import BackEmfObserver, angle_error, st_damping
from servo_tuning.sensorless_constants import F2, FIELDS
from tuning_tool import axis, logarithmic

T = 1.0 / 16000.0
U_FS, I_FS, W_FS = 24.2, 8.25, 5000.0 * math.pi / 30.0
R, L, PSI, P = 0.55, 0.4575e-3, 0.0154, 2
A = math.exp(-R * T / L)
B = (1.0 - A) / R


OBSERVER: dict[str, object] = {"axis1__feedback": "observer"}
"""An axis that needs the observer: an encoder axis is not warned of what it does not use."""
SLIDE: dict[str, object] = {"axis1__observer__pll_i": 1506742.0}


@pytest.fixture(scope="module")
def constants() -> dict[str, Any]:
    return dict(axis(**SLIDE).constants)


# ---- the committed motor, by hand -----------------------------------------------------------------------------------


def test_observer_constants_place_the_pole(constants: dict[str, Any]) -> None:
    pole = math.exp(-(R / (2.0 * L) + 2.0 * math.pi * 500.0) * T)
    f1, f2 = constants["observer.f1"], constants["observer.f2"]
    assert (f1, f2) == (11, 11)
    assert constants["observer.loss"] / 2.0**32 == pytest.approx(1.0 - A, rel=1e-8)
    assert constants["observer.drive"] / 2.0**32 == pytest.approx(B * U_FS / I_FS * 2.0 ** (f1 - f2), rel=1e-8)
    assert constants["observer.k1"] / 2.0**31 == pytest.approx(pole**2 / A - 1.0, rel=1e-8)
    assert constants["observer.k2"] / 2.0**28 == pytest.approx((1.0 - pole) ** 2 / B * I_FS / U_FS, rel=1e-6)


def test_gains_of_the_phase_locked_loop_are_those_of_the_slide(constants: dict[str, Any]) -> None:
    """I gain of the slide in library units: 1506742 f_max / f_s^2 over 2^18; 2^16 per revolution; e(f_max) = 2^15."""
    f_max = P * 4000.0  # electrical revolutions per minute
    i_gain = 1506742.0 * f_max * T**2
    omega_max = f_max * 2.0 * math.pi / 60.0
    square = i_gain * 2.0**15 / 2.0**18 * 2.0 * math.pi / 2.0**16 / T**2
    per_speed = square / omega_max
    assert per_speed == pytest.approx(172.43, rel=1e-4)
    omega_n = math.sqrt(per_speed * U_FS / PSI)  # speed at which the back-EMF is at full scale
    per_error = 2.0**32 / (2.0 * math.pi) / 2.0 ** (14 + 11)
    assert constants["pll.ki"] / 2.0**24 == pytest.approx((omega_n * T) ** 2 * per_error, rel=1e-5)
    assert constants["pll.kp"] / 2.0**24 == pytest.approx(2.0 * omega_n * T * per_error, rel=1e-5)
    turn = P * W_FS * T / (2.0 * math.pi)
    assert constants["pll.step_per_speed"] == pytest.approx(turn * 2.0**32, abs=1)
    assert constants["pll.speed_per_step"] / 2.0**22 * turn * 2.0**32 == pytest.approx(2.0**31, rel=1e-8)
    assert constants["pll.counts_per_turn"] / 65536 == 4000 / P
    gained = 3.0 * PSI * I_FS / 0.8e-5 * P * 0.5e-3 * T / (2.0 * math.pi) * 2.0**32
    assert constants["pll.acceleration"] == pytest.approx(gained, rel=1e-6)
    learnt = omega_n**3 / 8.0 * 0.5e-3 * 0.5e-3 * T / (2.0 * math.pi) * 2.0**32
    assert constants["pll.load_gain"] == pytest.approx(learnt, rel=1e-5)
    decay = math.exp(-2.0 * math.pi * 75.0 * 0.5e-3)
    per_emf = U_FS / 2.0**23 / PSI * T / (2.0 * math.pi) * 2.0**32  # step at the speed of the smallest back-EMF
    assert constants["pll.amplitude_gain"] / 2.0**24 == pytest.approx((1.0 - decay**2) * per_emf, rel=1e-5)
    assert constants["pll.amplitude_load_gain"] / 2.0**24 == pytest.approx((1.0 - decay) ** 2 * per_emf, rel=1e-5)
    assert constants["pll.offset_gain"] / 2.0**24 == pytest.approx(0.5e-3 / 0.128 / per_emf, rel=1e-3)


def test_slide_damping_is_that_of_its_two_gains() -> None:
    """P = 532 f_max / f_s over 2^14: at 4000 rpm of two pole pairs 1.07, at 200 rpm 0.24."""
    for rpm, damping in ((4000.0, 1.073), (200.0, 0.240)):
        omega_e = P * rpm * math.pi / 30.0
        kp = 532.0 * P * rpm * T * 2.0**15 / 2.0**14 * 2.0 * math.pi / 2.0**16 / T
        assert st_damping(omega_e) == pytest.approx(kp / (2.0 * math.sqrt(172.43 * omega_e)), rel=1e-4)
        assert st_damping(omega_e) == pytest.approx(damping, rel=2e-3)


def test_start_up_constants_follow_from_motor_and_load(constants: dict[str, Any]) -> None:
    k_t, inertia = 3.0 * PSI, 0.8e-5
    swing = math.sqrt(P * k_t * 2.0 / inertia)
    ramp = 6.0 * 2.0 * math.pi / swing
    assert constants["startup.first_current"] / 2.0**15 * I_FS == pytest.approx(1.5, abs=1e-3)
    assert constants["startup.final_current"] / 2.0**15 * I_FS == pytest.approx(2.0, abs=1e-3)
    assert constants["startup.current_step"] / 2.0**31 * I_FS == pytest.approx(0.5 * 0.5e-3 / 0.1, rel=1e-5)
    assert constants["startup.final_speed"] / 2.0**31 * W_FS == pytest.approx(0.25 * 314.0, rel=1e-6)
    assert constants["startup.speed_step"] / 2.0**31 * W_FS == pytest.approx(78.5 / ramp * 0.5e-3, rel=1e-5)
    assert constants["startup.duration_ticks"] * 0.5e-3 == pytest.approx(ramp + 1.25, abs=0.5e-3)
    assert constants["startup.minimum_speed"] / 2.0**31 * W_FS == pytest.approx(12.56, rel=1e-6)
    assert constants["startup.mean_min"] / 2.0**14 == pytest.approx(0.8, abs=1e-4)
    damping = 2.0 * 0.7 * swing * inertia / (P * k_t * PSI)
    assert constants["startup.damping"] / 2.0**24 * I_FS / U_FS == pytest.approx(damping, rel=1e-6)


def test_oscillation_of_the_rotor_has_the_requested_damping() -> None:
    """J d'' = -p K_t (I d + i), i = k psi d'; d: electrical lag of the rotor behind the vector."""
    start_up = axis().sensorless.start_up
    stiffness = P * 3.0 * PSI * start_up.current_final / 0.8e-5
    rate = P * 3.0 * PSI * start_up.damping * PSI / 0.8e-5
    assert rate / (2.0 * math.sqrt(stiffness)) == pytest.approx(0.7, rel=1e-9)


def test_a_speed_time_replaces_the_number_of_oscillations() -> None:
    assert axis(axis1__start_up__speed_time=0.4).sensorless.start_up.speed_time == 0.4


def test_typed_gains_are_those_of_the_slide() -> None:
    it = axis(axis1__observer__k_1=-6000.0, axis1__observer__k_2=4000.0)
    rows = {row.name: row.used for row in it.rows()}
    assert rows["observer K1"] == pytest.approx(-6000.0, rel=1e-8)
    assert rows["observer K2"] == pytest.approx(4000.0, rel=1e-6)
    assert it.constants["observer.k1"] == round(-6000.0 * T * 2.0**31)


# ---- poles and angles -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bandwidth", "damping"), [(500.0, 1.0), (300.0, 0.5), (700.0, 2.0)])
def test_poles_at_standstill_have_the_requested_bandwidth_and_damping(bandwidth: float, damping: float) -> None:
    observer = axis(axis1__observer__bandwidth=bandwidth, axis1__observer__damping=damping).sensorless.observer
    omega = 2.0 * math.pi * bandwidth
    root = cmath.sqrt(damping**2 - 1.0)
    expected = [cmath.exp((-R / (2.0 * L) - omega * (damping + sign * root)) * T) for sign in (-1, 1)]
    found = observer.poles(0.0)
    assert sum(found) == pytest.approx(sum(expected), abs=1e-6)
    assert found[0] * found[1] == pytest.approx(expected[0] * expected[1], abs=1e-6)


@pytest.mark.parametrize("omega_e", [0.0, 100.0, 628.0])
def test_an_error_of_the_estimate_decays_like_the_slower_pole(omega_e: float) -> None:
    """Equations of the observer on a winding without current and back-EMF."""
    observer = axis().sensorless.observer
    current, emf, sizes = 1.0 + 0.5j, 0.3 - 2.0j, []
    for _ in range(200):
        emf = (emf + observer.k2 * current) * cmath.exp(1j * omega_e * T)
        current = observer.a * (1.0 + observer.k1) * current - observer.b * emf
        sizes.append(math.hypot(abs(current), abs(emf)))
    rate = (sizes[-1] / sizes[99]) ** (1.0 / 100.0)
    assert rate == pytest.approx(observer.radius(omega_e), rel=0.02)


def observed_emf(
    observer: BackEmfObserver, omega_e: float, i_q: float, r_s: float, l_q: float, psi: float
) -> tuple[complex, complex]:
    """Observed back-EMF in the steady state, and the true one, both at the same angle.

    Voltage and back-EMF are means over a period: half a period ahead of the sample at its beginning.
    """
    turn, ahead = cmath.exp(1j * omega_e * T), cmath.exp(0.5j * omega_e * T)
    emf, current = 1j * omega_e * psi, 1j * i_q
    voltage = r_s * current + 1j * omega_e * l_q * current + emf
    i_est, e_est = current, emf
    for _ in range(3000):
        error = i_est - current
        e_est = (e_est + observer.k2 * error) * turn
        i_est = observer.a * (i_est + observer.k1 * error) + observer.b * (voltage * ahead - e_est)
        i_est, e_est = i_est / turn, e_est / turn  # in the rotor frame
    return e_est * ahead, emf


@pytest.mark.parametrize("factors", [(1.0, 1.0), (0.5, 1.0), (1.5, 1.0), (1.0, 0.5), (1.0, 1.5)])
@pytest.mark.parametrize(("speed", "i_q"), [(42.0, 0.5), (42.0, 2.0), (314.0, 2.0), (628.0, -2.0)])
def test_angle_error_of_another_winding(factors: tuple[float, float], speed: float, i_q: float) -> None:
    it = axis()
    r_s, l_q = factors[0] * R, factors[1] * 0.512e-3
    seen, true = observed_emf(it.sensorless.observer, speed, i_q, r_s, l_q, PSI)
    found = cmath.phase(seen / true)
    predicted = angle_error(it.axis, speed, i_q, *factors)
    assert math.remainder(found - predicted, 2.0 * math.pi) == pytest.approx(0.0, abs=math.radians(0.2))


def test_only_the_inductance_causes_an_angle_error() -> None:
    it = axis()
    assert angle_error(it.axis, 314.0, 2.0, 1.5, 1.0) == pytest.approx(angle_error(it.axis, 314.0, 2.0), rel=0.15)
    assert math.degrees(angle_error(it.axis, 314.0, 2.0, 1.0, 1.5)) == pytest.approx(2.31, abs=0.01)


# ---- figures and findings -------------------------------------------------------------------------------------------


def test_committed_motor_has_large_margins_and_no_warning() -> None:
    figures = assess(axis(**SLIDE)).sensorless
    assert figures.trouble is None
    assert {(entry.r_s, entry.inductance) for entry in figures.poles} >= {(1.0, 1.0), (0.5, 1.0), (1.0, 1.5)}
    assert all(abs(pole.z) < 0.95 for entry in figures.poles for pole in entry.poles)
    assert figures.locks[0].frequency == pytest.approx(math.sqrt(172.43 * 2.0 * 12.56) / 2.0 / math.pi, rel=1e-3)
    assert figures.locks[-1].speed == 314.0
    assert all(lock.half_inertia and lock.twice_inertia for lock in figures.locks)
    phases = [lock.speed_margins.phase for lock in figures.locks]
    assert all(phase is not None and phase > 60.0 for phase in phases)


def test_loop_without_torque_feed_forward_has_less_phase_margin_at_low_speed() -> None:
    full, partial = (
        assess(axis(axis1__observer__pll_torque=part, axis1__feedback="observer")).sensorless.locks[0]
        for part in (1, 0.3)
    )
    assert full.speed_margins.phase is not None
    assert partial.speed_margins.phase is not None
    assert partial.speed_margins.phase < full.speed_margins.phase - 10.0


def test_gains_unstable_with_another_winding_cause_a_warning() -> None:
    gains: dict[str, object] = {"axis1__observer__k_1": -5200.0, "axis1__observer__k_2": 3.1e5}
    it = axis(**gains, **OBSERVER)
    assert any(
        "with R x 1 and L x 0.5 the gains of the observer are unstable" in finding
        for finding in map(str, findings(it, assess(it)))
    )


def test_the_sign_current_follows_the_inductance() -> None:
    """24 V for 1 us change the current of 0.15 mH by 0.16 A."""
    assert axis().constants["current_loop.dead_time.slope"] == axis(2).constants["current_loop.dead_time.slope"]
    slope = axis(axis1__motor__l_d=0.15e-3).constants["current_loop.dead_time.slope"]
    assert slope == round(256.0 * 8.25 / (1.25 * 24.0e-6 / 0.15e-3))
    with pytest.raises(ConfigError, match=r"^axis1\.limits\.current .*changes by 4\.8 A during a dead time") as refusal:
        axis(axis1__motor__l_d=5e-6)
    # the dead time is a property of the switches
    assert [one.entry for one in refusal.value.problem.remedies] == ["axis1.limits.current"]


def test_the_sign_current_is_not_cut_where_the_limit_is_small() -> None:
    """0.8 A per dead time: the direction is certain above 1 A, also in the rotor search."""
    small: dict[str, object] = {"axis1__motor__l_d": 30e-6, "axis1__motor__l_q": 30e-6, "axis1__limits__current": 1.7}
    small["axis1__motor__inertia"] = 8e-5
    with pytest.raises(ConfigError, match=r"^axis1\.rotor_search\.current = 0\.9: below 1 A"):
        axis(**small, axis1__rotor_search__current=0.9)
    found = axis(**small, axis1__rotor_search__current=1.1).constants
    assert found["current_loop.dead_time.slope"] == round(256.0 * 8.25)
    assert found["winding.direction_current_min"] == round(32768.0 / 8.25)


@pytest.mark.parametrize("limit", [0.11, 0.15, 0.3])
def test_a_silent_phase_is_noticed_with_a_small_limit(limit: float) -> None:
    small: dict[str, object] = {"axis1__limits__current": limit, "axis1__rotor_search__current": limit}
    found = axis(**small, axis1__friction__coulomb=1e-4, axis1__motor__l_d=3e-3, axis1__motor__l_q=3e-3).constants
    assert found["winding.current_min"] == round(32768.0 / 8.25 * min(0.16, 0.8 * limit))


def test_a_sign_current_near_the_limit_is_refused_with_both_remedies() -> None:
    with pytest.raises(ConfigError, match=r"^axis1\.sensing\.sign_current .* is not noticed") as refusal:
        axis(axis1__sensing__sign_current=3.3)
    entries = [one.entry for one in refusal.value.problem.remedies]
    assert entries == ["axis1.sensing.sign_current", "axis1.limits.current"]


def test_a_resistance_error_above_the_back_emf_causes_a_warning() -> None:
    """25 % of 2.2 ohm at 4 A: 2.2 V, the back-EMF of 0.0308 V s at 71.4 rad/s, 23 % of the speed limit."""
    it = axis(axis1__motor__r_s=2.2, **OBSERVER)
    assert not it.unusable
    found = [finding for finding in map(str, findings(it, assess(it))) if "exceeds the back-EMF" in finding]
    assert len(found) == 1
    assert "axis1.motor.r_s = 2.2" in found[0]
    assert "below 71.4 rad/s" in found[0]
    cured = axis(axis1__motor__r_s=2.2, axis1__limits__current=3.0, axis1__rotor_search__current=3.0, **OBSERVER)
    assert not any("exceeds the back-EMF" in finding for finding in map(str, findings(cured, assess(cured))))


LITTLE_FLUX: dict[str, object] = {
    "axis1__motor__psi_m": 0.004,
    "axis1__motor__inertia": 2e-6,
    "axis1__motor__rotor_inertia": 1e-6,
}
BLIND: dict[str, object] = {**LITTLE_FLUX, **OBSERVER}


def test_a_flux_too_small_for_the_blocked_shaft_test_causes_a_warning() -> None:
    it = axis(**LITTLE_FLUX)
    seen = 0.3 * 0.004 * math.radians(it.axis("rotor_search.turn_angle")) / 0.1
    found = [finding for finding in map(str, findings(it, assess(it))) if "following rotor" in finding]
    assert len(found) == 1
    assert f"gives {1e3 * seen:.2g} mV" in found[0]
    assert f"write {0.1 * seen / 0.075:.2g}" in found[0]
    cured = axis(**LITTLE_FLUX, axis1__rotor_search__turn_time=0.025)
    assert not any("following rotor" in finding for finding in map(str, findings(cured, assess(cured))))


def test_a_back_emf_too_small_for_the_amplitude_correction_causes_a_warning() -> None:
    """0.35 V / (2 x 0.004 V s) = 43.7 rad/s, 14 % of the speed limit."""
    it = axis(**BLIND)
    found = [finding for finding in map(str, findings(it, assess(it))) if "pll_size" in finding]
    assert len(found) == 1
    assert "speed error of 43.7 rad/s; write 14" in found[0]
    cured = axis(**BLIND, axis1__observer__pll_size=14.0)
    assert not any("pll_size" in finding for finding in map(str, findings(cured, assess(cured))))


def test_a_minimum_speed_within_the_dead_time_error_causes_a_warning() -> None:
    """The same 43.7 rad/s, with a minimum speed of 4 % of the speed limit."""
    it = axis(**BLIND)
    assert it.sensorless.start_up.minimum_speed == pytest.approx(0.04 * it.axis("limits.speed"))
    found = [
        finding
        for finding in map(str, findings(it, assess(it)))
        if "speed error" in finding and "minimum_speed" in finding
    ]
    assert len(found) == 1
    part = 43.75 / it.axis("limits.speed") / 0.68
    assert f"speed error of 43.7 rad/s, sensorless; write axis1.start_up.minimum_speed = {part:.2g} and" in found[0]
    cured = axis(**BLIND, axis1__start_up__minimum_speed=part, axis1__start_up__speed_final=0.4)
    assert not any("minimum_speed" in finding for finding in map(str, findings(cured, assess(cured))))


@pytest.mark.parametrize("changes", [LITTLE_FLUX, {"axis1__motor__r_s": 2.2}])
def test_an_encoder_axis_is_not_warned_of_the_observer(changes: dict[str, object]) -> None:
    it = axis(**changes)
    found = map(str, findings(it, assess(it)))
    assert not [one for one in found if re.search(r"observer|back-EMF exceeds|start_up|sensorless|speed error", one)]


def test_pole_that_rotates_with_the_frame_has_no_conjugate() -> None:
    assert not pole_of(complex(0.9), T).pair


# ---- other motors ---------------------------------------------------------------------------------------------------

FAST_WINDING: dict[str, object] = {"axis1__motor__r_s": 6.0}


def test_a_motor_unsuitable_for_the_observer_runs_with_its_encoder() -> None:
    it = axis(**FAST_WINDING)
    assert set(it.unusable) == {"sensorless"}
    assert {field: raw for field in FIELDS if (raw := it.constants[field]) != 0} == {"observer.f2": F2}
    assert any(
        "operation without an encoder (feedback OBSERVER) and the feature ANGLE_CHECK cannot be used" in finding
        for finding in map(str, findings(it, assess(it)))
    )


@pytest.mark.parametrize("wish", [{"axis1__feedback": "observer"}])
def test_a_motor_unsuitable_for_the_observer_is_refused_without_an_encoder(wish: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"^axis1: R T / L of the observer = 0\.5.*correct motor\.r_s"):
        axis(**FAST_WINDING, **wish)


def test_feedback_is_encoder_or_observer() -> None:
    assert axis(axis1__feedback="observer").constants["feedback"] == 1
    assert axis(2, axis1__feedback="observer").constants["feedback"] == 0
    assert axis(defaults__feedback="encoder").constants["feedback"] == 0
    for wrong in ("hall", 1, True, ["encoder"]):
        with pytest.raises(ConfigError, match=r"^axis1\.feedback = .*write one of encoder, observer"):
            axis(axis1__feedback=wrong)


@settings(max_examples=200)
@given(
    logarithmic(0.05, 5.0),
    logarithmic(0.05e-3, 5e-3),
    logarithmic(100.0, 1900.0),
    st.floats(0.3, 2.0),
    st.floats(0, 1e3),
)
def test_poles_of_any_motor_are_inside_the_unit_circle(
    r_s: float, l_s: float, bandwidth: float, damping: float, omega: float
) -> None:
    changes: dict[str, object] = {"axis1__motor__r_s": r_s, "axis1__motor__l_d": l_s, "axis1__motor__l_q": l_s}
    changes |= {"axis1__observer__bandwidth": bandwidth, "axis1__observer__damping": damping}
    try:
        it = axis(**changes)
    except ConfigError:
        return  # test_config_motors.py tests refusals
    if it.designed_sensorless is not None:
        observer, used = it.designed_sensorless.observer, it.sensorless.observer
        assert observer.k1 < 0.0 < observer.k2
        assert observer.radius(0.0) < 1.0
        assert np.allclose(sorted(map(abs, used.poles(0.0))), sorted(map(abs, observer.poles(0.0))), atol=2e-3)


# ---- the C ----------------------------------------------------------------------------------------------------------


def test_sensorless_constants_fit_the_structure(compile_c: CompileC) -> None:
    core: Core = load_core(compile_c)
    config = core.ffi.new("servo_config_t *")
    for field in FIELDS:
        group, name = field.split(".")
        place = getattr(config.axis[0], group)
        value = axis().constants[field]
        setattr(place, name, value)
        assert getattr(place, name) == value, field
