"""Picture and rerun file of a comparison: the runs on top of each other, their differences below."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import named, open_output
from servo_msgs_py.rerun_file import import_rerun
from servo_msgs_py.trace import Trace

from servo_twin.runs.curves import TIME
from servo_twin.view import scene

_BINS: Final = 1500
"""Points of a curve in a picture, each with its smallest and largest value."""

_COLOURS: Final = tuple(scene.COLOURS.values())
_DIFFERENCE: Final = "difference"

_Array = NDArray[np.float64]


def _quantities() -> list[tuple[int, scene.Quantity, str]]:
    """Axis, quantity and variable of every plot."""
    return [(axis, q, q.column(scene.BOARD, axis)) for axis, _ in scene.axes() for q in scene.QUANTITIES]


class Envelope:
    """Smallest and largest values of curves in bins of time, whose width doubles as the run grows longer."""

    def __init__(self) -> None:
        self._width = 0.01  # [s]
        self._start: float | None = None
        self._low: dict[tuple[str, str], _Array] = {}
        self._high: dict[tuple[str, str], _Array] = {}

    def add(self, source: str, variable: str, time: _Array, values: _Array) -> None:
        """Add points; NaN is left out."""
        if self._start is None:
            self._start = float(time[0])
        while time[-1] - self._start >= self._width * _BINS:
            self._double()
        key = source, variable
        low = self._low.setdefault(key, np.full(_BINS, np.inf))
        high = self._high.setdefault(key, np.full(_BINS, -np.inf))
        shown = np.isfinite(values) & (time >= self._start)
        places = ((time[shown] - self._start) / self._width).astype(np.int64)
        np.minimum.at(low, places, values[shown])
        np.maximum.at(high, places, values[shown])

    def curve(self, source: str, variable: str) -> tuple[_Array, _Array, _Array] | None:
        """Times, lowest and highest values; None if there are none."""
        key = source, variable
        if key not in self._low or self._start is None:
            return None
        used = np.isfinite(self._low[key])
        time = np.asarray(self._start + self._width * (np.flatnonzero(used) + 0.5), np.float64)
        return (time, self._low[key][used], self._high[key][used]) if used.any() else None

    def _double(self) -> None:
        self._width *= 2.0
        for tables, join, empty in ((self._low, np.minimum, np.inf), (self._high, np.maximum, -np.inf)):
            for key, table in tables.items():
                tables[key] = np.concatenate([join(table[0::2], table[1::2]), np.full(_BINS // 2, empty)])


class Picture:
    """Collects a comparison for a picture."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = names  # title by source
        self._envelope = Envelope()

    def watch(self, source: str, reference: str, block: Trace, values: Mapping[str, _Array]) -> None:
        """Take a block of the reference and the other run at its times."""
        time = block[TIME]
        for _, _, name in _quantities():
            if name in block.columns:
                self._envelope.add(reference, name, time, block[name])
                if name in values:
                    self._envelope.add(source, name, time, values[name])
                    self._envelope.add(f"{source} {_DIFFERENCE}", name, time, block[name] - values[name])

    def write(self, path: Path) -> None:
        """Draw: a column per axis; per quantity the runs, and below them the reference minus the others."""
        figure = new_figure(16.0, 14.0)
        rows = 2 * len(scene.QUANTITIES)
        plots = figure.subplots(
            rows, len(list(scene.axes())), sharex=True, squeeze=False, height_ratios=[2, 1] * (rows // 2)
        )
        for number, (axis, quantity, name) in enumerate(_quantities()):
            row = 2 * (number % len(scene.QUANTITIES))
            for colour, (source, title) in zip(_COLOURS[1:], self._names.items(), strict=False):
                for plot, key in ((plots[row, axis], source), (plots[row + 1, axis], f"{source} {_DIFFERENCE}")):
                    curve = self._envelope.curve(key, name)
                    if curve is not None:
                        time, low, high = curve
                        shade = tuple(part / 255 for part in colour)
                        plot.fill_between(time, low, high, color=shade, linewidth=0.8, label=title, alpha=0.8)
            plots[row, axis].set_ylabel(f"{quantity.title} [{quantity.unit}]")
            plots[row + 1, axis].set_ylabel("difference")
        for axis, name in scene.axes():
            plots[0, axis].set_title(name)
            plots[0, axis].legend(loc="upper right")
            plots[-1, axis].set_xlabel("board time of the first run [s]")
        for plot in plots.flat:
            plot.grid(alpha=0.3)
        write_figure(figure, path)


class RerunFile:
    """Writes a comparison for the rerun viewer as it is made.

    Raises
    ------
    RecordingError
        If rerun is not installed.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, names: Mapping[str, str]) -> None:
        self._rr = rr = import_rerun()
        self._path = path
        self._stream = rr.RecordingStream("servo-twin", send_properties=False)
        self._data = self._stream.binary_stream()  # rerun would wait for ever at the end of a full disk
        self._file = open_output(path, "wb")
        self._stream.send_blueprint(_blueprint())
        self._written: set[float] = set()
        for number, (source, title) in enumerate(names.items()):
            for _, _, name in _quantities():
                style = rr.SeriesLines(names=title, colors=[_COLOURS[1:][number % 3]], aggregation_policy="MinMax")
                self._stream.log(_entity(name, source), style, static=True)

    def watch(self, source: str, reference: str, block: Trace, values: Mapping[str, _Array]) -> None:
        """Take a block of the reference and the other run at its times."""
        time = block[TIME]
        again = float(time[0]) in self._written  # by the comparison with another run
        self._written.add(float(time[0]))
        for _, _, name in _quantities():
            if name in block.columns and not again:
                self._send(_entity(name, reference), time, block[name])
            if name in block.columns and name in values:
                self._send(_entity(name, source), time, values[name])
                self._send(_entity(name, source, _DIFFERENCE), time, block[name] - values[name])
        self._write()

    def close(self) -> None:
        """Complete the file."""
        self._write()
        with named(self._path):
            self._file.close()

    def _write(self) -> None:
        with named(self._path):
            self._file.write(self._data.read() or b"")

    def _send(self, entity: str, time: _Array, values: _Array) -> None:
        rr = self._rr
        index = rr.TimeColumn(scene.TIMELINE, duration=time)
        self._stream.send_columns(entity, indexes=[index], columns=rr.Scalars.columns(scalars=values))


def _entity(variable: str, source: str, kind: str = "plot") -> str:
    return f"/{kind}/{variable.replace('.', '/')}/{source}"


def _blueprint() -> Any:
    import rerun.blueprint as rrb

    columns = []
    for axis, title in scene.axes():
        views = []
        for quantity in scene.QUANTITIES:
            name = quantity.column(scene.BOARD, axis).replace(".", "/")
            for kind, text in (("plot", quantity.title), (_DIFFERENCE, f"{quantity.title}: difference")):
                heading = f"{title}: {text} [{quantity.unit}]"
                views.append(rrb.TimeSeriesView(name=heading, origin=f"/{kind}/{name}"))
        columns.append(rrb.Vertical(*views, row_shares=[2, 1] * len(scene.QUANTITIES), name=title))
    panel = rrb.TimePanel(state="collapsed", timeline=scene.TIMELINE)
    return rrb.Blueprint(rrb.Horizontal(*columns), panel, auto_views=False, auto_layout=False)
