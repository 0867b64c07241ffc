"""Groups and keys of ``servo.toml``: what each number means and which values can make sense at all."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from servo_msgs_py.tuning.errors import ConfigError, refused

LEAST: Final = 1e-12
"""Nothing that could stand in the file is smaller, 0 apart."""

MOST: Final = 1e12
"""Nothing is larger."""


@dataclass(frozen=True)
class Entry:
    """What one number of the configuration has to be."""

    unit: str  # SI, or empty
    meaning: str  # description
    zero: bool = False  # whether 0 is valid
    whole: bool = False  # whether it is an integer
    maximum: float = math.inf  # largest valid magnitude
    signed: bool = False  # whether it may be negative
    optional: bool = False  # whether it may be left out

    def check(self, name: str, value: object) -> float:
        """The value as a number.

        Raises
        ------
        ConfigError
            If it is none, or one that cannot make sense.
        """
        wanted = self._wanted()
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise refused(name, repr(value), "not a number", f"write {wanted}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise refused(name, number, "not a finite number", f"write {wanted}")
        size = abs(number) if self.signed else number
        if size < LEAST and not (size == 0.0 and self.zero):
            raise refused(name, number, "too small", f"write {wanted}")
        if size > min(self.maximum, MOST):
            raise refused(name, number, "too large", f"write {wanted}")
        if self.whole and number % 1.0 != 0.0:
            raise refused(name, number, "not a whole number", f"write {wanted}")
        return number

    def _wanted(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        minimum = "of either sign" if self.signed else "from 0" if self.zero else "above 0"
        maximum = f" up to {self.maximum:g}" if math.isfinite(self.maximum) else ""
        unit = f" [{self.unit}]" if self.unit else ""
        return f"{kind} {minimum}{maximum}{unit}: {self.meaning}"


BOARD: Final[Mapping[str, Entry]] = {
    "pwm_frequency": Entry("Hz", "switching frequency, one fast loop per period"),
    "slow_divider": Entry("", "PWM periods per slow loop", whole=True),
    "timer_clock": Entry("Hz", "clock that times the encoder edges"),
    "nominal_voltage": Entry("V", "DC bus"),
    "over_voltage": Entry("V", "bus voltage that is a fault"),
    "under_voltage": Entry("V", "bus voltage that is a fault"),
    "host_timeout": Entry("s", "silence of the host that is a fault"),
    "command_timeout": Entry("s", "age at which a velocity or torque set-point expires; 0: never", zero=True),
    "dead_time": Entry("s", "both switches of a leg are open at every edge", zero=True),
    "switch_drop": Entry("V", "switch or diode", zero=True),
    "voltage_use": Entry("", "part of the linear range of the modulation that is used", maximum=1.0),
}
"""Keys of the group [board]."""

BOARD_GROUPS: Final[Mapping[str, Mapping[str, Entry]]] = {
    "brake": {
        "resistance": Entry("ohm", "brake resistor across the bus"),
        "on_voltage": Entry("V", "bus voltage that switches the resistor on"),
        "off_voltage": Entry("V", "bus voltage that switches it off again"),
        "power": Entry("W", "continuous power rating of the resistor"),
        "energy": Entry("J", "pulse energy rating of the cold resistor"),
    },
    "regeneration": {
        "start_voltage": Entry("V", "bus voltage from which braking current is folded back"),
        "full_voltage": Entry("V", "bus voltage from which there is none"),
    },
}
"""Keys of the groups [board.brake], which says besides whether there is one, and [board.regeneration]."""

AXIS_GROUPS: Final[Mapping[str, Mapping[str, Entry]]] = {
    "motor": {
        "r_s": Entry("ohm", "stator resistance"),
        "l_d": Entry("H", "stator inductance, d axis"),
        "l_q": Entry("H", "stator inductance, q axis"),
        "psi_m": Entry("V s", "flux linkage of the magnets, electrical"),
        "pole_pairs": Entry("", "pole pairs", whole=True),
        "inertia": Entry("kg m^2", "everything that turns with the shaft"),
        "rotor_inertia": Entry("kg m^2", "of the motor alone"),
        "rated_speed": Entry("rad/s", "of the motor's data sheet"),
        "rated_current": Entry("A", "of the motor's data sheet, peak"),
    },
    "encoder": {"lines": Entry("", "lines per turn", whole=True)},
    "friction": {
        "coulomb": Entry("N m", "friction of a turning shaft", zero=True),
        "viscous": Entry("N m s", "friction per speed", zero=True),
        "smooth": Entry("rad/s", "speed within which the sign of the Coulomb friction changes"),
    },
    "limits": {
        "current": Entry("A", "largest current that the motor is driven with, peak"),
        "speed": Entry("rad/s", "largest speed set-point"),
        "acceleration": Entry("rad/s^2", "ramp of speed set-points and of stops"),
        "position": Entry("rad", "soft limits to both sides"),
        "following_error": Entry("rad", "distance from the shaped set-point that is a fault"),
        "over_speed": Entry("rad/s", "speed that is a fault"),
    },
    "control": {
        "current_bandwidth": Entry("Hz", "of both current loops"),
        "speed_bandwidth": Entry("Hz", "of the speed loop"),
        "speed_ratio": Entry("", "bandwidth over corner frequency of the integral part"),
        "anti_windup": Entry("", "Kc of DRM E35, below 1", maximum=1.0),
        "position_gain": Entry("1/s", "K_v: speed set-point per position error"),
        "observer_bandwidth": Entry("Hz", "of the speed observer; twice the position gain over 2 pi at least"),
        "path_current_use": Entry("", "fraction of the current limit used by shaped set-points"),
    },
    "rotor_search": {
        "current": Entry("A", "largest vector"),
        "ramp_time": Entry("s", "from zero to that current, of the first vectors"),
        "hold_time": Entry("s", "at that current without another count"),
        "rest_time": Entry("s", "standstill after a twitch"),
        "move_counts": Entry("", "movement that counts as a twitch", whole=True),
        "interval": Entry("deg electrical", "remaining interval at which the search ends"),
        "verify_angle": Entry(
            "deg electrical", "largest turn until the shaft follows where the rotor was found", maximum=45.0
        ),
        "verify_time": Entry("s", "of that turn"),
        "turn_angle": Entry(
            "deg electrical", "turn of the vector that tells a held shaft from a dead encoder", maximum=180.0
        ),
        "turn_time": Entry("s", "of that turn, and again of the way back"),
        "follow_flux": Entry("", "part of the flux of a rotor that follows; more has moved", maximum=1.0),
        "time_max": Entry("s", "for the whole search"),
    },
    "observer": {
        "bandwidth": Entry("Hz", "of the poles, beyond half the decay of a current", optional=True),
        "damping": Entry("", "of that", maximum=10.0, optional=True),
        "k_1": Entry("1/s", "K1 of the slide, below 0, instead of bandwidth and damping", signed=True, optional=True),
        "k_2": Entry("V/(A s)", "K2 of the slide, above 0; together with k_1", signed=True, optional=True),
        "pll_i": Entry("", "number in the rule of the slide for the I gain, 1506742"),
        "pll_damping": Entry("", "of the phase-locked loop", maximum=10.0),
        "pll_torque": Entry(
            "", "fraction of the acceleration by the current fed forward to the phase-locked loop", True, maximum=2
        ),
        "pll_size": Entry("Hz", "how quickly its speed follows the size of the back-EMF", True, maximum=250.0),
        "pll_load": Entry(
            "", "acceleration that it learns from the angle, per time, over omega_n^3", True, maximum=1.0
        ),
        "speed_part": Entry("", "speed loop of a sensorless axis, part of control.speed_bandwidth", maximum=1.0),
    },
    "reliability": {
        "period": Entry("", "slow ticks between two of the 64 speeds", whole=True),
        "variance_threshold": Entry("", "part of the squared mean up to which the variance is that of a good speed"),
        "hysteresis": Entry("", "bad tests in a row that are a fault", whole=True),
    },
    "emf_check": {
        "floor": Entry("V", "by which the back-EMF may be off at any speed: dead time"),
        "spin_floor": Entry("V", "the same after the filter of a sensorless axis"),
        "resistance": Entry("", "part by which r_s may be off", True, maximum=2.0),
        "part": Entry("", "part of the back-EMF by which it may be off", maximum=1.0),
        "spin_time": Entry("s", "of that until a sensorless axis has lost its rotor"),
        "stand_time": Entry("s", "below half of start_up.minimum_speed until a sensorless axis is held fast"),
        "check_time": Entry("s", "of that until encoder and observer disagree"),
    },
    "start_up": {
        "current_first": Entry("", "FIRST_I_STARTUP, part of limits.current", maximum=1.0),
        "current_final": Entry("", "FINAL_I_STARTUP, part of limits.current", maximum=1.0),
        "current_time": Entry("s", "I_START_UP_DURATION: from the first to the final current"),
        "speed_final": Entry("", "FINAL_START_UP_SPEED, part of limits.speed", maximum=1.0),
        "swings": Entry("", "FREQ_START_UP_DURATION in periods of the rotor's swing about the turning current"),
        "speed_time": Entry("s", "FREQ_START_UP_DURATION, instead of swings", optional=True),
        "wait_max": Entry("s", "after that ramp until the start-up has failed"),
        "consecutive_tests": Entry("", "NB_CONSECUTIVE_TESTS", whole=True),
        "minimum_speed": Entry("", "MINIMUM_SPEED_RPM, part of limits.speed", maximum=1.0),
        "mean_min": Entry("", "part of the forced speed that the observed mean must reach", maximum=1.0),
        "mean_max": Entry("", "part of the forced speed that it must not pass", maximum=3.9),
        "swing_damping": Entry(
            "", "of the swing about the turning current, by the current across it", True, maximum=2.0
        ),
        "swing_current": Entry("", "part of the final current that this may take", True, maximum=1.0),
        "catch_time": Entry("s", "to see whether the shaft turns already"),
        "fade_time": Entry("s", "from the current limit to 0, for the rest of the start-up current"),
    },
    "timing": {
        "settle": Entry("s", "in INIT"),
        "runaway_margin": Entry("rad/s", "beyond the speed limit, or gained against the full current"),
        "runaway_max": Entry("s", "of that until it is a fault"),
        "rest_max": Entry("s", "that an enabled axis waits for its shaft to rest"),
        "stall_max": Entry("s", "at full current without movement until it is a fault"),
        "stop_speed": Entry("rad/s", "below it a stop is over"),
        "stop_max": Entry("s", "after the ramp of a stop until the outputs go off at any speed"),
        "following_max": Entry("s", "of a following error until it is a fault"),
        "over_speed_max": Entry("s", "of over-speed until it is a fault"),
    },
    "stop": {
        "time_max": Entry("s", "from the beginning of a stop until the outputs go off in any case"),
        "hold_time": Entry("s", "that an axis holds its position without a drive"),
        "short_current": Entry("A", "steady current that shorted windings may carry"),
        "copper_use": Entry(
            "", "part of the current limit for i_d while braking current is folded back", zero=True, maximum=1.0
        ),
    },
    "winding": {
        "thermal_resistance": Entry(
            "K/W", "to the surroundings; without it the rated current leads to maximum", optional=True
        ),
        "heat_capacity": Entry("J/K", "of the copper and the parts in thermal contact"),
        "ambient": Entry("deg C", "hottest surroundings", zero=True, signed=True),
        "initial": Entry("deg C", "assumed after a reset, which loses the temperature", zero=True, signed=True),
        "derating": Entry("deg C", "from where on the current limit falls"),
        "maximum": Entry("deg C", "at which the current limit equals the rated current"),
        "fault": Entry("deg C", "that is a fault, until it is below maximum again"),
    },
    "field_weakening": {
        "margin": Entry("V", "stator voltage that stays free below its limit", zero=True),
        "bandwidth": Entry(
            "Hz", "of the voltage's controller, where the back-EMF takes the whole voltage", maximum=250.0
        ),
        "current_use": Entry("", "part of limits.current for the current against the flux", maximum=1.0),
        "magnet_current": Entry("A", "largest current against the flux for hot magnets, peak"),
    },
    "home": {
        "speed": Entry("rad/s", "of the first approach of a homing; the next ones take a quarter of it"),
        "current": Entry("A", "limit of i_q while an axis is homed"),
        "back_off": Entry("rad", "way back from a stop or a switch before the next approach"),
        "spread": Entry("rad", "distance of the places where it was found that is a fault", zero=True),
        "turns_max": Entry("", "turns within which it has to be found", whole=True),
        "reach": Entry("rad", "largest distance from the position of enabling, until the position is known"),
    },
    "pins": {
        "open_time": Entry("s", "until the holding brake is open", zero=True),
        "close_time": Entry("s", "until the holding brake holds", zero=True),
    },
    "sensing": {
        "sign_current": Entry("A", "above it the direction of a phase current is certain"),
        "offset_tolerance": Entry("", "ADC codes that an offset may lie off mid-scale", whole=True),
        "offset_duty": Entry("", "shortest high side for a true offset sample", maximum=1.0),
    },
}
"""Keys of the groups of an axis; [defaults] may hold any of them."""

SCHEMA: Final[Mapping[str, Mapping[str, Entry]]] = {"board": BOARD, **BOARD_GROUPS, **AXIS_GROUPS}
"""Every group and its keys; a group must have these and no others."""


def unknown_name(where: str, name: str, known: Collection[str]) -> ConfigError:
    """Error about a name that nothing is known about, with the closest ones."""
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    return ConfigError(f"{where} is unknown; {hint}")


def check_table(where: str, value: object) -> Mapping[str, Any]:
    """A table of TOML.

    Raises
    ------
    ConfigError
        If it is something else.
    """
    if not isinstance(value, Mapping):
        raise refused(where, repr(value), "not a table", f"write a group [{where}] with its entries below")
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
    """A group with exactly its keys, each with a number that can make sense, in the units of its entries.

    Parameters
    ----------
    where : str
        Full name of the group for messages.
    group : str
        Its name in `SCHEMA`.
    value : object
        What TOML has found there.
    places : mapping, optional
        Full names of the entries for messages, where they differ from ``where.key``.

    Raises
    ------
    ConfigError
        Naming the first entry that is missing, unknown or wrong.
    """
    if group not in SCHEMA:
        raise unknown_name(where, group, SCHEMA)
    entries, known = check_table(where, value), SCHEMA[group]
    _check_names(where, entries, known)
    names = {key: f"{where}.{key}" for key in known} | dict(places or {})
    return {key: entry.check(names[key], entries[key]) for key, entry in known.items() if key in entries}


def check_switches(where: str, value: object, names: Collection[str]) -> dict[str, bool]:
    """A group of switches, each true or false.

    Raises
    ------
    ConfigError
        Naming the first entry that is missing, unknown or neither true nor false.
    """
    entries = check_table(where, value)
    _check_names(where, entries, names)
    for key in names:
        if not isinstance(entries[key], bool):
            raise refused(f"{where}.{key}", repr(entries[key]), "neither on nor off", "write true or false")
    return {key: entries[key] for key in names}
