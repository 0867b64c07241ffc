"""Tables and picture of the trials."""

from __future__ import annotations

import csv
import io
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import named, write_file

from servo_twin.parquet import import_parquet
from servo_twin.validation.sweep.space import Varied
from servo_twin.validation.sweep.trial import Trial

BATCH: Final = 10_000  # rows in memory
LABEL_WIDTH: Final = 28  # [characters]


def _row(trial: Trial, figures: Sequence[str]) -> dict[str, Any]:
    values = {name: trial.figures[name].value if name in trial.figures else None for name in figures}
    inside = all(figure.inside for figure in trial.figures.values())
    return {
        "trial": trial.number,
        **trial.point,
        **values,
        "inside": inside and not trial.problem,
        "problem": trial.problem,
    }


def _names(varied: Sequence[str], figures: Sequence[str]) -> list[str]:
    return ["trial", *varied, *figures, "inside", "problem"]


def write_csv(path: Path, trials: Iterable[Trial], varied: Sequence[str], figures: Sequence[str]) -> None:
    """Write a row per trial: number, varied values, figures, ``inside`` (all within their bounds), ``problem``."""
    text = io.StringIO()
    table = csv.DictWriter(text, _names(varied, figures))
    table.writeheader()
    table.writerows(_row(trial, figures) for trial in trials)
    write_file(path, text.getvalue())


def write_parquet(path: Path, trials: Iterable[Trial], varied: Sequence[str], figures: Sequence[str]) -> None:
    """Write the rows of `write_csv` as a parquet file.

    Raises
    ------
    ParquetError
        If pyarrow is not installed.
    """
    pyarrow, parquet = import_parquet()
    types = {"trial": pyarrow.int64(), "inside": pyarrow.bool_(), "problem": pyarrow.string()}
    names = _names(varied, figures)
    schema = pyarrow.schema([(name, types.get(name, pyarrow.float64())) for name in names])
    with named(path), parquet.ParquetWriter(path, schema) as writer:
        for batch in _batches(trials):
            rows = [_row(trial, figures) for trial in batch]
            writer.write_table(pyarrow.Table.from_pylist(rows, schema))


def _batches(trials: Iterable[Trial]) -> Iterator[list[Trial]]:
    source = iter(trials)
    while batch := list(islice(source, BATCH)):
        yield batch


def draw(path: Path, trials: Iterable[Trial], varied: Sequence[Varied], figures: Sequence[str], title: str) -> None:
    """Draw every figure over every varied value; trials outside a bound in red.

    Parameters
    ----------
    path : Path
        File of the picture; the extension determines the format.
    trials : iterable of Trial
        Trials to draw; all are kept in memory.
    varied : sequence of Varied
        Varied values, one column each.
    figures : sequence of str
        Figures, one row each.
    title : str
    """
    shown = list(trials)
    drawing = new_figure(3.2 * len(varied) + 1.0, 2.2 * len(figures) + 0.6, 100)
    drawing.suptitle(title)
    plots = drawing.subplots(len(figures), len(varied), squeeze=False, sharex="col", sharey="row")
    for column, value in enumerate(varied):
        plots[-1, column].set_xlabel(value.name)
        plots[-1, column].set_xscale("log" if value.kind == "log" else "linear")
        for line, name in enumerate(figures):
            _scatter(plots[line, column], shown, value.name, name)
    for line, name in enumerate(figures):
        plots[line, 0].set_ylabel(textwrap.fill(name, LABEL_WIDTH), fontsize="small")
    write_figure(drawing, path)


def _scatter(plot: Any, shown: Sequence[Trial], value: str, name: str) -> None:
    points = [(t.point[value], t.figures[name]) for t in shown if name in t.figures]
    for inside, colour in ((True, "tab:blue"), (False, "tab:red")):
        chosen = [(x, f.value) for x, f in points if f.value is not None and f.inside is inside]
        plot.plot(
            *(zip(*chosen, strict=True) if chosen else ((), ())), ".", markersize=2 if inside else 4, color=colour
        )
    plot.grid(alpha=0.3)
