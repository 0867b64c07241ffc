"""Flux, friction, load and inertia from runs at several speeds with reversals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD

from servo_measurement.least_squares import Floats, fit_linear, mean_of
from servo_measurement.motor_values import Estimate
from servo_measurement.standstill import Ohmic, switching_share

GAP_MAX: Final = 3  # largest number of consecutive missing samples that are interpolated
PEAK: Final = 0.5
"""Smallest value of a sine near its peak, relative to it."""
LOST_VOLTAGE_ERROR: Final = 0.1
"""Relative uncertainty of the lost voltage in phase with the torque current, while a larger d-axis current flows."""


@dataclass(frozen=True)
class Steady:
    """Means in a time at constant speed, each with its standard uncertainty."""

    speed: float  # of the shaft, from its angle [rad/s]
    acceleration: float  # remaining acceleration [rad/s^2]
    i_d: Estimate  # [A]
    i_q: Estimate  # [A]
    u_q: Estimate | None = None  # [V]; None: not recorded
    u_d: Estimate | None = None  # [V]; None: not recorded


def half_wave(recording: Trace, period: float, sign: float) -> Trace:
    """A recording of one period [s] of a sine, with the samples near the peak of one sign; the others are missing."""
    wave = np.sin(2.0 * math.pi * recording.step * np.arange(len(recording)) / period)
    kept = sign * wave > PEAK
    return recording.changed(**{name: np.where(kept, column, np.nan) for name, column in recording.columns.items()})


def steady_of(recording: Trace, axis: str) -> Steady:
    """Means of a recording at constant speed."""
    names = [name for name in ("i_d", "i_q", "u_q", "u_d") if f"{axis}.{name}" in recording.columns]
    part = {name: recording[f"{axis}.{name}"] for name in ("position", *names)}
    usable = np.isfinite(part["position"])
    time = recording.time[usable]
    curvature, slope, _ = np.polyfit(time - time.mean(), part["position"][usable], 2)
    means = {name: Estimate(*mean_of(part[name])) for name in names}
    return Steady(float(slope), 2.0 * float(curvature), **means)


def torque_of(i_d: Floats, i_q: Floats, pairs: int, psi: float, l_d: float, l_q: float) -> Floats:
    """Air-gap torque [N m]."""
    return 1.5 * pairs * (psi + (l_d - l_q) * i_d) * i_q


def _lost_fundamental(current: Floats, voltage: Floats, u_dc: float, direct: Ohmic, inductance: float) -> Floats:
    """Fundamental component of the voltage lost in the legs, in phase with the rotating current [V].

    The current ripple, which increases with the modulation, widens the range of sign changes.
    """
    phase = np.linspace(0.0, 2.0 * math.pi, 180, endpoint=False)
    spread = np.clip(math.sqrt(3.0) * 3.0 / math.pi * np.abs(voltage) / u_dc, 0.0, 1.0)
    band = direct.band + u_dc * spread * (1.0 - spread) * PERIOD / (6.0 * inductance)
    wave = switching_share(np.outer(current / band, np.cos(phase)))
    result: Floats = 2.0 * direct.lost.value * (wave * np.cos(phase)).mean(axis=1)
    return result


def flux(
    points: list[Steady], pairs: int, direct: Ohmic, u_dc: float, l_d: float, l_q: float, delay: float
) -> Estimate:
    """Flux linkage [V s] from the dependence of voltage on speed, corrected by the lost voltage at direct current.

    Points with d-axis currents of both signs: errors that change their sign with this current are fitted. These are the
    lag of the lost voltage, which follows the current only after its zero crossing, and the error of `l_d`.

    A voltage acts after the rotation during the delay of its load and half its hold time. The drive advances its angle
    by one period.
    """
    speed = np.array([point.speed for point in points]) * pairs
    i_d, i_q = (np.array([getattr(point, name).value for point in points]) for name in ("i_d", "i_q"))
    rotation = speed * (delay - 0.5 * PERIOD)
    u_q, u_d = (np.array([getattr(point, name).value for point in points]) for name in ("u_q", "u_d"))
    u_q = u_q * np.cos(rotation) - u_d * np.sin(rotation)
    size = np.hypot(i_d, i_q) + 1e-9
    lost = _lost_fundamental(size, u_q, u_dc, direct, 0.5 * (l_d + l_q)) * i_q / size
    sign = np.sign(i_d)
    columns = np.column_stack([speed, speed * sign, np.sign(speed) * sign])
    induced = u_q - direct.resistance.value * i_q - speed * l_d * i_d - lost
    (psi, *_), covariance, _ = fit_linear(columns, induced)
    # errors of resistance and lost voltage contribute as far as both depend on speed
    current_slope, lost_slope = (float(fit_linear(columns, values)[0][0]) for values in (i_q, lost))
    parts = (
        float(np.sqrt(covariance[0, 0])),
        current_slope * direct.resistance.sigma,
        LOST_VOLTAGE_ERROR * lost_slope,
    )
    return Estimate(float(psi), math.hypot(*parts))


def friction(points: list[Steady], torque: Floats, torque_sigma: Floats) -> dict[str, Estimate]:
    """Coulomb [N m] and viscous [N m s/rad] friction and load [N m] from torques [N m], shape (points,)."""
    speed = np.array([point.speed for point in points])
    columns = np.column_stack([np.sign(speed), speed, np.ones_like(speed)])
    x, covariance, _ = fit_linear(columns, torque, np.maximum(torque_sigma, 1e-9))
    errors = np.sqrt(np.diag(covariance))
    return {name: Estimate(float(x[k]), float(errors[k])) for k, name in enumerate(("friction", "viscous", "load"))}


def _interpolated(column: Floats) -> Floats:
    """Samples with short gaps interpolated linearly; long gaps remain."""
    missing = ~np.isfinite(column)
    if not missing.any() or missing.all():
        return column
    at = np.arange(column.size)
    result: Floats = column.copy()
    result[missing] = np.interp(at[missing], at[~missing], column[~missing])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if end - first > GAP_MAX:
            result[first:end] = np.nan
    return result


def balance(
    recordings: list[Trace],
    axis: str,
    motor: tuple[int, float, float, float],
    parts: tuple[float, float, float] | None,
) -> tuple[Estimate, Estimate]:
    """Inertia [kg m^2] and Coulomb friction [N m] from the balance of momentum: speed and integral of the torque.

    Parameters
    ----------
    recordings : list of Trace
        Recordings of an axis that accelerates and decelerates.
    axis : str
        Name of the axis.
    motor : tuple
        Pole pairs, ``psi_m`` [V s], ``l_d``, ``l_q`` [H].
    parts : tuple of float, optional
        Coulomb [N m] and viscous [N m s/rad] friction and load [N m]; if omitted, the Coulomb friction is
        estimated, too.
    """
    rows: list[Floats] = []
    values: list[Floats] = []
    for k, recording in enumerate(recordings):
        position, i_d, i_q = (_interpolated(recording[f"{axis}.{name}"]) for name in ("position", "i_d", "i_q"))
        torque = torque_of(i_d, i_q, *motor)
        speed = np.diff(position) / recording.step
        middle = torque[1:-1]  # between the middles of two intervals
        change = np.diff(speed)
        at = 0.5 * (speed[1:] + speed[:-1])
        usable = np.isfinite(change) & np.isfinite(middle)
        given = np.where(usable, middle, 0.0) * recording.step
        sign = np.where(usable, np.tanh(at / 1.0), 0.0) * recording.step
        if parts is not None:
            coulomb, viscous, load = parts
            given = given - coulomb * sign - np.where(usable, viscous * at + load, 0.0) * recording.step
        total = np.cumsum(given)[usable]
        gained = np.cumsum(np.where(usable, change, 0.0))[usable]
        own = np.zeros((total.size, len(recordings)))
        own[:, k] = 1.0
        columns = [gained, own] if parts is not None else [gained, np.cumsum(sign)[usable], own]
        rows.append(np.column_stack(columns))
        values.append(total)
    x, covariance, _ = fit_linear(np.vstack(rows), np.concatenate(values))
    errors = np.sqrt(np.diag(covariance)) * 5.0  # the sums are correlated
    dry = Estimate(float(x[1]), float(errors[1])) if parts is None else Estimate(parts[0], 0.0)
    return Estimate(float(x[0]), float(errors[0])), dry
