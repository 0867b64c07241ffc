"""Curves of a run from any of its files, in blocks, so that the memory does not grow with the length of the run.

A block is a `Trace` with the column `TIME`: board time [s], rising within a run. Columns have the names of variables.
"""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.convert import snapshot_table
from servo_msgs_py.run_file.reader import RUN_SUFFIXES, Record, RunReader
from servo_msgs_py.text_file import TextFileError
from servo_msgs_py.text_file import decoded as text_of
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import PERIOD_NS

from servo_msgs_py import topics
from servo_twin.runs.recorded import DEFAULT_NAMESPACE, RecordedRun, RunError, message_of
from servo_twin.runs.sample_order import Place, SampleOrder
from servo_twin.view import scene
from servo_twin.view.recording import read_scalars

TIME: Final = topics.BURST_TIME
"""Column with the board time [s]."""

BLOCK: Final = 1 << 14
"""Samples of a block."""

TICK: Final = "tick"
LOG_TIME: Final = "log_time"
ROS_TIME: Final = "ros_time"
"""Columns of an exported table: times of the recording and of the sample since the epoch [ns]."""

_CDR_LITTLE: Final = b"\x00\x01"
_CSV_REMEDY: Final = "give a file of servo-tool record"
_LINE_BYTES: Final = 1 << 16  # of the longest line of a CSV file
_Array = NDArray[np.float64]


class Curves(Protocol):
    """Curves of a run."""

    @property
    def path(self) -> Path:
        """File or folder."""

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Trace]:
        """Blocks of these columns and the time, by default of all; each call reads the run anew."""


def curves_of(path: Path, namespace: str = "") -> Curves:
    """Curves of a recording (MCAP, bag, .rrd of the viewer) or of a CSV file of ``servo-tool record``.

    Raises
    ------
    RunError, RunFileError, RecordingError
        If it cannot be read.
    """
    if path.suffix == ".csv":
        return _CsvFile(path)
    if path.suffix == ".rrd":
        return _RrdFile(path)
    if not path.is_dir() and path.suffix not in (*RUN_SUFFIXES, ".bag"):
        raise RunError(
            f"{path} is no recording of curves; give a {' or '.join(RUN_SUFFIXES)} file, the folder of a bag, an .rrd "
            "file of the viewer, or a .csv file of servo-tool record"
        )
    return _Snapshots(path, namespace)


def collected(run: Curves, names: Sequence[str] | None, span: float = math.inf) -> Trace:
    """Samples of these columns in one block; columns that a part of the run lacks are left out.

    Parameters
    ----------
    run : Curves
        The run.
    names : sequence of str or None
        Columns besides the time; None: all.
    span : float
        Time after the first sample from which on blocks are left out [s].

    Raises
    ------
    RunError
        If there are no samples.
    """
    blocks: list[Trace] = []
    for block in run.blocks(names):
        blocks.append(block)
        if block[TIME][-1] - blocks[0][TIME][0] > span:
            break
    if not blocks:
        raise RunError(f"{run.path} contains no samples")
    common = [name for name in blocks[0].columns if all(name in block.columns for block in blocks)]
    return Trace(0.0, {name: np.concatenate([block[name] for block in blocks]) for name in common})


@dataclass(frozen=True)
class _Layout:
    """Layout of the serialised messages of one table: their beginning is the same but for the number of samples."""

    names: tuple[str, ...]
    tick: int  # place of the tick in a sample
    start: int  # of the numbers
    place: int  # of the names
    label: bytes  # the names

    @classmethod
    def of(cls, record: Record) -> _Layout:
        """Layout of a message.

        Raises
        ------
        RunError
            If it is no telemetry with ticks.
        """
        try:
            if record.data[:2] != _CDR_LITTLE:
                raise ValueError("big-endian numbers")
            names, table = snapshot_table(message_of(record, topics.SNAPSHOT))
        except ValueError as error:
            raise RunError(f"{record.topic}: {error}; record it with the bridge of this version") from None
        if TICK not in names:
            raise RunError(f"{record.topic} has no column tick; add it to the parameter telemetry of the bridge")
        label = ",".join(names).encode()
        start = len(record.data) - 8 * table.size
        return cls(tuple(names), names.index(TICK), start, record.data.rindex(label), label)

    def ticks(self, data: bytes) -> tuple[float, float]:
        """Ticks of the first and the last sample of a message."""
        row = 8 * len(self.names)
        first, last = (struct.unpack_from("<d", data, at + 8 * self.tick) for at in (self.start, len(data) - row))
        return first[0], last[0]

    def fits(self, data: bytes) -> bool:
        """Whether a message has this layout."""
        row = 8 * len(self.names)
        return data[self.place : self.place + len(self.label)] == self.label and not (len(data) - self.start) % row


class _Snapshots:
    """Telemetry of a recording."""

    def __init__(self, path: Path, namespace: str) -> None:
        self.path = path
        self._reader = RunReader(path)
        self._topic = f"{namespace or DEFAULT_NAMESPACE}/{topics.SNAPSHOT}"
        if next(self._reader.records({self._topic}), None) is None:  # which board, or what is wrong
            self._topic = f"{RecordedRun(path, namespace).contents.namespace}/{topics.SNAPSHOT}"

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Trace]:
        layout: _Layout | None = None
        parts: list[bytes] = []
        size, last = 0, -np.inf
        order = SampleOrder()
        for record in self._reader.records({self._topic}):
            if layout is None or not layout.fits(record.data):
                if layout is not None and parts:
                    last = yield from self._block(layout, parts, names, last)
                parts, size, layout = [], 0, _Layout.of(record)
            if len(record.data) == layout.start:
                continue  # no samples
            first, final = layout.ticks(record.data)
            if math.isfinite(first + final) and order.place(first, final, record.time_ns) is Place.RESET:
                raise RunError(
                    f"{self.path}: the board was reset before {first * PERIOD_NS * 1e-9:.3f} s; servo-twin export "
                    "writes a table of the time before it and one of the time after it"
                )
            parts.append(record.data[layout.start :])
            size += len(record.data) - layout.start
            if size >= 8 * len(layout.names) * BLOCK:
                last = yield from self._block(layout, parts, names, last)
                parts, size = [], 0
        if layout is not None and parts:
            yield from self._block(layout, parts, names, last)

    def _block(
        self, layout: _Layout, parts: list[bytes], names: Sequence[str] | None, last: float
    ) -> Generator[Trace, None, float]:
        """The samples of these messages in the order of their ticks, from a time on; returns the last time."""
        table = np.frombuffer(b"".join(parts), "<f8").reshape(-1, len(layout.names))
        time = table[:, layout.tick] * (PERIOD_NS * 1e-9)
        if (np.diff(time, prepend=last) < 0.0).any():
            sorted_ = np.argsort(time, kind="stable")
            table = table[sorted_[time[sorted_] >= last]]
            time = table[:, layout.tick] * (PERIOD_NS * 1e-9)
        chosen = [name for name in layout.names if names is None or name in names]
        columns = {name: table[:, layout.names.index(name)] for name in chosen if name not in topics.STAMP_COLUMNS}
        if len(time):
            yield _checked(self.path, Trace(0.0, {TIME: time, **columns}), last)
            last = float(time[-1])
        return last


def _checked(path: Path, block: Trace, last: float) -> Trace:
    """A block of finite numbers whose time rises from that of the block before on [s].

    Raises
    ------
    RunError
        If it is none.
    """
    remedy = "leave such samples out of a table of servo-twin export"
    for name, column in block.columns.items():
        if len(places := np.flatnonzero(~np.isfinite(column))):
            raise RunError(f"{path}: {name} is {column[places[0]]} at {block[TIME][places[0]]:.3f} s; {remedy}")
    if len(places := np.flatnonzero(np.diff(block[TIME], prepend=last) < 0.0)):
        raise RunError(f"{path}: the time falls to {block[TIME][places[0]]:.3f} s; {remedy}")
    return block


class _RrdFile:
    """Curves of the viewer: set-points and measured values of both axes."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Trace]:
        found: dict[str, tuple[_Array, _Array]] = {}
        for axis, _ in scene.axes():
            for quantity in scene.QUANTITIES:
                for source in (scene.BOARD, scene.SET_POINT):
                    name = quantity.column(source, axis)
                    times, values = read_scalars(self.path, scene.series_entity(axis, quantity.name, source))
                    shown = np.isfinite(values)  # NaN: gap
                    if shown.any():
                        found[name] = times[shown], values[shown]
        if not found:
            raise RunError(f"{self.path} contains no telemetry of a board: record with a connected bridge")
        time = max((times for times, _ in found.values()), key=len)
        columns = {name: np.interp(time, *curve) for name, curve in found.items() if names is None or name in names}
        for begin in range(0, len(time), BLOCK):
            part = slice(begin, begin + BLOCK)
            yield Trace(0.0, {TIME: time[part], **{name: column[part] for name, column in columns.items()}})


class _CsvFile:
    """Rows of ``servo-tool record``, or of ``servo-twin export``."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Trace]:
        with self.path.open("rb") as file:
            try:
                heads = [head.partition(" [")[0] for head in text_of(file.readline(_LINE_BYTES)).strip().split(",")]
            except TextFileError as error:
                raise RunError(f"{self.path}: {error}") from None
            if TIME not in heads or len(set(heads)) < len(heads):
                raise RunError(f"{self.path} has no column {TIME} in its first line, or a name twice; {_CSV_REMEDY}")
            lines = iter(partial(file.readline, _LINE_BYTES), b"")
            last = -np.inf
            while True:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # the end of the file
                    try:
                        table = np.loadtxt(lines, delimiter=",", max_rows=BLOCK, ndmin=2)
                    except ValueError as error:
                        raise RunError(f"{self.path}: {error}; {_CSV_REMEDY}") from None
                if not table.size:
                    return
                if table.shape[1] != len(heads):
                    raise RunError(f"{self.path} has {table.shape[1]} values for {len(heads)} columns; {_CSV_REMEDY}")
                columns = dict(zip(heads, table.T, strict=True))
                for stamp in (LOG_TIME, ROS_TIME):
                    columns.pop(stamp, None)
                if TICK in columns:
                    columns[TIME] = columns[TICK] * (PERIOD_NS * 1e-9)
                chosen = {n: c for n, c in columns.items() if names is None or n in (TIME, *names)}
                yield _checked(self.path, Trace(0.0, chosen), last)
                last = float(columns[TIME][-1])
