"""Extrema and roots of polynomials. Coefficients in powers of s in [0, 1], constant term first."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.polynomial import polynomial

from servo_bridge.trajectory.waypoints import Array

_NEGLIGIBLE = 1.0e-13
"""Leading coefficients below this fraction of the largest one are ignored: they would spoil the companion matrix."""


def derivative(coefficients: Array) -> Array:
    """Coefficients of the derivative along the last axis, constant term first, padded to the same shape."""
    result = np.zeros_like(coefficients)
    result[..., :-1] = coefficients[..., 1:] * np.arange(1, coefficients.shape[-1])
    return result


def enclosure(coefficients: Array) -> tuple[Array, Array]:
    """Bounds of polynomials on [0, 1] along the last axis: smallest and largest Bernstein coefficient.

    The bounds are safe, but not tight. G. Farin, Curves and Surfaces for CAGD, 5th ed., ch. 5.
    """
    n = coefficients.shape[-1]
    to_bernstein = np.array([[comb(i, k) / comb(n - 1, k) if k <= i else 0.0 for k in range(n)] for i in range(n)])
    bernstein = coefficients @ to_bernstein.T
    return bernstein.min(axis=-1), bernstein.max(axis=-1)


def roots(coefficients: Array) -> Array:
    """Sorted real parts in (0, 1) of all roots; coefficients of shape (degree + 1,), constant term first.

    Complex roots are included: double roots that rounding has made complex are needed, and additional points do no harm
    where an interval is divided or values are computed.
    """
    size = np.abs(coefficients)
    significant = np.flatnonzero(size > _NEGLIGIBLE * size.max(initial=0.0))
    if not len(significant) or significant[-1] == 0:
        return np.empty(0)
    found = np.sort(polynomial.polyroots(coefficients[: significant[-1] + 1]).real)
    return np.asarray(found[(found > 0.0) & (found < 1.0)], dtype=np.float64)


def extrema(coefficients: Array, begin: float = 0.0, end: float = 1.0) -> tuple[Array, Array]:
    """Limits of the monotone sections of a polynomial on [begin, end], and its values there."""
    inner = roots(derivative(coefficients))
    s = np.concatenate(([begin], inner[(inner > begin) & (inner < end)], [end]))
    return s, np.asarray(polynomial.polyval(s, coefficients), dtype=np.float64)


def first_above(coefficients: Array, s: Array, values: Array, bound: float) -> float:
    """First s (0 .. 1) with a value above `bound`; `s` and `values` from `extrema`, one value must be above."""
    k = int(np.argmax(values > bound))
    if k == 0:
        return float(s[0])
    low, high = float(s[k - 1]), float(s[k])
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if polynomial.polyval(middle, coefficients) > bound else (middle, high)
    return high
