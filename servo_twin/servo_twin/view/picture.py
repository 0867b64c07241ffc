"""Picture of a recording: position and speed of both axes with set-point, board and twin, and the residual.

If the axes have followed a path, a further column shows the last one: one axis over the other, and the position errors.

Run as ``python -m servo_twin.view.picture RECORDING PICTURE``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.figure import PictureError, new_figure, write_figure
from servo_msgs_py.rerun_file import RecordingError
from servo_msgs_py.units import COUNTS_PER_TURN

from servo_msgs_py import argument
from servo_twin.view import scene
from servo_twin.view.recording import read_scalars, read_texts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Curve = tuple[NDArray[np.float64], NDArray[np.float64]]

_SIZE: Final = (16.0, 10.0)  # [inch]
_PATH_WIDTH: Final = 6.5  # width of the column with the path [inch]
_DPI: Final = 100
_MARGIN: Final = 0.5  # displayed before the first and after the last movement [s]
_MOVING: Final = 0.5  # speed above which a shaft moves [rad/s]
_TURN: Final = 2.0 * np.pi
_DARK: Final = "#2b2f36"
_PALE: Final = "#7fb2ec"  # second axis, if the first has the colour of the board
_FAINT: Final = "#e4e7ec"


@dataclass(frozen=True)
class _Row:
    """One row of plots."""

    quantity: str
    label: str
    factor: float  # of the plotted unit per SI unit


_ROWS: Final = (
    _Row("position", "position [turns]", 1.0 / _TURN),
    _Row("speed", "speed [rad/s]", 1.0),
)
_RESIDUAL: Final = "board − twin [counts]"
_LABELS: Final = {scene.SET_POINT: "set-point", scene.BOARD: "board", scene.TWIN: "twin"}
# The curves of twin and board coincide: the twin is a thin dashed line on top.
_STYLES: Final[dict[str, dict[str, Any]]] = {
    scene.SET_POINT: {"linewidth": 4.5, "alpha": 0.55, "zorder": 2},
    scene.BOARD: {"linewidth": 2.0, "zorder": 3},
    scene.TWIN: {"linewidth": 1.3, "linestyle": (0, (4, 3)), "zorder": 4},
}


def draw(rrd: Path, png: Path) -> None:
    """Draw a recording.

    Parameters
    ----------
    rrd : Path
        Recording of `servo_twin.viewer_node`.
    png : Path
        Picture to write; its folder is created.

    Raises
    ------
    RecordingError
        If the file cannot be read or contains no telemetry.
    PictureError
        If matplotlib is not installed.
    OSError
        If the picture cannot be written.
    """
    write_figure(figure(rrd), png)


def figure(rrd: Path) -> Figure:
    """Figure of a recording: a column per axis with position, speed and residual; see `draw`."""
    if not rrd.is_file():
        raise RecordingError(f"no such recording: {rrd}")
    curves = {
        (axis, row.quantity, source): read_scalars(rrd, scene.series_entity(axis, row.quantity, source))
        for axis, _ in scene.axes()
        for row in _ROWS
        for source in _LABELS
    }
    residuals = [read_scalars(rrd, scene.residual_entity(axis, "position")) for axis, _ in scene.axes()]
    if not any(len(curves[axis, "position", scene.BOARD][0]) for axis, _ in scene.axes()):
        raise RecordingError(f"{rrd} contains no telemetry of a board: record with a connected bridge")
    speeds = [curves[axis, "speed", scene.BOARD] for axis, _ in scene.axes()]
    states = [read_texts(rrd, scene.state_entity(name), "StateChange:state") for _, name in scene.axes()]
    spans = _path_spans(read_texts(rrd, scene.state_entity("path"), "StateChange:state"))
    return _figure(curves, residuals, states, _span(speeds), spans[-1] if spans else None)


def _path_spans(states: Sequence[tuple[float, str]]) -> list[tuple[float, float]]:
    """Start and end of every path [s]."""
    ends = [time for time, _ in states[1:]] + [np.inf]
    return [(time, end) for (time, state), end in zip(states, ends, strict=True) if state == scene.PATH_STATES[1]]


def _span(speeds: Sequence[_Curve]) -> tuple[float, float]:
    """From the first to the last movement, with a margin; the whole recording without movement."""
    times = np.concatenate([time for time, _ in speeds])
    moving = np.concatenate([time[np.abs(np.nan_to_num(speed)) > _MOVING] for time, speed in speeds])
    first, last = float(times.min()), float(times.max())
    if len(moving):
        first, last = max(first, float(moving.min()) - _MARGIN), min(last, float(moving.max()) + _MARGIN)
    return first, max(last, first + 1e-3)


def _figure(
    curves: dict[tuple[int, str, str], _Curve],
    residuals: Sequence[_Curve],
    states: Sequence[list[tuple[float, str]]],
    span: tuple[float, float],
    path_span: tuple[float, float] | None,
) -> Figure:
    width, height = _SIZE
    path_width = _PATH_WIDTH if path_span is not None else 0.0
    result: Figure = new_figure(width + path_width, height, _DPI)
    result.set_layout_engine("constrained", w_pad=0.12, h_pad=0.08)
    widths = [width / len(residuals)] * len(residuals) + ([path_width] if path_width else [])
    grid = result.add_gridspec(len(_ROWS) + 1, len(widths), height_ratios=[3, 3, 2], width_ratios=widths)
    plots = np.empty((len(_ROWS) + 1, len(residuals)), dtype=object)
    for row, axis in np.ndindex(*plots.shape):
        plots[row, axis] = result.add_subplot(grid[row, axis], sharex=plots[0, 0])
        plots[row, axis].tick_params(labelbottom=row == len(_ROWS))
    if path_span is not None:
        _path(result.add_subplot(grid[:-1, -1]), result.add_subplot(grid[-1, -1]), curves, path_span)
    for axis, name in scene.axes():
        column: list[Axes] = list(plots[:, axis])
        column[0].set_title(name, fontsize=15, fontweight="bold", color=_DARK, loc="left")
        for plot, row in zip(column, _ROWS, strict=False):
            for source in _LABELS:
                time, value = curves[axis, row.quantity, source]
                if len(time):
                    colour = _colour(source)
                    plot.plot(time, value * row.factor, color=colour, label=_LABELS[source], **_STYLES[source])
        _residual(column[-1], residuals[axis], span)
        for plot, label in zip(column, [*(row.label for row in _ROWS), _RESIDUAL], strict=True):
            _format(plot, label if axis == 0 else "")
            _shade(plot, states[axis], span)
            _fit(plot, span)
        column[-1].set_xlabel("board time [s]", color=_DARK, fontsize=11)
    result.suptitle("Two axes: the board and its twin", x=0.01, ha="left", fontsize=18, color=_DARK)
    handles, labels = plots[0, 0].get_legend_handles_labels()
    result.legend(handles, labels, loc="outside upper right", ncols=len(labels), frameon=False, fontsize=13)
    return result


def _path(plane: Axes, error: Axes, curves: dict[tuple[int, str, str], _Curve], span: tuple[float, float]) -> None:
    """One axis over the other along a path, and below it the position errors."""
    names = [name for _, name in scene.axes()]
    time = curves[0, "position", scene.BOARD][0]
    time = time[(time >= span[0]) & (time <= span[1])]
    positions = {
        source: [np.interp(time, *curves[axis, "position", source]) for axis, _ in scene.axes()]
        for source in (scene.SET_POINT, scene.BOARD)
        if all(len(curves[axis, "position", source][0]) for axis, _ in scene.axes())
    }
    for source, values in positions.items():
        plane.plot(*(value / _TURN for value in values), color=_colour(source), **_STYLES[source])
    plane.set_aspect("equal", adjustable="datalim")
    plane.set_title(
        f"path: {names[1]} over {names[0]} [turns]", fontsize=15, fontweight="bold", color=_DARK, loc="left"
    )
    _format(plane, "")
    _format(error, "board − set-point [counts]")
    error.set_xlabel("board time [s]", color=_DARK, fontsize=11)
    if scene.SET_POINT in positions:
        errors = np.subtract(positions[scene.BOARD], positions[scene.SET_POINT]) * (COUNTS_PER_TURN / _TURN)
        for values, name, colour in zip(errors, names, (_colour(scene.BOARD), _PALE), strict=True):
            error.plot(time, values, color=colour, linewidth=1.5, label=name)
        error.margins(y=0.2)  # space for the legend
        error.legend(loc="upper left", ncols=len(names), frameon=False, fontsize=10)
        error.set_title(f"largest {np.abs(errors).max():.1f} counts", loc="right", fontsize=10, color=_DARK)


def _residual(plot: Axes, curve: _Curve, span: tuple[float, float]) -> None:
    time, value = curve
    if not len(time):
        plot.text(0.5, 0.5, "no twin", transform=plot.transAxes, ha="center", va="center", color="#8a909a", fontsize=13)
        return
    counts = value * (COUNTS_PER_TURN / _TURN)
    plot.plot(time, counts, color=_colour(scene.RESIDUAL), linewidth=1.5, zorder=3)
    in_span = counts[(time >= span[0]) & (time <= span[1]) & np.isfinite(counts)]
    if len(in_span):
        text = f"largest {np.abs(in_span).max():.1f} counts, rms {np.sqrt(np.mean(in_span**2)):.2f}"
        plot.set_title(text, loc="right", fontsize=10, color=_colour(scene.RESIDUAL))


def _format(plot: Axes, label: str) -> None:
    plot.set_ylabel(label, color=_DARK, fontsize=11)
    plot.grid(color=_FAINT, linewidth=0.8)
    plot.set_axisbelow(True)
    plot.tick_params(colors=_DARK, labelsize=10)
    for side, spine in plot.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color("#b8bec8")


def _shade(plot: Axes, states: list[tuple[float, str]], span: tuple[float, float]) -> None:
    """Shade the times without closed-loop control: faults red, other states except RUN/SPIN grey."""
    ends = [time for time, _ in states[1:]] + [np.inf]
    for (begin, state), end in zip(states, ends, strict=True):
        begin, end = max(begin, span[0]), min(end, span[1])
        if state != "RUN/SPIN" and begin < end:
            colour = _colour_of(scene.STATE_COLOURS["FAULT"]) if state == "FAULT" else "#8a909a"
            plot.axvspan(begin, end, color=colour, alpha=0.12, linewidth=0, zorder=0)


def _fit(plot: Axes, span: tuple[float, float]) -> None:
    """Set the limits of the plot to the span and the values in it."""
    plot.set_xlim(*span)
    in_span = [np.empty(0)]
    for line in plot.lines:
        time, value = (np.asarray(data, dtype=np.float64) for data in line.get_data())
        in_span.append(value[(time >= span[0]) & (time <= span[1]) & np.isfinite(value)])
    values = np.concatenate(in_span)
    if len(values):
        low, high = float(values.min()), float(values.max())
        margin = 0.06 * (high - low) or 1.0
        plot.set_ylim(low - margin, high + margin)


def _colour(source: str) -> str:
    return _colour_of(scene.COLOURS[source])


def _colour_of(colour: scene.Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def main(argv: Sequence[str] | None = None) -> int:
    """Draw one recording; returns the exit status."""
    parser = argument.Parser(prog="servo_twin.view.picture", description="Draw a picture of a recording.")
    parser.add_argument("recording", type=Path, help="recording of servo_viewer (.rrd)")
    parser.add_argument("picture", type=argument.picture, help="picture to write (.png)")
    args = parser.parse_args(argv)
    try:
        draw(args.recording, args.picture)
    except (RecordingError, PictureError, OSError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
