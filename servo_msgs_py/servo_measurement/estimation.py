"""Closed-form estimates from the recordings of a motor test. Missing samples (NaN) are omitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.trace import Trace

from servo_measurement.access import MeasurementError
from servo_measurement.least_squares import mean_of
from servo_measurement.log import MeasurementLog
from servo_measurement.motor_values import Estimate, MotorEstimates
from servo_measurement.rotating_vector import NotFollowingError, follow_vector, sensor_errors
from servo_measurement.speed_runs import balance, flux, friction, half_wave, steady_of, torque_of
from servo_measurement.standstill import Ohmic, impedance, ohmic

BAND: Final = {"d": (400.0, 2500.0), "q": (700.0, 2500.0)}
"""Frequency bands for the inductances [Hz]; below them the rotor follows a current perpendicular to the vector."""

PLAIN_TIME: Final = 0.45
"""Duration of each run without a d-axis current [s]."""

FLUX_CURRENT_TIME: Final = 0.8
"""Duration of the d-axis current of a run for the flux, one period of a sine [s]."""

PERIOD_MIN: Final = 0.95
"""Smallest length of its recording, relative to it."""

FLUX_UNCERTAINTY: Final = 0.1
"""Relative uncertainty of the flux from a rotating vector, for the unknown effect of dead time and voltage drops."""

SALIENT_MIN: Final = 0.05
"""Smallest relative difference of the inductances along and across the vector that shows a rotor off the vector."""

FAST_OVER_SLOW: Final = 1.4
"""Smallest ratio of the speeds of two rotating vectors that separates their voltages."""

FOLLOW_TOLERANCE: Final = 0.15
"""Relative tolerance of the mean speed of a shaft that oscillates about a rotating vector, and of the vector."""


class NoVoltageError(MeasurementError):
    """The voltage of the flux is not seen."""

    def __init__(self) -> None:
        super().__init__(
            "the rotating rotor induces no voltage that differs from that of the switches: it is too slow or has no"
            " magnets, or a wire is open"
        )


def _columns(log: MeasurementLog, point: str) -> tuple[str, str, str]:
    name = axis_name(log.axis)
    return f"{name}.i_{point}", f"{name}.u_{point}", f"{name}.test_signal"


def resistance_of(log: MeasurementLog) -> Ohmic:
    """Resistance of winding and switch, and lost voltage, from a series of currents."""
    name = axis_name(log.axis)
    points = []
    for recording in log.labelled("level"):
        i_d, _ = mean_of(recording[f"{name}.i_d"])
        u_d, error = mean_of(recording[f"{name}.u_d"])
        if math.isfinite(i_d) and math.isfinite(u_d):
            points.append((i_d, u_d, max(error, 1e-3)))
    if len(points) < 4:
        raise MeasurementError(f"{len(points)} currents with samples are too few for the resistance: measure again")
    current, voltage, sigma = (np.array(column) for column in zip(*points, strict=True))
    return ohmic(current, voltage, sigma)


def inductances_of(log: MeasurementLog, r: float) -> dict[str, Estimate]:
    """``l_d``, ``l_q`` and ``delay`` from swept sines; `r` includes the switch [ohm]."""
    of_d = impedance(log.labelled("sweep_d"), _columns(log, "d"), r, BAND["d"])
    delay = of_d.delay.value
    of_q = impedance(log.labelled("sweep_q"), _columns(log, "q"), r, BAND["q"], swings=True, delay=delay)
    return {"l_d": of_d.inductance, "l_q": of_q.inductance, "delay": of_d.delay}


def inductance_at_low_current(log: MeasurementLog, r: float) -> Estimate | None:
    """``l_d`` [H] at a smaller d-axis current for comparison; None: not measured. `r`: resistance [ohm]."""
    recordings = log.labelled("sweep_d_low")
    return impedance(recordings, _columns(log, "d"), r, BAND["d"]).inductance if recordings else None


def rotation_of(log: MeasurementLog, r: float) -> dict[str, Estimate]:
    """``pole_pairs``, gains and offsets from a vector that rotates slowly in both directions.

    Raises
    ------
    NotFollowingError
        If the shaft does not follow the last two vectors.
    MeasurementError
        If the encoder counts in the opposite direction.
    """
    name = axis_name(log.axis)
    slow = log.labelled("turn_slow")[-2:]
    if not slow:
        raise MeasurementError("there is no recording of a rotating vector")
    found = [follow_vector(one[f"{name}.position"], one[f"{name}.test_angle"]) for one in slow]
    if len({one.pole_pairs for one in found}) != 1 or len({one.direction for one in found}) != 1:
        raise NotFollowingError("the shaft follows the rotating vector in one direction only: it is blocked or loaded")
    if found[0].direction < 0:
        raise MeasurementError(
            "the encoder counts against the phase sequence: swap its lines A and B, or two wires of the motor"
        )
    return {"pole_pairs": Estimate(float(found[0].pole_pairs), 0.0), **sensor_errors(slow, name, r)}


def _speeds(recording: Trace, name: str) -> tuple[float, float]:
    """Mean speeds of vector (electrical) and shaft (mechanical) [rad/s]."""
    angle, position = (recording[f"{name}.{key}"] for key in ("test_angle", "position"))
    usable = np.isfinite(angle) & np.isfinite(position)
    time = recording.time[usable]
    return tuple(float(np.polyfit(time, y, 1)[0]) for y in (np.unwrap(angle[usable]), position[usable]))  # type: ignore[return-value]


def shaft_follows(recording: Trace, name: str, pairs: float) -> bool:
    """Whether the shaft follows a rotating vector, and the voltage is enough for it; `pairs`: number of pole pairs."""
    electrical, shaft = _speeds(recording, name)
    along, across = (mean_of(recording[f"{name}.{key}"])[0] for key in ("i_d", "i_q"))
    controlled = abs(across) < FOLLOW_TOLERANCE * abs(along)
    return controlled and abs(shaft * pairs - electrical) < FOLLOW_TOLERANCE * abs(electrical)


def swing_of(recording: Trace, name: str, pairs: float) -> float:
    """Standard deviation of the angle between a rotating vector and the rotor [rad, electrical]."""
    angle, position = (recording[f"{name}.{key}"] for key in ("test_angle", "position"))
    usable = np.isfinite(angle) & np.isfinite(position)
    return float(np.std(np.unwrap(angle[usable]) - pairs * position[usable]))


def lies_on_vector(l_d: Estimate, l_q: Estimate, l_d_low: Estimate | None = None) -> bool:
    """Whether a rotor that is not blocked lies on the vector that holds it.

    Above ``psi_m / (l_q - l_d)`` its reluctance turns it off the vector. From there on the inductance along the vector
    grows with the current, and finally exceeds the one across it.

    Parameters
    ----------
    l_d, l_q : Estimate
        Inductances along and across the vector [H].
    l_d_low : Estimate, optional
        The one along a vector of a smaller current [H].
    """
    others = [l_q] if l_d_low is None else [l_q, l_d_low]
    return all(l_d.interval[0] <= (1.0 + SALIENT_MIN) * one.interval[1] for one in others)


def current_on_vector(along: float, across: float, held: float, flux: float, current: float) -> float:
    """Current above which the reluctance of a rotor turns it off the vector, from measurements above it [A].

    At the angle a to the vector the torques balance: ``cos a = psi_m / ((l_q - l_d) i)``. The difference of the
    inductances along and across the vector is then ``(l_d - l_q) cos 2a``, and the whole flux along it ``l_q i``.

    Parameters
    ----------
    along, across : float
        Inductances along and across the vector [H].
    held : float
        Current with which they were measured [A].
    flux : float
        Flux along a rotating vector, without that of its current in the inductance `along` [V s].
    current : float
        Of that vector [A].
    """
    part = flux / current  # (l_q - l_d) cos^2 a at the current `held` [H]
    return held * math.sqrt(part / (along - across + 2.0 * part))


def friction_angle_of(log: MeasurementLog, pairs: float) -> float:
    """Angle between a slowly rotating vector and the rotor by Coulomb friction [rad, electrical].

    It changes its sign with the direction; a constant load does not.
    """
    name = axis_name(log.axis)
    lags = []
    for one in log.labelled("turn_slow")[-2:]:
        lag = np.exp(1j * (one[f"{name}.test_angle"] - pairs * one[f"{name}.position"]))
        lags.append(np.nanmean(lag))
    forward, backward = lags
    return 0.5 * abs(float(np.angle(forward / backward)))


def flux_of(log: MeasurementLog, l_d: float, pairs: float) -> dict[str, Estimate]:
    """First estimate of ``psi_m`` [V s] from the back-EMF of a rotor that follows a rotating vector; `l_d` [H].

    Raises
    ------
    NotFollowingError
        If the rotor does not follow.
    NoVoltageError
        If it induces no voltage.
    """
    name = axis_name(log.axis)
    fast = [one for one in log.labelled("turn_fast") if shaft_follows(one, name, pairs)][-2:]
    speeds = [_speeds(one, name)[0] for one in fast]
    if len(fast) < 2 or speeds[0] * speeds[1] > 0.0:
        raise NotFollowingError(
            "the shaft does not follow a rotating vector: it is blocked, or the current is too small for its friction"
            " or inertia"
        )
    # the lost voltage lags the current, by a voltage that is the same at all of these speeds
    slow = [one for one in log.labelled("turn_slow")[-2:] if shaft_follows(one, name, pairs)]
    points = np.array([(_speeds(one, name)[0], mean_of(one[f"{name}.u_q"])[0]) for one in slow + fast])
    columns = [points[:, 0]]
    if abs(speeds[0]) > FAST_OVER_SLOW * abs(points[0, 0]):
        columns.append(np.sign(points[:, 0]))
    total = float(np.linalg.lstsq(np.column_stack(columns), points[:, 1], rcond=None)[0][0])
    induced = total - l_d * mean_of(fast[0][f"{name}.i_d"])[0]
    if not induced > 1e-4:
        raise NoVoltageError
    return {"psi_m": Estimate(induced, FLUX_UNCERTAINTY * induced)}


def speed_runs_of(log: MeasurementLog, known: dict[str, Estimate], direct: Ohmic) -> dict[str, Estimate]:
    """``psi_m``, friction, ``load`` and ``inertia`` from runs at several speeds."""
    name = axis_name(log.axis)
    runs = log.labelled("speed")
    if any(len(run) * run.step < PERIOD_MIN * FLUX_CURRENT_TIME for run in log.labelled("hold")):
        raise MeasurementError("recordings for the flux are shorter than a period of their current: measure again")
    held = [
        steady_of(half_wave(run, FLUX_CURRENT_TIME, sign), name) for run in log.labelled("hold") for sign in (1.0, -1.0)
    ]
    plain = [steady_of(run, name) for run in log.labelled("plain")]
    if len(held) < 8 or len(plain) < 4:
        raise MeasurementError(f"{len(plain)} runs are too few for flux and friction: measure again")
    pairs, l_d, l_q = round(known["pole_pairs"].value), known["l_d"].value, known["l_q"].value
    psi = flux(held, pairs, direct, float(log.notes["limits"]["voltage"]), l_d, l_q, known["delay"].value)
    i_d, i_q = (np.array([getattr(point, key).value for point in plain]) for key in ("i_d", "i_q"))
    torque = torque_of(i_d, i_q, pairs, psi.value, l_d, l_q)
    sigma = 1.5 * pairs * psi.value * np.array([point.i_q.sigma for point in plain])
    acceleration = np.array([point.acceleration for point in plain])
    inertia = Estimate(0.0, 0.0)
    for _ in range(3):  # friction and inertia depend on each other slightly
        parts = friction(plain, torque - inertia.value * acceleration, sigma)
        resistance_torque = parts["friction"].value, parts["viscous"].value, parts["load"].value
        inertia, _ = balance(runs, name, (pairs, psi.value, l_d, l_q), resistance_torque)
    # the torque is computed from the flux and shares its relative error
    scaled = {key: _with_part(value, psi.sigma / psi.value) for key, value in parts.items()}
    return {"psi_m": psi, **scaled, "inertia": _with_part(inertia, psi.sigma / psi.value)}


def _with_part(estimate: Estimate, part: float) -> Estimate:
    return Estimate(estimate.value, math.hypot(estimate.sigma, part * estimate.value))


def estimates_of(log: MeasurementLog) -> MotorEstimates:
    """All values determined by the recordings of a test, and the causes of undetermined ones."""
    r_on = float(log.notes["limits"]["r_on"])
    values: dict[str, Estimate] = {}
    undetermined: dict[str, str] = {}

    def attempt(names: str, make: Callable[[], Mapping[str, Estimate]]) -> bool:
        try:
            values.update(make())
        except MeasurementError as error:
            undetermined.update(dict.fromkeys(names.split(), str(error)))
            return False
        return True

    def standstill() -> dict[str, Estimate]:
        found = resistance_of(log)
        winding = Estimate(found.resistance.value - r_on, found.resistance.sigma)
        return {"r_s": winding, "dead_voltage": found.lost}

    if not attempt("r_s dead_voltage", standstill):
        return MotorEstimates(values, undetermined)
    total = values["r_s"].value + r_on
    attempt("l_d l_q delay", lambda: inductances_of(log, total))
    if "l_d" not in values:
        return MotorEstimates(values, undetermined)
    if attempt("pole_pairs gain_ratio", lambda: rotation_of(log, total)):
        attempt("psi_m", lambda: flux_of(log, values["l_d"].value, values["pole_pairs"].value))
        attempt("psi_m friction viscous load inertia", lambda: speed_runs_of(log, values, resistance_of(log)))
    else:  # a blocked rotor has not aligned with the vector
        for name in ("l_d", "l_q"):
            values.pop(name)
            undetermined[name] = "the rotor does not follow a current vector: its angle to the vector is unknown"
    return MotorEstimates(values, undetermined)
