"""Tables of a recording as CSV or Parquet files, written as it is read: the memory does not grow with its length."""

from __future__ import annotations

import csv
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.output_file import named
from servo_msgs_py.run_file.reader import RunReader
from servo_msgs_py.trace import with_unit

from servo_twin.parquet import import_parquet
from servo_twin.runs.curves import LOG_TIME, TICK, TIME, curves_of
from servo_twin.runs.sample_order import Place, SampleOrder
from servo_twin.runs.tables import Rows, joined, rows_of

_BATCH: Final = 1 << 12
"""Messages of a table in memory."""


class _Sink(Protocol):
    """A file of a table that is open."""

    def write(self, rows: Rows) -> None: ...

    def close(self) -> None: ...


def _heads(rows: Rows) -> list[str]:
    return [with_unit(name, rows.units.get(name, "")) for name in rows.columns]


class _Csv:
    def __init__(self, path: Path, rows: Rows) -> None:
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        self._writer.writerow(_heads(rows))

    def write(self, rows: Rows) -> None:
        self._writer.writerows(zip(*(column.tolist() for column in rows.columns.values()), strict=True))

    def close(self) -> None:
        self._file.close()


class _Parquet:
    def __init__(self, path: Path, rows: Rows) -> None:
        pyarrow, parquet = import_parquet()
        fields = [
            pyarrow.field(head, pyarrow.from_numpy_dtype(column.dtype), metadata={"unit": rows.units.get(name, "")})
            for head, (name, column) in zip(_heads(rows), rows.columns.items(), strict=True)
        ]
        self._arrow = pyarrow
        self._schema = pyarrow.schema(fields)
        self._writer: Any = parquet.ParquetWriter(path, self._schema)

    def write(self, rows: Rows) -> None:
        self._writer.write_table(self._arrow.table(list(rows.columns.values()), schema=self._schema))

    def close(self) -> None:
        self._writer.close()


FORMATS: Final[Mapping[str, Callable[[Path, Rows], _Sink]]] = {"csv": _Csv, "parquet": _Parquet}
"""Formats by the suffix of their files."""


@dataclass
class Table:
    """A table that was written."""

    path: Path
    rows: int = 0
    columns: int = 0


@dataclass
class Exported:
    """Result of an export."""

    tables: list[Table] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)  # messages by topic: no numbers for a table
    troubles: Counter[str] = field(default_factory=Counter)  # what could not be read, for people


class _File:
    """A table: its file, and rows that wait."""

    def __init__(self, table: Table, sink: _Sink) -> None:
        self._table = table
        self._sink = sink
        self._waiting: list[Rows] = []

    def add(self, rows: Rows) -> None:
        self._waiting.append(rows)
        if len(self._waiting) >= _BATCH:
            self.flush()

    def flush(self) -> None:
        if self._waiting:
            rows = joined(self._waiting)
            with named(self._table.path):
                self._sink.write(rows)
            self._table.rows += len(next(iter(rows.columns.values())))
            self._waiting = []

    def close(self) -> None:
        with named(self._table.path):
            self._sink.close()


def export(run: Path, folder: Path, suffix: str, wanted: Collection[str] = ()) -> Exported:
    """Write every table of a recording.

    Parameters
    ----------
    run : Path
        As for `RunReader`, or an .rrd file of the viewer.
    folder : Path
        Is created; files of the same name are replaced.
    suffix : str
        Of `FORMATS`.
    wanted : collection of str
        Absolute names of topics; default: all.

    Raises
    ------
    RunFileError, ParquetError
        If it is no recording, or a library is missing.
    OSError
        If a file cannot be read or written.
    """
    result = Exported()
    every = _curves(run, wanted) if run.suffix == ".rrd" else _messages(RunReader(run), wanted, result)
    files: dict[tuple[str, int, tuple[str, ...]], _File] = {}
    names: Counter[str] = Counter()
    resets: Counter[str] = Counter()  # of the board, by table
    orders: defaultdict[str, SampleOrder] = defaultdict(SampleOrder)  # by table
    if suffix == "parquet":
        import_parquet()
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        for rows in every:
            if (ticks := rows.columns.get(TICK)) is not None and np.isfinite(ticks).all():
                place = orders[rows.stream].place(ticks[0], ticks[-1], int(rows.columns[LOG_TIME][0]))
                resets[rows.stream] += place is Place.RESET
            key = rows.stream, resets[rows.stream], tuple(rows.columns)
            if key not in files:  # also if the columns change during the run, or the time begins again
                name = rows.stream.strip("/").replace("/", ".")
                names[name] += 1
                number = f".{names[name]}" if names[name] > 1 else ""
                table = Table(folder / f"{name}{number}.{suffix}", columns=len(rows.columns))
                with named(table.path):
                    files[key] = _File(table, FORMATS[suffix](table.path, rows))
                stack.callback(files[key].close)
                result.tables.append(table)
            files[key].add(rows)
        for file in files.values():
            file.flush()
    return result


def _messages(reader: RunReader, wanted: Collection[str], result: Exported) -> Iterator[Rows]:
    """Rows of the messages of a recording; notes the others."""
    catalogue = Catalogue.load()
    for record in reader.records(wanted or None):
        try:
            rows = rows_of(record, catalogue)
        except ValueError as error:
            result.troubles[f"{record.topic}: {error}"] += 1
            continue
        if rows is None:
            result.left_out[record.topic] += 1
        elif len(rows.columns[LOG_TIME]):
            yield rows
    result.troubles.update(reader.troubles)


def _curves(run: Path, wanted: Collection[str]) -> Iterator[Rows]:
    """Rows of the curves of a viewer, which have no topics."""
    variables = Catalogue.load().variables
    for block in () if wanted else curves_of(run).blocks():
        units = {name: variables[name].unit for name in block.columns if name in variables}
        yield Rows("curves", dict(block.columns), {**units, TIME: "s"})
