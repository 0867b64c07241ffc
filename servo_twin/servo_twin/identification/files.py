"""Output files of identify: plant file for the twin, ``servo.toml`` for the controller, estimates, picture."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from servo_measurement.least_squares import mean_of
from servo_measurement.motor_values import COVERAGE, UNITS
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.table_text import aligned
from servo_msgs_py.text_file import toml_text
from servo_tuning.errors import Remedy

from servo_twin.identification.refine import plant_of
from servo_twin.identification.session import Identified
from servo_twin.plant import PlantConfig

_PLANT: Final = ("r_s", "l_d", "l_q", "psi_m", "pole_pairs", "inertia", "friction", "viscous", "r_on", "v_drop")
"""Values of an axis in the plant file."""


def report_lines(result: Identified) -> list[str]:
    """Table of the estimates, and of the differences to a simulation with them."""
    lines = result.estimates.lines()
    bias = result.log.notes.get("bias")
    if bias is not None and "l_d" in result.estimates.values:
        lines.append(f"l_d is valid at {bias['l_d']:.2g} A along the flux, l_q without q current")
    if result.refinement is not None:
        cells = [["difference to the simulation (root mean square)", "before", "after"]]
        for column, before in result.refinement.before.items():
            cells.append([f"  {column}", f"{before:.3g}", f"{result.refinement.after[column]:.3g}"])
        lines += aligned(cells, "<>")
    return lines


def write_plant(path: Path, result: Identified, plant: PlantConfig) -> None:
    """Write a plant file with the identified values."""
    values = {name: estimate.value for name, estimate in result.estimates.values.items()}
    limits: Mapping[str, float] = result.log.notes["limits"]
    own = plant_of(plant, result.log.axis, values, limits).axes[result.log.axis]
    entries = {name: float(f"{getattr(own, name):.6g}") for name in _PLANT}
    entries["pole_pairs"] = round(own.pole_pairs)
    load = result.estimates.values.get("load")
    if load is not None and not load.interval[0] <= 0.0 <= load.interval[1]:
        entries["load_torque"] = float(f"{load.value:.6g}")
    head = "# Identified by servo-sim identify. dead_time and r_on are given; r_s and v_drop are the remainders.\n"
    write_file(path, head + toml_text({axis_name(result.log.axis): entries}))


def write_servo(path: Path, table: Mapping[str, Any]) -> None:
    """Write a ``servo.toml`` for ``servo-tool tune`` and ``make tune``."""
    write_file(path, "# Written by servo-sim identify.\n" + toml_text(table))


def write_estimates(path: Path, result: Identified, lines: Sequence[str]) -> None:
    """Write all results as JSON."""
    refinement = result.refinement
    content = {
        "axis": axis_name(result.log.axis),
        "limits": result.log.notes["limits"],
        "board_seconds": result.log.notes.get("seconds", result.log.seconds),
        "estimates": {
            name: {"value": one.value, "sigma": one.sigma, "interval": list(one.interval), "unit": UNITS[name]}
            for name, one in result.estimates.values.items()
        },
        "bias": result.log.notes.get("bias"),
        "undetermined": dict(result.estimates.undetermined),
        "problems": [str(one) for one in result.problems],
        "remedies": [
            {"problem": one.entry, "alternatives": [_options(remedy) for remedy in one.remedies]}
            for one in result.problems
            if one.remedies
        ],
        "difference": None if refinement is None else {"before": refinement.before, "after": refinement.after},
        "margins": list(lines),
    }
    write_file(path, json.dumps(content, indent=2) + "\n")


def _options(remedy: Remedy | None) -> dict[str, float | None]:
    """Values of options, all of them necessary."""
    return {} if remedy is None else {remedy.entry: remedy.value, **_options(remedy.also)}


def draw(path: Path, result: Identified) -> None:
    """Draw resistance, swept sines, speed runs and friction, measured and simulated, and the intervals."""
    figure = new_figure(13.0, 8.0, 110)
    plots = figure.subplots(2, 3)
    name, log = axis_name(result.log.axis), result.log
    simulated = None if result.refinement is None else result.refinement.simulated
    sources = [("measured", log.recordings, "o", "tab:blue")]
    if simulated is not None:
        sources.append(("simulated", simulated, "x", "tab:orange"))
    for label, recordings, mark, colour in sources:
        labelled = list(zip(log.labels, recordings, strict=True))
        levels = [one.columns for kind, one in labelled if kind == "level"]
        current, voltage = ([mean_of(one[f"{name}.{key}"])[0] for one in levels] for key in ("i_d", "u_d"))
        plots[0, 0].plot(current, voltage, mark, color=colour, label=label)
        for point, style in (("d", "-"), ("q", "--")):
            sweep = next((one for kind, one in labelled if kind == f"sweep_{point}"), None)
            if sweep is not None:
                plots[0, 1].plot(1e3 * sweep.time[:400], sweep[f"{name}.i_{point}"][:400], style, color=colour, lw=0.8)
        begin = 0.0
        for kind, one in labelled:
            if kind == "speed":
                time = begin + one.time
                begin = float(time[-1])
                plots[0, 2].plot(time, one[f"{name}.speed"], color=colour, lw=1.0)
                plots[1, 0].plot(time, one[f"{name}.i_q"], color=colour, lw=0.8)
        held = [one for kind, one in labelled if kind == "plain"]
        speeds = [float(np.polyfit(one.time, np.nan_to_num(one[f"{name}.position"]), 1)[0]) for one in held]
        plots[1, 1].plot(speeds, [mean_of(one[f"{name}.i_q"])[0] for one in held], mark, color=colour)
    for plot, title, x, y in (
        (plots[0, 0], "resistance and voltage error", "i_d [A]", "u_d [V]"),
        (plots[0, 1], "swept sine, d and q (dashed)", "time [ms]", "current [A]"),
        (plots[0, 2], "runs", "time [s]", "speed [rad/s]"),
        (plots[1, 0], "runs", "time [s]", "i_q [A]"),
        (plots[1, 1], "friction", "speed [rad/s]", "i_q [A]"),
    ):
        plot.set(title=title, xlabel=x, ylabel=y)
        plot.grid(alpha=0.3)
    plots[0, 0].legend()
    _bars(plots[1, 2], result)
    write_figure(figure, path)


def _bars(plot: Any, result: Identified) -> None:
    rows = [
        (name, 100.0 * COVERAGE * one.sigma / abs(one.value))
        for name, one, _ in result.estimates.rows()
        if one.value and one.sigma and name not in ("offset_alpha", "offset_beta", "load")
    ]
    rows = [(name, part) for name, part in rows if math.isfinite(part)]
    plot.barh([name for name, _ in rows], [part for _, part in rows], color="tab:blue")
    plot.set(title="half the 95 % interval", xlabel="% of the value", xscale="log")
    plot.invert_yaxis()
    plot.grid(alpha=0.3)
