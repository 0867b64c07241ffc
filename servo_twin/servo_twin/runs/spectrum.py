"""Amplitude spectrum of a variable of a run, and its lines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.figure import new_figure

from servo_twin.runs.curves import TIME, Curves, collected
from servo_twin.runs.recorded import RunError

LINES_MAX: Final = 10
"""Lines of a spectrum that are named."""

_SEGMENT_MAX: Final = 1 << 16  # samples
_SEGMENTS: Final = 4  # whose overlapping halves are averaged, of short recordings fewer samples each
_SAMPLES_MIN: Final = 64
_ABOVE: Final = 4.0  # of a line, over the median of its surroundings; of noise alone one bin in 10^5 is
_AROUND: Final = 31  # bins of the surroundings
_LOBE: Final = 2  # bins on each side of a line: main lobe of the Hann window
_NOISE_BANDWIDTH: Final = 1.5  # of the Hann window [bins]
_STEADY: Final = 0.2  # largest standard deviation of the speed over its mean at which lines have orders

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """A sine in a signal."""

    frequency: float  # [Hz]
    amplitude: float  # unit of the variable
    order: float | None  # periods per turn of the shaft; None: its speed is not constant, or not in the run


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Averaged spectrum; resolution and highest frequency follow from length and sampling of the run."""

    variable: str
    frequency: _Array  # (bins,) [Hz]
    amplitude: _Array  # (bins,) of a sine at that frequency; unit of the variable
    lines: tuple[Line, ...]  # the largest first


def spectrum_of(run: Curves, variable: str, start: float | None = None, end: float | None = None) -> Spectrum:
    """Spectrum of a variable between two board times [s], by default of the whole run.

    The samples of telemetry are not equidistant; they are interpolated at their mean interval. Motion faster than half
    their rate appears at a wrong frequency: record faster with ``servo-tool record``.

    Raises
    ------
    RunError
        If the run does not have the variable, too few samples of it, or it is constant.
    """
    speed = f"{variable.rpartition('.')[0]}.speed"
    samples = collected(run, [variable, speed])
    if variable not in samples.columns:
        known = ", ".join(sorted(name for name in collected(run, None).columns if name != TIME)[:40])
        raise RunError(f"{run.path} has no variable {variable}; it has {known}")
    bounds = -math.inf if start is None else start, math.inf if end is None else end
    samples = samples.samples(*np.searchsorted(samples[TIME], bounds).tolist())
    time, values = samples[TIME], samples[variable]
    if len(time) < _SAMPLES_MIN:
        raise RunError(f"{run.path} has {len(time)} samples of {variable} in this time; {_SAMPLES_MIN} are needed")
    if np.nanmin(values) == np.nanmax(values):
        raise RunError(f"{run.path}: {variable} is constant in this time; choose a time with motion")
    speeds = samples.columns.get(speed)
    frequency, amplitude = _averaged(time, values)
    return Spectrum(variable, frequency, amplitude, _lines(frequency, amplitude, _turns(speeds)))


def table(spectrum: Spectrum, unit: str) -> list[list[str]]:
    """Rows for people: heads, and a row per line."""
    rows = [["frequency [Hz]", f"amplitude [{unit}]", "per turn"]]
    rows += [
        [f"{line.frequency:.4g}", f"{line.amplitude:.3g}", "-" if line.order is None else f"{line.order:.2f}"]
        for line in spectrum.lines
    ]
    return rows


def picture(spectrum: Spectrum, unit: str) -> Any:
    """Figure of the spectrum with its lines."""
    figure = new_figure(10.0, 5.0)
    plot = figure.subplots()
    plot.loglog(spectrum.frequency[1:], spectrum.amplitude[1:], linewidth=0.8)
    for line in spectrum.lines:
        plot.annotate(f"{line.frequency:.4g} Hz", (line.frequency, line.amplitude), fontsize=8, ha="center")
    plot.set_xlabel("frequency [Hz]")
    plot.set_ylabel(f"amplitude of {spectrum.variable} [{unit}]")
    plot.grid(which="both", alpha=0.3)
    return figure


def _averaged(time: _Array, values: _Array) -> tuple[_Array, _Array]:
    """Frequencies [Hz] and amplitudes, (bins,), by Welch's method with a Hann window."""
    from scipy import signal  # takes longer to import than all the rest of ``servo-twin``

    shown = np.isfinite(values)
    grid = np.linspace(time[0], time[-1], len(time))
    even = np.interp(grid, time[shown], values[shown])
    segment = min(2 * len(grid) // (_SEGMENTS + 1), _SEGMENT_MAX)
    rate = (len(time) - 1) / (time[-1] - time[0])
    frequency, power = signal.welch(even, rate, "hann", segment, scaling="spectrum")
    return frequency, np.sqrt(2.0 * power)


def _lines(frequency: _Array, amplitude: _Array, turns: float | None) -> tuple[Line, ...]:
    """Peaks that stand out of their surroundings; `turns` per second, None: not constant."""
    from scipy import signal

    around = signal.medfilt(amplitude, min(_AROUND, (len(amplitude) - 1) | 1))
    peaks, _ = signal.find_peaks(amplitude, height=_ABOVE * around, distance=_LOBE)
    found = []
    for k in peaks[peaks > _LOBE]:
        lobe = slice(k - _LOBE, k + _LOBE + 1)
        power = amplitude[lobe] ** 2  # a line between two bins is spread over the main lobe
        at = float(np.average(frequency[lobe], weights=power))
        size = math.sqrt(float(np.sum(power)) / _NOISE_BANDWIDTH)
        found.append(Line(at, size, None if turns is None else at / turns))
    return tuple(sorted(found, key=lambda line: -line.amplitude)[:LINES_MAX])


def _turns(speeds: _Array | None) -> float | None:
    """Turns of the shaft per second; None: at rest, or not constant."""
    if speeds is None:
        return None
    mean = float(np.mean(speeds))
    steady = mean != 0.0 and float(np.std(speeds)) <= _STEADY * abs(mean)
    return abs(mean) / (2.0 * math.pi) if steady else None
