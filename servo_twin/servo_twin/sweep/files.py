"""Tables and a picture of the trials."""

from __future__ import annotations

import csv
import importlib
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final

from servo_twin.figure import new_figure
from servo_twin.simulation import SimulationError
from servo_twin.sweep.space import Varied
from servo_twin.sweep.trial import Trial

BATCH: Final = 10_000  # rows that are in memory at once
LABEL_WIDTH: Final = 28  # letters


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
    """A row per trial: its number, what was varied, its figures, whether all lie within their bounds."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, _names(varied, figures))
        table.writeheader()
        table.writerows(_row(trial, figures) for trial in trials)


def write_parquet(path: Path, trials: Iterable[Trial], varied: Sequence[str], figures: Sequence[str]) -> None:
    """The same for pandas, polars and others.

    Raises
    ------
    SimulationError
        If pyarrow is not installed.
    """
    try:
        pyarrow: Any = importlib.import_module("pyarrow")  # without types
        parquet: Any = importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise SimulationError("parquet needs pyarrow: pip install pyarrow") from None
    types = {"trial": pyarrow.int64(), "inside": pyarrow.bool_(), "problem": pyarrow.string()}
    names = _names(varied, figures)
    schema = pyarrow.schema([(name, types.get(name, pyarrow.float64())) for name in names])
    with parquet.ParquetWriter(path, schema) as writer:
        for batch in _batches(trials):
            rows = [_row(trial, figures) for trial in batch]
            writer.write_table(pyarrow.Table.from_pylist(rows, schema))


def _batches(trials: Iterable[Trial]) -> Iterator[list[Trial]]:
    source = iter(trials)
    while batch := list(islice(source, BATCH)):
        yield batch


def draw(path: Path, trials: Iterable[Trial], varied: Sequence[Varied], figures: Sequence[str], title: str) -> None:
    """Every figure over every value that was varied; trials outside a bound in red.

    Parameters
    ----------
    path : Path
        File of the picture; its ending says its format.
    trials : iterable of Trial
        Those that are drawn; all of them are in memory at once.
    varied : sequence of Varied
        A column each.
    figures : sequence of str
        A row each.
    title : str

    Raises
    ------
    SimulationError
        If matplotlib is not installed.
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
    drawing.savefig(path)


def _scatter(plot: Any, shown: Sequence[Trial], value: str, name: str) -> None:
    points = [(t.point[value], t.figures[name]) for t in shown if name in t.figures]
    for inside, colour in ((True, "tab:blue"), (False, "tab:red")):
        mine = [(x, f.value) for x, f in points if f.value is not None and f.inside is inside]
        plot.plot(*(zip(*mine, strict=True) if mine else ((), ())), ".", markersize=2 if inside else 4, color=colour)
    plot.grid(alpha=0.3)
