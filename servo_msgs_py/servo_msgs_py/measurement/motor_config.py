"""Configurations for a motor: of which nothing is known, and of which the values have been measured. Pure."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue, axis_name
from servo_msgs_py.measurement.motor_values import Limits
from servo_msgs_py.tuning.errors import ConfigError
from servo_msgs_py.tuning.reading import parse
from servo_msgs_py.tuning.tuned import Tuned, tuned

SPEED_USE: Final = 0.8
"""Part of the speed that the voltage reaches without load."""

SPEED_RATIO: Final = 1.3
"""Over-speed, over the largest set-point."""

SALIENT_USE: Final = 0.5
"""Part of the current at which reluctance turns a rotor away from the vector."""

ACCELERATION_USE: Final = 0.5
"""Part of the current limit for the ramp of the speed."""

PATH_OMEGA_MAX: Final = 0.2
"""omega_n Ts of the path filter, whose format ends at 0.25."""

TICK: Final = 0.5e-3  # [s]

SPEED_BANDWIDTHS: Final = (75.0, 60.0, 45.0, 30.0, 20.0, 12.0, 8.0, 5.0)
"""Tried in this order until the loops are stable and the tool has no warning about them [Hz]."""

SLOW_LOOPS_SPEED_BANDWIDTH: Final = 12.0  # [Hz]
SLOW_LOOPS_CURRENT_BANDWIDTH: Final = 300.0  # [Hz]
PHASE_MIN: Final = 50.0  # of the speed loop [degrees]


def configured(
    base: Mapping[str, Any], axis: int, limits: Limits, motor: Mapping[str, float], **groups: Mapping[str, Any]
) -> dict[str, Any]:
    """A ``servo.toml`` whose motor is another one.

    Parameters
    ----------
    base : mapping
        Parsed file that the rest is taken from.
    axis : int
        Index of the axis.
    limits : Limits
    motor : mapping
        ``r_s``, ``l_d``, ``l_q``, ``psi_m``, ``pole_pairs``, ``inertia``, ``friction``, ``viscous`` [SI].
    **groups : mapping
        Further entries of the axis, by group.
    """
    table = copy.deepcopy(dict(base))
    board, own = table["board"], table.setdefault(axis_name(axis), {})
    board["nominal_voltage"] = limits.voltage
    own.pop("exact", None)  # raw numbers, of another motor
    for group in (own, table.get("defaults", {})):
        group.get("winding", {}).pop("thermal_resistance", None)  # follows from the rated current
    current = limits.current
    pairs, psi, inertia = motor["pole_pairs"], motor["psi_m"], motor["inertia"]
    reach = limits.voltage / math.sqrt(3.0) * board.get("voltage_use", 1.0)
    # idle speed, less what the friction's current takes
    friction_current = motor["friction"] / (1.5 * pairs * psi)
    idle = max(reach - friction_current * motor["r_s"], 0.2 * reach) / (pairs * psi)
    speed = _rounded(min(limits.speed, SPEED_USE * idle))
    push = 1.5 * pairs * psi * current
    acceleration = _rounded(ACCELERATION_USE * max(push - motor["friction"], 0.1 * push) / inertia)
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
        "coulomb": min(motor["friction"], 0.9 * push),
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
    # the path filter asks for accelerations up to omega_n v / e (E40): the slower the axis, the less of the current
    use_max = PATH_OMEGA_MAX / TICK * speed * inertia / (math.e * push)
    control = {**defaults.get("control", {}), **own.get("control", {})}
    if control.get("path_current_use", math.inf) > use_max:
        own["control"] = {**own.get("control", {}), "path_current_use": _rounded(use_max)}
    search = {**defaults.get("rotor_search", {}), **own.get("rotor_search", {})}
    saliency = motor["l_q"] - motor["l_d"]
    # beyond psi / (L_q - L_d) a rotor does not lie along a vector any more, but across it
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
    if "sensing" not in own:
        sign = 1.33 * limits.voltage * board["dead_time"] / min(motor["l_d"], motor["l_q"])
        minimum = {**defaults.get("sensing", {})}.get("sign_current", 0.08)
        if sign > minimum:
            own["sensing"] = {"sign_current": min(sign, 0.5 * current)}
    for group, entries in groups.items():
        own[group] = {**own.get(group, {}), **entries}
    return table


def tuned_axis(table: Mapping[str, Any], axis: int) -> Tuned:
    """Gains and block of one axis.

    Raises
    ------
    ConfigError
        If it cannot work.
    """
    configuration = parse(table, Catalogue.load())
    return tuned(configuration.axes[axis], configuration)


def fitted(
    base: Mapping[str, Any], axis: int, limits: Limits, motor: Mapping[str, float], *, slow_loops: bool = False
) -> dict[str, Any]:
    """The same with the bandwidths that this motor bears; its values in SI by name.

    Parameters
    ----------
    slow_loops : bool
        Slow loops, which turn less of the noise of currents and speed into voltage.

    Raises
    ------
    ConfigError
        If none works; the reason is that of the slowest.
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
            it = tuned_axis(table, axis)
        except ConfigError as error:
            problem = error
            continue
        phase = it.shaft().speed_margins().phase
        if phase is None or phase >= PHASE_MIN:
            return table
    assert problem is not None
    raise problem


def _rounded(value: float) -> float:
    """Three digits, downwards."""
    digits = 10.0 ** (math.floor(math.log10(value)) - 2)
    return math.floor(value / digits) * digits
