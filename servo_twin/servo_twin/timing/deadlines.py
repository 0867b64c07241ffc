"""How long each kind of handler takes, and how much of its time to the load of its own duties is left. Pure.

A loop has from the sample of its motor's currents to the load of its motor's duties, half a PWM period later. Duties
that come behind it wait for the next load: that is a miss, however soon the next load may be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_twin.experiments.outcome import Bound, Row
from servo_twin.timing.chip_map import LOOPS, SLOTS, Loop
from servo_twin.timing.trace import CLOCK, Kind, Trace

PERIOD: Final = round(PERIOD_NS * 1e-9 / CLOCK)  # of the PWM [clocks]
ROOM_MIN: Final = 0.20
"""Of the time from sample to load."""
LDOK: Final = 0x7
"""Bits of MCTRL that release the duties of the three phases."""
OUTPUTS: Final = 0x770
"""Bits of OUTEN that let the gate signals of the three phases out."""
BUSY_MAX: Final = 0.75
"""Share of the core that all handlers may take."""


@dataclass(frozen=True)
class Handler:
    """All runs of one kind of handler."""

    name: str  # the loop and the work that follows it
    runs: int
    begin: float  # latest begin, from the sample [s]
    written: float
    """Latest release of the loop's duties, from the sample; the latest end where none were written [s]. Without duties
    because the outputs are off nothing is late: such runs count only if there are no others."""
    end: float  # latest end, from the sample [s]
    deadline: float  # load of the duties, from the sample [s]
    room: float  # smallest part of the time from sample to load that was left; negative: missed
    busy: float  # share of the core's time


def handlers(trace: Trace, first_m1: int) -> list[Handler]:
    """Handlers by loop and slot.

    Parameters
    ----------
    trace : Trace
        Of some slow ticks.
    first_m1 : int
        Clock at which M1 began for the first time after reset: that was PWM period 1.
    """
    clocks = trace.entries["clock"]
    span = float(clocks[-1] - clocks[0]) if clocks.size else 0.0
    return [handler for loop in LOOPS for handler in _of_loop(trace, loop, first_m1, span)]


@dataclass(frozen=True)
class Runs:
    """Runs of one loop's handler, an element each [clocks]."""

    begin: NDArray[np.int64]  # of the handler
    end: NDArray[np.int64]  # of the handler
    sample: NDArray[np.int64]  # that it answers
    load: NDArray[np.int64]  # of its duties, which is its deadline
    released: NDArray[np.int64]  # time at which it released the duties; its end if it did not
    judged: NDArray[np.bool_]  # false where it released none because the outputs were off: there is no deadline then


def runs_of(trace: Trace, loop: Loop) -> Runs:
    """Runs of a loop's handler whose sample is in the trace."""
    runs = trace.handlers(loop.vector)
    cycles = trace.clocks(Kind.CYCLE, loop.phases[0])
    samples = trace.clocks(Kind.SAMPLE, loop.sample)
    index = np.searchsorted(samples, runs[:, 0], side="right") - 1
    runs, index = runs[index >= 0], index[index >= 0]
    sample = samples[index]
    cycle = np.searchsorted(cycles, sample, side="right") - 1
    runs, sample, cycle = runs[cycle >= 0], sample[cycle >= 0], cycle[cycle >= 0]
    load = cycles[cycle] + PERIOD // 2
    writes = trace.of(Kind.WRITE, loop.release)
    releases = writes["clock"][writes["b"] & LDOK == LDOK].astype(np.int64)
    released, has_released = _first_within(releases, runs)
    return Runs(runs[:, 0], runs[:, 1], sample, load, released, has_released | ~_outputs_off(trace, loop, runs))


def _of_loop(trace: Trace, loop: Loop, first_m1: int, span: float) -> list[Handler]:
    runs = runs_of(trace, loop)
    # M2 is half a period behind its M1, either may begin a little late, and M1 a few clocks early.
    slots = (1 + (runs.begin - first_m1 + PERIOD // 8) // PERIOD) % SLOW_PERIODS
    result = []
    for slot, name in SLOTS.items():
        chosen = slots == slot
        if not chosen.any():
            continue
        judged = chosen & runs.judged if (chosen & runs.judged).any() else chosen
        begins, ends, sample = runs.begin[chosen], runs.end[chosen], runs.sample[chosen]
        due, written = (runs.load - runs.sample)[judged], (runs.released - runs.sample)[judged]
        result.append(
            Handler(
                f"{loop.name} {name}",
                int(chosen.sum()),
                float((begins - sample).max()) * CLOCK,
                float(written.max()) * CLOCK,
                float((ends - sample).max()) * CLOCK,
                float(due.min()) * CLOCK,
                float(((due - written) / due).min()),
                float((ends - begins).sum()) / span,
            )
        )
    return result


def _first_within(instants: NDArray[np.int64], runs: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The first of some instants within each run, or its end; and whether there was one.

    Only the first: a change of state writes others behind the loop.
    """
    if instants.size == 0:
        return runs[:, 1], np.zeros(runs.shape[0], np.bool_)
    first = instants[np.clip(np.searchsorted(instants, runs[:, 0]), None, instants.size - 1)]
    within = (first >= runs[:, 0]) & (first <= runs[:, 1])
    return np.where(within, first, runs[:, 1]), within


def _outputs_off(trace: Trace, loop: Loop, runs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether a motor's outputs are known to be off when a run begins."""
    writes = trace.of(Kind.WRITE, loop.outputs)
    if writes.size == 0:
        return np.zeros(runs.shape[0], np.bool_)
    last = np.searchsorted(writes["clock"].astype(np.int64), runs[:, 0], side="right") - 1
    return np.asarray((last >= 0) & (writes["b"][np.clip(last, 0, None)] & OUTPUTS == 0))


def busy(trace: Trace) -> float:
    """Share (0 .. 1) of the core's time in handlers of any kind; what interrupts another one is counted once."""
    depth, begin, total = 0, 0, 0
    for entry in trace.entries[np.isin(trace.entries["kind"], (Kind.ENTER, Kind.LEAVE))]:
        clock = int(entry["clock"])
        if entry["kind"] == Kind.ENTER:
            begin = clock if depth == 0 else begin
            depth += 1
        elif depth > 0:  # else it had begun before the recording
            depth -= 1
            total += clock - begin if depth == 0 else 0
    clocks = trace.entries["clock"]
    return total / float(clocks[-1] - clocks[0]) if clocks.size > 1 else 0.0


def rows(trace: Trace, first_m1: int, what: str = "") -> list[Row]:
    """A row for each kind of handler, and one for the core.

    Parameters
    ----------
    trace, first_m1
        As for `handlers`.
    what : str
        Goes in front of the names.
    """
    prefix = f"{what}: " if what else ""
    room = Bound(100.0 * ROOM_MIN, 100.0)
    result = [
        Row(f"{prefix}{each.name}, least room", "F38: duties before their own load", 100.0 * each.room, "%", room)
        for each in handlers(trace, first_m1)
    ]
    share = Bound(0.0, 100.0 * BUSY_MAX)
    return [*result, Row(f"{prefix}core busy", "F38", 100.0 * busy(trace), "%", share)]


def lines(handlers: Sequence[Handler]) -> list[str]:
    """A table for people: microseconds from the sample of the currents, at worst."""
    head = ("handler", "runs", "begin", "duties", "end", "load", "room", "core")
    body = [
        (
            each.name,
            str(each.runs),
            *(f"{1e6 * value:.2f}" for value in (each.begin, each.written, each.end, each.deadline)),
            f"{100 * each.room:.0f} %",
            f"{100 * each.busy:.1f} %",
        )
        for each in handlers
    ]
    widths = [max(len(line[k]) for line in (head, *body)) for k in range(len(head))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in (head, *body)
    ]
