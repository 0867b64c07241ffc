"""Outcomes as text, picture and ``summary.json``."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.table_text import aligned
from servo_msgs_py.text_file import parse_json, read_text

from servo_twin.validation.experiments.outcome import Outcome, Panel

SUMMARY: Final = "summary.json"
_HEAD: Final = ("figure", "measured", "unit", "bound", "agrees", "the reference design")
_WIDTH: Final = 44


def _number(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "none"
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def table(outcome: Outcome) -> str:
    """Rows of an outcome as text."""
    lines = [
        _HEAD,
        *(
            (r.name, _number(r.measured), r.unit, str(r.bound), "yes" if r.agrees else "NO", r.reference)
            for r in outcome.rows
        ),
    ]
    text = [f"{outcome.name}, level {outcome.level}" if outcome.level else outcome.name, ""]
    cells: list[tuple[str, ...]] = []
    for *values, reference in lines:
        first, *others = textwrap.wrap(reference, _WIDTH) or [""]
        cells += [(*values, first), *(("",) * len(values) + (more,) for more in others)]
    text.extend(f"  {line}" for line in aligned(cells))
    text.extend(["", *(f"  {note}" for note in outcome.notes)] if outcome.notes else [])
    return "\n".join(text) + "\n"


def summary(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """All rows of all outcomes as dictionaries."""
    return [row.as_dict(outcome.name, outcome.level) for outcome in outcomes for row in outcome.rows]


def update_summary(folder: Path, outcomes: Sequence[Outcome]) -> Path:
    """Update ``summary.json``; rows of other experiments are kept if they have a reference.

    Returns
    -------
    Path
        The file.
    """
    path = folder / SUMMARY
    replaced = {outcome.name for outcome in outcomes}
    try:
        old = parse_json(read_text(path))
        kept = [row for row in old if "reference" in row and row["experiment"] not in replaced]
    except (OSError, ValueError, KeyError, TypeError):
        kept = []  # missing or another format
    text = json.dumps(kept + summary(outcomes), indent=2, allow_nan=False, ensure_ascii=False)
    write_file(path, text + "\n")
    return path


def draw(outcome: Outcome, path: Path) -> None:
    """Draw the panels of an outcome."""
    columns = 1 if len(outcome.panels) <= 1 else 2
    rows = max(math.ceil(len(outcome.panels) / columns), 1)
    figure = new_figure(6.8 * columns, 3.6 * rows + 0.6, 110)
    plots = figure.subplots(rows, columns, squeeze=False)
    for plot, panel in zip(plots.flat, outcome.panels, strict=False):
        _draw_panel(plot, panel)
    for plot in list(plots.flat)[len(outcome.panels) :]:
        plot.set_axis_off()
    verdict = "agrees" if outcome.agrees else "does not agree"
    figure.suptitle(f"{outcome.name}: {verdict} with the reference design")
    write_figure(figure, path)


def _draw_panel(plot: Any, panel: Panel) -> None:
    for curve in panel.curves:
        plot.plot(curve.x, curve.y, curve.style, label=curve.label, linewidth=1.1, markersize=3)
    if panel.log_x:
        plot.set_xscale("log")
    if panel.log_y:
        plot.set_yscale("log")
    plot.set_title(panel.title, fontsize="medium")
    plot.set_xlabel(panel.x_label)
    plot.set_ylabel(panel.y_label)
    plot.grid(alpha=0.3)
    plot.legend(fontsize="x-small")
