"""Resistance, lost voltage, inductances and delay of a motor whose rotor is held by a current vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD

from servo_measurement.access import MeasurementError
from servo_measurement.least_squares import Floats, fit_linear, fit_nonlinear
from servo_measurement.motor_values import Estimate

Complex = NDArray[np.complex128]

RESISTANCE_MIN: Final = 0.02  # of winding and switch [ohm]
SMOOTHED: Final = 6  # number of neighbouring frequencies whose cross spectra are summed


def switching_share(x: Floats) -> Floats:
    """Lost voltage of a leg relative to its full value; `x`: current relative to the range of sign changes.

    A current close to zero changes its sign within a PWM period: then dead time and voltage drops of both signs
    act. A cubic approximates measured values in this range.
    """
    clipped = np.clip(x, -1.0, 1.0)
    share: Floats = clipped * (1.5 - 0.5 * clipped * clipped)
    return share


@dataclass(frozen=True)
class Ohmic:
    """Results with direct current."""

    resistance: Estimate  # of winding and one switch [ohm]
    lost: Estimate  # voltage lost in a leg by dead time and forward drops [V]
    band: float  # current of a leg below which only a part of it is lost [A]
    rms: float  # RMS of the residuals [V]


def ohmic(current: Floats, voltage: Floats, sigma: Floats) -> Ohmic:
    """Fit of voltages to currents along phase a, with half the current back in each of phases b and c.

    Parameters
    ----------
    current, voltage, sigma : ndarray, shape (n,)
        Means of each level, and the standard uncertainty of the voltages [A], [V].
    """
    best: Ohmic | None = None
    minimum = np.inf
    for band in np.linspace(0.02, 0.6, 59) * float(np.abs(current).max()):
        # mean of leg a minus mean of b and c, times 2/3
        shape = (2.0 / 3.0) * (switching_share(current / band) + switching_share(0.5 * current / band))
        (r, lost), covariance, rms = fit_linear(np.column_stack([current, shape]), voltage, sigma)
        if rms < minimum:
            minimum = rms
            errors = np.sqrt(np.diag(covariance))
            best = Ohmic(Estimate(r, errors[0]), Estimate(lost, errors[1]), float(band), rms)
    assert best is not None
    return best


@dataclass(frozen=True)
class Impedance:
    """Results with a test signal."""

    inductance: Estimate  # [H]
    delay: Estimate  # from a sample of the current to the load of the resulting duty cycle [s]
    swing: float  # voltage per integral of the current, from oscillation of the rotor [V/(A s)]
    explained: float  # part of the power of the current that the model explains


def _response(omega: Floats, r: float, inductance: float, delay: float, swing: float) -> Complex:
    """Current per voltage of samples; the voltage is held for a period after the delay [periods]."""
    whole = int(np.floor(delay))
    part = delay - whole
    z1: Complex = np.exp(-1j * omega * PERIOD)
    decay = r * PERIOD / inductance
    late, both = np.exp(-(1.0 - part) * decay), np.exp(-decay)
    winding: Complex = ((1.0 - late) * z1 + (late - both) * z1**2) / (r * (1.0 - both * z1)) * z1**whole
    result: Complex = winding / (1.0 + winding * swing / (1j * omega)) if swing else winding
    return result


def impedance(
    recordings: list[Trace],
    names: tuple[str, str, str],
    r: float,
    band: tuple[float, float],
    *,
    swings: bool = False,
    delay: float | None = None,
    any_resistance: bool = False,
) -> Impedance:
    """Inductance from recordings of a swept sine; the signal is the instrumental variable, so noise causes no bias.

    Parameters
    ----------
    recordings : list of Trace
        Sampled every PWM period, including the decay after the signal.
    names : tuple of str
        Columns of current, voltage and test signal.
    r : float
        Resistance [ohm].
    band : tuple of float
        Evaluated frequencies [Hz].
    swings : bool
        Whether the current causes oscillations of the rotor.
    delay : float, optional
        Known delay [s].
    any_resistance : bool
        Whether the resistance is estimated, too. A small alternating current that changes the lost voltage of a leg
        has an additional resistance.
    """
    if not recordings:
        raise MeasurementError("there is no recording of a test signal: measure again")
    omega, i_d, u_d = spectra(recordings, names, band)
    known = None if delay is None else delay / PERIOD
    size = float(np.abs(u_d).mean() / np.abs(i_d).mean() / omega.mean())
    names_of, start, scale = ["inductance"], [size], [size]
    for name, wanted, first, unit in (
        ("delay", known is None, 0.5, 1.0),
        ("swing", swings, 0.0, size * float(omega[0]) ** 2),
        ("resistance", any_resistance, r, r),
    ):
        if wanted:
            names_of.append(name)
            start.append(first)
            scale.append(unit)

    def residual(x: Floats) -> Floats:
        given = dict(zip(names_of, map(float, x), strict=True))
        late = float(np.clip(given["delay"], 0.0, 3.0)) if known is None else known
        resistance = max(given.get("resistance", r), RESISTANCE_MIN)
        model = _response(omega, resistance, abs(given["inductance"]) + 1e-9, late, given.get("swing", 0.0))
        error = i_d - model * u_d
        return np.concatenate([error.real, error.imag])

    x, covariance = fit_nonlinear(residual, np.array(start), np.array(scale))
    errors = np.sqrt(np.abs(np.diag(covariance)))
    found = Estimate(float(x[1]) * PERIOD, float(errors[1]) * PERIOD) if known is None else Estimate(delay or 0.0, 0.0)
    swing = float(x[names_of.index("swing")]) if swings else 0.0
    explained = 1.0 - float((residual(x) ** 2).sum()) / float((np.abs(i_d) ** 2).sum())
    return Impedance(Estimate(abs(float(x[0])), float(errors[0])), found, swing, explained)


def spectra(
    recordings: Sequence[Trace], names: tuple[str, str, str], band: tuple[float, float]
) -> tuple[Floats, Complex, Complex]:
    """Cross spectra with the test signal, averaged over repetitions.

    Returns
    -------
    omega : ndarray, shape (n,)
        Frequencies [rad/s].
    current, voltage : ndarray of complex, shape (n,)
        Spectra relative to the test signal, which is free of noise.
    """
    columns = [_mean_of_repetitions([recording[name] for recording in recordings]) for name in names]
    size = columns[0].size
    # the response has decayed in the last samples: their mean is the constant component
    i, u, d = (np.fft.rfft(column - column[-max(size // 16, 4) :].mean()) for column in columns)
    frequency = np.fft.rfftfreq(size, recordings[0].step)
    inside = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]))
    rows = inside[: inside.size // SMOOTHED * SMOOTHED].reshape(-1, SMOOTHED)
    weight = np.sqrt((np.abs(d[rows]) ** 2).sum(axis=1))
    i_d = (i[rows] * d[rows].conj()).sum(axis=1) / weight
    u_d = (u[rows] * d[rows].conj()).sum(axis=1) / weight
    return 2.0 * np.pi * frequency[rows].mean(axis=1), i_d, u_d


def _mean_of_repetitions(columns: Sequence[Floats]) -> Floats:
    """Mean of each sample over the repetitions, without missing ones; linear interpolation if all are missing."""
    table = np.stack(columns)
    usable = np.isfinite(table)
    counts = usable.sum(axis=0)
    at = np.arange(counts.size)
    available = counts > 0
    if not available.any():
        raise MeasurementError("all samples of a test signal are missing: measure again")
    means = np.where(usable, table, 0.0).sum(axis=0)[available] / counts[available]
    bridged: Floats = np.interp(at, at[available], means)
    return bridged
