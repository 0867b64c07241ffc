"""A load on a spring, which the tuning does not know: the drive finds that it oscillates, and becomes quiet."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace

from servo_twin.plant import PlantConfig
from servo_twin.sprung_load import SprungLoad
from servo_twin.validation.experiments.outcome import BEYOND, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.rig import features, record, spinning

NAME: Final = "resonance"
HELP: Final = """\
Beyond the reference design: half of the inertia, or more, is behind a spring of 80, 150 or 300 Hz with 2 % damping, and
the tuning is that of a rigid shaft. Most of these loops are unstable. The drive has to find that within half a second,
name the frequency, and reduce its gains until the shaft is quiet, or stop with a fault."""

FREQUENCIES: Final = (80.0, 150.0, 300.0)  # resonance [Hz]
RATIOS: Final = (1.0, 3.0, 10.0)  # inertia of the load over that of the rotor
DAMPING: Final = 0.02
SPEEDS: Final = {"M/T": False, "observer": True}  # methods of the speed: feature SPEED_OBSERVER

TARGET: Final = 10.0 * math.pi  # excites the resonance [rad]
SECONDS: Final = 2.0
RINGING: Final = 1.0  # standard deviation of the current that has to be noticed [A]
FOUND_MAX: Final = 0.8  # since the start of the move [s]
COUNTED: Final = 0.2  # time in which the board counts its periods [s]
SHORT: Final = 0.1  # time in which its frequency is measured [s]
QUIET: Final = 0.2  # at the end [s]
SWING_MAX: Final = 20.0  # peak to peak: a current of a quarter of its limit, which is not found, at 150 Hz [counts]
FREQUENCY_ERROR: Final = 0.15  # it changes while the oscillation grows


def move(plant: PlantConfig, seed: int, load: SprungLoad | None, *, observer: bool) -> list[Trace]:
    """One move of both axes, in opposite directions; speed by the M/T method or by the observer."""
    if load is not None:
        first, second = map(load.of, plant.axes)
        plant = replace(plant, axes=(first, second))
    with spinning(plant, seed) as board:
        for axis in range(AXES):
            features(board, axis, SPEED_OBSERVER=observer)
            write_axis(board, "cmd.position", axis, TARGET * (-1.0) ** axis)
        recorded = record(board, range(AXES), SECONDS, may_fail=True)
    return [recorded[axis] for axis in range(AXES)]


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """A rigid shaft, then every frequency with every ratio."""
    for speed, observer in SPEEDS.items():
        found = 0
        for axis, rigid in enumerate(move(plant, seed, None, observer=observer)):
            judge = Judge(f"{speed}, rigid, {axis_name(axis)}, ", BEYOND)
            yield judge.none("oscillations found", float(rigid["oscillation"].any()))
        for load in (SprungLoad(frequency, ratio, DAMPING) for frequency in FREQUENCIES for ratio in RATIOS):
            recorded = move(plant, seed, load, observer=observer)
            name = f"{speed}, {load.frequency:g} Hz, 1:{load.ratio:g}"
            for axis, r in enumerate(recorded):
                found += bool(r["oscillation"].any())
                yield from _rows(Judge(f"{name}, {axis_name(axis)}, ", BEYOND), r)
            yield Panel(
                name, "time [s]", "i_q [A]", [Curve(axis_name(k), r.time, r["i_q"]) for k, r in enumerate(recorded)]
            )
        yield f"{speed}: oscillation found in {found} of {AXES * len(FREQUENCIES) * len(RATIOS)} moves"


def _rows(judge: Judge, r: Trace) -> Iterator[Row]:
    yield judge("swing at the end", swing(r.part(SECONDS - QUIET)), "counts", maximum=SWING_MAX)
    noticed = (r["oscillation"] != 0) | (r["faults"] != 0)
    found = float(r.time[np.argmax(noticed)]) if noticed.any() else None
    if found is None and not rings(r.part(FOUND_MAX - SHORT, FOUND_MAX)):
        return
    yield judge("time until found", found, "s", 0.0, FOUND_MAX)
    if found is not None and found >= COUNTED and r["oscillation"].any():
        first = int(r["oscillation"][np.argmax(r["oscillation"] != 0)])
        before = alternation(r.part(found - SHORT, found))
        yield judge.near("frequency over that of the rotor", first / before, "", 1.0, FREQUENCY_ERROR)


def about_motion(r: Trace, column: str) -> NDArray[np.float64]:
    """Deviation of a column from a parabola through it."""
    return np.asarray(r[column] - np.polynomial.Polynomial.fit(r.time, r[column], 2)(r.time))


def swing(r: Trace) -> float:
    """Swing of the measured position about its own motion, peak to peak [counts]."""
    return float(np.ptp(about_motion(r, "position")))


def rings(r: Trace) -> bool:
    """Whether the current is large and the shaft alternates at least as fast as the lowest resonance."""
    return bool(np.std(r["i_q"]) > RINGING) and alternation(r) >= FREQUENCIES[0]


def alternation(r: Trace) -> float:
    """Frequency of the true speed of the rotor, which has fewer harmonics than the current [Hz]."""
    return float(np.count_nonzero(np.diff(about_motion(r, "omega") > 0.0)) / (2.0 * len(r) * r.step))
