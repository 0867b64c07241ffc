"""Warnings about an axis that can run: one sentence each, with the entry and a remedy."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from servo_msgs_py.units import COUNTS_PER_TURN

from servo_tuning.assessment import Assessment
from servo_tuning.configuration import FEEDBACKS, Axis
from servo_tuning.control_loops import control_loops, softened
from servo_tuning.errors import Problem, Remedy, exactly, higher, lower
from servo_tuning.field_weakening import field_weakening_loops
from servo_tuning.gains import current_bandwidth_min
from servo_tuning.linear import spectral_radius
from servo_tuning.motor import Load
from servo_tuning.optional import PARTS
from servo_tuning.rotor_search import RotorSearch
from servo_tuning.sensorless_constants import needs_observer
from servo_tuning.sensorless_figures import SensorlessFigures
from servo_tuning.tuned import DITHER_COUNTS, Tuned

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

DITHER_USE_MAX: Final = 0.5
"""Largest current of an oscillation of one count at the bandwidth of the speed loop, over the current limit."""

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

BANDWIDTH_STEP: Final = 0.9
"""Ratio of the bandwidths that are tried for a load on a spring, down to a hundredth of those of the configuration."""

BANDWIDTH_STEPS: Final = 45

_BANDWIDTHS: Final = ("control.speed_bandwidth", "control.position_gain")

_ENTRIES: Final = {
    "current d": "control.current_bandwidth",
    "current q": "control.current_bandwidth",
    "speed": "control.speed_bandwidth",
    "speed, observer": "control.speed_bandwidth",
}


def findings(design: Tuned, figures: Assessment) -> list[Problem]:
    """All warnings of one axis."""
    return [
        *_exchange(design),  # first: a faster current loop permits a faster speed loop
        *_margins(design, figures),
        *_inertias(design, figures),
        *_spring(design),
        *_dither(design),
        *_position(design, figures),
        *_reach(design, figures),
        *_field_weakening(design),
        *_rounding(design),
        *_follows(design),
        *_unusable(design),
        *_sensorless(design, figures),
        *_blind(design),  # last: often nothing corrects it
    ]


def _exchange(design: Tuned) -> Iterator[Problem]:
    axis, path = design.axis, "control.current_bandwidth"
    wanted = current_bandwidth_min(axis.motor, design.board("pwm_frequency"))
    if axis(path) < wanted:
        reason = f"too slow for the back-EMF, by which winding and shaft oscillate at {axis.motor.exchange:.0f} Hz"
        yield axis.problem(path, reason, exactly(path, wanted))


def _margins(design: Tuned, figures: Assessment) -> Iterator[Problem]:
    for loop in figures.loops:
        if loop.name not in _ENTRIES or not loop.in_force:
            continue
        path = _ENTRIES[loop.name]
        phase, gain = loop.margins.phase, loop.margins.gain
        if phase is not None and phase < PHASE_MIN:
            reason = f"the {loop.name} loop has a phase margin of {phase:.1f} deg, less than {PHASE_MIN:g}"
            yield design.axis.problem(path, reason, lower(path))
        if gain is not None and gain < GAIN_MIN:
            reason = f"the {loop.name} loop has a gain margin of {gain:.2f}, less than {GAIN_MIN:g}"
            yield design.axis.problem(path, reason, lower(path))


def _dither(design: Tuned) -> Iterator[Problem]:
    """At rest the shaft oscillates by a count; a controller that answers with its full current moves it by several."""
    axis, path = design.axis, "control.speed_bandwidth"
    count, omega = 2.0 * math.pi / axis.counts, 2.0 * math.pi * axis(path)
    current = axis("motor.inertia") * omega**2 * count / axis.torque_constant
    limit = DITHER_USE_MAX * axis("limits.current")
    if current > limit:
        reason = f"an oscillation of one count at this frequency requires {current:.3g} A, more than {limit:.3g} A"
        reason = f"{reason}, {DITHER_USE_MAX:g} of limits.current: the shaft would not come to rest"
        yield axis.problem(path, reason, lower(path), higher("limits.current"))


def _blind(design: Tuned) -> Iterator[Problem]:
    """The drive finds no oscillation if the current limit does not permit the smallest swing that counts.

    The current limit is that of motor and inverter, and a slower speed loop is no remedy: random heavy shafts with 0.03
    to 0.3 of the bandwidth passed their target by 7 to 21 counts and stayed there for half a minute. The rate of the
    integral part, which reverses the friction current, falls with the square of the bandwidth. With the whole bandwidth
    they arrived.
    """
    axis, swing = design.axis, design.oscillation_swing
    if swing <= 2.0 * axis("limits.current"):
        return
    changes = []
    if axis.feedback != FEEDBACKS[0]:
        changes.append(lower("observer.speed_part"))
    elif axis("encoder.lines") < COUNTS_PER_TURN / 4:  # the position has no finer counts
        changes.append(higher("encoder.lines"))
    reason = (
        f"{DITHER_COUNTS} counts per slow tick cause a swing of {swing:.3g} A, more than the current limit permits:"
    )
    advice = "raise the current if motor and inverter permit; a speed loop slow enough would overcome friction late"
    yield axis.problem("limits.current", f"{reason} the drive will not find an oscillation", *changes, advice)


def _inertias(design: Tuned, figures: Assessment) -> Iterator[Problem]:
    for case in figures.inertias:
        if not case.stable and case.observed == design.observed:
            reason = f"unstable with {case.factor:g} times this inertia"
            yield design.axis.problem("motor.inertia", reason, lower("control.speed_bandwidth"))


def _spring(design: Tuned) -> Iterator[Problem]:
    """The loops are designed for a rigid shaft; with its load on a spring they may be unstable."""
    load = design.axis.load
    if load is None:
        return
    if _is_stable(design, load, 1.0):
        return
    axis, frequency = design.axis, load.resonance(design.axis("motor.inertia"))
    reason = f"with this spring the load resonates at {frequency:.3g} Hz, and the loops are unstable:"
    reason = f"{reason} the drive will reduce their gains (limit OSCILLATION)"
    parts = (BANDWIDTH_STEP**k for k in range(1, BANDWIDTH_STEPS))
    part = next((p for p in parts if _is_stable(design, load, p) and _is_stable(design, load, GAIN_MIN * p)), None)
    slower = lower("control.speed_bandwidth")
    if part is not None:
        speed, position = (lower(path, _short_below(part * axis(path))) for path in _BANDWIDTHS)
        slower = replace(speed, also=position)
    yield axis.problem("load.stiffness", reason, slower, higher("load.stiffness"))


def _is_stable(design: Tuned, load: Load, part: float) -> bool:
    """Whether the loops are stable with a part of the bandwidths of speed and position control."""
    shaft = control_loops(softened(design.block, part), design.motor).sprung(load, design.observed)
    return max(spectral_radius(shaft.speed_alone), spectral_radius(shaft.position.a)) < 1.0


def _position(design: Tuned, figures: Assessment) -> Iterator[Problem]:
    path, rule, arrival = "control.position_gain", figures.rule, figures.arrival
    if rule.k_v_t > K_V_T_MAX:
        reason = f"K_v T = {rule.k_v_t:.2f} > {K_V_T_MAX:g}, the shaft may overshoot"
        yield design.axis.problem(path, reason, lower(path))
    if arrival.bare > OVERSHOOT_MAX:
        reason = f"a step without shaping overshoots by {100.0 * arrival.bare:.1f} %"
        yield design.axis.problem(path, reason, lower(path))
    if arrival.shaped > MOVE_OVERSHOOT_MAX:
        reason = f"a shaped move overshoots by {arrival.shaped:.1f} counts"
        yield design.axis.problem(path, reason, lower(path), lower("control.path_current_use"))


def _reach(design: Tuned, figures: Assessment) -> Iterator[Problem]:
    reach, limit = figures.reach, design.axis("limits.current")
    if design.axis("limits.speed") > reach.speed_rated:
        reason = f"above the speed possible with the rated current, {reach.speed_rated:.4g} rad/s"
        yield design.axis.problem("limits.speed", reason, lower("limits.speed"))
    required = {"control.path_current_use": reach.path_current, "limits.acceleration": reach.ramp_current}
    for path, current in required.items():
        if current + reach.friction_current > limit:
            sums = f"requires {current:.2f} A, with friction {current + reach.friction_current:.2f} A"
            yield design.axis.problem(path, f"{sums}; the limit is {limit:g} A", lower(path))


def _field_weakening(design: Tuned) -> Iterator[Problem]:
    if not design.axis.features["field_weakening"]:
        return
    for name, loop in field_weakening_loops(design.axis, design.board, design.block).items():
        if loop.gain * GAIN_MIN > 1.0:
            path = "field_weakening.bandwidth"
            reason = f"the loop {name} has a gain margin of {1 / loop.gain:.2f}, less than {GAIN_MIN:g}"
            yield design.axis.problem(path, reason, lower(path), lower("field_weakening.current_use"))


def _rounding(design: Tuned) -> Iterator[Problem]:
    for row in design.rows():
        lost = abs(row.used / row.designed - 1.0)
        if lost > ROUNDING_MAX:
            value = f"{design.axis.name}: {row.name} = {row.designed:g} {row.unit}".rstrip()
            fact = f"{value}: rounding to an integer changes it by {100.0 * lost:.0f} %"
            yield Problem(fact, advice="choose a larger value")


def _follows(design: Tuned) -> Iterator[Problem]:
    axis = design.axis
    search = RotorSearch.of(axis, design.board)
    if search.verify < SEARCH_SWINGS_MIN * search.swing:
        reason = f"a swing of the shaft about the vector takes {search.swing:.3g} s, too slow for a rotation in"
        changes = higher("rotor_search.current"), higher("rotor_search.verify_angle")
        yield axis.problem("rotor_search.current", f"{reason} {search.verify:.3g} s", *changes)
    flux = axis("rotor_search.follow_flux") * axis("motor.psi_m") * math.radians(axis("rotor_search.turn_angle"))
    seen = flux / axis("rotor_search.turn_time")
    if seen < FOLLOW_VOLTAGE_MIN:
        reason = f"a following rotor gives {1e3 * seen:.2g} mV, below the error by dead time and switch drops"
        path = "rotor_search.turn_time"
        yield axis.problem(path, reason, exactly(path, _short(flux / FOLLOW_VOLTAGE_RECOMMENDED)))


def _short(value: float) -> float:
    return float(f"{value:.2g}")


def _short_below(value: float) -> float:
    digit: float = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / digit + 1e-9) * digit:.2g}")


def _unusable(design: Tuned) -> Iterator[Problem]:
    axis = design.axis
    for name, problem in design.unusable.items():
        yield Problem(f"{axis.name}: {PARTS[name].needed_for} cannot be used: {problem}")
    if not axis.features["over_speed"] and axis("limits.over_speed") <= axis("limits.speed"):
        reason = f"with the feature OVER_SPEED a fault below limits.speed = {axis('limits.speed'):g} rad/s"
        yield axis.problem("limits.over_speed", reason, higher("limits.over_speed", 1.2 * axis("limits.speed")))


def _sensorless(design: Tuned, figures: Assessment) -> Iterator[Problem]:
    if design.used_sensorless is None or not needs_observer(design.axis):
        return
    found, start_up = figures.sensorless, design.used_sensorless.start_up
    if start_up.torque > START_UP_TORQUE_MAX:
        reason = f"the start-up needs {100.0 * start_up.torque:.0f} % of the torque of its current"
        yield design.axis.problem("start_up.current_first", reason, higher("start_up.swings"))
    yield from _back_emf(design, found)
    for case in found.poles:
        if any(abs(pole.z) >= 1.0 for pole in case.poles):
            text = f"with R x {case.r_s:g} and L x {case.inductance:g} the gains of the observer are unstable"
            fact = f"{design.axis.name}.observer at {case.speed:g} rad/s: {text}"
            yield Problem(fact, advice="lower observer.bandwidth")
    yield from _observed_speed(design, figures)


def _back_emf(design: Tuned, found: SensorlessFigures) -> Iterator[Problem]:
    axis, limit = design.axis, design.axis("limits.speed")
    if found.blind_speed > BLIND_SPEED_MAX * limit:
        hidden = (
            f"below {found.blind_speed:.3g} rad/s the drop of limits.current in a warm winding exceeds the back-EMF"
        )
        advice = "lower limits.current, or use the encoder"
        yield axis.problem("motor.r_s", f"sensorless, {hidden} in braking", advice)
    part = found.unexplained_speed / limit
    reason = f"dead time and switch drops give a speed error of {found.unexplained_speed:.3g} rad/s"
    if axis("observer.pll_size") * part > PLL_SIZE_MAX:
        path = "observer.pll_size"
        yield axis.problem(path, reason, exactly(path, _short(PLL_SIZE_RECOMMENDED / part)))
    if found.unexplained_speed > SPEED_ERROR_MAX * design.sensorless.start_up.minimum_speed:
        yield axis.problem("start_up.minimum_speed", f"{reason}, sensorless", _minimum_speed(axis, part))


def _minimum_speed(axis: Axis, part: float) -> Remedy | str:
    """Remedy of a relative speed error; the ramp of the start-up ends above the minimum speed."""
    slowest = _short(part / SPEED_ERROR_RECOMMENDED)
    remedy = exactly("start_up.minimum_speed", slowest)
    if slowest < axis("start_up.mean_min") * axis("start_up.speed_final"):
        return remedy
    final = _short(1.1 * slowest / axis("start_up.mean_min"))
    return replace(remedy, also=exactly("start_up.speed_final", final)) if final < 1.0 else "use the encoder"


def _observed_speed(design: Tuned, figures: Assessment) -> Iterator[Problem]:
    for lock in figures.sensorless.locks:
        phase = lock.speed_margins.phase
        if phase is not None and phase < PHASE_MIN:
            text = f"at {lock.speed:.3g} rad/s the speed loop has a phase margin of {phase:.1f} deg"
            yield design.axis.problem(
                "observer.speed_part", f"{text}, less than {PHASE_MIN:g}", lower("observer.speed_part")
            )
    lock = figures.sensorless.locks[0]
    if lock.back_emf < design.axis("emf_check.spin_floor"):
        reason = f"the back-EMF of {lock.back_emf:.2g} V at {lock.speed:.3g} rad/s is below emf_check.spin_floor"
        yield design.axis.problem("start_up.minimum_speed", reason, higher("start_up.minimum_speed"))
