"""Integers of braking and stopping: brake resistor, braking current, shorted windings, stop categories, pins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from servo_tuning.configuration import PINS, Axis, Configuration
from servo_tuning.conversion import Category, Converter, FaultSet, Value
from servo_tuning.errors import ConfigError, checking, either, lower
from servo_tuning.formats import FRAC16, FRAC32, GAIN

BUS_END: Final = 0.98
"""Fraction of the range of the bus ADC above which a voltage counts as saturated."""

_MOTOR: Final = "correct motor.psi_m, motor.pole_pairs or motor.r_s"


def short_speed(axis: Axis) -> float:
    """Mechanical speed at which shorted windings carry ``stop.short_current`` [rad/s]; infinite if they never do.

    K_e w / sqrt(R_s^2 + w^2 L_s^2) grows with the speed towards K_e / L_s.
    """
    current = axis("stop.short_current")
    inductance = 0.5 * (axis("motor.l_d") + axis("motor.l_q"))
    square = axis("motor.psi_m") ** 2 - (current * inductance) ** 2
    if square <= 0.0:
        return math.inf
    return current * axis("motor.r_s") / math.sqrt(square) / axis("motor.pole_pairs")


def regeneration_speed(axis: Axis) -> float:
    """Mechanical speed up to which the full current dissipates all returned energy in the winding [rad/s]."""
    return axis("limits.current") * axis("motor.r_s") / (axis("motor.pole_pairs") * axis("motor.psi_m"))


def stop_constants(to: Converter) -> dict[str, Value]:
    """Fields of ``axis_config_t`` for braking and stopping."""
    axis, s, stops = to.axis, to.s, to.axis.stops
    names = {"shorted": "short", "ramp": "ramp", "hold": "hold"}
    maximum = 1.0 - 2.0**-31
    return {
        **{f"stop.{command}": Category(category) for command, category in stops.commands.items()},
        **{f"stop.{field}": FaultSet(stops.faults_with(category)) for field, category in names.items()},
        "stop.short_speed": to.of("speed of the short", min(short_speed(axis) / s.speed, maximum), _MOTOR),
        "stop.short_current": to.at("stop.short_current", 1.0 / s.i * (1.0 - 2.0**-15)),
        "stop.ticks_max": to.ticks("stop.time_max"),
        "stop.hold_ticks": to.ticks("stop.hold_time"),
        "regeneration_speed": to.of("speed of regeneration", min(regeneration_speed(axis) / s.speed, maximum), _MOTOR),
        "copper_current": to.at("stop.copper_use", axis("limits.current") / s.i),
    }


def pin_constants(to: Converter) -> dict[str, Value]:
    """Fields of ``axis_config_t`` for the fitted pins and the times of the holding brake."""
    return {
        "pins.fitted": sum(to.axis.pins[pin] << bit for bit, pin in enumerate(PINS)),
        "pins.open_ticks": to.ticks("pins.open_time"),
        "pins.close_ticks": to.ticks("pins.close_time"),
    }


def brake_constants(configuration: Configuration) -> Mapping[str, int]:
    """Fields of ``bus_braking_config_t``.

    Raises
    ------
    ConfigError
        If a value does not fit its format, or is rounded to 0.
    """
    if not configuration.board.complete:
        raise ConfigError("[board.brake] and [board.regeneration] are missing; the firmware needs both")
    with checking(configuration.table):
        return _brake_constants(configuration)


def _brake_constants(configuration: Configuration) -> Mapping[str, int]:
    board, s = configuration.board, configuration.scales
    energy, power = board("brake.energy"), board("brake.power")
    heating = s.u_dc**2 / board("brake.resistance") * board.tick / energy

    def volts(key: str) -> int:
        entry = f"board.{key}"
        return FRAC16.raw(entry, board(key) / s.u_dc, lower(entry), given=board(key))

    return {
        "fitted": int(board.brake),
        "on": volts("brake.on_voltage"),
        "off": volts("brake.off_voltage"),
        "heating": GAIN.raw(
            "board.brake.energy", heating, *map(either, ("board.brake.energy", "board.brake.resistance")), given=energy
        ),
        "cooling": FRAC32.raw(
            "board.brake.power",
            power * board.tick / energy,
            *map(either, ("board.brake.power", "board.brake.energy")),
            given=power,
        ),
        "start": volts("regeneration.start_voltage"),
        "full": volts("regeneration.full_voltage"),
        "u_dc_max_braking": FRAC16.raw("board: end of the bus converter", BUS_END),
    }
