"""Flux, friction, load and inertia from an axis that runs at several speeds and reverses. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from servo_msgs_py.measurement.access import Recording
from servo_msgs_py.measurement.least_squares import Floats, fit_linear, mean_of
from servo_msgs_py.measurement.motor_values import Estimate
from servo_msgs_py.measurement.standstill import PERIOD, Ohmic, switching_share

BRIDGED: Final = 3  # samples that may be missing in a row
LOST_OFF: Final = 0.3
"""Part by which a lost voltage may be off that changes within the band of small currents."""


@dataclass(frozen=True)
class Steady:
    """Means over a time at constant speed, each with its standard uncertainty."""

    speed: float  # of the shaft, from its angle [rad/s]
    acceleration: float  # that remains [rad/s^2]
    i_d: Estimate  # [A]
    i_q: Estimate  # [A]
    u_q: Estimate | None = None  # [V]; None: not recorded
    u_d: Estimate | None = None  # [V]; None: not recorded


def second_half(recording: Recording) -> Recording:
    """Of a recording during which something settles."""
    return Recording(recording.step, {name: column[column.size // 2 :] for name, column in recording.columns.items()})


def steady_of(recording: Recording, axis: str) -> Steady:
    """Of a recording at constant speed."""
    names = [name for name in ("i_d", "i_q", "u_q", "u_d") if f"{axis}.{name}" in recording.columns]
    part = {name: recording.columns[f"{axis}.{name}"] for name in ("position", *names)}
    usable = np.isfinite(part["position"])
    time = recording.time[usable]
    bend, slope, _ = np.polyfit(time - time.mean(), part["position"][usable], 2)
    means = {name: Estimate(*mean_of(part[name])) for name in names}
    return Steady(float(slope), 2.0 * float(bend), **means)


def torque_of(i_d: Floats, i_q: Floats, pairs: int, psi: float, l_d: float, l_q: float) -> Floats:
    """Air-gap torque [N m]."""
    return 1.5 * pairs * (psi + (l_d - l_q) * i_d) * i_q


def _lost_fundamental(current: Floats, voltage: Floats, u_dc: float, direct: Ohmic, inductance: float) -> Floats:
    """Voltage along the current that legs lose while it turns: of the first harmonic [V].

    The ripple of the current, which grows with the modulation, widens the band within which a current changes its sign.
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
    """Flux linkage from the voltage over the speed [V s]; what dead time and drops take is known from direct current.

    A voltage acts when the rotor has turned on, by the delay of its load and half the time that it is held.
    """
    speed = np.array([point.speed for point in points]) * pairs
    i_d, i_q = (np.array([getattr(point, name).value for point in points]) for name in ("i_d", "i_q"))
    turned = speed * (delay + 0.5 * PERIOD)
    u_q, u_d = (np.array([getattr(point, name).value for point in points]) for name in ("u_q", "u_d"))
    u_q = u_q * np.cos(turned) - u_d * np.sin(turned)
    size = np.hypot(i_d, i_q) + 1e-9
    lost = _lost_fundamental(size, u_q, u_dc, direct, 0.5 * (l_d + l_q)) * i_q / size
    columns = np.column_stack([speed, np.sign(speed)])
    induced = u_q - direct.resistance.value * i_q - speed * l_d * i_d - lost
    (psi, _), covariance, _ = fit_linear(columns, induced)
    # errors of resistance and lost voltage count as far as both grow with the speed
    (grown, _), _, _ = fit_linear(columns, i_q)
    (lost_grown, _), _, _ = fit_linear(columns, lost)
    parts = (float(np.sqrt(covariance[0, 0])), float(grown) * direct.resistance.sigma, LOST_OFF * float(lost_grown))
    return Estimate(float(psi), math.hypot(*parts))


def friction(points: list[Steady], torque: Floats, torque_sigma: Floats) -> dict[str, Estimate]:
    """Coulomb [N m] and viscous [N m s/rad] friction and load [N m] from torques [N m], shape (points,)."""
    speed = np.array([point.speed for point in points])
    columns = np.column_stack([np.sign(speed), speed, np.ones_like(speed)])
    x, covariance, _ = fit_linear(columns, torque, np.maximum(torque_sigma, 1e-9))
    errors = np.sqrt(np.diag(covariance))
    return {name: Estimate(float(x[k]), float(errors[k])) for k, name in enumerate(("friction", "viscous", "load"))}


def _bridged(column: Floats) -> Floats:
    """Samples with straight lines over short gaps; long ones stay."""
    missing = ~np.isfinite(column)
    if not missing.any() or missing.all():
        return column
    at = np.arange(column.size)
    result: Floats = column.copy()
    result[missing] = np.interp(at[missing], at[~missing], column[~missing])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if end - first > BRIDGED:
            result[first:end] = np.nan
    return result


def balance(
    recordings: list[Recording],
    axis: str,
    motor: tuple[int, float, float, float],
    parts: tuple[float, float, float] | None,
) -> tuple[Estimate, Estimate]:
    """Inertia [kg m^2] and Coulomb friction [N m] from momentum: the integral of the torque is in the shaft's speed.

    Parameters
    ----------
    recordings : list of Recording
        Of an axis that speeds up and slows down.
    axis : str
        Its name.
    motor : tuple
        Pole pairs, ``psi_m`` [V s], ``l_d``, ``l_q`` [H].
    parts : tuple of float, optional
        Coulomb [N m] and viscous [N m s/rad] friction and load [N m]; without them the Coulomb friction is
        estimated, too.
    """
    rows: list[Floats] = []
    values: list[Floats] = []
    for k, recording in enumerate(recordings):
        position, i_d, i_q = (_bridged(recording.columns[f"{axis}.{name}"]) for name in ("position", "i_d", "i_q"))
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
    errors = np.sqrt(np.diag(covariance)) * 5.0  # the sums are not independent of each other
    dry = Estimate(float(x[1]), float(errors[1])) if parts is None else Estimate(parts[0], 0.0)
    return Estimate(float(x[0]), float(errors[0])), dry
