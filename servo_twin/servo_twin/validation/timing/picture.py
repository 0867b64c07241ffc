"""Pictures of a trace as in DRM F34, F35 and F38."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.figure import new_figure, write_figure

from servo_twin.simulation import SimulationError
from servo_twin.validation.timing.chip_map import LOOPS, PHASES, VECTOR_M1, VECTOR_M2, VECTOR_START, Loop
from servo_twin.validation.timing.deadlines import PERIOD, runs_of
from servo_twin.validation.timing.trace import CLOCK, ChipTrace, Kind

_US: Final = CLOCK * 1e6
_COLOURS: Final = ("tab:blue", "tab:orange")
_PAIRS: Final = 3


def draw(pwm_cycle: ChipTrace, start: ChipTrace, path: Path) -> None:
    """Draw the PWM cycle of both loops and the start.

    Parameters
    ----------
    pwm_cycle : ChipTrace
        Several periods with both axes in closed-loop control.
    start : ChipTrace
        Trace from power-on until both loops run.
    path : Path
        File of the picture.

    Raises
    ------
    SimulationError
        If the trace is shorter than six periods.
    """
    periods = pwm_cycle.clocks(Kind.CYCLE, PHASES[0][0])
    if periods.size < 6:
        raise SimulationError("the trace is shorter than six PWM periods")
    begin, period = int(periods[1]), int(periods[2] - periods[1])
    figure = new_figure(12.0, 16.0, 110)
    plots = figure.subplots(4, 1, height_ratios=(11, 6, 5, 5))
    _timing(plots[0], pwm_cycle, begin, begin + 2 * period)
    _scan(plots[1], pwm_cycle, begin, begin + period + period // 2)
    _scope(plots[2], pwm_cycle, begin, begin + 4 * period)
    _start(plots[3], start)
    write_figure(figure, path)


def margins(trace: ChipTrace, loop: Loop) -> NDArray[np.int64]:
    """Intervals from the release of the duties to their load; a missed load is before the release.

    Parameters
    ----------
    trace : ChipTrace
    loop : Loop

    Returns
    -------
    ndarray, shape (n, 2)
        Release and load [clocks], for each run with a deadline.
    """
    runs = runs_of(trace, loop)
    return np.column_stack([runs.released, runs.load])[runs.with_deadline]


# ---- parts -----------------------------------------------------------------------------------------------------------


class _Channels:
    """Channels of a logic analyser, one below the other; time in microseconds from the left edge."""

    def __init__(self, plot: Any, title: str, begin: int, end: int) -> None:
        self._plot, self._begin, self._end = plot, begin, end
        self._names: list[str] = []
        plot.set_title(title, fontsize="medium", loc="left")
        plot.set_xlim(0.0, (end - begin) * _US)
        plot.set_xlabel("time [us]")
        plot.grid(axis="x", alpha=0.3)

    def _next(self, name: str) -> float:
        self._names.append(name)
        return -float(len(self._names))

    def _time(self, clocks: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.asarray((clocks - self._begin) * _US)

    def levels(self, name: str, intervals: NDArray[np.int64], colour: str) -> None:
        """Draw a signal that is high within the intervals."""
        base = self._next(name)
        clocks, level = [self._begin], [0.0]
        for first, last in intervals:
            clocks += [first, first, last, last]
            level += [0.0, 1.0, 1.0, 0.0]
        clocks.append(self._end)
        level.append(0.0)
        self._plot.plot(self._time(np.asarray(clocks)), base + 0.75 * np.asarray(level), colour, linewidth=1.2)

    def saw(self, name: str, starts: NDArray[np.int64], colour: str) -> None:
        """Draw a counter that increases from each start to the next."""
        base = self._next(name)
        for first, last in itertools.pairwise(starts):
            time = self._time(np.asarray([first, last]))
            self._plot.plot([*time, time[1]], [base, base + 0.75, base], colour, linewidth=1.0)

    def marks(self, name: str, clocks: NDArray[np.int64], texts: list[str], colour: str) -> None:
        """Draw labelled instants."""
        base = self._next(name)
        inside = (clocks >= self._begin) & (clocks <= self._end)
        for time, text in zip(self._time(clocks[inside]), np.asarray(texts)[inside], strict=True):
            self._plot.plot([time, time], [base, base + 0.75], colour, linewidth=1.2)
            self._plot.text(time, base + 0.4, f" {text}", fontsize="xx-small", color=colour, clip_on=True)

    def margins(self, name: str, intervals: NDArray[np.int64], colour: str) -> None:
        """Draw bars labelled with their lengths."""
        base = self._next(name)
        for first, last in intervals[(intervals[:, 1] > self._begin) & (intervals[:, 0] < self._end)]:
            left, right = self._time(np.asarray([first, last]))
            bar = {"color": colour if last > first else "tab:red", "alpha": 0.4}
            self._plot.fill_between([left, right], base, base + 0.75, **bar)
            self._plot.text(left, base + 0.4, f" {right - left:.1f} us", fontsize="xx-small", clip_on=True)

    def finish(self) -> None:
        self._plot.set_yticks([0.35 - k for k in range(1, len(self._names) + 1)], self._names, fontsize="small")
        self._plot.set_ylim(-len(self._names) - 0.3, 0.1)


def _timing(plot: Any, trace: ChipTrace, begin: int, end: int) -> None:
    channels = _Channels(plot, "F34: both motors on one chip", begin, end)
    for motor, (phases, colour) in enumerate(zip(PHASES, _COLOURS, strict=True), start=1):
        channels.saw(f"counter of motor {motor}", trace.clocks(Kind.CYCLE, phases[0]), colour)
        channels.levels(f"motor {motor}, a, upper", trace.intervals(phases[0], 0), colour)
        channels.levels(f"motor {motor}, a, lower", trace.intervals(phases[0], 1), colour)
    samples = trace.of(Kind.SAMPLE)
    first = samples[samples["a"] < 8]
    texts = [{0: "t0", _PAIRS: "t2"}.get(int(a), "") for a in first["a"]]
    channels.marks("samples", first["clock"].astype(np.int64), texts, "tab:green")
    for motor, (vector, text, colour) in enumerate(
        zip((VECTOR_M1, VECTOR_M2), ("t1", "t3"), _COLOURS, strict=True), start=1
    ):
        runs = trace.handlers(vector)
        channels.levels(f"M{motor} ({text})", runs, colour)
        loads = trace.clocks(Kind.LOAD, PHASES[motor - 1][0])
        channels.marks(f"duties of motor {motor} load", loads, [""] * loads.size, colour)
        channels.margins(f"margin of M{motor} to its load", margins(trace, LOOPS[motor - 1]), colour)
    channels.finish()


def _scan(plot: Any, trace: ChipTrace, begin: int, end: int) -> None:
    channels = _Channels(plot, "F35: the converter's sequence, sample: pin", begin, end)
    syncs = trace.of(Kind.SYNC)
    words = ["accepted" if b else "ignored" for b in syncs["b"]]
    channels.marks("triggers", syncs["clock"].astype(np.int64), words, "tab:red")
    samples = trace.of(Kind.SAMPLE)
    for converter, name in enumerate("AB"):
        own = samples[samples["a"] // 8 == converter]
        for pair in range(2 * _PAIRS):
            held = own[own["a"] % 8 == pair]
            texts = [f"{entry['a']}: AN{name}{entry['b'] % 8}" for entry in held]
            label = f"{name}, {'t0' if pair < _PAIRS else 't2'}, pair {pair}"
            channels.marks(label, held["clock"].astype(np.int64), texts, "tab:green")
    ends = trace.clocks(Kind.SCAN_END, 0)
    channels.marks("end of scan", ends, [""] * ends.size, "tab:red")
    channels.finish()


def _scope(plot: Any, trace: ChipTrace, begin: int, end: int) -> None:
    channels = _Channels(plot, "F38: lower gates of phase a, both interrupts", begin, end)
    for motor, (phases, colour) in enumerate(zip(PHASES, _COLOURS, strict=True), start=1):
        channels.levels(f"motor {motor}, a, lower", trace.intervals(phases[0], 1), colour)
    for motor, (vector, colour) in enumerate(zip((VECTOR_M1, VECTOR_M2), _COLOURS, strict=True), start=1):
        channels.levels(f"M{motor}", trace.handlers(vector), colour)
    channels.finish()


def _start(plot: Any, trace: ChipTrace) -> None:
    runs = trace.handlers(VECTOR_START)
    samples = trace.of(Kind.SAMPLE)
    if not (runs.size and samples.size):
        plot.set_title("4.3.3: no start", fontsize="medium", loc="left")
        return
    begin, end = int(runs[0, 0]) - 2 * PERIOD, int(runs[0, 1]) + 3 * PERIOD
    channels = _Channels(plot, "4.3.3: start of the sequence", begin, end)
    for motor, (phases, colour) in enumerate(zip(PHASES, _COLOURS, strict=True), start=1):
        channels.saw(f"counter of motor {motor}", trace.clocks(Kind.CYCLE, phases[0]), colour)
    channels.levels("start interrupt", runs, "tab:red")
    first = samples[samples["a"] < 8]
    channels.marks("samples", first["clock"].astype(np.int64), [f"{a}" for a in first["a"]], "tab:green")
    for motor, (vector, colour) in enumerate(zip((VECTOR_M1, VECTOR_M2), _COLOURS, strict=True), start=1):
        channels.levels(f"M{motor}", trace.handlers(vector), colour)
    channels.finish()
