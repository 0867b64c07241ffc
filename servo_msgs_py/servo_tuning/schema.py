"""Groups and keys of ``servo.toml``: meaning, unit and range of each number."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from servo_tuning.errors import ConfigError, refused

VALUE_MIN: Final = 1e-12
"""Smallest magnitude of an entry other than 0."""

VALUE_MAX: Final = 1e12
"""Largest magnitude of an entry."""


@dataclass(frozen=True)
class Entry:
    """Unit, meaning and range of one number of the configuration."""

    unit: str  # SI, or empty
    meaning: str  # description
    zero: bool = False  # whether 0 is valid
    whole: bool = False  # whether it is an integer
    maximum: float = math.inf  # largest valid magnitude
    signed: bool = False  # whether it may be negative
    optional: bool = False  # whether it may be left out

    def check(self, name: str, value: object) -> float:
        """Return the value as a number.

        Raises
        ------
        ConfigError
            If it is not a number or out of range.
        """
        expected = self._expected()
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise refused(name, repr(value), "not a number", f"write {expected}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise refused(name, number, "not a finite number", f"write {expected}")
        size = abs(number) if self.signed else number
        if size < VALUE_MIN and not (size == 0.0 and self.zero):
            raise refused(name, number, "too small", f"write {expected}")
        if size > min(self.maximum, VALUE_MAX):
            raise refused(name, number, "too large", f"write {expected}")
        if self.whole and number % 1.0 != 0.0:
            raise refused(name, number, "not a whole number", f"write {expected}")
        return number

    def _expected(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        minimum = "of either sign" if self.signed else "from 0" if self.zero else "above 0"
        maximum = f" up to {self.maximum:g}" if math.isfinite(self.maximum) else ""
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{kind} {minimum}{maximum}{unit}: {self.meaning}"


BOARD: Final[Mapping[str, Entry]] = {
    "pwm_frequency": Entry("Hz", "switching frequency and rate of the fast loop"),
    "slow_divider": Entry("", "PWM periods per slow loop", whole=True),
    "timer_clock": Entry("Hz", "clock of the encoder edge timer"),
    "nominal_voltage": Entry("V", "nominal bus voltage"),
    "over_voltage": Entry("V", "threshold of the bus voltage, fault above"),
    "under_voltage": Entry("V", "threshold of the bus voltage, fault below"),
    "host_timeout": Entry("s", "time without a message of the host until a fault"),
    "command_timeout": Entry("s", "age at which a velocity or torque set-point expires; 0: never", zero=True),
    "dead_time": Entry("s", "time with both switches of a leg open, per edge", zero=True),
    "switch_drop": Entry("V", "voltage drop of a switch or diode", zero=True),
    "voltage_use": Entry("", "used fraction of the linear range of the modulation", maximum=1.0),
}
"""Keys of the group [board]."""

BOARD_GROUPS: Final[Mapping[str, Mapping[str, Entry]]] = {
    "brake": {
        "resistance": Entry("ohm", "brake resistor across the bus"),
        "on_voltage": Entry("V", "bus voltage that switches the resistor on"),
        "off_voltage": Entry("V", "bus voltage that switches the resistor off"),
        "power": Entry("W", "continuous power rating of the resistor"),
        "energy": Entry("J", "pulse energy rating of the cold resistor"),
    },
    "regeneration": {
        "start_voltage": Entry("V", "bus voltage where the reduction of the braking current begins"),
        "full_voltage": Entry("V", "bus voltage above which there is no braking current"),
    },
}
"""Keys of the groups [board.brake] (besides its switch ``fitted``) and [board.regeneration]."""

AXIS_GROUPS: Final[Mapping[str, Mapping[str, Entry]]] = {
    "motor": {
        "r_s": Entry("ohm", "stator resistance"),
        "l_d": Entry("H", "stator inductance, d axis"),
        "l_q": Entry("H", "stator inductance, q axis"),
        "psi_m": Entry("V s", "flux linkage of the magnets, electrical"),
        "pole_pairs": Entry("", "pole pairs", whole=True),
        "inertia": Entry("kg m^2", "total inertia of the shaft"),
        "rotor_inertia": Entry("kg m^2", "inertia of the motor alone"),
        "rated_speed": Entry("rad/s", "rated speed of the data sheet"),
        "rated_current": Entry("A", "rated current of the data sheet, peak"),
    },
    "encoder": {"lines": Entry("", "lines per turn", whole=True)},
    "friction": {
        "coulomb": Entry("N m", "Coulomb friction", zero=True),
        "viscous": Entry("N m s", "viscous friction", zero=True),
        "smooth": Entry("rad/s", "speed range in which the sign of the Coulomb friction changes smoothly"),
    },
    "limits": {
        "current": Entry("A", "largest motor current, peak"),
        "speed": Entry("rad/s", "largest speed set-point"),
        "acceleration": Entry("rad/s^2", "acceleration of speed ramps, position moves and stops"),
        "position": Entry("rad", "soft position limits in both directions"),
        "following_error": Entry("rad", "largest following error; fault above"),
        "over_speed": Entry("rad/s", "speed threshold; fault above"),
    },
    "control": {
        "current_bandwidth": Entry("Hz", "bandwidth of both current loops"),
        "speed_bandwidth": Entry("Hz", "bandwidth of the speed loop"),
        "speed_ratio": Entry("", "bandwidth over corner frequency of the integral part"),
        "anti_windup": Entry("", "Kc of DRM E35, below 1", maximum=1.0),
        "position_gain": Entry("1/s", "K_v: speed set-point per position error"),
        "observer_bandwidth": Entry("Hz", "bandwidth of the speed observer; at least twice position_gain / (2 pi)"),
        "path_current_use": Entry("", "fraction of the current limit used by shaped set-points"),
    },
    "rotor_search": {
        "current": Entry("A", "largest current of a vector"),
        "ramp_time": Entry("s", "time from zero to that current, for the first vectors"),
        "hold_time": Entry("s", "time at that current without a further count"),
        "rest_time": Entry("s", "standstill after a twitch"),
        "move_counts": Entry("", "movement that counts as a twitch", whole=True),
        "interval": Entry("deg electrical", "remaining interval at which the search ends"),
        "verify_angle": Entry(
            "deg electrical",
            "largest rotation of the vector until the shaft follows, in the verification",
            maximum=45.0,
        ),
        "verify_time": Entry("s", "duration of that rotation"),
        "turn_angle": Entry(
            "deg electrical", "rotation of the vector if no twitch was detected: blocked or no count", maximum=180.0
        ),
        "turn_time": Entry("s", "duration of that rotation, in each direction"),
        "follow_flux": Entry(
            "", "fraction of the flux of a following rotor, above which the rotor has moved", maximum=1.0
        ),
        "time_max": Entry("s", "maximum duration of the search"),
    },
    "observer": {
        "bandwidth": Entry("Hz", "frequency of the poles, above half the decay rate of the winding", optional=True),
        "damping": Entry("", "damping of these poles", maximum=10.0, optional=True),
        "k_1": Entry(
            "1/s", "K1 of the ST document, below 0; instead of bandwidth and damping", signed=True, optional=True
        ),
        "k_2": Entry("V/(A s)", "K2 of the ST document, above 0; together with k_1", signed=True, optional=True),
        "pll_i": Entry("", "number in the rule of the ST document for the I gain, there 1506742"),
        "pll_damping": Entry("", "damping of the phase-locked loop (PLL)", maximum=10.0),
        "pll_torque": Entry(
            "", "fraction of the acceleration by the current that is fed forward to the PLL", True, maximum=2
        ),
        "pll_size": Entry(
            "Hz", "bandwidth with which the PLL speed follows the amplitude of the back-EMF", True, maximum=250.0
        ),
        "pll_load": Entry("", "gain of the load torque estimate of the PLL, over omega_n^3", True, maximum=1.0),
        "speed_part": Entry("", "speed loop of a sensorless axis, fraction of control.speed_bandwidth", maximum=1.0),
    },
    "reliability": {
        "period": Entry("", "slow ticks between the 64 samples of the speed", whole=True),
        "variance_threshold": Entry("", "largest variance of a reliable speed, over its squared mean"),
        "hysteresis": Entry("", "consecutive failed tests until a fault", whole=True),
    },
    "emf_check": {
        "floor": Entry("V", "tolerance of the back-EMF at any speed, for dead time and switches"),
        "spin_floor": Entry("V", "tolerance of the filtered back-EMF of a sensorless axis"),
        "resistance": Entry("", "relative tolerance of r_s", True, maximum=2.0),
        "part": Entry("", "relative tolerance of the back-EMF", maximum=1.0),
        "spin_time": Entry("s", "duration of a deviation until SPEED_FEEDBACK"),
        "stand_time": Entry(
            "s", "time below half of start_up.minimum_speed until a sensorless shaft counts as blocked"
        ),
        "check_time": Entry("s", "duration of a deviation until ANGLE_MISMATCH"),
    },
    "start_up": {
        "current_first": Entry("", "FIRST_I_STARTUP, fraction of limits.current", maximum=1.0),
        "current_final": Entry("", "FINAL_I_STARTUP, fraction of limits.current", maximum=1.0),
        "current_time": Entry("s", "I_START_UP_DURATION: time from the first to the final current"),
        "speed_final": Entry("", "FINAL_START_UP_SPEED, fraction of limits.speed", maximum=1.0),
        "swings": Entry("", "FREQ_START_UP_DURATION in periods of the rotor oscillation"),
        "speed_time": Entry("s", "FREQ_START_UP_DURATION; instead of swings", optional=True),
        "wait_max": Entry("s", "time after that ramp until the start-up has failed"),
        "consecutive_tests": Entry("", "NB_CONSECUTIVE_TESTS", whole=True),
        "minimum_speed": Entry("", "MINIMUM_SPEED_RPM, fraction of limits.speed", maximum=1.0),
        "mean_min": Entry("", "smallest ratio of observed mean and forced speed", maximum=1.0),
        "mean_max": Entry("", "largest ratio of observed mean and forced speed", maximum=3.9),
        "swing_damping": Entry(
            "", "damping of the rotor oscillation, by a current across the vector", True, maximum=2.0
        ),
        "swing_current": Entry("", "largest current of that damping, fraction of the final current", True, maximum=1.0),
        "catch_time": Entry("s", "time to detect the back-EMF of a rotating shaft"),
        "fade_time": Entry("s", "ramp time from the current limit to 0, for the remaining start-up current"),
    },
    "timing": {
        "settle": Entry("s", "time in INIT"),
        "runaway_margin": Entry(
            "rad/s", "speed above the limit, or gained against the full current, that is a runaway"
        ),
        "runaway_max": Entry("s", "duration of a runaway until a fault"),
        "rest_max": Entry("s", "time that an enabled axis waits for standstill"),
        "stall_max": Entry("s", "time at full current without movement until a fault"),
        "stop_speed": Entry("rad/s", "speed below which a stop is complete"),
        "stop_max": Entry("s", "time after the ramp of a stop until the outputs go off at any speed"),
        "following_max": Entry("s", "duration of a following error until a fault"),
        "over_speed_max": Entry("s", "duration of over-speed until a fault"),
    },
    "stop": {
        "time_max": Entry("s", "maximum duration of a stop; then the outputs go off"),
        "hold_time": Entry("s", "duration of position hold after a disable or a fault"),
        "short_current": Entry("A", "permitted steady-state current in shorted windings"),
        "copper_use": Entry(
            "", "fraction of the current limit for i_d while braking current is reduced", zero=True, maximum=1.0
        ),
    },
    "winding": {
        "thermal_resistance": Entry(
            "K/W", "winding to ambient; if omitted, motor.rated_current heats to winding.maximum", optional=True
        ),
        "heat_capacity": Entry("J/K", "of the copper and the parts in thermal contact"),
        "ambient": Entry("deg C", "highest ambient temperature", zero=True, signed=True),
        "initial": Entry("deg C", "estimate after a reset", zero=True, signed=True),
        "derating": Entry("deg C", "temperature where the derating of the current limit begins"),
        "maximum": Entry("deg C", "temperature at which the current limit equals the rated current"),
        "fault": Entry("deg C", "fault threshold; can be cleared below winding.maximum"),
    },
    "field_weakening": {
        "margin": Entry("V", "reserve of stator voltage below its limit", zero=True),
        "bandwidth": Entry("Hz", "bandwidth at the speed whose back-EMF equals the voltage limit", maximum=250.0),
        "current_use": Entry("", "fraction of limits.current for the current against the flux", maximum=1.0),
        "magnet_current": Entry("A", "largest current against the flux for hot magnets, peak"),
    },
    "home": {
        "speed": Entry("rad/s", "speed of the first approach of a homing; the later ones use a quarter of it"),
        "current": Entry("A", "limit of i_q during a homing"),
        "back_off": Entry("rad", "distance from a stop or a switch before the next approach"),
        "spread": Entry("rad", "spread of the positions found that is a fault", zero=True),
        "turns_max": Entry("", "turns within which the reference must be found", whole=True),
        "reach": Entry("rad", "largest distance from the position of enabling, while the position is not known"),
    },
    "pins": {
        "open_time": Entry("s", "time until the holding brake is open", zero=True),
        "close_time": Entry("s", "time until the holding brake holds", zero=True),
    },
    "sensing": {
        "sign_current": Entry(
            "A", "phase current above which its direction is certain; more is used for a winding of low inductance"
        ),
        "offset_tolerance": Entry("", "largest distance of an offset from mid-scale [ADC codes]", whole=True),
        "offset_duty": Entry("", "shortest high-side duty for a valid offset sample", maximum=1.0),
    },
}
"""Keys of the groups of an axis; [defaults] may hold any of them."""

SCHEMA: Final[Mapping[str, Mapping[str, Entry]]] = {"board": BOARD, **BOARD_GROUPS, **AXIS_GROUPS}
"""Every group and its keys; a group must have all keys that are not optional, and no others."""


def unknown_name(where: str, name: str, known: Collection[str]) -> ConfigError:
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


def check_group(where: str, group: str, value: object, places: Mapping[str, str] | None = None) -> dict[str, float]:
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
        Full names of the entries for messages, where they differ from ``where.key``.

    Raises
    ------
    ConfigError
        About the first entry that is missing, unknown or wrong.
    """
    if group not in SCHEMA:
        raise unknown_name(where, group, SCHEMA)
    entries, known = check_table(where, value), SCHEMA[group]
    _check_names(where, entries, known)
    names = {key: f"{where}.{key}" for key in known} | dict(places or {})
    return {key: entry.check(names[key], entries[key]) for key, entry in known.items() if key in entries}


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
