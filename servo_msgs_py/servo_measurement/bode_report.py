"""Output of a measurement: text, JSON, table, picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.table_text import aligned

from servo_measurement.bode import Bode
from servo_measurement.frequency_response import Measured, Response

COLUMNS: Final = (
    "frequency [Hz]",
    "gain [dB]",
    "phase [degrees]",
    "sigma [dB]",
    "sigma [degrees]",
    "coherence",
    "predicted gain [dB]",
    "predicted phase [degrees]",
)
"""Column names of `rows`."""

_CONFIDENCE: Final = 2.0  # standard deviations: 95 %
_DECIBELS: Final = 20.0 / np.log(10.0)


def predicted_curve(bode: Bode) -> Response:
    """Prediction at the measured frequencies."""
    f = bode.response.frequency
    return Response(f, bode.prediction.response(f), np.zeros_like(f), np.ones_like(f))


def rows(bode: Bode) -> NDArray[np.float64]:
    """The measured points, shape (points, columns); see `COLUMNS`."""
    response, predicted = bode.response, predicted_curve(bode)
    columns = (
        response.frequency,
        response.decibels,
        _aligned(response.degrees, predicted.degrees, response.good),
        _DECIBELS * response.sigma,
        np.degrees(response.sigma),
        response.coherence,
        predicted.decibels,
        predicted.degrees,
    )
    return np.column_stack(columns)


def _aligned(degrees: NDArray[np.float64], to: NDArray[np.float64], good: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Phase unwrapping: add multiples of 360 degrees so that both curves agree on average at the valid points."""
    if not good.any():
        return degrees
    return np.asarray(degrees - 360.0 * np.round(np.median((degrees - to)[good]) / 360.0))


def _comparison(bode: Bode) -> list[tuple[str, str, Measured | None, float | None]]:
    """Name, unit, measured and predicted value of each figure."""
    measured, predicted = bode.figures, bode.prediction.margins
    return [
        ("crossover", "Hz", measured.crossover, predicted.crossover),
        ("phase margin", "degrees", measured.phase_margin, predicted.phase),
        ("gain margin", "", measured.gain_margin, predicted.gain),
    ]


def text(bode: Bode) -> str:
    """Figures and their predictions as text."""
    return "\n".join(_lines(bode)) + "\n"


def _lines(bode: Bode) -> Iterator[str]:
    settings = bode.settings
    motion = f" at {settings.speed:.4g} rad/s" if settings.speed else ""
    motion += f", {settings.gain:.3g} of its bandwidth" if settings.gain != 1.0 else ""
    yield (
        f"{axis_name(settings.axis)}, {settings.loop.name} loop{motion}: {settings.repeats} sweeps of "
        f"{settings.amplitude:.3g} {settings.loop.unit}, {settings.f_min:.3g} .. {settings.f_max:.3g} Hz"
    )
    cells = []
    for name, unit, measured, predicted in _comparison(bode):
        found = "not determined"
        if measured is not None:
            found = f"{measured.value:.4g}{_uncertainty(measured)} {unit}"
        expected = "none" if predicted is None else f"{predicted:.4g} {unit}"
        cells.append([name, found.rstrip(), f"predicted {expected.rstrip()}", _difference(unit, measured, predicted)])
    for resonance in bode.figures.resonances:
        kind = "resonance" if resonance.height > 0.0 else "antiresonance"
        cells.append([kind, f"{resonance.frequency:.4g} Hz, {resonance.height:+.1f} dB", "", ""])
    yield from (f"  {line}" for line in aligned(cells))
    good = int(bode.response.good.sum())
    points = f"{good} of {bode.response.good.size} points have a sufficient coherence"
    yield f"  {points}; +-: 95 % confidence" if bode.confirmed else f"  {points}"
    if bode.figures.crossover is not None and not bode.confirmed:
        yield "  not confirmed: the figures depend on the amplitude, their uncertainty is unknown"
    yield from (f"  not determined: {why}" for why in bode.figures.undetermined)
    yield from (f"  note: {note}" for note in bode.notes)


def _uncertainty(measured: Measured) -> str:
    return f" +- {_CONFIDENCE * measured.sigma:.2g}" if np.isfinite(measured.sigma) else ""


def _difference(unit: str, measured: Measured | None, predicted: float | None) -> str:
    if measured is None or predicted is None:
        return ""
    if unit == "degrees":
        return f"{measured.value - predicted:+.2f} degrees"
    return f"{100.0 * (measured.value / predicted - 1.0):+.2f} %"


def as_dict(bode: Bode) -> dict[str, Any]:
    """All results as numbers: SI, frequencies in Hz, phases in degrees, gain margins as factors."""
    settings, predicted = bode.settings, bode.prediction.margins
    return {
        "axis": axis_name(settings.axis),
        "loop": settings.loop.name,
        "speed": settings.speed,
        "amplitude": settings.amplitude,
        "band": [settings.f_min, settings.f_max],
        "repeats": settings.repeats,
        "gain": settings.gain,
        "measured": {name: _plain(measured) for name, _, measured, _ in _comparison(bode)},
        "predicted": {"crossover": predicted.crossover, "phase margin": predicted.phase, "gain margin": predicted.gain},
        "resonances": [{"frequency": r.frequency, "height": r.height} for r in bode.figures.resonances],
        "confirmed": bode.confirmed,
        "not determined": list(bode.figures.undetermined),
        "notes": list(bode.notes),
        "points": [dict(zip(COLUMNS, _finite(row), strict=True)) for row in rows(bode).tolist()],
    }


def _plain(measured: Measured | None) -> dict[str, float | None] | None:
    if measured is None:
        return None
    return {"value": measured.value, "sigma": measured.sigma if np.isfinite(measured.sigma) else None}


def _finite(row: list[float]) -> list[float | None]:
    """Replace values that JSON cannot represent by None."""
    return [value if np.isfinite(value) else None for value in row]


def draw(bode: Bode, path: Path) -> None:
    """Plot gain, phase and coherence over frequency, with the prediction and 95 % confidence."""
    figure = new_figure(8.0, 8.0)
    table, good = rows(bode), bode.response.good
    gain, phase, coherence = figure.subplots(3, 1, sharex=True, height_ratios=[3, 3, 1])
    for plot, column, deviation in ((gain, 1, 3), (phase, 2, 4)):
        f, value, sigma = (table[good, k] for k in (0, column, deviation))
        plot.semilogx(table[:, 0], table[:, column + 5], color="C1", linewidth=1.2, label="predicted (make tune)")
        plot.semilogx(f, value, ".", color="C0", markersize=3, label="measured")
        band = _CONFIDENCE * sigma
        plot.fill_between(f, value - band, value + band, color="C0", alpha=0.25, linewidth=0, label="95 %")
        plot.grid(alpha=0.3, which="both")
        plot.legend(fontsize="x-small")
    gain.set_ylabel("gain [dB]")
    gain.axhline(0.0, color="black", linewidth=0.6)
    phase.set_ylabel("phase [degrees]")
    phase.axhline(-180.0, color="black", linewidth=0.6)
    if bode.figures.crossover is not None:
        for plot in (gain, phase):
            plot.axvline(bode.figures.crossover.value, color="C0", linewidth=0.8, linestyle="--")
    coherence.semilogx(table[:, 0], table[:, 5], color="C2", linewidth=0.9)
    coherence.set_ylim(0.0, 1.05)
    coherence.set_ylabel("coherence")
    frequency_axis(coherence)
    coherence.grid(alpha=0.3, which="both")
    gain.set_title("\n".join(line.strip() for line in list(_lines(bode))[:3]), fontsize="small", loc="left")
    write_figure(figure, path)


def frequency_axis(plot: Any) -> None:
    """Label the horizontal axis of a plot over the logarithm of the frequency [Hz]."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    plot.set_xlabel("frequency [Hz]")
    plot.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    plot.xaxis.set_major_formatter(FuncFormatter(lambda hertz, _: f"{hertz:g}"))
    plot.xaxis.set_minor_formatter(NullFormatter())
