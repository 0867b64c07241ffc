"""Output of `autotune`: text, JSON, picture, configuration file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.table_text import aligned
from servo_msgs_py.text_file import toml_text
from servo_tuning.findings import GAIN_MIN
from servo_tuning.linear import Margins
from servo_tuning.robust import stable
from servo_tuning.tuned import Tuned

from servo_measurement.autotune import Autotuned
from servo_measurement.bode_report import frequency_axis
from servo_measurement.position_move import Move

CONFIG, PICTURE = "servo.toml", "autotune.png"
"""Files of a result."""

_ENTRIES: Final = (
    ("control.speed_bandwidth", "Hz"),
    ("control.position_gain", "1/s"),
    ("control.path_current_use", ""),
    ("limits.acceleration", "rad/s^2"),
)
_COLOURS: Final = ("tab:orange", "tab:blue")  # before, after
_POINTS: Final = 500  # of a predicted curve


def text(found: Autotuned) -> str:
    """Tables of the shaft, the configuration, the margins and the moves."""
    rows = [["", "before", "after"]]
    for entry, unit in _ENTRIES:
        rows.append([entry, *(f"{design.axis(entry):.4g} {unit}".rstrip() for design in (found.before, found.after))])
    rows.append(["speed estimate", *map(_estimate, (found.before, found.after))])
    for loop in ("speed", "position"):
        rows.append([f"{loop} loop, predicted", *(_predicted(found, one, loop) for one in (found.before, found.after))])
    rows.append(["speed loop, measured", "", _margins(found.measured)])
    for name, of in (("settling after the path", _settling), ("overshoot of the move", _overshoot)):
        rows.append([name, *(of(moves) if moves else "not moved" for moves in (found.moves_before, found.moves))])
    return "\n".join([found.resonance.text(), *(f"  {line}" for line in aligned(rows))])


def _estimate(design: Tuned) -> str:
    return f"observer, {design.axis('control.observer_bandwidth'):.4g} Hz" if design.observed else "M/T method"


def _predicted(found: Autotuned, design: Tuned, loop: str) -> str:
    if not stable(found.shaft, design):
        return "unstable"
    loops = found.shaft.within(design.shaft())
    return _margins(loops.speed_margins() if loop == "speed" else loops.position_margins())


def _margins(margins: Margins) -> str:
    phase = "no crossover" if margins.phase is None else f"{abs(margins.phase):.1f} degrees"
    return phase if margins.gain is None else f"{phase}, factor {margins.gain:.2f}"


def _settling(moves: Sequence[Move]) -> str:
    times = [move.settling for move in moves if move.settling is not None]
    return f"{1e3 * max(times):.3g} ms" if len(times) == len(moves) else "not arrived"


def _overshoot(moves: Sequence[Move]) -> str:
    return f"{max(move.figures.overshoot for move in moves):.2g} rad"


def as_dict(found: Autotuned) -> dict[str, Any]:
    """All results as numbers: SI, frequencies in Hz, phases in degrees, gain margins as factors."""
    measured = found.measured
    return {
        "axis": axis_name(found.request.axis),
        "shaft": found.resonance.as_dict(),
        "before": _entries(found.before),
        "after": _entries(found.after),
        "measured": {"crossover": measured.crossover, "phase margin": measured.phase, "gain margin": measured.gain},
        "settling before": [move.settling for move in found.moves_before],
        "settling": [move.settling for move in found.moves],
        "problems": list(map(str, found.problems)),
    }


def _entries(design: Tuned) -> dict[str, float | bool]:
    entries = [entry for entry, _ in _ENTRIES] + ["control.observer_bandwidth"]
    return {entry: design.axis(entry) for entry in entries} | {"features.speed_observer": design.observed}


def write_configuration(found: Autotuned, folder: Path) -> None:
    """Write the configuration if it is confirmed: an earlier one is removed if it is not."""
    folder.mkdir(parents=True, exist_ok=True)
    if found.problems:
        (folder / CONFIG).unlink(missing_ok=True)
        return
    name, phase_min = axis_name(found.request.axis), found.request.phase_min
    head = f"# {name}: load and bandwidths by autotune, phase margin {phase_min:g} degrees.\n"
    write_file(folder / CONFIG, head + toml_text(found.table))


def draw(found: Autotuned, path: Path) -> None:
    """Plot the open speed loop and the move, before and after."""
    figure, name = new_figure(12.0, 8.0), axis_name(found.request.axis)
    gain, position, phase, error = figure.subplots(2, 2).flat
    response = found.bode.response
    f = np.geomspace(response.frequency[0], response.frequency[-1], _POINTS)
    names = ("before", "after")
    for when, design, colour in zip(names, (found.before, found.after), _COLOURS, strict=True):
        loops = found.shaft.within(design.shaft())
        curve = loops.speed_open(2.0 * np.pi * f, found.bode.prediction.delay)
        label = f"{when}, predicted with the load" + ("" if stable(found.shaft, design) else ": unstable")
        gain.semilogx(f, 20.0 * np.log10(np.abs(curve)), color=colour, lw=1.0, label=label)
        phase.semilogx(f, _degrees(curve), ".", ms=1.5, color=colour)
    good = response.good
    gain.semilogx(response.frequency[good], response.decibels[good], ".", color="black", ms=3, label="after, measured")
    phase.semilogx(response.frequency[good], _degrees(response.value[good]), ".", color="black", ms=3)
    gain.axhline(0.0, color="black", lw=0.6)
    gain.axhline(-20.0 * np.log10(GAIN_MIN), color="grey", lw=0.6, ls="--")
    for edge in (-180.0 + found.request.phase_min, 180.0 - found.request.phase_min):
        phase.axhline(edge, color="grey", lw=0.6, ls="--")
    for when, moves, colour in zip(names, (found.moves_before, found.moves), _COLOURS, strict=True):
        for move in moves[:1]:
            time, reference = move.trace.time - move.start, move.trace["position_ref"]
            origin = float(reference[0])
            position.plot(time, move.trace["position"] - origin, color=colour, lw=1.0, label=when)
            position.plot(time, reference - origin, color="black", lw=0.6, ls=":")
            error.plot(time, move.trace["position"] - reference, color=colour, lw=1.0, label=when)
    phase.set_yticks(range(-180, 181, 60))
    for plot, title, y in (
        (gain, f"{name}: open speed loop, dashed: factor {GAIN_MIN:g}", "gain [dB]"),
        (phase, f"dashed: {found.request.phase_min:g} degrees from instability", "phase [degrees]"),
        (position, "move, dotted: set-point", "position [rad]"),
        (error, "deviation from the set-point", "position [rad]"),
    ):
        plot.set_title(title, fontsize="medium")
        plot.set_ylabel(y)
        plot.grid(alpha=0.3, which="both")
    for plot in (gain, phase):
        frequency_axis(plot)
    for plot in (position, error):
        plot.set_xlabel("time [s]")
    for plot in (gain, position):
        plot.legend(fontsize="small")
    write_figure(figure, path)


def _degrees(value: Any) -> Any:
    """Phase between -180 and 180 degrees."""
    return np.degrees(np.angle(value))
