"""Groups and keys of ``servo.toml``: meaning, unit and range of each number."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

from servo_msgs_py.quantity import ABOVE_0, VALUE_MAX, Quantity

from servo_tuning.errors import ConfigError, Entry, refused


def number(
    unit: str,
    text: str,
    *,
    minimum: float = ABOVE_0,
    maximum: float = VALUE_MAX,
    whole: bool = False,
    optional: bool = False,
) -> Quantity:
    """A number of the configuration; by default any positive one."""
    return Quantity(unit=unit, text=text, minimum=minimum, maximum=maximum, whole=whole, optional=optional)


def checked_number(entry: Quantity, name: Entry | str, value: object) -> float:
    """Return a valid value of an entry.

    Raises
    ------
    ConfigError
        If it is not a number or out of range.
    """
    problem = entry.problem(value)
    if not problem:
        assert isinstance(value, (int, float))
        if value == 0 or abs(value) >= ABOVE_0:
            return float(value)
        problem = "too small"
    raise refused(name, value if isinstance(value, float) else repr(value), problem, f"write {entry.expected}")


BOARD: Final[Mapping[str, Quantity]] = {
    "nominal_voltage": number("V", "nominal bus voltage"),
    "over_voltage": number("V", "threshold of the bus voltage, fault above"),
    "under_voltage": number("V", "threshold of the bus voltage, fault below"),
    "host_timeout": number("s", "time without a message of the host until a fault"),
    "command_timeout": number("s", "age at which a velocity or torque set-point expires; 0: never", minimum=0.0),
    "voltage_use": number("", "used fraction of the linear range of the modulation", maximum=1.0),
}
"""Keys of the group [board]."""

BOARD_GROUPS: Final[Mapping[str, Mapping[str, Quantity]]] = {
    "brake": {
        "resistance": number("ohm", "brake resistor across the bus"),
        "on_voltage": number("V", "bus voltage that switches the resistor on"),
        "off_voltage": number("V", "bus voltage that switches the resistor off"),
        "power": number("W", "continuous power rating of the resistor"),
        "energy": number("J", "pulse energy rating of the cold resistor"),
    },
    "regeneration": {
        "start_voltage": number("V", "bus voltage where the reduction of the braking current begins"),
        "full_voltage": number("V", "bus voltage above which there is no braking current"),
    },
}
"""Keys of the groups [board.brake] (besides its switch ``fitted``) and [board.regeneration]."""

AXIS_GROUPS: Final[Mapping[str, Mapping[str, Quantity]]] = {
    "motor": {
        "r_s": number("ohm", "stator resistance"),
        "l_d": number("H", "stator inductance, d axis"),
        "l_q": number("H", "stator inductance, q axis"),
        "psi_m": number("V s", "flux linkage of the magnets, electrical"),
        "pole_pairs": number("", "pole pairs", whole=True),
        "inertia": number("kg m^2", "total inertia of the shaft"),
        "rotor_inertia": number("kg m^2", "inertia of the motor alone"),
        "rated_speed": number("rad/s", "rated speed of the data sheet"),
        "rated_current": number("A", "rated current of the data sheet, peak"),
    },
    "load": {
        "inertia": number("kg m^2", "inertia behind a spring, a part of motor.inertia", optional=True),
        "stiffness": number("N m/rad", "stiffness of that spring; together with inertia", optional=True),
        "damping": number("", "damping of the resonance, e.g. 0.02; together with inertia", maximum=1.0, optional=True),
    },
    "encoder": {"lines": number("", "lines per turn", whole=True, minimum=100, maximum=16384)},
    "friction": {
        "coulomb": number("N m", "Coulomb friction", minimum=0.0),
        "viscous": number("N m s", "viscous friction", minimum=0.0),
        "smooth": number("rad/s", "speed range in which the sign of the Coulomb friction changes smoothly"),
    },
    "limits": {
        "current": number("A", "largest motor current, peak"),
        "speed": number("rad/s", "largest speed set-point"),
        "acceleration": number("rad/s^2", "acceleration of speed ramps, position moves and stops"),
        "position": number("rad", "soft position limits in both directions"),
        "following_error": number("rad", "largest following error; fault above"),
        "over_speed": number("rad/s", "speed threshold; fault above"),
    },
    "control": {
        "current_bandwidth": number("Hz", "bandwidth of both current loops"),
        "speed_bandwidth": number("Hz", "bandwidth of the speed loop"),
        "speed_ratio": number("", "bandwidth over corner frequency of the integral part"),
        "anti_windup": number("", "Kc of DRM E35, below 1", maximum=1.0),
        "position_gain": number("1/s", "K_v: speed set-point per position error"),
        "observer_bandwidth": number("Hz", "bandwidth of the speed observer; at least twice position_gain / (2 pi)"),
        "path_current_use": number("", "fraction of the current limit used by shaped set-points"),
    },
    "rotor_search": {
        "current": number("A", "largest current of a vector"),
        "ramp_time": number("s", "time from zero to that current, for the first vectors"),
        "hold_time": number("s", "time at that current without a further count"),
        "rest_time": number("s", "standstill after a twitch"),
        "move_counts": number("", "movement that counts as a twitch", whole=True),
        "interval": number("deg electrical", "remaining interval at which the search ends"),
        "verify_angle": number(
            "deg electrical",
            "largest rotation of the vector until the shaft follows, in the verification",
            maximum=45.0,
        ),
        "verify_time": number("s", "duration of that rotation"),
        "turn_angle": number(
            "deg electrical", "rotation of the vector if no twitch was detected: blocked or no count", maximum=180.0
        ),
        "turn_time": number("s", "duration of that rotation, in each direction"),
        "follow_flux": number(
            "", "fraction of the flux of a following rotor, above which the rotor has moved", maximum=1.0
        ),
        "time_max": number("s", "maximum duration of the search"),
    },
    "observer": {
        "bandwidth": number("Hz", "frequency of the poles, above half the decay rate of the winding", optional=True),
        "damping": number("", "damping of these poles", maximum=10.0, optional=True),
        "k_1": number(
            "1/s",
            "K1 of the ST document, below 0; instead of bandwidth and damping",
            minimum=-VALUE_MAX,
            optional=True,
        ),
        "k_2": number(
            "V/(A s)", "K2 of the ST document, above 0; together with k_1", minimum=-VALUE_MAX, optional=True
        ),
        "pll_i": number("", "number in the rule of the ST document for the I gain, there 1506742"),
        "pll_damping": number("", "damping of the phase-locked loop (PLL)", maximum=10.0),
        "pll_torque": number(
            "", "fraction of the acceleration by the current that is fed forward to the PLL", minimum=0.0, maximum=2
        ),
        "pll_size": number(
            "Hz", "bandwidth with which the PLL speed follows the amplitude of the back-EMF", minimum=0.0, maximum=250.0
        ),
        "pll_load": number("", "gain of the load torque estimate of the PLL, over omega_n^3", minimum=0.0, maximum=1.0),
        "speed_part": number("", "speed loop of a sensorless axis, fraction of control.speed_bandwidth", maximum=1.0),
    },
    "reliability": {
        "period": number("", "slow ticks between the 64 samples of the speed", whole=True),
        "variance_threshold": number("", "largest variance of a reliable speed, over its squared mean"),
        "hysteresis": number("", "consecutive failed tests until a fault", whole=True),
    },
    "emf_check": {
        "floor": number("V", "tolerance of the back-EMF at any speed, for dead time and switches"),
        "spin_floor": number("V", "tolerance of the filtered back-EMF of a sensorless axis"),
        "resistance": number("", "relative tolerance of r_s", minimum=0.0, maximum=2.0),
        "part": number("", "relative tolerance of the back-EMF", maximum=1.0),
        "spin_time": number("s", "duration of a deviation until SPEED_FEEDBACK"),
        "stand_time": number(
            "s", "time below half of start_up.minimum_speed until a sensorless shaft counts as blocked"
        ),
        "check_time": number("s", "duration of a deviation until ANGLE_MISMATCH"),
    },
    "start_up": {
        "current_first": number("", "FIRST_I_STARTUP, fraction of limits.current", maximum=1.0),
        "current_final": number("", "FINAL_I_STARTUP, fraction of limits.current", maximum=1.0),
        "current_time": number("s", "I_START_UP_DURATION: time from the first to the final current"),
        "speed_final": number("", "FINAL_START_UP_SPEED, fraction of limits.speed", maximum=1.0),
        "swings": number("", "FREQ_START_UP_DURATION in periods of the rotor oscillation"),
        "speed_time": number("s", "FREQ_START_UP_DURATION; instead of swings", optional=True),
        "wait_max": number("s", "time after that ramp until the start-up has failed"),
        "consecutive_tests": number("", "NB_CONSECUTIVE_TESTS", whole=True),
        "minimum_speed": number("", "MINIMUM_SPEED_RPM, fraction of limits.speed", maximum=1.0),
        "mean_min": number("", "smallest ratio of observed mean and forced speed", maximum=1.0),
        "mean_max": number("", "largest ratio of observed mean and forced speed", maximum=3.9),
        "swing_damping": number(
            "", "damping of the rotor oscillation, by a current across the vector", minimum=0.0, maximum=2.0
        ),
        "swing_current": number(
            "", "largest current of that damping, fraction of the final current", minimum=0.0, maximum=1.0
        ),
        "catch_time": number("s", "time to detect the back-EMF of a rotating shaft"),
        "fade_time": number("s", "ramp time from the current limit to 0, for the remaining start-up current"),
    },
    "timing": {
        "settle": number("s", "time in INIT"),
        "runaway_margin": number(
            "rad/s", "speed above the limit, or gained against the full current, that is a runaway"
        ),
        "runaway_max": number("s", "duration of a runaway until a fault"),
        "rest_max": number("s", "time that an enabled axis waits for standstill"),
        "stall_max": number("s", "time at full current without movement until a fault"),
        "stop_speed": number("rad/s", "speed below which a stop is complete"),
        "stop_max": number("s", "time after the ramp of a stop until the outputs go off at any speed"),
        "following_max": number("s", "duration of a following error until a fault"),
        "over_speed_max": number("s", "duration of over-speed until a fault"),
    },
    "stop": {
        "time_max": number("s", "maximum duration of a stop; then the outputs go off"),
        "hold_time": number("s", "duration of position hold after a disable or a fault"),
        "short_current": number("A", "permitted steady-state current in shorted windings"),
        "copper_use": number(
            "", "fraction of the current limit for i_d while braking current is reduced", minimum=0.0, maximum=1.0
        ),
    },
    "winding": {
        "thermal_resistance": number(
            "K/W", "winding to ambient; if omitted, motor.rated_current heats to winding.maximum", optional=True
        ),
        "heat_capacity": number("J/K", "of the copper and the parts in thermal contact"),
        "ambient": number("deg C", "highest ambient temperature", minimum=-VALUE_MAX),
        "initial": number("deg C", "estimate after a reset", minimum=-VALUE_MAX),
        "derating": number("deg C", "temperature where the derating of the current limit begins"),
        "maximum": number("deg C", "temperature at which the current limit equals the rated current"),
        "fault": number("deg C", "fault threshold; can be cleared below winding.maximum"),
    },
    "field_weakening": {
        "margin": number("V", "reserve of stator voltage below its limit", minimum=0.0),
        "bandwidth": number("Hz", "bandwidth at the speed whose back-EMF equals the voltage limit", maximum=250.0),
        "current_use": number("", "fraction of limits.current for the current against the flux", maximum=1.0),
        "magnet_current": number("A", "largest current against the flux for hot magnets, peak"),
    },
    "home": {
        "speed": number("rad/s", "speed of the first approach of a homing; the later ones use a quarter of it"),
        "current": number("A", "limit of i_q during a homing"),
        "back_off": number("rad", "distance from a stop or a switch before the next approach"),
        "spread": number("rad", "spread of the positions found that is a fault", minimum=0.0),
        "turns_max": number("", "turns within which the reference must be found", whole=True),
        "reach": number("rad", "largest distance from the position of enabling, while the position is not known"),
    },
    "pins": {
        "open_time": number("s", "time until the holding brake is open", minimum=0.0),
        "close_time": number("s", "time until the holding brake holds", minimum=0.0),
    },
    "sensing": {
        "sign_current": number(
            "A", "phase current above which its direction is certain; more is used for a winding of low inductance"
        ),
        "offset_tolerance": number("", "largest distance of an offset from mid-scale [ADC codes]", whole=True),
        "offset_duty": number("", "shortest high-side duty for a valid offset sample", maximum=1.0),
    },
}
"""Keys of the groups of an axis; [defaults] may hold any of them."""

SCHEMA: Final[Mapping[str, Mapping[str, Quantity]]] = {"board": BOARD, **BOARD_GROUPS, **AXIS_GROUPS}
"""Every group and its keys; a group must have all keys that are not optional, and no others."""


def unknown_name(where: Entry | str, name: str, known: Collection[str]) -> ConfigError:
    """Error about an unknown name, with the closest known name or all known names."""
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    return ConfigError(f"{where} is unknown; {hint}")


def check_table(where: str, value: object) -> Mapping[str, Any]:
    """Return the value if it is a table of TOML.

    Raises
    ------
    ConfigError
        If it is not a table.
    """
    if not isinstance(value, Mapping):
        raise refused(where, repr(value), "not a table", f"write a group [{where}] with its entries")
    return value


def _check_names(where: str, names: Iterable[str], known: Collection[str]) -> None:
    given = list(names)
    for name in given:
        if name not in known:
            raise unknown_name(f"{where}.{name}", name, known)
    for name in known:
        if name not in given and not (isinstance(known, Mapping) and known[name].optional):
            raise ConfigError(f"{where}.{name} is missing; add it to [{where}]")


def check_group(where: str, group: str, value: object, places: Mapping[str, Entry] | None = None) -> dict[str, float]:
    """Check a group: exactly its keys, each with a number in its range; SI units as in `SCHEMA`.

    Parameters
    ----------
    where : str
        Full name of the group for messages.
    group : str
        Its name in `SCHEMA`.
    value : object
        Parsed group.
    places : mapping, optional
        The entries by key, for messages; omitted: all are in the group itself.

    Raises
    ------
    ConfigError
        About the first entry that is missing, unknown or wrong.
    """
    if group not in SCHEMA:
        raise unknown_name(where, group, SCHEMA)
    entries, known = check_table(where, value), SCHEMA[group]
    _check_names(where, entries, known)
    names = places or {key: Entry(f"{where}.{key}") for key in known}
    return {key: checked_number(entry, names[key], entries[key]) for key, entry in known.items() if key in entries}


def check_switches(where: str, value: object, names: Collection[str]) -> dict[str, bool]:
    """Check a group of switches, each true or false.

    Raises
    ------
    ConfigError
        About the first entry that is missing, unknown or neither true nor false.
    """
    entries = check_table(where, value)
    _check_names(where, entries, names)
    for key in names:
        if not isinstance(entries[key], bool):
            raise refused(f"{where}.{key}", repr(entries[key]), "neither on nor off", "write true or false")
    return {key: entries[key] for key in names}
