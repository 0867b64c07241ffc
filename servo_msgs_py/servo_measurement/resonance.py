"""Motor and load on a spring, from the measured open speed loop.

A load on a spring makes the tuned loops oscillate, so the loop is measured with a part of its gains. The open loop of
the tuning model (controller, current loop, speed measurement, two masses) is fitted to the measured one by least
squares of the complex logarithm: gain and phase count alike, relative to their uncertainty (Pintelon and Schoukens,
System Identification, 2nd ed., 8.3).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.table_text import aligned
from servo_tuning.motor import Load
from servo_tuning.robust import ShaftModel

from servo_measurement.access import BoardAccess, MeasurementError
from servo_measurement.bode import measure as measure_open_loop
from servo_measurement.bode_plan import GAIN_MIN, BodeRequest
from servo_measurement.frequency_response import Response
from servo_measurement.least_squares import Floats, fit_nonlinear
from servo_measurement.prediction import Prediction, predict

BANDWIDTH: Final = 9.4
"""Bandwidth of the speed loop during the measurement [Hz]: far below that of a resonance."""

CHANGE: Final = 1.2
"""Factor by which the frequency of a resonance may change after the measurement: with the pose, load or temperature."""

DAMPING_EXCESS: Final = 0.003
"""Largest measured damping minus the true one, over the ratio of load to motor.

Measured on virtual boards for resonances of 80 to 300 Hz, ratios 0.5 to 8 and damping 1 to 5 %."""

DAMPING_FACTOR: Final = 3.0
"""Largest measured damping over the true one, on the same boards."""

GROUPS: Final = 160
"""Groups of frequencies per decade: a resonance with 1 % damping is wider."""

_F_MIN, _F_MAX = 15.0, 790.0  # band [Hz]
_MODEL_ERROR: Final = 0.02  # relative, of the open loop of the tuning model
_POINTS_MIN: Final = 20
_CONFIDENCE: Final = 2.0  # standard deviations: 95 %
_PARTS: Final = (0.1, 0.3, 0.5, 0.75, 0.9)  # load inertia over the whole inertia: starts of the fit
_START_DAMPING: Final = 0.05
_DAMPING_MIN: Final = 1e-4
_START_FREQUENCIES: Final = 24
_STARTS: Final = 3  # fits
_UNEXPLAINED: Final = 0.5
"""Largest squared error with a load, over that of a rigid shaft. A load of 5 % of the inertia leaves less than 0.1;
of a shaft without load 0.67 or more remain."""

_PART_MIN: Final = 0.02  # of the inertia at each end of the spring
_BOUND: Final = 30.0  # of the parameters, which are logarithms
_LARGER: Final = "raise param.i_q_limit, --speed or --range, which permit a larger test signal"


@dataclass(frozen=True)
class ResonanceRequest:
    """Specification of a measurement."""

    axis: int  # index
    speed: float | None = None  # of the shaft [rad/s]; None: as of `BodeRequest`
    travel_max: float = math.inf  # largest rotation of the shaft in each direction [rad]
    gain: float | None = None  # part of the bandwidths during the measurement; None: for `BANDWIDTH`


@dataclass(frozen=True)
class Value:
    """A measured value above 0."""

    name: str
    unit: str
    value: float
    relative: float  # 95 % interval, over the value

    def cells(self) -> list[str]:
        """Row of a table."""
        return [self.name, f"{self.value:.4g} {self.unit}".rstrip(), f"+- {100.0 * self.relative:.2g} %"]


@dataclass(frozen=True)
class Shaft:
    """A fitted shaft.

    The parameters are the logarithms of the whole inertia and, with a spring, of the ratio of load to motor, of the
    frequency of the resonance and of its damping.
    """

    parameters: Floats  # (1,) or (4,)
    covariance: Floats  # (p, p)
    at_half: Floats  # (p,), parameters from the measurement with half the amplitude
    squares: float  # sum of the squared weighted residuals

    @property
    def inertia(self) -> float:
        """Inertia of the whole shaft [kg m^2]."""
        return _inertia(self.parameters)

    @property
    def load(self) -> Load | None:
        """Load behind the spring; None: a rigid shaft."""
        return _load(self.parameters) if self.parameters.size > 1 else None

    @property
    def model(self) -> ShaftModel:
        """The shaft for the design of the loops."""
        return _model(self.parameters)

    @property
    def possible(self) -> list[ShaftModel]:
        """Shafts at the ends of each interval by itself, and with a resonance that has changed by `CHANGE`.

        The damping is the lowest possible one: the fit finds more than there is.
        """
        x = self.parameters.copy()
        deviation = _CONFIDENCE * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        if x.size > 1:
            damping = _damping(x)
            lowest = max(damping - DAMPING_EXCESS * math.exp(x[1]), damping / DAMPING_FACTOR)
            x[3] = math.log(lowest) - deviation[3]
        deviation = np.maximum(np.maximum(deviation, np.abs(self.at_half - self.parameters)), math.log1p(_MODEL_ERROR))
        if x.size > 1:
            deviation[2] = max(deviation[2], math.log(CHANGE))
        ends = [x + sign * deviation * row for row in np.eye(x.size)[:3] for sign in (-1.0, 1.0)]
        return [_model(one) for one in (x, *ends)]

    def values(self) -> Iterator[Value]:
        """Figures of the shaft with their 95 % intervals."""
        yield self._value("inertia of the shaft", "kg m^2", _inertia)
        if self.load is None:
            return
        yield self._value("load behind a spring", "kg m^2", lambda x: _load(x).inertia)
        yield self._value("load over motor", "", lambda x: math.exp(x[1]))
        yield self._value("stiffness", "N m/rad", lambda x: _load(x).stiffness)
        yield self._value("resonance", "Hz", lambda x: math.exp(x[2]))
        yield self._value("antiresonance", "Hz", lambda x: math.exp(x[2]) / math.sqrt(1.0 + math.exp(x[1])))
        yield self._value("damping of the resonance", "", _damping)

    def _value(self, name: str, unit: str, of: Callable[[Floats], float]) -> Value:
        """A function of the parameters; its uncertainty by linear propagation."""
        value, step = of(self.parameters), 1e-4
        slope = (
            np.array([of(self.parameters + step * row) / value - 1.0 for row in np.eye(self.parameters.size)]) / step
        )
        scatter = _CONFIDENCE * math.sqrt(max(float(slope @ self.covariance @ slope), 0.0))
        return Value(name, unit, value, max(scatter, abs(of(self.at_half) / value - 1.0)))


def _inertia(x: Floats) -> float:
    return math.exp(x[0])


def _load(x: Floats) -> Load:
    inertia, ratio = math.exp(x[0]), math.exp(x[1])
    part = ratio / (1.0 + ratio)
    reduced = inertia * part / (1.0 + ratio)
    return Load(part * inertia, (2.0 * math.pi * math.exp(x[2])) ** 2 * reduced, _damping(x))


def _damping(x: Floats) -> float:
    return max(math.exp(x[3]), _DAMPING_MIN)


def _model(x: Floats) -> ShaftModel:
    return ShaftModel(_inertia(x), _load(x) if x.size > 1 else None)


@dataclass(frozen=True)
class Resonance:
    """Result of a measurement."""

    axis: int  # index
    band: tuple[float, float]  # of the valid points [Hz]
    shaft: Shaft
    nominal: float  # inertia of the configuration [kg m^2]

    def text(self) -> str:
        """Table of the figures."""
        low, high = self.band
        head = f"{axis_name(self.axis)}, {low:.3g} .. {high:.3g} Hz, +- is for 95 %"
        rows = [f"  {line}" for line in aligned([value.cells() for value in self.shaft.values()])]
        if self.shaft.load is None:
            rows.append("  the shaft is rigid: no significant resonance of a load in this band")
        (inertia, *_) = self.shaft.values()
        if abs(self.nominal / inertia.value - 1.0) > max(inertia.relative, _MODEL_ERROR):
            rows.append(f"  motor.inertia of the configuration is {self.nominal:.4g}: write {inertia.value:.4g}")
        return "\n".join([head, *rows])

    def toml(self) -> str:
        """The group of ``servo.toml``."""
        load = self.shaft.load
        if load is None:
            return ""
        rows = {"inertia": load.inertia, "stiffness": load.stiffness, "damping": load.damping}
        lines = "".join(f"{key} = {value:.4g}\n" for key, value in rows.items())
        name, whole = axis_name(self.axis), self.shaft.inertia
        return f"# write inertia = {whole:.4g} in [{name}.motor]: this load is a part of it\n[{name}.load]\n{lines}"

    def as_dict(self) -> dict[str, object]:
        """The figures for JSON."""
        rows = [
            {"name": one.name, "unit": one.unit, "value": one.value, "interval": one.relative * one.value}
            for one in self.shaft.values()
        ]
        return {
            "axis": axis_name(self.axis),
            "band": list(self.band),
            "rigid": self.shaft.load is None,
            "configured inertia": self.nominal,
            "values": rows,
        }


def measure(
    access: BoardAccess,
    request: ResonanceRequest,
    *,
    enable: bool = False,
    report: Callable[[str], None] = lambda _: None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Resonance:
    """Measure motor and load of an axis; arguments as of `bode.measure`.

    The speed is that of the M/T method meanwhile: the observer does not know the load.

    Raises
    ------
    MeasurementError
        If the measurement is not possible.
    """
    bode = measure_open_loop(
        access,
        BodeRequest(
            request.axis,
            "speed",
            f_min=_F_MIN,
            f_max=_F_MAX,
            speed=request.speed,
            travel_max=request.travel_max,
            gain=_gain(access, request),
            groups=GROUPS,
            half=True,
            observed=False,
        ),
        enable=enable,
        report=report,
        progress=progress,
    )
    assert bode.half is not None
    shaft = fitted(bode.prediction, bode.response, bode.half)
    frequency = bode.response.frequency[bode.response.good]
    return Resonance(
        request.axis, (float(frequency[0]), float(frequency[-1])), shaft, bode.prediction.loops.motor.inertia
    )


def _gain(access: BoardAccess, request: ResonanceRequest) -> float:
    """Part of the bandwidths during the measurement."""
    if request.gain is not None:
        return request.gain
    bandwidth = predict(access, request.axis, "speed", 0.0, observed=False).loops.speed_bandwidth
    return min(max(BANDWIDTH / bandwidth, GAIN_MIN), 1.0)


# ---- fit ------------------------------------------------------------------------------------------------------------


def fitted(prediction: Prediction, response: Response, half: Response | None = None) -> Shaft:
    """Shaft whose open speed loop fits a measured one best: rigid, unless a load behind a spring is significant.

    Parameters
    ----------
    prediction : Prediction
        Model of the loop with the configuration of the axis.
    response : Response
        The measured open loop.
    half : Response, optional
        With half the amplitude: the change is an estimate of the remaining error.

    Raises
    ------
    MeasurementError
        If too few points are valid, or the shaft differs at half the amplitude.
    """
    if any(int(part.good.sum()) < _POINTS_MIN for part in (response, half) if part is not None):
        raise MeasurementError(f"too few frequencies have a sufficient coherence: {_LARGER}")
    residual = _residual(prediction, response)
    nominal = math.log(prediction.loops.motor.inertia)
    rigid = _fit(residual, np.array([nominal]))
    fits = [_fit(residual, start) for start in _starts(residual, nominal, response.frequency[response.good])]
    sprung = min((fit for fit in fits if math.isfinite(fit.squares)), key=lambda fit: fit.squares, default=rigid)
    shaft = sprung if _is_significant(rigid, sprung) else rigid
    if half is None:
        return shaft
    again = _fit(_residual(prediction, half), shaft.parameters)
    if not math.isfinite(again.squares):
        raise MeasurementError(f"the shaft differs at half the amplitude of the test signal: {_LARGER}")
    return replace(shaft, at_half=again.parameters)


def _residual(prediction: Prediction, response: Response) -> Callable[[Floats], Floats]:
    """Weighted differences of the complex logarithm as a function of the parameters."""
    good = response.good
    omega, measured = 2.0 * math.pi * response.frequency[good], response.value[good]
    weight = 1.0 / np.hypot(response.sigma[good], _MODEL_ERROR)

    def residual(x: Floats) -> Floats:
        with np.errstate(all="ignore"):  # far from the solution
            error = np.log(_open(prediction, x, omega) / measured) * weight
        return np.concatenate([error.real, error.imag])

    return residual


def _open(prediction: Prediction, x: Floats, omega: Floats) -> NDArray[np.complex128]:
    """Open speed loop of a shaft with these parameters."""
    x = np.clip(x, -_BOUND, _BOUND)
    return _model(x).within(prediction.shaft).speed_open(omega, prediction.delay)


def _fit(residual: Callable[[Floats], Floats], start: Floats) -> Shaft:
    try:
        x, covariance = fit_nonlinear(residual, start, np.ones_like(start))
        remaining = residual(x)
    except (np.linalg.LinAlgError, OverflowError):
        return Shaft(start, np.full((start.size, start.size), math.inf), start, math.inf)
    return Shaft(x, covariance, x, float(remaining @ remaining))


def _starts(residual: Callable[[Floats], Floats], nominal: float, frequency: Floats) -> list[Floats]:
    """The best points of a grid; the inertia is the one that fits the gain."""
    grid = []
    for resonance, part in itertools.product(np.geomspace(frequency[0], frequency[-1], _START_FREQUENCIES), _PARTS):
        x = np.array([nominal, math.log(part / (1.0 - part)), math.log(resonance), math.log(_START_DAMPING)])
        errors = residual(x)
        squares = float(errors @ errors)
        if math.isfinite(squares):
            grid.append((squares, x))
    grid.sort(key=lambda one: one[0])
    return [x for _, x in grid[:_STARTS]]


def _is_significant(rigid: Shaft, sprung: Shaft) -> bool:
    """Whether a load explains most of what a rigid shaft leaves, which is scatter and the error of the loop's model."""
    if sprung.load is None or sprung.squares > _UNEXPLAINED * rigid.squares:
        return False
    part = sprung.load.inertia / sprung.inertia
    return _PART_MIN < part < 1.0 - _PART_MIN
