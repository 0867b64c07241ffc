"""Checks of a board and an axis. Those with access to the board leave its outputs off: nothing moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

from servo_measurement.access import BoardAccess, refuse_faults
from servo_measurement.motor_rig import SUPPLY_FAULTS
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_bridge.commissioning.figure import Figure

_SAMPLES: Final = 20
_PAUSE: Final = 0.05  # between samples [s]
_COUNTERS: Final = ("late_loops", "receiver_overruns")
_CLEARED: Final = 0.1  # until a fault with a present cause is set again [s]
_CLOCK: Final = 0.02  # tolerance of the time of the board
_VOLTAGE: Final = 0.1  # tolerance of the bus voltage, relative
_RIPPLE: Final = 0.05  # largest range of the bus voltage, relative
_AT_REST: Final = 0.02  # largest motion of a shaft at rest [rad]
_TURN: Final = 0.2  # tolerance of a turn by hand, relative
OWN: Final = ("gain_ratio", "offset_alpha", "offset_beta", "delay")
"""Estimates of an identification that describe the board, not the motor."""


def _samples(access: BoardAccess, name: str) -> list[float]:
    values = []
    for _ in range(_SAMPLES):
        values.append(access.read(name)[0])
        access.wait(_PAUSE)
    return values


def board(access: BoardAccess, *, real: bool) -> list[Figure]:
    """Time of the board against that of the computer, and its counters of errors, over a second.

    Parameters
    ----------
    access : BoardAccess
        The board.
    real : bool
        Whether its time has to be that of the computer; a virtual board may be slower.
    """
    before = {name: access.read_words(name)[0] for name in ("tick", *_COUNTERS)}
    begin = access.clock()
    access.wait(_SAMPLES * _PAUSE)
    after = {name: access.read_words(name)[0] for name in before}
    seconds = access.clock() - begin
    ticks = (after["tick"] - before["tick"]) % 2**32 * PERIOD_NS * 1e-9
    ends = (1.0 - _CLOCK, 1.0 + _CLOCK) if real else (0.0, math.inf)
    clock = Figure("time of the board / of the computer", ticks / seconds, "", *ends, "crystal and PLL of the board")
    remedies = {
        "late_loops": "the control loops do not keep their time: the build of the firmware",
        "receiver_overruns": "bytes are lost: line speed, cable and ground",
    }
    counters = [Figure(name, (after[name] - before[name]) % 2**16, "", 0, 0, remedies[name]) for name in _COUNTERS]
    return [clock, *counters]


def clear_faults(access: BoardAccess, axis: int) -> list[str]:
    """Clear the faults of an axis whose cause is gone; returns the names of all that it had."""
    variable = access.catalogue[f"{axis_name(axis)}.faults"]
    assert variable.flags is not None
    found = [fault.name for fault in access.catalogue.active(variable.flags, access.read_words(variable.name)[0])]
    if found:
        access.write("cmd.clear_faults", [1], axis)
        access.wait(_CLEARED)
    return found


def supply(access: BoardAccess, axis: int, voltage: float) -> list[Figure]:
    """Voltage of the bus against the one that the user measures.

    Parameters
    ----------
    access : BoardAccess
        The board.
    axis : int
        Index; it must have no fault but those of the voltage, whose thresholds follow `voltage` later.
    voltage : float
        [V].

    Raises
    ------
    MeasurementError
        If the axis has another fault; with its remedy.
    """
    refuse_faults(access, axis, *SUPPLY_FAULTS)
    values = _samples(access, "u_dc")
    mean = math.fsum(values) / len(values)
    near = (voltage * (1.0 - _VOLTAGE), voltage * (1.0 + _VOLTAGE))
    return [
        Figure("bus voltage", mean, "V", *near, "the supply, --voltage, or the divider of the board"),
        Figure("range of the bus voltage", max(values) - min(values), "V", 0.0, _RIPPLE * voltage, "supply and wiring"),
    ]


def pins(access: BoardAccess, axis: int) -> list[str]:
    """Names of the active inputs of an axis."""
    variable = access.catalogue[f"{axis_name(axis)}.inputs"]
    assert variable.flags is not None
    word = access.read_words(variable.name)[0]
    return [flag.name for flag in access.catalogue.active(variable.flags, word)]


def encoder(access: BoardAccess, axis: int) -> list[Figure]:
    """Motion that the encoder reports while the shaft is at rest."""
    values = _samples(access, f"{axis_name(axis)}.position")
    remedy = "hold the shaft still; else the lines A and B of the encoder: supply, ground and screen"
    return [Figure("motion at rest", max(values) - min(values), "rad", 0.0, _AT_REST, remedy)]


def turned(before: float, after: float) -> list[Figure]:
    """A turn of the shaft by hand in the positive direction, from positions [rad]."""
    remedy = "lines per turn of the encoder (encoder_lines), loose coupling; negative: the other direction is positive"
    ends = (math.tau * (1.0 - _TURN), math.tau * (1.0 + _TURN))
    return [Figure("one turn by hand", after - before, "rad", *ends, remedy)]


def identified(estimates: Mapping[str, Mapping[str, float]], current_scale: float, period: float) -> list[Figure]:
    """Figures of an identification that describe the board, whatever the motor is (`OWN`).

    Parameters
    ----------
    estimates : mapping
        ``estimates`` of ``estimates.json``.
    current_scale : float
        Full scale of the currents [A].
    period : float
        PWM period [s].
    """
    offset = 0.03 * current_scale
    shunts = "shunts and amplifiers of the phases"
    checks: Sequence[tuple[str, str, str, float, float, str]] = (
        ("gain of phase a / b and c", "gain_ratio", "", 0.9, 1.1, shunts),
        ("offset of the current, alpha", "offset_alpha", "A", -offset, offset, shunts),
        ("offset of the current, beta", "offset_beta", "A", -offset, offset, shunts),
        ("delay from sample to voltage", "delay", "s", 0.2 * period, 1.5 * period, "trigger of the converters"),
    )
    return [
        Figure(title, estimates[name]["value"], unit, low, high, remedy)
        for title, name, unit, low, high, remedy in checks
        if name in estimates
    ]
