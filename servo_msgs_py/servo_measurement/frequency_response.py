"""Open-loop frequency response and margins, with uncertainty, from recordings of a closed loop.

In closed loop, error and output both contain the disturbances, so the quotient of output and error would be biased
towards the inverse of the controller. The test signal d is not correlated with the disturbances; as an instrumental
variable it gives an unbiased estimate L = S_od / S_ed (Ljung, System Identification, 2nd ed., 7.6 and 13.5).

A test signal begins and ends within its recording, with the loop at rest or in steady motion before and after it.
Therefore the discrete Fourier transform of a whole recording has no leakage, and a constant affects its first bin only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

COHERENCE_MIN: Final = 0.6
"""Smallest coherence of a valid point."""

_SIGMA_MAX: Final = 0.3
"""Largest relative standard deviation of a valid point."""

GROUPS: Final = 40
"""Groups of frequencies per decade."""

_NEAR: Final = 1.5  # the fit at a crossing uses frequencies within this factor
_FIT_POINTS: Final = 4
_RESONANCE_MIN: Final = 3.0  # [dB]
_RESONANCE_SIGMAS: Final = 5.0

_Complex = NDArray[np.complex128]
_Float = NDArray[np.float64]


@dataclass(frozen=True)
class Response:
    """Points of a frequency response, in the order of the frequencies."""

    frequency: _Float  # (n,) [Hz]
    value: _Complex  # (n,), complex gain
    sigma: _Float  # (n,), standard deviation of `value` over its magnitude: relative one of the gain, phase in [rad]
    coherence: _Float  # (n,), the smaller of test signal to error and test signal to output; 0 .. 1

    @property
    def good(self) -> NDArray[np.bool_]:
        """Valid points, shape (frequencies,)."""
        return np.asarray((self.coherence >= COHERENCE_MIN) & (self.sigma <= _SIGMA_MAX))

    @property
    def decibels(self) -> _Float:
        """Gain [dB]."""
        return np.asarray(20.0 * np.log10(np.maximum(np.abs(self.value), 1e-12)))

    @property
    def degrees(self) -> _Float:
        """Unwrapped phase, at the first point above -360 and at most 0 [degrees]."""
        return np.asarray(np.degrees(_phase(self.value)))


@dataclass(frozen=True)
class Measured:
    """A measured value with its uncertainty."""

    value: float  # infinite if unknown
    sigma: float  # standard deviation; infinite if unknown


@dataclass(frozen=True)
class Resonance:
    """A peak or a notch of the gain."""

    frequency: float  # [Hz]
    height: float  # relative to the surrounding gain, negative for a notch [dB]


@dataclass(frozen=True)
class Figures:
    """Crossover, margins, resonances; None: not determined."""

    crossover: Measured | None  # frequency of unity gain [Hz]; of several the one nearest to instability
    phase_margin: Measured | None  # [degrees]
    gain_margin: Measured | None  # factor by which the gain may increase
    resonances: tuple[Resonance, ...]  # by frequency
    undetermined: tuple[str, ...]  # causes of figures that are None, a sentence each


# ---- from samples to points ------------------------------------------------------------------------------------------


def estimate(
    step: float,
    instrument: _Float,
    error: _Float,
    output: _Float,
    f_min: float,
    f_max: float,
    groups: int = GROUPS,
) -> Response:
    """Estimate the open loop from repeated recordings of one test signal.

    Parameters
    ----------
    step : float
        Time between two samples [s].
    instrument, error, output : ndarray, shape (repetitions, samples)
        Test signal, and input and output of the open loop.
    f_min, f_max : float
        Band of the test signal [Hz].
    groups : int
        Groups of frequencies per decade.

    Returns
    -------
    Response
        One point per group of frequencies; a group is a part of a decade, or a single frequency of the transform.
    """
    samples = instrument.shape[1]
    frequency = np.fft.rfftfreq(samples, step)
    d, e, o = (np.fft.rfft(signal, axis=1) for signal in (instrument, error, output))
    inside = np.nonzero((frequency >= f_min) & (frequency <= f_max) & (frequency > 0.0))[0]
    group = np.floor(groups * np.log10(frequency[inside] / f_min) + 1e-9).astype(np.int64)
    bins = [inside[group == number] for number in np.unique(group)]
    points = [_point(frequency[k], d[:, k], e[:, k], o[:, k]) for k in bins]
    table = np.array(points, dtype=np.complex128).reshape(-1, 4)
    return Response(table[:, 0].real.copy(), table[:, 1].copy(), table[:, 2].real.copy(), table[:, 3].real.copy())


def _point(f: _Float, d: _Complex, e: _Complex, o: _Complex) -> tuple[float, complex, float, float]:
    """Frequency, value, relative standard deviation and coherence of a group of bins (repetitions in rows).

    The response within the group is a straight line: o = (l_0 + l_1 (f - f_0)) e, with d and d (f - f_0) as
    instruments.
    """
    energy = (np.abs(d) ** 2).sum(axis=0)
    if not energy.any():
        return float(f.mean()), 0.0j, math.inf, 0.0
    middle = float(energy @ f / energy.sum())
    orders = 2 if f.size >= 3 else 1
    span = max(float(np.abs(f - middle).max()), 1e-12)
    powers = np.vstack([((f - middle) / span) ** k for k in range(orders)])  # (orders, bins)
    z, x = ((signal[None] * powers[:, None]).reshape(orders, -1).T for signal in (d, e))  # (equations, orders)
    y = o.ravel()
    degrees_of_freedom = y.size - orders
    cross = z.conj().T @ x
    if degrees_of_freedom < 1 or np.linalg.cond(cross) > 1e12:
        return middle, 0.0j, math.inf, 0.0
    line = np.linalg.solve(cross, z.conj().T @ y)
    noise = float((np.abs(y - x @ line) ** 2).sum()) / degrees_of_freedom
    inverse = np.linalg.inv(cross)
    variance = noise * float((inverse @ (z.conj().T @ z) @ inverse.conj().T)[0, 0].real)
    size = abs(line[0])
    sigma = math.sqrt(max(variance, 0.0)) / size if size > 0.0 else math.inf
    return middle, complex(line[0]), sigma, min(_coherence(z, e.ravel()), _coherence(z, y))


def _coherence(z: _Complex, y: _Complex) -> float:
    """Coefficient of determination of y by the columns of z, corrected for the number of columns."""
    total = float((np.abs(y) ** 2).sum())
    if total <= 0.0:
        return 0.0
    fit, *_ = np.linalg.lstsq(z, y, rcond=None)
    residual = float((np.abs(y - z @ fit) ** 2).sum())
    size, orders = z.shape
    return float(np.clip(1.0 - residual / total * size / (size - orders), 0.0, 1.0))


def joined(responses: Sequence[Response]) -> Response:
    """Points of several bands, in the order of their frequencies."""
    order = np.argsort(np.concatenate([r.frequency for r in responses]), kind="stable")
    return Response(
        *(
            np.concatenate([getattr(r, name) for r in responses])[order]
            for name in ("frequency", "value", "sigma", "coherence")
        )
    )


# ---- from points to figures ------------------------------------------------------------------------------------------


def figures(response: Response) -> Figures:
    """Crossover, margins and resonances of a measured open loop from its valid points."""
    good = response.good
    f, value, sigma = response.frequency[good], response.value[good], response.sigma[good]
    if f.size < _FIT_POINTS:
        cause = f"only {f.size} of {good.size} points have a coherence of {COHERENCE_MIN:g}: the signal is too small"
        return Figures(None, None, None, (), (f"crossover, margins: {cause}",))
    gain, phase = np.log(np.abs(value)), _phase(value)
    weight = 1.0 / np.maximum(sigma, 1e-5)
    span = f"{f[0]:.3g} .. {f[-1]:.3g} Hz"
    undetermined: list[str] = []

    crossings = [fit for k in _sign_changes(gain) if (fit := _crossing(f, gain, phase, weight, k)) is not None]
    margins = [(_wrapped(math.degrees(c.other) + 180.0), c) for c in crossings]
    crossover = phase_margin = gain_margin = None
    if margins:
        margin, c = min(margins, key=lambda pair: abs(pair[0]))
        crossover, phase_margin = Measured(c.frequency, c.sigma), Measured(margin, math.degrees(c.other_sigma))
    else:
        side = "above" if gain.mean() > 0.0 else "below"
        cause = f"the gain is always {side} 1" if not _sign_changes(gain) else "too few valid points near unity gain"
        undetermined.append(f"crossover, phase margin: {cause} in {span}, the range with sufficient coherence")

    first = f[0] if crossover is None else crossover.value
    crossings_180 = [
        fit
        for k in _half_turns(phase)
        if f[k + 1] > first and (fit := _crossing(f, phase - _half_turn(phase, k), gain, weight, k)) is not None
    ]
    rising = [Measured(math.exp(-c.other), math.exp(-c.other) * c.other_sigma) for c in crossings_180 if c.other < 0.0]
    if rising:
        gain_margin = min(rising, key=lambda m: m.value)
    else:
        undetermined.append(f"gain margin: the phase does not pass -180 degrees within {span}")
    return Figures(crossover, phase_margin, gain_margin, _resonances(f, gain, sigma), tuple(undetermined))


def _phase(value: _Complex) -> _Float:
    """Unwrapped phase [rad], at the first point above -2 pi and at most 0."""
    if value.size == 0:
        return np.zeros(0)
    phase = np.unwrap(np.angle(value))
    return np.asarray(phase - 2.0 * math.pi * math.ceil(phase[0] / (2.0 * math.pi)))


def _wrapped(degrees: float) -> float:
    """Angle in -180 .. 180."""
    return (degrees + 180.0) % 360.0 - 180.0


def _sign_changes(values: _Float) -> list[int]:
    """Indices before a change of sign."""
    return [int(k) for k in np.nonzero((values[:-1] > 0.0) != (values[1:] > 0.0))[0]]


def _revolutions(phase: _Float) -> NDArray[np.int64]:
    return np.floor((phase - math.pi) / (2.0 * math.pi)).astype(np.int64)


def _half_turns(phase: _Float) -> list[int]:
    """Indices before a crossing of the phase with an odd multiple of 180 degrees."""
    revolutions = _revolutions(phase)
    return [int(k) for k in np.nonzero(revolutions[:-1] != revolutions[1:])[0]]


def _half_turn(phase: _Float, k: int) -> float:
    """The odd multiple of 180 degrees that is crossed after index k [rad]."""
    return math.pi + 2.0 * math.pi * float(max(_revolutions(phase[k : k + 2])))


@dataclass(frozen=True)
class _Crossing:
    """Zero of one quantity: frequency [Hz] and the other quantity there, with standard deviations."""

    frequency: float  # [Hz]
    sigma: float  # standard deviation [Hz]
    other: float  # other quantity at this frequency
    other_sigma: float  # its standard deviation


def _crossing(f: _Float, zero: _Float, other: _Float, weight: _Float, k: int) -> _Crossing | None:
    """Fit both quantities by parabolas over log f near index k, and find the zero of the first one.

    Returns
    -------
    _Crossing or None
        None if there are too few points on one side, or the parabola has no zero between them.
    """
    centre = math.sqrt(f[k] * f[k + 1])
    near = (f > centre / _NEAR) & (f < centre * _NEAR)
    if near.sum() < _FIT_POINTS or (f[near] < centre).sum() < 1 or (f[near] > centre).sum() < 1:
        return None
    x = np.log(f[near] / centre)
    basis = np.vander(x, 3 if near.sum() > _FIT_POINTS else 2, increasing=True)
    scaled = basis * weight[near, None]
    covariance = np.linalg.inv(scaled.T @ scaled)
    first, second = (covariance @ scaled.T @ (values[near] * weight[near]) for values in (zero, other))
    # In a nonlinear loop the scatter of the points exceeds their standard deviations: use the larger one.
    freedom = max(int(near.sum()) - basis.shape[1], 1)
    spread = [
        max(1.0, math.sqrt(float((((values[near] - basis @ fit) * weight[near]) ** 2).sum()) / freedom))
        for values, fit in ((zero, first), (other, second))
    ]
    roots = np.roots(first[::-1])
    real = [float(r.real) for r in roots if abs(r.imag) < 1e-9 and x[0] <= r.real <= x[-1]]
    if not real:
        return None
    root = min(real, key=abs)
    row = root ** np.arange(basis.shape[1])
    slope = np.arange(basis.shape[1]) * root ** np.maximum(np.arange(basis.shape[1]) - 1, 0)
    deviation = math.sqrt(float(row @ covariance @ row))
    slope_zero, slope_other = float(slope @ first), float(slope @ second)
    if slope_zero == 0.0:
        return None
    place = spread[0] * deviation / abs(slope_zero)
    return _Crossing(
        centre * math.exp(root),
        centre * math.exp(root) * place,
        float(row @ second),
        math.hypot(spread[1] * deviation, slope_other * place),
    )


def _resonances(f: _Float, gain: _Float, sigma: _Float) -> tuple[Resonance, ...]:
    """Significant peaks and notches relative to a slope of -20 dB per decade."""
    level = 20.0 / math.log(10.0) * (gain + np.log(f))
    deviation = 20.0 / math.log(10.0) * sigma
    found = [
        Resonance(_between(f, level, k), height)
        for sign in (1.0, -1.0)
        for k, height in _peaks(sign * level, deviation, sign)
    ]
    return tuple(sorted(found, key=lambda r: r.frequency))


def _between(f: _Float, level: _Float, k: int) -> float:
    """Frequency of the extremum of the parabola through a point and its neighbours."""
    fit = np.polyfit(np.log(f[k - 1 : k + 2] / f[k]), level[k - 1 : k + 2], 2)
    place = -0.5 * float(fit[1] / fit[0]) if fit[0] != 0.0 else 0.0
    return float(np.clip(f[k] * math.exp(place), f[k - 1], f[k + 1]))


def _peaks(level: _Float, deviation: _Float, sign: float) -> list[tuple[int, float]]:
    """Index and height [dB] of the peaks that are significant on both sides."""
    result = []
    for k in range(1, level.size - 1):
        if level[k] < level[k - 1] or level[k] <= level[k + 1]:
            continue
        feet = []
        for side in (level[:k][::-1], level[k + 1 :]):
            higher = np.nonzero(side > level[k])[0]
            valley = side[: int(higher[0])] if higher.size else side
            feet.append(float(level[k] - valley.min()))
        height = min(feet)
        if height > max(_RESONANCE_MIN, _RESONANCE_SIGMAS * deviation[k]):
            result.append((k, sign * height))
    return result
