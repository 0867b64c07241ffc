"""Configurations for an unknown motor, and for a motor with measured values."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.measurement.motor_values import Limits
from servo_msgs_py.tuning.errors import ConfigError
from servo_msgs_py.tuning.reading import parse
from servo_msgs_py.tuning.rotor_search import SALIENT_USE
from servo_msgs_py.tuning.tuned import Tuned, tuned

SPEED_USE: Final = 0.8
"""Speed set-point limit, relative to the no-load speed at the available voltage."""

SPEED_RATIO: Final = 1.3
"""Over-speed threshold, relative to the largest set-point."""

ACCELERATION_USE: Final = 0.5
"""Current for the speed ramp, relative to the current limit."""

PATH_OMEGA_MAX: Final = 0.2
"""Largest omega_n Ts of the path filter; its format ends at 0.25."""

TICK: Final = 0.5e-3  # [s]

SPEED_BANDWIDTHS: Final = (75.0, 60.0, 45.0, 30.0, 20.0, 12.0, 8.0, 5.0)
"""Tried in this order until the loops are stable and the tuning tool reports no warning [Hz]."""

SLOW_LOOPS_SPEED_BANDWIDTH: Final = 12.0  # [Hz]
SLOW_LOOPS_CURRENT_BANDWIDTH: Final = 300.0  # [Hz]
PHASE_MIN: Final = 50.0  # of the speed loop [degrees]


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
    board["nominal_voltage"] = limits.voltage
    own.pop("exact", None)  # raw numbers of another motor
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
        "acceleration": min(max(acceleration, 10.0), 2e5),
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
    move = search.get("move_counts", 3)
    if move * interval >= 0.25 * search.get("verify_angle", 24.0):
        own["rotor_search"]["verify_angle"] = min(4.2 * move * interval, 45.0)
    for group, entries in groups.items():
        own[group] = {**own.get(group, {}), **entries}
    return table


def tuned_axis(table: Mapping[str, Any], axis: int) -> Tuned:
    """Gains and block of one axis.

    Raises
    ------
    ConfigError
        If the configuration is not possible.
    """
    configuration = parse(table, Catalogue.load())
    return tuned(configuration.axes[axis], configuration)


def fitted(
    base: Mapping[str, Any], axis: int, limits: Limits, motor: Mapping[str, float], *, slow_loops: bool = False
) -> dict[str, Any]:
    """The same with the highest bandwidths possible for this motor; values in SI by name.

    Parameters
    ----------
    slow_loops : bool
        Low bandwidths, which amplify the noise of currents and speed less.

    Raises
    ------
    ConfigError
        If no bandwidth is possible; the cause is the one of the lowest bandwidth.
    """
    problem: ConfigError | None = None
    for bandwidth in SPEED_BANDWIDTHS:
        if slow_loops and bandwidth > SLOW_LOOPS_SPEED_BANDWIDTH:
            continue
        control = {
            "current_bandwidth": SLOW_LOOPS_CURRENT_BANDWIDTH if slow_loops else 1000.0,
            "speed_bandwidth": bandwidth,
            "position_gain": 0.8 * bandwidth,
            "observer_bandwidth": max(bandwidth, 10.0),
        }
        table = configured(base, axis, limits, motor, control=control)
        try:
            design = tuned_axis(table, axis)
        except ConfigError as error:
            problem = error
            continue
        phase = design.shaft().speed_margins().phase
        if phase is None or phase >= PHASE_MIN:
            return table
    assert problem is not None
    raise problem


def _rounded(value: float) -> float:
    """Value rounded down to three digits."""
    digits = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / digits) * digits
