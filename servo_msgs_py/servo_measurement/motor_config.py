"""Configurations for an unknown motor, and for a motor with measured values."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.units import PERIOD, TICK
from servo_tuning import remedies
from servo_tuning.braking import BUS_END
from servo_tuning.errors import ConfigError, Problem, Remedy, Table
from servo_tuning.gains import current_bandwidth_min
from servo_tuning.members import MEMBERS
from servo_tuning.motor import Motor
from servo_tuning.remedies import refusal_of
from servo_tuning.rotor_search import SALIENT_USE
from servo_tuning.tuned import Tuned, tuned_axis

from servo_measurement.motor_values import Limits

SPEED_USE: Final = 0.8
"""Speed set-point limit, relative to the no-load speed at the available voltage."""

SPEED_RATIO: Final = 1.3
"""Over-speed threshold, relative to the largest set-point."""

ACCELERATION_USE: Final = 0.5
"""Current for the speed ramp, relative to the current limit."""

SUPPLY_END: Final = BUS_END * Catalogue.load().full_scale("bus_voltage")
"""Largest bus voltage that the converter of the board can measure [V]."""

PATH_OMEGA_MAX: Final = 0.2
"""Largest omega_n Ts of the path filter; its format ends at 0.25."""

SPEED_BANDWIDTHS: Final = (75.0, 60.0, 45.0, 30.0, 20.0, 12.0, 8.0, 5.0)
"""Tried in this order until the loops are stable and the tuning tool reports no warning [Hz]."""

SLOW_LOOPS_SPEED_BANDWIDTH: Final = 12.0  # [Hz]
SLOW_LOOPS_CURRENT_BANDWIDTH: Final = 300.0  # [Hz]
CURRENT_BANDWIDTH: Final = 1000.0  # of any other loops, and of a shaft with an unknown inertia [Hz]
VERIFY_TIME_UNKNOWN: Final = 0.6
"""Duration of the verification of a rotor search with an unknown inertia [s]: the longest period of a shaft that has
followed the rotating vector."""
VERIFY_MOVES: Final = 7.0  # angle of the verification of a rotor search, relative to the smallest movement
PHASE_MIN: Final = 50.0  # of the speed loop [degrees]
_CHOSEN: Final = (
    "limits.current",
    "limits.speed",
    "control.current_bandwidth",
    "control.speed_bandwidth",
    "control.position_gain",
)


def configured(
    base: Mapping[str, Any], axis: int, limits: Limits, motor: Mapping[str, float], **groups: Mapping[str, Any]
) -> dict[str, Any]:
    """A ``servo.toml`` for another motor.

    Parameters
    ----------
    base : mapping
        Parsed file with the remaining entries.
    axis : int
        Index of the axis.
    limits : Limits
    motor : mapping
        ``r_s``, ``l_d``, ``l_q``, ``psi_m``, ``pole_pairs``, ``inertia``, ``friction``, ``viscous`` [SI].
    **groups : mapping
        Additional entries of the axis, by group.
    """
    table = copy.deepcopy(dict(base))
    board, own = table["board"], table.setdefault(axis_name(axis), {})
    board.update(supply(board, limits.voltage))
    own.pop(MEMBERS, None)  # of another motor
    for group in (own, table.get("defaults", {})):
        group.get("winding", {}).pop("thermal_resistance", None)  # derived from the rated current
    current = limits.current
    pairs, psi, inertia = motor["pole_pairs"], motor["psi_m"], motor["inertia"]
    voltage_max = limits.voltage / math.sqrt(3.0) * board.get("voltage_use", 1.0)
    # no-load speed, reduced by the voltage drop of the friction current
    friction_current = motor["friction"] / (1.5 * pairs * psi)
    no_load_speed = max(voltage_max - friction_current * motor["r_s"], 0.2 * voltage_max) / (pairs * psi)
    speed = _rounded(min(limits.speed, SPEED_USE * no_load_speed))
    torque_max = 1.5 * pairs * psi * current
    acceleration = _rounded(ACCELERATION_USE * max(torque_max - motor["friction"], 0.1 * torque_max) / inertia)
    rated = min(own.get("motor", {}).get("rated_current", 0.5 * current), 0.7 * current)
    own["motor"] = {
        **{name: motor[name] for name in ("r_s", "l_d", "l_q", "psi_m", "inertia")},
        "pole_pairs": round(pairs),
        "rotor_inertia": inertia,
        "rated_speed": speed,
        "rated_current": rated,
    }
    own["friction"] = {
        **own.get("friction", {}),
        "coulomb": min(motor["friction"], 0.9 * torque_max),
        "viscous": max(motor["viscous"], 0.0),
    }
    own["limits"] = {
        **own.get("limits", {}),
        "current": current,
        "speed": speed,
        "acceleration": min(max(acceleration, 10.0), 5e4),
        "over_speed": SPEED_RATIO * speed,
    }
    defaults = table.get("defaults", {})
    # the path filter requires accelerations up to omega_n v / e (E40): the slower the axis, the less current is used
    use_max = PATH_OMEGA_MAX / TICK * speed * inertia / (math.e * torque_max)
    control = {**defaults.get("control", {}), **own.get("control", {})}
    if control.get("path_current_use", math.inf) > use_max:
        own["control"] = {**own.get("control", {}), "path_current_use": _rounded(use_max)}
    search = {**defaults.get("rotor_search", {}), **own.get("rotor_search", {})}
    saliency = motor["l_q"] - motor["l_d"]
    # above psi / (L_q - L_d) a rotor aligns perpendicular to the current vector
    along = SALIENT_USE * psi / saliency if saliency > 0.0 else math.inf
    own["rotor_search"] = {
        **own.get("rotor_search", {}),
        "current": min(search.get("current", current), current, along),
    }
    counts = 4.0 * {**defaults.get("encoder", {}), **own.get("encoder", {})}["lines"]
    interval = math.degrees(2.0 * math.pi * pairs / counts)
    if interval > search.get("interval", 1.41):
        own["rotor_search"]["interval"] = 1.02 * interval
    # several times the smallest movement: the rest is for friction
    angle = max(search.get("verify_angle", 24.0), min(VERIFY_MOVES * search.get("move_counts", 3) * interval, 45.0))
    own["rotor_search"]["verify_angle"] = _rounded(angle)
    for group, entries in groups.items():
        own[group] = {**own.get(group, {}), **entries}
    return table


def supply(board: Mapping[str, Any], voltage: float) -> dict[str, Any]:
    """Entries of [board] with the voltages of another supply [V].

    The under-voltage threshold is scaled. The upper thresholds are ratings of the hardware and remain, unless the
    supply is higher than before: then they move towards the end of the range of the converter.
    """
    before = float(board["nominal_voltage"])

    def moved(threshold: float) -> float:
        if voltage <= before:
            return threshold
        return SUPPLY_END - (SUPPLY_END - float(threshold)) * (SUPPLY_END - voltage) / (SUPPLY_END - before)

    entries: dict[str, Any] = {
        "nominal_voltage": voltage,
        "under_voltage": float(f"{board['under_voltage'] * voltage / before:.3g}"),
        "over_voltage": float(f"{moved(board['over_voltage']):.4g}"),
    }
    for group, keys in (("brake", ("on_voltage", "off_voltage")), ("regeneration", ("start_voltage", "full_voltage"))):
        if group in board:
            changes = {key: float(f"{moved(board[group][key]):.4g}") for key in keys}
            entries[group] = {**board[group], **changes}
    return entries


def fitted(
    base: Mapping[str, Any],
    axis: int,
    limits: Limits,
    motor: Mapping[str, float],
    *,
    slow_loops: bool = False,
    inertia_known: bool = True,
    attend: Callable[[], None] = lambda: None,
) -> Table:
    """The same with the highest bandwidths possible for this motor; values in SI by name.

    Other entries that are refused with this motor are corrected by the remedies of the refusals.

    Parameters
    ----------
    slow_loops : bool
        Low bandwidths, which amplify the noise of currents and speed less.
    inertia_known : bool
        Whether the inertia is not a guess: a heavier shaft swings more slowly, and a lighter one exchanges more energy
        with the winding, which a fast current loop damps.
    attend : callable, optional
        Called before each configuration that is tried: the search takes up to a second, a board waits less for its
        host.

    Raises
    ------
    ConfigError
        If no bandwidth is possible; the cause is the one of the lowest bandwidth.
    """
    problem: ConfigError | None = None
    current = SLOW_LOOPS_CURRENT_BANDWIDTH if slow_loops and inertia_known else CURRENT_BANDWIDTH
    fields = {field.name: motor[field.name] for field in dataclasses.fields(Motor)}
    current = max(current, current_bandwidth_min(Motor(**fields), 1.0 / PERIOD))
    for bandwidth in SPEED_BANDWIDTHS:
        if slow_loops and bandwidth > SLOW_LOOPS_SPEED_BANDWIDTH:
            continue
        control = {
            "current_bandwidth": current,
            "speed_bandwidth": bandwidth,
            "position_gain": 0.8 * bandwidth,
            "observer_bandwidth": max(bandwidth, 10.0),
        }
        table = configured(base, axis, limits, motor, control=control)
        if not inertia_known:
            search = table.get("defaults", {}).get("rotor_search", {}) | table[axis_name(axis)]["rotor_search"]
            table[axis_name(axis)]["rotor_search"]["verify_time"] = max(search["verify_time"], VERIFY_TIME_UNKNOWN)
        try:
            fit, design = corrected(table, axis, attend)
        except ConfigError as error:
            problem = error
            continue
        phase = design.shaft().speed_margins().phase
        if phase is None or phase >= PHASE_MIN:
            return fit
    assert problem is not None
    raise problem


def corrected(table: Table, axis: int, attend: Callable[[], None] = lambda: None) -> tuple[Table, Tuned]:
    """Table with the corrections of entries that follow from the motor, and its gains; `attend` as in `fitted`.

    Raises
    ------
    ConfigError
        If none of its remedies is a change of such an entry.
    """

    def check(changed: Table) -> Problem | None:
        attend()
        return refusal_of(changed)

    found = remedies.corrected(table, partial(_may_change, axis=axis), check)
    if found.problem is not None:
        raise ConfigError(found.problem)
    return found.table, tuned_axis(found.table, axis)


def _may_change(remedy: Remedy, axis: int) -> bool:
    """Whether an entry is neither given by the user, nor measured, nor chosen by `fitted`."""
    owner, _, path = remedy.entry.partition(".")
    if owner == "board" or path.split(".")[0] in ("motor", "friction"):
        return False
    return owner != axis_name(axis) or path not in _CHOSEN


def _rounded(value: float) -> float:
    """Value rounded down to three digits."""
    digits = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / digits) * digits
