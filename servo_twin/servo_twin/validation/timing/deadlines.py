"""Duration of each kind of handler, and time margin to the load of its duties.

The deadline of a loop is the load of its duties, half a PWM period after the sampling of its currents. Duties that are
released later have missed the deadline, as they become active at the next load.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.table_text import aligned
from servo_msgs_py.units import PERIOD_NS, SLOW_PERIODS

from servo_twin.validation.experiments.outcome import Bound, Row
from servo_twin.validation.timing.chip_map import LOOPS, SLOTS, Loop
from servo_twin.validation.timing.trace import CLOCK, ChipTrace, Kind

PERIOD: Final = round(PERIOD_NS * 1e-9 / CLOCK)  # PWM period [clocks]
MARGIN_MIN: Final = 0.20
"""Smallest permitted margin, relative to the time from sample to load."""
LDOK: Final = 0x7
"""Bits of MCTRL that release the duties of the three phases."""
OUTPUTS: Final = 0x770
"""Bits of OUTEN that enable the gate signals of the three phases."""
BUSY_MAX: Final = 0.75
"""Largest permitted utilisation of the core by all handlers."""


@dataclass(frozen=True)
class Handler:
    """All runs of one kind of handler."""

    name: str  # loop and subsequent task
    runs: int
    begin: float  # latest start, from the sample [s]
    written: float
    """Latest release of the duties, from the sample; without a release the latest end [s]. Runs without duties because
    the outputs are off have no deadline, and are included only if there are no others."""
    end: float  # latest end, from the sample [s]
    deadline: float  # load of the duties, from the sample [s]
    margin: float  # minimum margin relative to the time from sample to load; negative: missed
    busy: float  # fraction of the time of the core


def handlers(trace: ChipTrace, first_m1: int) -> list[Handler]:
    """Handlers by loop and slot.

    Parameters
    ----------
    trace : ChipTrace
        Trace of several slow ticks.
    first_m1 : int
        Time of the first M1 after reset, in PWM period 1 [clocks].
    """
    clocks = trace.entries["clock"]
    span = float(clocks[-1] - clocks[0]) if clocks.size else 0.0
    return [handler for loop in LOOPS for handler in _of_loop(trace, loop, first_m1, span)]


@dataclass(frozen=True)
class Runs:
    """Times of all runs of the handler of one loop [clocks]."""

    begin: NDArray[np.int64]  # start of the handler
    end: NDArray[np.int64]  # end of the handler
    sample: NDArray[np.int64]  # sample that started the handler
    load: NDArray[np.int64]  # load of the duties (deadline)
    released: NDArray[np.int64]  # release of the duties; without a release the end
    with_deadline: NDArray[np.bool_]  # false: no release because the outputs are off, no deadline


def runs_of(trace: ChipTrace, loop: Loop) -> Runs:
    """Runs of the handler of a loop with the sample in the trace."""
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


def _of_loop(trace: ChipTrace, loop: Loop, first_m1: int, span: float) -> list[Handler]:
    runs = runs_of(trace, loop)
    # M2 is half a period after M1; both may start late, and M1 a few clocks early.
    slots = (1 + (runs.begin - first_m1 + PERIOD // 8) // PERIOD) % SLOW_PERIODS
    result = []
    for slot, name in SLOTS.items():
        chosen = slots == slot
        if not chosen.any():
            continue
        with_deadline = chosen & runs.with_deadline if (chosen & runs.with_deadline).any() else chosen
        begins, ends, sample = runs.begin[chosen], runs.end[chosen], runs.sample[chosen]
        due, written = (runs.load - runs.sample)[with_deadline], (runs.released - runs.sample)[with_deadline]
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
    """First of the instants within each run, or its end, and whether there is one.

    Only the first counts: a change of state writes further ones after the loop.
    """
    if instants.size == 0:
        return runs[:, 1], np.zeros(runs.shape[0], np.bool_)
    first = instants[np.clip(np.searchsorted(instants, runs[:, 0]), None, instants.size - 1)]
    within = (first >= runs[:, 0]) & (first <= runs[:, 1])
    return np.where(within, first, runs[:, 1]), within


def _outputs_off(trace: ChipTrace, loop: Loop, runs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """True if the outputs of a motor are known to be off at the start of a run."""
    writes = trace.of(Kind.WRITE, loop.outputs)
    if writes.size == 0:
        return np.zeros(runs.shape[0], np.bool_)
    last = np.searchsorted(writes["clock"].astype(np.int64), runs[:, 0], side="right") - 1
    return np.asarray((last >= 0) & (writes["b"][np.clip(last, 0, None)] & OUTPUTS == 0))


def busy(trace: ChipTrace) -> float:
    """Utilisation of the core by all handlers (0 .. 1); nested handlers are counted once."""
    depth, begin, total = 0, 0, 0
    for entry in trace.entries[np.isin(trace.entries["kind"], (Kind.ENTER, Kind.LEAVE))]:
        clock = int(entry["clock"])
        if entry["kind"] == Kind.ENTER:
            begin = clock if depth == 0 else begin
            depth += 1
        elif depth > 0:  # else started before the recording
            depth -= 1
            total += clock - begin if depth == 0 else 0
    clocks = trace.entries["clock"]
    return total / float(clocks[-1] - clocks[0]) if clocks.size > 1 else 0.0


def rows(trace: ChipTrace, first_m1: int, what: str = "") -> list[Row]:
    """Rows for each kind of handler, and for the core.

    Parameters
    ----------
    trace, first_m1
        See `handlers`.
    what : str
        Prefix of the names.
    """
    prefix = f"{what}: " if what else ""
    limits = Bound(100.0 * MARGIN_MIN, 100.0)
    result = [
        Row(
            f"{prefix}{each.name}, minimum margin",
            "F38: duties before their own load",
            100.0 * each.margin,
            "%",
            limits,
        )
        for each in handlers(trace, first_m1)
    ]
    share = Bound(0.0, 100.0 * BUSY_MAX)
    return [*result, Row(f"{prefix}core busy", "F38", 100.0 * busy(trace), "%", share)]


def lines(handlers: Sequence[Handler]) -> list[str]:
    """Table as text: largest times from the sample of the currents [us]."""
    head = ("handler", "runs", "begin", "duties", "end", "load", "margin", "core")
    body = [
        (
            each.name,
            str(each.runs),
            *(f"{1e6 * value:.2f}" for value in (each.begin, each.written, each.end, each.deadline)),
            f"{100 * each.margin:.0f} %",
            f"{100 * each.busy:.1f} %",
        )
        for each in handlers
    ]
    return aligned([head, *body])
