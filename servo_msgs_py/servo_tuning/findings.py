"""Warnings about an axis that can run: one sentence each, with the entry and a remedy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from servo_tuning.assessment import Assessment
from servo_tuning.field_weakening import field_weakening_loops
from servo_tuning.optional import PARTS
from servo_tuning.rotor_search import RotorSearch
from servo_tuning.sensorless_constants import needs_observer
from servo_tuning.sensorless_figures import SensorlessFigures
from servo_tuning.tuned import Tuned

PHASE_MIN: Final = 45.0
"""Recommended phase margin of current and speed loop [degrees]."""

GAIN_MIN: Final = 2.0
"""Recommended gain margin of current and speed loop."""

K_V_T_MAX: Final = 0.25
"""Largest K_v T without overshoot of the position loop, if the speed loop is of first order."""

OVERSHOOT_MAX: Final = 0.01
"""Largest overshoot of a position step without shaping, over the step."""

MOVE_OVERSHOOT_MAX: Final = 2.0
"""Largest overshoot of a shaped move at the speed limit [counts]."""

ROUNDING_MAX: Final = 0.01
"""Largest relative error of a gain by rounding to an integer."""

START_UP_TORQUE_MAX: Final = 0.8
"""Largest torque of ramp and friction, as a fraction of the torque of the start-up current."""

BLIND_SPEED_MAX: Final = 0.2
"""Largest speed, as a fraction of the speed limit, below which the back-EMF may be hidden during braking."""

PLL_SIZE_MAX: Final = 4.0
"""Largest product of `observer.pll_size` [Hz] and the relative speed error (speed error that `emf_check.floor` permits
over the speed limit): the speed loop responds to this error. At twice this product the observed speed of a light shaft
was too noisy."""

PLL_SIZE_RECOMMENDED: Final = 2.0
"""Recommended product, used in the remedy [Hz]."""

SPEED_ERROR_MAX: Final = 1.25
"""Largest speed error by dead time and switch drops, over `start_up.minimum_speed`. On the switching plant a tiny motor
always lost synchronism at 2.7 and 1.2 and often at 0.91 (no warning there: heavier motors did not at 1.1)."""

SPEED_ERROR_RECOMMENDED: Final = 0.68
"""Recommended ratio, used in the remedy; the tiny motor did not lose synchronism at it."""

FOLLOW_VOLTAGE_MIN: Final = 0.03
"""Smallest mean voltage by which the rotor search distinguishes a following rotor from a blocked one [V]. On the
switching plant 0.019 V were hidden by switch drops and dead time, 0.036 V were not."""

FOLLOW_VOLTAGE_RECOMMENDED: Final = 0.075
"""Recommended voltage, used in the remedy [V]; the motors of the reference design have 0.087 V or more."""

SEARCH_SWINGS_MIN: Final = 2.0
"""Smallest duration of the rotation in the verification of the rotor search, in periods of the swing of the shaft."""

_ENTRIES: Final = {
    "current d": "control.current_bandwidth",
    "current q": "control.current_bandwidth",
    "speed": "control.speed_bandwidth",
    "speed, observer": "control.speed_bandwidth",
}


class Finding(str):
    """Text of a warning."""

    to_lower: str = (
        ""  # entry that removes the warning if it is lowered, such as axis1.control.speed_bandwidth; or empty
    )


def _lower(design: Tuned, path: str, text: str) -> Finding:
    """Warning that ends with the remedy."""
    found = Finding(text)
    found.to_lower = f"{design.axis.name}.{path}"
    return found


def findings(design: Tuned, figures: Assessment) -> list[str]:
    """All warnings of one axis."""
    return [
        *_margins(design, figures),
        *_inertias(design, figures),
        *_position(design, figures),
        *_reach(design, figures),
        *_field_weakening(design),
        *_rounding(design),
        *_follows(design),
        *_unusable(design),
        *_sensorless(design, figures),
    ]


def _entry(design: Tuned, path: str) -> str:
    return f"{design.axis.entry(path)} = {design.axis(path):g}"


def _margins(design: Tuned, figures: Assessment) -> Iterator[str]:
    for loop in figures.loops:
        if loop.name not in _ENTRIES or not loop.in_force:
            continue
        path = _ENTRIES[loop.name]
        text = f"{_entry(design, path)}: the {loop.name} loop has a"
        phase, gain = loop.margins.phase, loop.margins.gain
        if phase is not None and phase < PHASE_MIN:
            yield _lower(design, path, f"{text} phase margin of {phase:.1f} deg, less than {PHASE_MIN:g}; lower it")
        if gain is not None and gain < GAIN_MIN:
            yield _lower(design, path, f"{text} gain margin of {gain:.2f}, less than {GAIN_MIN:g}; lower it")


def _inertias(design: Tuned, figures: Assessment) -> Iterator[str]:
    for case in figures.inertias:
        if not case.stable and case.observed == design.observed:
            entry = _entry(design, "motor.inertia")
            text = f"{entry}: unstable with {case.factor:g} times this inertia; lower control.speed_bandwidth"
            yield _lower(design, "control.speed_bandwidth", text)


def _position(design: Tuned, figures: Assessment) -> Iterator[str]:
    path, rule, arrival = "control.position_gain", figures.rule, figures.arrival
    entry = _entry(design, path)
    if rule.k_v_t > K_V_T_MAX:
        text = f"{entry}: K_v T = {rule.k_v_t:.2f} > {K_V_T_MAX:g}, the shaft may overshoot; lower it"
        yield _lower(design, path, text)
    if arrival.bare > OVERSHOOT_MAX:
        text = f"{entry}: a step without shaping overshoots by {100.0 * arrival.bare:.1f} %; lower it"
        yield _lower(design, path, text)
    if arrival.shaped > MOVE_OVERSHOOT_MAX:
        text = f"{entry}: a shaped move overshoots by {arrival.shaped:.1f} counts; lower it or control.path_current_use"
        yield _lower(design, path, text)


def _reach(design: Tuned, figures: Assessment) -> Iterator[str]:
    reach, limit = figures.reach, design.axis("limits.current")
    if design.axis("limits.speed") > reach.speed_rated:
        entry = _entry(design, "limits.speed")
        yield f"{entry}: above the speed possible with the rated current, {reach.speed_rated:.4g} rad/s; lower it"
    required = {"control.path_current_use": reach.path_current, "limits.acceleration": reach.ramp_current}
    for path, current in required.items():
        if current + reach.friction_current > limit:
            sums = f"requires {current:.2f} A, with friction {current + reach.friction_current:.2f} A"
            yield _lower(design, path, f"{_entry(design, path)}: {sums}; the limit is {limit:g} A; lower it")


def _field_weakening(design: Tuned) -> Iterator[str]:
    if not design.axis.features["field_weakening"]:
        return
    for name, loop in field_weakening_loops(design.axis, design.board, design.block).items():
        if loop.gain * GAIN_MIN > 1.0:
            entry = _entry(design, "field_weakening.bandwidth")
            text = f"{entry}: the loop {name} has a gain margin of {1 / loop.gain:.2f}"
            yield f"{text}, less than {GAIN_MIN:g}; lower it or field_weakening.current_use"


def _rounding(design: Tuned) -> Iterator[str]:
    for row in design.rows():
        lost = abs(row.used / row.designed - 1.0)
        if lost > ROUNDING_MAX:
            value = f"{design.axis.name}: {row.name} = {row.designed:g} {row.unit}".rstrip()
            yield f"{value}: rounding to an integer changes it by {100.0 * lost:.0f} %; choose a larger value"


def _follows(design: Tuned) -> Iterator[str]:
    axis = design.axis
    search = RotorSearch.of(axis, design.board)
    if search.verify < SEARCH_SWINGS_MIN * search.swing:
        text = f"a swing of the shaft about the vector takes {search.swing:.3g} s, too slow for a rotation in"
        text = f"{text} {search.verify:.3g} s"
        yield f"{_entry(design, 'rotor_search.current')}: {text}; raise it, or rotor_search.verify_angle"
    flux = axis("rotor_search.follow_flux") * axis("motor.psi_m") * math.radians(axis("rotor_search.turn_angle"))
    seen = flux / axis("rotor_search.turn_time")
    if seen < FOLLOW_VOLTAGE_MIN:
        text = f"a following rotor gives {1e3 * seen:.2g} mV, below the error by dead time and switch drops"
        yield f"{_entry(design, 'rotor_search.turn_time')}: {text}; write about {flux / FOLLOW_VOLTAGE_RECOMMENDED:.2g}"


def _unusable(design: Tuned) -> Iterator[str]:
    for name, reason in design.unusable.items():
        yield f"{design.axis.name}: {PARTS[name].needed_for} cannot be used: {reason}"
    if not design.axis.features["over_speed"] and design.axis("limits.over_speed") <= design.axis("limits.speed"):
        text = f"with the feature OVER_SPEED a fault below limits.speed = {design.axis('limits.speed'):g} rad/s"
        yield f"{_entry(design, 'limits.over_speed')}: {text}; write {1.2 * design.axis('limits.speed'):.3g}"


def _sensorless(design: Tuned, figures: Assessment) -> Iterator[str]:
    if design.used_sensorless is None:
        return
    found, start_up = figures.sensorless, design.used_sensorless.start_up
    if start_up.torque > START_UP_TORQUE_MAX:
        entry = _entry(design, "start_up.current_first")
        share = f"{100.0 * start_up.torque:.0f} % of the torque of its current"
        yield f"{entry}: the start-up needs {share}; raise start_up.swings"
    yield from _back_emf(design, found)
    for case in found.poles:
        if any(abs(pole.z) >= 1.0 for pole in case.poles):
            text = f"with R x {case.r_s:g} and L x {case.inductance:g} the gains of the observer are unstable"
            yield f"{design.axis.name}.observer at {case.speed:g} rad/s: {text}; lower observer.bandwidth"
    if needs_observer(design.axis):
        yield from _observed_speed(design, figures)


def _back_emf(design: Tuned, found: SensorlessFigures) -> Iterator[str]:
    limit = design.axis("limits.speed")
    if found.blind_speed > BLIND_SPEED_MAX * limit:
        hidden = (
            f"below {found.blind_speed:.3g} rad/s the drop of limits.current in a warm winding exceeds the back-EMF"
        )
        entry = _entry(design, "motor.r_s")
        yield f"{entry}: sensorless, {hidden} in braking; lower limits.current, or use the encoder"
    part = found.unexplained_speed / limit
    if design.axis("observer.pll_size") * part > PLL_SIZE_MAX:
        text = f"dead time and switch drops give a speed error of {found.unexplained_speed:.3g} rad/s"
        yield f"{_entry(design, 'observer.pll_size')}: {text}; write about {PLL_SIZE_RECOMMENDED / part:.2g}"
    if found.unexplained_speed > SPEED_ERROR_MAX * design.sensorless.start_up.minimum_speed:
        text = f"dead time and switch drops give a speed error of {found.unexplained_speed:.3g} rad/s, sensorless"
        yield f"{_entry(design, 'start_up.minimum_speed')}: {text}; write about {part / SPEED_ERROR_RECOMMENDED:.2g}"


def _observed_speed(design: Tuned, figures: Assessment) -> Iterator[str]:
    for lock in figures.sensorless.locks:
        phase = lock.speed_margins.phase
        if phase is not None and phase < PHASE_MIN:
            text = f"at {lock.speed:.3g} rad/s the speed loop has a phase margin of {phase:.1f} deg"
            yield f"{_entry(design, 'observer.speed_part')}: {text}, less than {PHASE_MIN:g}; lower it"
    lock = figures.sensorless.locks[0]
    if lock.back_emf < design.axis("emf_check.spin_floor"):
        text = f"the back-EMF of {lock.back_emf:.2g} V at {lock.speed:.3g} rad/s is below emf_check.spin_floor"
        yield f"{_entry(design, 'start_up.minimum_speed')}: {text}; raise it"
