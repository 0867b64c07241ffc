"""Rotor search: consistency of its entries; resolution and times, which depend on pole pairs and inertia."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from servo_tuning.configuration import FEEDBACKS, Axis, Board
from servo_tuning.errors import higher, lower

HOLD_SWINGS: Final = 1.0
"""Least duration of the hold, in periods of the swing: a swing with friction has passed its first turning points."""

VERIFY_SWINGS: Final = 4.0
"""Least duration of the rotation of the verification, in periods: the lag of the shaft behind it remains small."""


GROWTH_MAX: Final = 4.0
"""Largest growth of the current over that of the first vectors, as in the firmware."""

LOW_CURRENT: Final = 0.25
"""Part of the requested current below which the current of the search is low, as in the firmware; from this part of the
limit on."""

LOW_CURRENT_PERIODS: Final = 64
"""PWM periods of a low current that end the search, as in the firmware."""

LOST_MARGIN: Final = 1.2
"""Margin of the voltage that dead time and switches take from a vector."""

SALIENT_USE: Final = 0.5
"""Largest current of the search, relative to the one at which a salient rotor leaves the vector."""

FRICTION_USE: Final = 0.25
"""Largest electrical angle between rotor and vector by Coulomb friction [rad]; with 0.28 and 0.46 the searches of two
salient motors had no result."""


@dataclass(frozen=True)
class RotorSearch:
    """Resolution and times that the search uses: the entries, or more where encoder or shaft require it."""

    interval: float  # remaining interval at which the search ends, at least a count [deg electrical]
    ramp: float  # time from zero to the full current of the search, for the first vectors [s]
    swing: float  # period of the rotor's oscillation about the vector at the full current of the search [s]
    hold: float  # time at full current without a count [s]
    verify: float  # duration of the rotation of the vector in the verification [s]
    longest: float  # duration of a successful search, at most [s]
    time_max: float  # after which the shaft is assumed to be driven by its load [s]

    @property
    def halvings(self) -> int:
        """Vectors of the bisection."""
        return math.ceil(math.log2(360.0 / self.interval))

    @classmethod
    def of(cls, axis: Axis, board: Board) -> RotorSearch:
        """Values for the nominal inertia."""
        stiffness = axis("motor.pole_pairs") * axis.torque_constant * axis("rotor_search.current")  # [N m/rad]
        swing = 2.0 * math.pi * math.sqrt(axis("motor.inertia") / stiffness)
        slowest = axis("rotor_search.verify_angle") / 360.0 * 65536.0 * board.tick  # one step of the vector per tick
        hold = max(axis("rotor_search.hold_time"), HOLD_SWINGS * swing)
        verify = max(axis("rotor_search.verify_time"), min(VERIFY_SWINGS * swing, slowest))
        ramp = max(axis("rotor_search.ramp_time"), _overcoming_time(axis, board))
        bare = cls(max(axis("rotor_search.interval"), count_angle(axis)), ramp, swing, hold, verify, 0.0, 0.0)
        each = ramp + hold + axis("rotor_search.rest_time")
        longest = bare.halvings * each + 4.0 * verify  # rotations to one side, to the other side, and back
        return replace(bare, longest=longest, time_max=max(axis("rotor_search.time_max"), longest))


def _overcoming_time(axis: Axis, board: Board) -> float:
    """Least time of the ramp with which the current controller overcomes the lost voltage of the legs [s].

    Until then no current flows: a search whose current stays low has found an open wire. The voltage of the controller
    grows with the current that is requested, t / ramp, and with its integral. Within its change during a dead time a
    current loses a voltage in proportion.
    """
    omega = 2.0 * math.pi * axis("control.current_bandwidth")
    current, low_time = axis("rotor_search.current"), LOW_CURRENT_PERIODS * board.period
    inductance, voltage = min(axis("motor.l_d"), axis("motor.l_q")), board("nominal_voltage")
    lost = 4.0 / 3.0 * (voltage * board("dead_time") / board.period + board("switch_drop"))
    lost *= min(1.5 * LOW_CURRENT**2 * current * inductance / (voltage * board("dead_time")), 1.0)
    proportional = LOW_CURRENT * omega * inductance * current
    integral = omega * axis("motor.r_s") * current  # change of the voltage with the full current [V/s]
    # at the time x / 4 + T: integral / (2 x) (x / 4 + T)^2 = lost - proportional, with x: ramp of the fastest growth
    needed = 2.0 * max(LOST_MARGIN * lost - proportional, 0.0) / integral - 0.5 * low_time
    if needed <= 0.5 * low_time:
        return 0.0
    return GROWTH_MAX * 8.0 * (needed + math.sqrt(needed**2 - 0.25 * low_time**2))


def count_angle(axis: Axis) -> float:
    """Electrical angle of a count [deg]."""
    return 360.0 * axis("motor.pole_pairs") / axis.counts


def check_rotor_search(axis: Axis, board: Board) -> None:
    """Check current, resolution and duration.

    Raises
    ------
    ConfigError
        If a check fails.
    """
    maximum = axis("limits.current")
    if axis("rotor_search.current") > maximum:
        reason = f"above the current limit of {maximum:g} A (limits.current)"
        raise axis.refused("rotor_search.current", reason, lower("rotor_search.current"), higher("limits.current"))
    saliency = max(axis("motor.l_q") - axis("motor.l_d"), 0.0)
    largest = SALIENT_USE * axis("motor.psi_m") / saliency if saliency else math.inf
    current = min(axis("rotor_search.current"), largest)
    stiffness = axis.torque_constant * current * (1.0 - current * saliency / axis("motor.psi_m"))  # [N m/rad]
    if axis.feedback == FEEDBACKS[0] and axis("friction.coulomb") > FRICTION_USE * stiffness:
        reason = (
            f"friction can hold the rotor {axis('friction.coulomb') / stiffness:.2g} rad (electrical) off the current"
        )
        reason = f"{reason} vector at {current:.3g} A, more than {FRICTION_USE:g} rad"
        if current == largest:
            reason = f"{reason}; above this current the reluctance of this rotor turns it off the vector"
        advice = "correct friction.coulomb, motor.psi_m or motor.l_q"
        raise axis.refused("rotor_search.current", reason, higher("rotor_search.current"), advice)
    if current < axis("rotor_search.current"):
        reason = f"above {largest:.3g} A the reluctance of this rotor turns it off the current vector"
        raise axis.refused("rotor_search.current", reason, lower("rotor_search.current"))
    if axis("rotor_search.interval") >= 60.0:
        raise axis.refused("rotor_search.interval", "the torque is uncertain", lower("rotor_search.interval"))
    if axis("rotor_search.move_counts") < 3.0:
        reason = "below 3: dither at an encoder edge gives up to 2 counts without rotation"
        raise axis.refused("rotor_search.move_counts", reason, higher("rotor_search.move_counts"))
    if axis("rotor_search.move_counts") * count_angle(axis) >= 0.5 * axis("rotor_search.verify_angle"):
        reason = "not below half of rotor_search.verify_angle: the rest is for friction"
        changes = lower("rotor_search.move_counts"), higher("rotor_search.verify_angle")
        raise axis.refused("rotor_search.move_counts", reason, *changes)
    halvings = RotorSearch.of(axis, board).halvings
    longest = halvings * sum(axis(f"rotor_search.{key}_time") for key in ("ramp", "hold", "rest"))
    longest += 4.0 * axis("rotor_search.verify_time")
    if axis("rotor_search.time_max") < longest:
        reason = f"{halvings} vectors and the verification take up to {longest:.3g} s"
        shorter = (lower(f"rotor_search.{key}_time") for key in ("ramp", "hold", "rest", "verify"))
        raise axis.refused("rotor_search.time_max", reason, higher("rotor_search.time_max"), *shorter)
