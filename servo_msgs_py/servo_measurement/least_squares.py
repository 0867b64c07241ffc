"""Least squares with uncertainties for the closed-form estimates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BATCHES: Final = 8
"""Number of parts of a recording whose means are treated as independent; neighbouring samples are correlated."""

_STEPS: Final = 12
_RELATIVE: Final = 1e-4  # step of a numerical derivative


def mean_of(samples: Floats) -> tuple[float, float]:
    """Mean and its standard uncertainty, in the unit of the samples, from batch means; NaN is omitted."""
    usable = samples[np.isfinite(samples)]
    if usable.size < BATCHES:
        return float("nan"), float("inf")
    batches = np.array([part.mean() for part in np.array_split(usable, BATCHES)])
    return float(usable.mean()), float(batches.std(ddof=1) / np.sqrt(BATCHES))


def fit_linear(columns: Floats, y: Floats, sigma: Floats | None = None) -> tuple[Floats, Floats, float]:
    """Weighted linear least squares.

    Parameters
    ----------
    columns : ndarray, shape (n, p)
    y : ndarray, shape (n,)
    sigma : ndarray, shape (n,), optional
        Standard uncertainties; the covariance is scaled by the residuals if these exceed the uncertainties.

    Returns
    -------
    parameters : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    rms : float
        RMS of the weighted residuals.
    """
    weight = np.ones_like(y) if sigma is None else 1.0 / sigma
    a, b = columns * weight[:, None], y * weight
    x: Floats = np.linalg.lstsq(a, b, rcond=None)[0].astype(np.float64)
    degrees_of_freedom = max(y.size - x.size, 1)
    variance = float(((b - a @ x) ** 2).sum()) / degrees_of_freedom
    scale = variance if sigma is None else max(variance, 1.0)
    return x, np.linalg.pinv(a.T @ a) * scale, float(np.sqrt(variance))


def fit_nonlinear(residual: Callable[[Floats], Floats], start: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Gauss-Newton with step control.

    Parameters
    ----------
    residual : callable
        Maps parameters of shape (p,) to independent residuals of shape (n,) with equal variance.
    start, scale : ndarray, shape (p,)
        Initial values; magnitude of each parameter.

    Returns
    -------
    parameters : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    """
    x = start.astype(np.float64)
    r = residual(x)
    damping = 1e-3
    jacobian = np.zeros((r.size, x.size))
    for _ in range(_STEPS):
        for k in range(x.size):
            moved = x.copy()
            moved[k] += _RELATIVE * scale[k]
            jacobian[:, k] = (residual(moved) - r) / _RELATIVE
        normal, gradient = jacobian.T @ jacobian, jacobian.T @ r
        improved = False
        for _ in range(8):
            step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal) + 1e-30), -gradient, rcond=None)[0]
            trial = x + step * scale
            r_trial = residual(trial)
            if np.isfinite(r_trial).all() and r_trial @ r_trial <= r @ r:
                improved = bool((r @ r - r_trial @ r_trial) > 1e-10 * (r @ r))
                x, r, damping = trial, r_trial, damping / 5.0
                break
            damping *= 5.0
        if not improved:
            break
    degrees_of_freedom = max(r.size - x.size, 1)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(r @ r) / degrees_of_freedom
    return x, covariance * np.outer(scale, scale)
