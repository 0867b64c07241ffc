"""``servo-tool snapshot``: record of the first fault of each axis."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.convert import flag_texts
from servo_msgs_py.fault_record import FaultRecord, record_variable
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.table_text import aligned

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context


def snapshot(context: Context) -> int:
    """Print the first fault of each axis and the samples before it; returns 1 without a fault."""
    session = context.session
    if session.mismatch is not None:
        print(f"servo-tool: {session.mismatch}", file=sys.stderr)
        return 1
    axes = [int(context.args.axis) - 1] if context.args.axis else list(range(AXES))
    records = [
        FaultRecord.of(axis, session.read(session.variables[record_variable(axis)]), context.catalogue) for axis in axes
    ]
    found = [record for record in records if record.fault is not None]
    if context.args.plot:
        _plot(found, Path(context.args.plot))
    if context.args.json:
        print(json.dumps([record.plain() for record in found]))
    else:
        for record in records:
            _print(record, context)
    return 0 if found else 1


def _print(record: FaultRecord, context: Context) -> None:
    if record.fault is None:
        print(f"{axis_name(record.axis)}: {record.summary()}")
        return
    print(f"{axis_name(record.axis)}: first fault {record.summary()}")
    print("  " + "; ".join(flag_texts(context.catalogue, "faults", record.fault.mask)))
    columns = {name: values for name, values in record.samples.columns.items() if name != "time"}
    rows = zip(1e3 * record.samples["time"], *columns.values(), strict=True)
    cells = [["time [ms]", *map(record.samples.head, columns)], *([f"{number:.4f}" for number in row] for row in rows)]
    for line in aligned(cells, ">"):
        print(f"  {line}")


def _plot(records: Sequence[FaultRecord], path: Path) -> None:
    figure = new_figure(10.0, 3.0 * max(len(records), 1))
    grid = figure.subplots(max(len(records), 1), 3, squeeze=False)
    curves = (("i_a", "i_b", "i_d", "i_q"), ("u_dc",), ("speed",))
    for row, record in zip(grid, records, strict=False):
        samples = record.samples
        for place, names in zip(row, curves, strict=True):
            for name in names:
                place.plot(1e3 * samples["time"], samples[name], label=name)
            place.set_xlabel("ms")
            place.set_ylabel(samples.units[names[0]])
            place.legend()
        row[0].set_title(f"{axis_name(record.axis)}: {record.fault.name if record.fault else ''}")
    write_figure(figure, path)
    print(f"wrote {path}", file=sys.stderr)
