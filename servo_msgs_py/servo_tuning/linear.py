"""Linear discrete-time systems: zero-order hold, frequency response, margins, poles, simulation."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Omega = NDArray[np.float64]
"""Angular frequencies [rad/s]."""

_TERMS: Final = 18
_GRID: Final = 600
_ROUNDS: Final = 4
_FINER: Final = 33
_LOWEST: Final = 1e-4  # of half the sampling frequency


def expm(a: Matrix) -> Matrix:
    """Matrix exponential: Taylor series of the scaled matrix, then repeated squaring."""
    norm = float(np.abs(a).sum(axis=1).max(initial=0.0))
    squarings = max(math.ceil(math.log2(norm)) + 1, 0) if norm > 0.0 else 0
    part = np.ldexp(a, -squarings)
    term = result = np.eye(a.shape[0])
    for n in range(1, _TERMS):
        term = term @ part / n
        result = result + term
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(squarings):
            result = result @ result
    return result


def held(a: Matrix, b: Matrix, dt: float) -> tuple[Matrix, Matrix]:
    """Step of ``x' = a x + b u`` over `dt` [s] with `u` held: ``x(t + dt) = f x + g u``.

    Returns
    -------
    tuple of ndarray
        f and g.
    """
    states, inputs = b.shape
    both = np.zeros((states + inputs, states + inputs))
    both[:states, :states], both[:states, states:] = a * dt, b * dt
    step = expm(both)
    return step[:states, :states], step[:states, states:]


@dataclass(frozen=True)
class System:
    """``x(k+1) = a x(k) + b u(k)``, ``y(k) = c x(k) + d u(k)``."""

    a: Matrix  # (n, n)
    b: Matrix  # (n, inputs)
    c: Matrix  # (outputs, n)
    d: Matrix  # (outputs, inputs)
    dt: float  # sampling time [s]

    @classmethod
    def of(cls, step: Callable[[Matrix, Matrix], tuple[Matrix, Matrix]], states: int, inputs: int, dt: float) -> System:
        """Return the matrices of a linear function ``step(x, u) -> (x next, y)`` that accepts matrices of columns."""
        x = np.hstack([np.eye(states), np.zeros((states, inputs))])
        u = np.hstack([np.zeros((inputs, states)), np.eye(inputs)])
        x_next, y = step(x, u)
        return cls(x_next[:, :states], x_next[:, states:], y[:, :states], y[:, states:], dt)

    @property
    def nyquist(self) -> float:
        """Half the sampling frequency [rad/s]."""
        return math.pi / self.dt

    def channel(self, output: int, input_: int) -> System:
        """Return the system from one input to one output."""
        return System(
            self.a,
            self.b[:, input_ : input_ + 1],
            self.c[output : output + 1],
            self.d[output : output + 1, input_ : input_ + 1],
            self.dt,
        )

    def scaled(self, input_: int, gain: float) -> System:
        """Return the system with a gain in series with one input."""
        gains = np.ones(self.b.shape[1])
        gains[input_] = gain
        return System(self.a, self.b * gains, self.c, self.d * gains, self.dt)

    def fed_back(self, output: int, input_: int, gain: float = 1.0) -> System:
        """Close the loop from an output to an input, ``u = r - gain y``; the input becomes r.

        The output must have no direct feed-through from this input.
        """
        c, d = self.c[output : output + 1], self.d[output : output + 1]
        assert d[0, input_] == 0.0
        column, through = self.b[:, input_ : input_ + 1], self.d[:, input_ : input_ + 1]
        return System(
            self.a - gain * column @ c,
            self.b - gain * column @ d,
            self.c - gain * through @ c,
            self.d - gain * through @ d,
            self.dt,
        )

    def response(self, omega: Omega) -> NDArray[np.complex128]:
        """Frequency response of the first output to the first input at angular frequencies [rad/s]."""
        z = np.exp(1j * self.dt * omega)
        matrices = z[:, None, None] * np.eye(self.a.shape[0]) - self.a
        states = np.linalg.solve(matrices, np.broadcast_to(self.b[:, :1], (z.size, *self.b[:, :1].shape)))
        return np.asarray((self.c[:1] @ states)[:, 0, 0] + self.d[0, 0])

    def tracking(self) -> Tracking:
        """Bandwidth and peak of the first output over the first input of a closed loop."""
        grid = np.geomspace(_LOWEST * self.nyquist, self.nyquist, _GRID)
        gains = np.abs(self.response(grid))
        lost = np.nonzero(gains < math.sqrt(0.5))[0]
        bandwidth = None
        if lost.size and lost[0] > 0:
            edges = float(grid[lost[0] - 1]), float(grid[lost[0]])
            bandwidth = _root(lambda w: np.abs(self.response(w)) - math.sqrt(0.5), *edges) / (2.0 * math.pi)
        return Tracking(bandwidth, float(gains.max()))

    def simulate(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Outputs of shape (samples, outputs) for inputs of shape (samples, inputs), from rest."""
        x = np.zeros(self.a.shape[0])
        y = np.empty((u.shape[0], self.c.shape[0]))
        for k, inputs in enumerate(u):
            y[k] = self.c @ x + self.d @ inputs
            x = self.a @ x + self.b @ inputs
        return y


@dataclass(frozen=True)
class Tracking:
    """Bandwidth and peak of a closed loop."""

    bandwidth: float | None  # -3 dB frequency [Hz]; None: not below half the sampling frequency
    peak: float  # largest gain


@dataclass(frozen=True)
class Margins:
    """Stability margins of the open loop of a stable closed loop; the poles tell whether it is stable.

    A negative phase margin is that of a crossover with a phase lead above 0 degrees, towards +180 degrees.
    """

    crossover: float | None  # frequency at which the gain is 1 [Hz]; None: no crossover
    phase: float | None  # phase margin [degrees]; of several crossovers the one nearest to instability
    gain: float | None  # gain margin as a factor; None: infinite


def _root(f: Callable[[Omega], NDArray[np.float64]], low: float, high: float) -> float:
    """Frequency between `low` and `high` at which `f` changes its sign."""
    for _ in range(_ROUNDS):
        grid = np.geomspace(low, high, _FINER)
        positive = f(grid) > 0.0
        first = int(np.argmax(positive[1:] != positive[0]))  # in the last round, rounding may hide the sign
        low, high = float(grid[first]), float(grid[first + 1])
    return math.sqrt(low * high)


def _changes(grid: Omega, flags: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Pairs of adjacent grid frequencies between which a flag changes."""
    return [(float(grid[k]), float(grid[k + 1])) for k in np.nonzero(flags[:-1] != flags[1:])[0]]


def margins(response: Callable[[Omega], NDArray[np.complex128]], nyquist: float) -> Margins:
    """Margins of a loop with unity feedback.

    Parameters
    ----------
    response : callable
        Open-loop frequency response at angular frequencies [rad/s].
    nyquist : float
        Highest frequency [rad/s].
    """
    grid = np.geomspace(_LOWEST * nyquist, nyquist, _GRID)
    values = response(grid)
    above_one, positive = np.abs(values) > 1.0, np.imag(values) > 0.0
    crossings = [_root(lambda w: np.abs(response(w)) - 1.0, *edges) for edges in _changes(grid, above_one)]
    candidates = [_root(lambda w: np.imag(response(w)), *edges) for edges in _changes(grid, positive)]
    real = [complex(value) for value in response(np.array(candidates)) if value.real < 0.0]
    real.append(complex(values[-1]))  # the response at half the sampling frequency is real
    gains = [1.0 / abs(value) for value in real if -1.0 < value.real < 0.0]
    phases = [
        (math.degrees(cmath.phase(-value)), w)
        for value, w in zip(response(np.array(crossings)), crossings, strict=True)
    ]
    phase, omega = min(phases, key=lambda one: abs(one[0]), default=(None, None))
    crossover = None if omega is None else omega / (2.0 * math.pi)
    return Margins(crossover, phase, min(gains, default=None))


def spectral_radius(a: Matrix) -> float:
    """Largest magnitude of the eigenvalues: a discrete system is stable below 1. Infinite for a non-finite matrix."""
    return float(np.abs(np.linalg.eigvals(a)).max()) if np.isfinite(a).all() else math.inf


@dataclass(frozen=True)
class Pole:
    """Pole of a discrete system, with frequency and damping of the equivalent continuous pole."""

    z: complex  # in the z plane; for a conjugate pair with the positive imaginary part
    frequency: float  # magnitude of ln(z) / Ts over 2 pi [Hz]
    damping: float  # damping ratio of ln(z) / Ts
    pair: bool  # whether it is one of a conjugate pair


def poles(a: Matrix, dt: float) -> tuple[Pole, ...]:
    """Eigenvalues of a discrete system of step `dt` [s], the slowest first; those with abs(z) < 0.02 are omitted."""
    found = [complex(z) for z in np.linalg.eigvals(a)]
    kept = sorted((z for z in found if z.imag >= 0.0 and abs(z) >= 0.02), key=abs, reverse=True)
    return tuple(pole_of(z, dt) for z in kept)


def pole_of(z: complex, dt: float) -> Pole:
    """Return the pole at `z`; `dt` is the sampling time [s]."""
    s = cmath.log(z) / dt
    size = abs(s)
    return Pole(z, size / (2.0 * math.pi), -s.real / size if size > 0.0 else 1.0, z.imag != 0.0)
