"""Timing of DRM F34, F35, F38 and start of DRM 4.3.3, measured on a trace."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servo_twin.validation.experiments.outcome import Bound, Row
from servo_twin.validation.timing.chip_map import PHASES, START_STEPS, VECTOR_M1, VECTOR_M2, VECTOR_START
from servo_twin.validation.timing.trace import CLOCK, ChipTrace, Kind

PWM: Final = 16e3  # [Hz]
PAIRS: Final = 3  # pairs of samples per motor (F35)
MOTORS: Final = ("motor 1", "motor 2")
VECTORS: Final = (VECTOR_M1, VECTOR_M2)
NAMES: Final = ("M1", "M2")

PHASE_MAX: Final = 0.3
"""Largest deviation from 180 degrees, by the delay of the crossbar [degrees]."""
CENTRE_MAX: Final = 1.0e-6
"""Largest time from the centre of a window to the sample: delays of amplifier and converter [s]."""
SKEW_MAX: Final = 0.5e-6
"""High-side pulses start with the previous duty and end with the new one, which is loaded at the centre [s]."""
CONVERSION: Final = 0.3e-6
"""Conversion time of each pair after the first: 6 clocks of the ADC at 20 MHz [s]."""

DATA_AGE_MAX: Final = 5e-6
"""Longest time from the data to the interrupt that reads them [s]; later data belong to another half period."""


def pwm_cycle(trace: ChipTrace) -> list[Row]:
    """Rows for the PWM cycle t0..t3, from a trace of several hundred periods with both axes in closed-loop control."""
    return [*_carriers(trace), *_samples(trace), *_scans(trace), *_interrupts(trace)]


# ---- carriers (F33, F34) ---------------------------------------------------------------------------------------------


def _carriers(trace: ChipTrace) -> list[Row]:
    rows: list[Row] = []
    for motor, phases in zip(MOTORS, PHASES, strict=True):
        cycles = [trace.clocks(Kind.CYCLE, submodule) for submodule in phases]
        periods = np.diff(cycles[0])
        clocks = 1.0 / (PWM * CLOCK)
        exact = Bound(clocks - 0.5, clocks + 0.5)
        rows.append(Row(f"{motor}: period, shortest", "4.3.1: 16 kHz", _min(periods), "clocks", exact))
        rows.append(Row(f"{motor}: period, longest", "4.3.1: 16 kHz", _max(periods), "clocks", exact))
        apart = _apart(cycles)
        rows.append(Row(f"{motor}: counters apart", "F33: in step", apart, "clocks", Bound(0.0, 0.0)))
    first, second = (trace.clocks(Kind.CYCLE, phases[0]) for phases in PHASES)
    turns = 360.0 * _after(first, second) * CLOCK * PWM
    around = Bound(180.0 - PHASE_MAX, 180.0 + PHASE_MAX)
    rows.append(Row("motor 2 behind motor 1, minimum", "F34: 180 degrees", _min(turns), "deg", around))
    rows.append(Row("motor 2 behind motor 1, maximum", "F34: 180 degrees", _max(turns), "deg", around))
    return rows


def _apart(counters: Sequence[NDArray[np.int64]]) -> float | None:
    """Largest time difference of the events of counters that should be simultaneous [clocks]."""
    size = min(clocks.size for clocks in counters)
    if size == 0 or max(clocks.size for clocks in counters) > size + 1:
        return None
    return float(np.ptp([clocks[:size] for clocks in counters], axis=0).max())


# ---- samples (F34) ---------------------------------------------------------------------------------------------------


def _samples(trace: ChipTrace) -> list[Row]:
    rows: list[Row] = []
    for number, (motor, phases) in enumerate(zip(MOTORS, PHASES, strict=True)):
        own, foreign = number * PAIRS, (1 - number) * PAIRS + 1
        for what, sample, switch, side, maximum in (
            ("currents", own, 1, "low", CENTRE_MAX),
            ("offsets", foreign, 0, "high", CENTRE_MAX + CONVERSION + SKEW_MAX),
        ):
            instants = trace.clocks(Kind.SAMPLE, sample)
            offsets = [_from_centre(trace.intervals(phase, switch), instants) for phase in phases]
            both = np.concatenate(offsets) * CLOCK if offsets else np.empty(0)
            within = Bound(-SKEW_MAX * 1e6 if side == "high" else 0.0, maximum * 1e6)
            text = f"F34: {side}-side centre"
            rows.append(Row(f"{motor}: {what} after the centre, minimum", text, _scaled(_min(both)), "us", within))
            rows.append(Row(f"{motor}: {what} after the centre, maximum", text, _scaled(_max(both)), "us", within))
    return rows


def _from_centre(intervals: NDArray[np.int64], instants: NDArray[np.int64]) -> NDArray[np.float64]:
    """Time from the centre of the interval around an instant to the instant [clocks]; others are omitted."""
    if intervals.size == 0 or instants.size == 0:
        return np.empty(0)
    index = np.searchsorted(intervals[:, 0], instants, side="right") - 1
    chosen = intervals[np.clip(index, 0, None)]
    inside = (index >= 0) & (instants <= chosen[:, 1])
    return np.asarray((instants - chosen.mean(axis=1))[inside])


# ---- scans (F35) -----------------------------------------------------------------------------------------------------


def _scans(trace: ChipTrace) -> list[Row]:
    """Rows for the scans: six pairs, with a pause after the third."""
    ends = trace.clocks(Kind.SCAN_END, 0)
    samples = trace.of(Kind.SAMPLE)
    clocks, pairs = samples["clock"].astype(np.int64), samples["a"] % 8
    first = samples["a"] < 8
    in_order, together, pauses = 0, 0, []
    for begin, end in itertools.pairwise(ends):
        scan = (clocks > begin) & (clocks <= end)
        on_a = pairs[scan & first]
        in_order += on_a.tolist() == list(range(2 * PAIRS))
        together += _same(clocks, pairs, scan & first, scan & ~first)
        instants = clocks[scan & first]
        if instants.size == 2 * PAIRS:
            pauses.append(instants[PAIRS] - instants[PAIRS - 1])
    count = max(ends.size - 1, 0)
    whole = Bound(1.0, 1.0)
    half = 0.5 / PWM * 1e6
    pause = _scaled(_min(np.asarray(pauses) * CLOCK))
    return [
        Row("scans with six pairs in order", "F35", _share(in_order, count), "of all", whole),
        Row("scans with both converters together", "F35: parallel", _share(together, count), "of all", whole),
        Row("pause after the third pair, minimum", "F35: until t2", pause, "us", Bound(0.5 * half, half)),
    ]


def _same(
    clocks: NDArray[np.int64], pairs: NDArray[np.uint32], one: NDArray[np.bool_], other: NDArray[np.bool_]
) -> bool:
    """True if both converters sample the same pairs at the same times."""
    return bool(np.array_equal(clocks[one], clocks[other]) and np.array_equal(pairs[one], pairs[other]))


# ---- interrupts (F34, F38) -------------------------------------------------------------------------------------------


def _interrupts(trace: ChipTrace) -> list[Row]:
    rows: list[Row] = []
    periods = trace.clocks(Kind.CYCLE, PHASES[0][0])
    ready = (trace.clocks(Kind.SAMPLE, PAIRS - 1), trace.clocks(Kind.SCAN_END, 0))
    for name, vector, data in zip(NAMES, VECTORS, ready, strict=True):
        runs = trace.handlers(vector)
        per_period = _share(runs.shape[0], periods.size)
        about_one = Bound(1.0 - 2.0 / max(periods.size, 1), 1.0 + 2.0 / max(periods.size, 1))
        rows.append(Row(f"{name} per PWM period", "F38: once", per_period, "", about_one))
        since = _scaled(_min(_before(data, runs[:, 0]) * CLOCK))
        minimum = CONVERSION if vector == VECTOR_M1 else 0.0
        text = "t1: after three conversions" if vector == VECTOR_M1 else "t3: after the scan"
        rows.append(
            Row(f"{name} begins after its data, minimum", text, since, "us", Bound(minimum * 1e6, DATA_AGE_MAX * 1e6))
        )
    order = _order(trace)
    rows.append(Row("periods with t0, t1, t2, t3 in order", "F34", order, "of all", Bound(1.0, 1.0)))
    overlap = _overlap(trace.handlers(VECTOR_M1), trace.handlers(VECTOR_M2))
    rows.append(Row("M1 and M2 at the same time", "never", overlap, "times", Bound(0.0, 0.0)))
    return rows


def _order(trace: ChipTrace) -> float | None:
    """Fraction of the periods with the order: currents of motor 1, M1, currents of motor 2, M2."""
    begins = (
        trace.clocks(Kind.SAMPLE, 0),
        trace.clocks(Kind.ENTER, VECTOR_M1),
        trace.clocks(Kind.SAMPLE, PAIRS),
        trace.clocks(Kind.ENTER, VECTOR_M2),
    )
    marks = np.concatenate([np.full(clocks.size, k) for k, clocks in enumerate(begins)])
    sequence = marks[np.argsort(np.concatenate(begins), kind="stable")]
    if sequence.size < 2:
        return None
    return float(np.mean((sequence[1:] - sequence[:-1]) % 4 == 1))


def _overlap(one: NDArray[np.int64], other: NDArray[np.int64]) -> float:
    """Number of handlers that start before another one has ended."""
    runs = np.concatenate([one, other])
    runs = runs[np.argsort(runs[:, 0], kind="stable")]
    return float(np.sum(runs[1:, 0] < runs[:-1, 1]))


# ---- start (4.3.3) ---------------------------------------------------------------------------------------------------


def start(trace: ChipTrace) -> list[Row]:
    """Rows for the start interrupt, from a trace from power-on until both loops run."""
    runs = trace.handlers(VECTOR_START)
    writes = trace.of(Kind.WRITE)
    rows = [Row("start interrupt", "4.3.3: runs once", float(runs.shape[0]), "times", Bound(1.0, 1.0))]
    steps: Sequence[tuple[int, int]] = []
    if runs.shape[0]:
        inside = writes[(writes["clock"] >= runs[0, 0]) & (writes["clock"] <= runs[0, 1])]
        steps = [(int(entry["a"]), int(entry["b"])) for entry in inside]
    expected = [(address, value) for _, address, value in START_STEPS]
    done = _in_order(steps, expected)
    all_steps = Bound(float(len(expected)), float(len(expected)))
    rows.append(Row("steps of the start in order", "4.3.3", float(done), "", all_steps))
    samples = trace.of(Kind.SAMPLE)
    first = float(samples["a"][0] % 8) if samples.size else None
    rows.append(Row("first pair that is sampled", "t0: motor 1", first, "", Bound(0.0, 0.0)))
    after = runs[0, 1] if runs.shape[0] else 0
    handlers = [int(entry["a"]) for entry in trace.of(Kind.ENTER) if entry["clock"] >= after and entry["a"] in VECTORS]
    alternate = [VECTORS[k % 2] for k in range(len(handlers))]
    right = _share(sum(a == b for a, b in zip(handlers, alternate, strict=True)), len(handlers))
    rows.append(Row("M1, M2, M1, ... from the start on", "F34", right, "of all", Bound(1.0, 1.0)))
    early = [e for e in trace.of(Kind.ENTER) if e["clock"] < (runs[0, 0] if runs.shape[0] else 0) and e["a"] in VECTORS]
    rows.append(Row("M1 or M2 before the start", "4.3.3: disabled", float(len(early)), "times", Bound(0.0, 0.0)))
    return rows


def _in_order(steps: Sequence[tuple[int, int]], expected: Sequence[tuple[int, int]]) -> int:
    """Number of expected steps that are found in order."""
    done = 0
    for step in steps:
        if done < len(expected) and step == expected[done]:
            done += 1
    return done


# ---- helpers ---------------------------------------------------------------------------------------------------------


def _after(instants: NDArray[np.int64], events: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time from each instant to the next event [clocks]; instants without a next event are omitted."""
    index = np.searchsorted(events, instants, side="left")
    found = index < events.size
    return np.asarray(events[index[found]] - instants[found])


def _before(events: NDArray[np.int64], instants: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time from the last event to each instant [clocks]; instants without a previous event are omitted."""
    index = np.searchsorted(events, instants, side="right") - 1
    found = index >= 0
    return np.asarray(instants[found] - events[index[found]])


def _min(values: NDArray[Any]) -> float | None:
    return float(values.min()) if values.size else None


def _max(values: NDArray[Any]) -> float | None:
    return float(values.max()) if values.size else None


def _scaled(seconds: float | None) -> float | None:
    """Convert seconds to microseconds."""
    return None if seconds is None else seconds * 1e6


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
