"""What is wrong with an axis that can run: each finding one sentence with the entry and a way out."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from servo_msgs_py.tuning.assessment import Assessment
from servo_msgs_py.tuning.field_weakening import field_weakening_loops
from servo_msgs_py.tuning.sensorless_constants import needs_observer
from servo_msgs_py.tuning.sensorless_figures import SensorlessFigures
from servo_msgs_py.tuning.tuned import Tuned

PHASE_MIN: Final = 45.0
"""Phase margin that current and speed loop should have [degrees]."""

GAIN_MIN: Final = 2.0
"""Gain margin that they should have."""

K_V_T_MAX: Final = 0.25
"""K_v T up to which a first-order speed loop gives a position loop that does not overshoot."""

OVERSHOOT_MAX: Final = 0.01
"""Of a bare position step."""

ARRIVAL_MAX: Final = 2.0
"""Overshoot of a shaped move at the speed limit [counts]."""

ROUNDING_MAX: Final = 0.01
"""Part of a gain that may be lost by rounding it to an integer."""

SIGN: Final = 1.33
"""Current from which on its direction counts as certain, over what it changes by in a dead time."""

TORQUE_MAX: Final = 0.8
"""Part of the start-up current's torque that the ramp and the friction should take."""

BLIND_MAX: Final = 0.2
"""Part of the speed limit below which an axis without an encoder may be blind while it brakes."""

SIZE_MAX: Final = 4.0
"""`observer.pll_size` [Hz] times the part of the speed limit by which `emf_check.floor` lets the size of the back-EMF
be off: the speed loop answers to that. With twice as much the observed speed of a light shaft was too noisy to be
used."""

SIZE: Final = 2.0
"""What may be written without trying."""

UNEXPLAINED_MAX: Final = 1.25
"""Speed that dead time and switches look like, over `start_up.minimum_speed`. On the switching plant a tiny motor was
always lost at 2.7 and 1.2 and often at 0.91, without a warning there: heavier ones were not at 1.1."""

UNEXPLAINED: Final = 0.68
"""What may be written without trying: the tiny one was not lost then."""

FOLLOWS_MIN: Final = 0.03
"""Mean voltage that tells a rotor that follows the search's turn from one that is held [V]. On the switching plant
0.019 V were lost in drops and dead time, 0.036 V were not."""

FOLLOWS: Final = 0.075
"""That of the motors of the reference design [V]."""

_ENTRIES: Final = {
    "current d": "control.current_bandwidth",
    "current q": "control.current_bandwidth",
    "speed": "control.speed_bandwidth",
    "speed, observer": "control.speed_bandwidth",
}


def findings(it: Tuned, figures: Assessment) -> list[str]:
    """Everything that deserves a warning."""
    return [
        *_margins(it, figures),
        *_inertias(it, figures),
        *_position(it, figures),
        *_reach(it, figures),
        *_field_weakening(it),
        *_rounding(it),
        *_sign(it),
        *_follows(it),
        *_sensorless(it, figures),
    ]


def _entry(it: Tuned, path: str) -> str:
    return f"{it.axis.entry(path)} = {it.axis(path):g}"


def _margins(it: Tuned, figures: Assessment) -> Iterator[str]:
    for loop in figures.loops:
        if loop.name not in _ENTRIES or not loop.in_force:
            continue
        what = f"{_entry(it, _ENTRIES[loop.name])}: the {loop.name} loop has a"
        phase, gain = loop.margins.phase, loop.margins.gain
        if phase is not None and phase < PHASE_MIN:
            yield f"{what} phase margin of {phase:.1f} deg, less than {PHASE_MIN:g}; lower it"
        if gain is not None and gain < GAIN_MIN:
            yield f"{what} gain margin of {gain:.2f}, less than {GAIN_MIN:g}; lower it"


def _inertias(it: Tuned, figures: Assessment) -> Iterator[str]:
    for case in figures.inertias:
        if not case.stable and case.observed == it.observed:
            entry = _entry(it, "motor.inertia")
            yield f"{entry}: unstable on a shaft with {case.factor:g} times that; lower control.speed_bandwidth"


def _position(it: Tuned, figures: Assessment) -> Iterator[str]:
    entry, rule, arrival = _entry(it, "control.position_gain"), figures.rule, figures.arrival
    if rule.k_v_t > K_V_T_MAX:
        yield f"{entry}: K_v T = {rule.k_v_t:.2f} > {K_V_T_MAX:g}, the shaft may overshoot; lower it"
    if arrival.bare > OVERSHOOT_MAX:
        yield f"{entry}: a step that nothing shapes overshoots by {100.0 * arrival.bare:.1f} %; lower it"
    if arrival.shaped > ARRIVAL_MAX:
        yield f"{entry}: a shaped move overshoots by {arrival.shaped:.1f} counts; lower it or control.path_current_use"


def _reach(it: Tuned, figures: Assessment) -> Iterator[str]:
    reach, limit = figures.reach, it.axis("limits.current")
    if it.axis("limits.speed") > reach.speed_rated:
        entry = _entry(it, "limits.speed")
        yield f"{entry}: with the rated current the voltage ends at {reach.speed_rated:.4g} rad/s; lower it"
    asked = {"control.path_current_use": reach.path_current, "limits.acceleration": reach.ramp_current}
    for path, current in asked.items():
        if current + reach.friction_current > limit:
            sums = f"asks for {current:.2f} A besides {reach.friction_current:.2f} A of friction"
            yield f"{_entry(it, path)}: {sums}, and the limit is {limit:g} A; lower it"


def _field_weakening(it: Tuned) -> Iterator[str]:
    if not it.axis.features["field_weakening"]:
        return
    for name, loop in field_weakening_loops(it.axis, it.board, it.block).items():
        if loop.gain * GAIN_MIN > 1.0:
            what = (
                f"{_entry(it, 'field_weakening.bandwidth')}: the loop {name} has a gain margin of {1 / loop.gain:.2f}"
            )
            yield f"{what}, less than {GAIN_MIN:g}; lower it or field_weakening.current_use"


def _rounding(it: Tuned) -> Iterator[str]:
    for row in it.rows():
        lost = abs(row.used / row.designed - 1.0)
        if lost > ROUNDING_MAX:
            value = f"{it.axis.name}: {row.name} = {row.designed:g} {row.unit}".rstrip()
            yield f"{value}: rounded to an integer it is off by {100.0 * lost:.0f} %; choose it larger"


def _sign(it: Tuned) -> Iterator[str]:
    """While both switches are open the bus alone drives the current: below that its direction may change meanwhile."""
    axis, board = it.axis, it.board
    minimum = board("nominal_voltage") * board("dead_time") / min(axis("motor.l_d"), axis("motor.l_q"))
    if axis("sensing.sign_current") < minimum:
        what = f"a dead time lets the current of this winding change by {minimum:.3g} A and turn its sign"
        yield f"{_entry(it, 'sensing.sign_current')}: {what}; write some {SIGN * minimum:.2g}"


def _follows(it: Tuned) -> Iterator[str]:
    axis = it.axis
    flux = axis("rotor_search.follow_flux") * axis("motor.psi_m") * math.radians(axis("rotor_search.turn_angle"))
    seen = flux / axis("rotor_search.turn_time")
    if seen < FOLLOWS_MIN:
        what = f"a rotor that follows the turn shows in {1e3 * seen:.2g} mV, less than dead time and switches hide"
        yield f"{_entry(it, 'rotor_search.turn_time')}: {what}; write some {flux / FOLLOWS:.2g}"


def _sensorless(it: Tuned, figures: Assessment) -> Iterator[str]:
    found, start_up = figures.sensorless, it.sensorless.start_up
    if found.trouble is not None:
        yield f"{it.axis.name}.feedback: cannot do without its encoder: {found.trouble}"
        return
    if start_up.torque > TORQUE_MAX:
        entry = _entry(it, "start_up.current_first")
        share = f"{100.0 * start_up.torque:.0f} % of the current's torque"
        yield f"{entry}: the start-up takes {share}; raise start_up.swings"
    yield from _back_emf(it, found)
    for case in found.poles:
        if any(abs(pole.z) >= 1.0 for pole in case.poles):
            what = f"with R x {case.r_s:g} and L x {case.inductance:g} the observer's gains are unstable"
            yield f"{it.axis.name}.observer at {case.speed:g} rad/s: {what}; lower observer.bandwidth"
    if needs_observer(it.axis):
        yield from _observed_speed(it, figures)


def _back_emf(it: Tuned, found: SensorlessFigures) -> Iterator[str]:
    limit = it.axis("limits.speed")
    if found.blind_speed > BLIND_MAX * limit:
        hidden = (
            f"below {found.blind_speed:.3g} rad/s limits.current in a warm winding hides the back-EMF while it brakes"
        )
        yield f"{_entry(it, 'motor.r_s')}: without its encoder {hidden}; lower the limit, or keep the encoder"
    part = found.unexplained_speed / limit
    if it.axis("observer.pll_size") * part > SIZE_MAX:
        what = f"dead time and switches make the back-EMF look like {found.unexplained_speed:.3g} rad/s more or less"
        yield f"{_entry(it, 'observer.pll_size')}: {what}; write some {SIZE / part:.2g}"
    if found.unexplained_speed > UNEXPLAINED_MAX * it.sensorless.start_up.minimum_speed:
        what = f"dead time and switches look like {found.unexplained_speed:.3g} rad/s without an encoder"
        yield f"{_entry(it, 'start_up.minimum_speed')}: {what}; write some {part / UNEXPLAINED:.2g}"


def _observed_speed(it: Tuned, figures: Assessment) -> Iterator[str]:
    for lock in figures.sensorless.locks:
        phase = lock.speed_margins.phase
        if phase is not None and phase < PHASE_MIN:
            what = f"at {lock.speed:.3g} rad/s the speed loop has a phase margin of {phase:.1f} deg"
            yield f"{_entry(it, 'observer.speed_part')}: {what}, less than {PHASE_MIN:g}; lower it"
    lock = figures.sensorless.locks[0]
    if lock.back_emf < it.axis("emf_check.spin_floor"):
        what = f"{lock.speed:.3g} rad/s give {lock.back_emf:.2g} V, less than emf_check.spin_floor leaves unexplained"
        yield f"{_entry(it, 'start_up.minimum_speed')}: {what}; raise it"
