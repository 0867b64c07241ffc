"""Steps and moves of a run: where a set-point changes between two rests, and how the shaft follows it.

The telemetry shows whether the position is controlled: otherwise its set-point is the measured position. While it is,
the set-point of the speed is an output of the position controller and no step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_measurement.step_response import StepFigures, measure_step
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.figure import new_figure
from servo_msgs_py.trace import Trace

from servo_twin.runs.curves import TIME, Curves, collected
from servo_twin.runs.recorded import RunError
from servo_twin.view import scene

BAND: Final = 0.02
"""Default of the band that counts as reached: part of the distance, or of the range of a closed path."""

DRAWN_MAX: Final = 12
"""Steps in a picture."""

_REST: Final = 0.1  # of a set-point, between two steps [s]
_GAP: Final = 0.5  # of the telemetry: nothing is measured across it [s]
_HEADS: Final = (
    "step", "axis", "", "at", "from", "to", "set-point", "rise", "settling", "lag", "overshoot", "at end", "rms", "max",
)  # fmt: skip
_UNITS: Final = ("", "", "", "s", "", "", "ms", "ms", "ms", "ms", "", "error", "error", "error")
_MEASURED: Final = tuple(q for q in scene.QUANTITIES if q.name in ("position", "speed"))
_POSITION: Final = _MEASURED[0]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Step:
    """One step or move of an axis."""

    axis: str
    quantity: scene.Quantity
    start: float  # last sample before the set-point changes, board time [s]
    begin: float  # set-point before [SI]
    duration: float  # from then until the set-point rests [s]
    band: float  # half width of the band that counts as reached [SI]
    time: _Array  # samples since `start` [s]
    value: _Array  # measured [SI]
    reference: _Array  # set-point [SI]
    figures: StepFigures  # [SI]


def steps_of(run: Curves, band: float | None = None) -> list[Step]:
    """Steps of all axes in the order of time.

    Parameters
    ----------
    run : Curves
        Run with position, speed and their set-points of at least one axis; these columns are held in memory.
    band : float, optional
        Half width of the band that counts as reached [rad] or [rad/s]; by default `BAND` of each step.

    Raises
    ------
    RunError
        If no axis has the columns.
    """
    names = {axis: _columns(axis) for axis, _ in scene.axes()}
    samples = collected(run, [name for columns in names.values() for name in columns])
    whole = {axis: columns for axis, columns in names.items() if set(columns) <= set(samples.columns)}
    if not whole:
        raise RunError(
            f"{run.path} has no axis with {', '.join(names[0])}; add them to the parameter telemetry of the bridge, "
            "or to the variables of servo-tool record"
        )
    gaps = np.flatnonzero(np.diff(samples[TIME]) > _GAP) + 1
    edges = [0, *gaps.tolist(), len(samples)]
    parts = [samples.samples(a, b) for a, b in pairwise(edges)]
    found = [step for part in parts for axis in whole for step in _steps(part, axis, band)]
    return sorted(found, key=lambda step: (step.start, step.axis))


def table(steps: Sequence[Step]) -> list[list[str]]:
    """Rows for people: heads, units, and a row per step."""
    rows = [list(_HEADS), list(_UNITS)]
    for number, step in enumerate(steps, 1):
        f = step.figures
        times = [step.duration, f.rise_time, f.settling_time, f.lag]
        closed = abs(f.commanded - step.begin) <= step.band  # a path back to its begin
        rows.append(
            [
                str(number),
                step.axis,
                f"{step.quantity.name} [{step.quantity.unit}]",
                f"{step.start:.3f}",
                f"{step.begin:.4g}",
                f"{f.commanded:.4g}",
                *("-" if time is None else f"{1e3 * time:.0f}" for time in times),
                "-" if closed else f"{f.overshoot:.2g}",
                *(f"{error:.2g}" for error in (f.error, f.tracking_rms, f.tracking_max)),
            ]
        )
    return rows


def document(step: Step) -> dict[str, Any]:
    """A step for JSON, SI."""
    return {
        "axis": step.axis,
        "quantity": step.quantity.name,
        "unit": step.quantity.unit,
        "start": step.start,
        "begin": step.begin,
        "duration": step.duration,
        "band": step.band,
        **vars(step.figures),
    }


def picture(steps: Sequence[Step]) -> Any:
    """Figure with the `DRAWN_MAX` longest steps: set-point, measured value, band and settling time."""
    longest = sorted(range(len(steps)), key=lambda k: -steps[k].duration)[:DRAWN_MAX]
    chosen = [(k, steps[k]) for k in sorted(longest)]
    columns = min(len(chosen), 4)
    rows = -(-len(chosen) // columns)
    figure = new_figure(4.5 * columns, 3.2 * rows)
    set_point, measured = (
        tuple(part / 255 for part in scene.COLOURS[source]) for source in (scene.SET_POINT, scene.BOARD)
    )
    plots = figure.subplots(rows, columns, squeeze=False).flat
    for plot, (k, step) in zip(plots, chosen, strict=False):
        target, settling = step.figures.commanded, step.figures.settling_time
        plot.axhspan(target - step.band, target + step.band, color=measured, alpha=0.15)
        plot.plot(step.time, step.reference, color=set_point, label="set-point")
        plot.plot(step.time, step.value, color=measured, label="measured")
        if settling is not None:
            plot.axvline(settling, color=measured, linestyle=":")
            plot.set_xlim(0.0, 1.5 * max(settling, step.duration))
        plot.set_title(f"{k + 1}: {step.axis}, {step.start:.3f} s", fontsize=10)
        plot.set_xlabel("time [s]")
        plot.set_ylabel(f"{step.quantity.title} [{step.quantity.unit}]")
        plot.grid(alpha=0.3)
    for plot in plots:  # the rest of the last row
        plot.set_axis_off()
    figure.axes[0].legend(loc="best")
    return figure


def _columns(axis: int) -> list[str]:
    return [q.column(source, axis) for q in _MEASURED for source in (scene.BOARD, scene.SET_POINT)]


def _steps(samples: Trace, axis: int, band: float | None) -> Iterator[Step]:
    time = samples[TIME]
    position, shaped = (samples[_POSITION.column(source, axis)] for source in (scene.BOARD, scene.SET_POINT))
    controlled = position != shaped
    for quantity in _MEASURED:
        reference = samples[quantity.column(scene.SET_POINT, axis)]
        value = samples[quantity.column(scene.BOARD, axis)]
        for first, last, end in _changes(time, reference):
            if controlled[first + 1 : last + 1].any() != (quantity is _POSITION):
                continue
            span = slice(first, end)
            since = time[span] - time[first]
            width = BAND * float(np.ptp(reference[span])) if band is None else band
            if np.ptp(reference[span]) <= width:
                continue
            figures = measure_step(since, value[span], float(reference[last]), width, reference=reference[span])
            yield Step(
                axis_name(axis),
                quantity,
                float(time[first]),
                float(reference[first]),
                float(time[last] - time[first]),
                width,
                since,
                value[span],
                reference[span],
                figures,
            )


def _changes(time: _Array, reference: _Array) -> Iterator[tuple[int, int, int]]:
    """Samples of every change between two rests: the last before it, the first of the next rest, and its end."""
    moved = np.flatnonzero(np.diff(reference))
    if not moved.size:
        return
    rests = np.flatnonzero(time[moved[1:]] - time[moved[:-1] + 1] >= _REST)
    firsts = moved[np.r_[0, rests + 1]]
    lasts = moved[np.r_[rests, moved.size - 1]] + 1
    ends = np.r_[firsts[1:] + 1, time.size]
    for first, last, end in zip(firsts.tolist(), lasts.tolist(), ends.tolist(), strict=True):
        if first and time[end - 1] - time[last] >= _REST:  # not under way at the begin or the end of the samples
            yield first, last, end
