"""Files of a burst: CSV, plot, NumPy arrays or rerun recording."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.rerun_file import recording_file
from servo_msgs_py.trace import Trace

from servo_bridge.bursts.rerun_log import entity_of, send_curve
from servo_bridge.tool_values import UsageError

_TIMELINE: Final = "time"


def _time_head(burst: Trace) -> str:
    return "time [s]" if burst.step else "point"


def write_csv(burst: Trace, path: Path) -> None:
    """Write a CSV file with one row per point."""
    table = io.StringIO()
    writer = csv.writer(table)
    writer.writerow([_time_head(burst), *map(burst.head, burst.columns)])
    columns = (column.tolist() for column in burst.columns.values())
    for time, *values in zip(burst.time.tolist(), *columns, strict=True):
        writer.writerow([f"{time:.9g}", *values])
    write_file(path, table.getvalue())


def write_arrays(burst: Trace, path: Path) -> None:
    """Write ``time`` and one array per channel, under its name; ``units`` in the order of the channels."""
    arrays = {"time": burst.time, "units": np.array([burst.units[name] for name in burst.columns]), **burst.columns}
    write_file(path, lambda file: np.savez(file, allow_pickle=False, **arrays))


def write_picture(burst: Trace, path: Path) -> None:
    """Write a plot with one diagram per unit."""
    units = list(dict.fromkeys(burst.units[name] for name in burst.columns))
    figure = new_figure(10.0, 1.5 + 2.2 * len(units))
    plots = figure.subplots(len(units), 1, squeeze=False, sharex=True)[:, 0]
    for name, column in burst.columns.items():
        plots[units.index(burst.units[name])].plot(burst.time, column, label=name)
    for plot, unit in zip(plots, units, strict=True):
        plot.set_ylabel(unit)
        plot.axvline(0.0, color="0.7", linewidth=0.8)
        plot.legend(loc="upper right")
    plots[-1].set_xlabel(_time_head(burst))
    write_figure(figure, path)


def write_recording(burst: Trace, path: Path) -> None:
    """Write a recording for the rerun viewer: one entity per channel, on the timeline ``time``."""
    with recording_file("servo-tool", path) as recording:
        import rerun as rr

        index = (
            rr.TimeColumn(_TIMELINE, duration=burst.time)
            if burst.step
            else rr.TimeColumn(_TIMELINE, sequence=burst.time.astype(np.int64))
        )
        for name, column in burst.columns.items():
            entity = entity_of(name.split("."))
            recording.log(entity, rr.SeriesLines(names=burst.head(name)), static=True)
            send_curve(recording, entity, index, column)


_WRITERS: Final[Mapping[str, Callable[[Trace, Path], None]]] = {
    ".csv": write_csv,
    ".npz": write_arrays,
    ".png": write_picture,
    ".svg": write_picture,
    ".pdf": write_picture,
    ".rrd": write_recording,
}


def writer_for(path: Path) -> Callable[[Trace, Path], None]:
    """Function that writes a file of this type.

    Raises
    ------
    UsageError
        If the suffix is unknown.
    """
    try:
        return _WRITERS[path.suffix.lower()]
    except KeyError:
        raise UsageError(f"{path}: the name must end with one of {', '.join(_WRITERS)}") from None
