"""Four methods of speed measurement on the same shaft: M, T, M/T and enhanced M/T (DRM 2.4.4 to 2.4.6, F17 to F19)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import COUNTS_PER_TURN, PERIOD_NS, TICK

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.outcome import Curve, Item, Judge, Panel, experiment
from servo_twin.validation.experiments.rig import COUNT, RPM, edge_shift, features, fresh_board, record

NAME: Final = "mt-speed"
HELP: Final = """\
Speed from encoder pulses by the methods M, T, M/T and enhanced M/T, on one shaft, motor off and driven from outside.
According to the reference design M is inaccurate at low speed, T at high speed, M/T at neither (2.4.4); during
deceleration M/T stagnates until the next pulse (2.4.5, F18), the enhanced method does not (2.4.6, F19: M2 = 4 and
TMR3 = 2, 5, 8, 11 give 1, 4/5, 4/8, 4/11 of the speed, the next pulse after 12 gives 1/3)."""

AXIS: Final = 0
SPEEDS: Final = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 3500.0)  # [rpm]
TIMER: Final = 100e6 / 128.0
"""Clock of the time stamps, bus clock / 128 (DRM 2.4.4) [Hz]."""

BRAKE_FROM: Final = 60.0 * RPM
BRAKE_TIME: Final = 0.4  # [s]
BRAKE_REST: Final = 0.15  # [s]
SNAPSHOT: Final = -0.5 * PERIOD_NS * 1e-9
"""Time of the speed measurement of a slow tick, relative to the end of the tick [s]."""

FLOOR: Final = 1.05
"""Permitted error in units of 1/M2: two truncated time stamps, and the fraction format.

With deviating edges their largest deviation is added to the one tick.
"""

F19_M2: Final = 4
F19_TIMER: Final = (2, 5, 8, 11)
F19_NEXT: Final = 12
F19_FACTORS: Final = (Fraction(1), Fraction(4, 5), Fraction(4, 8), Fraction(4, 11), Fraction(1, 3))


def enhanced_factor(m2: int, timer: int) -> Fraction:
    """F19: factor of the last speed, measured over `m2` ticks, at `timer` ticks after its edge."""
    return Fraction(m2, timer) if timer > m2 else Fraction(1)


def worked_example() -> tuple[Fraction, ...]:
    """The five factors of F19; the last one is the speed at the next edge, E33."""
    return (*(enhanced_factor(F19_M2, timer) for timer in F19_TIMER), Fraction(F19_M2, F19_NEXT))


@dataclass(frozen=True)
class Edges:
    """Encoder edges of a recording: time of each [s] and its number; even numbers are edges of track B."""

    time: NDArray[np.float64]  # [s]
    number: NDArray[np.int64]  # even numbers are edges of track B

    def of_b(self) -> Edges:
        b = self.number % 2 == 0
        return Edges(self.time[b], self.number[b])


def edges_of(recording: Trace, start_angle: float, shift: float = 0.0) -> Edges:
    """Edges of a shaft that rotates forwards, with constant acceleration within each slow tick.

    All edges are shifted by `shift` [counts].
    """
    theta = np.concatenate([[start_angle], np.maximum.accumulate(recording["theta"])])
    omega = np.concatenate([[recording["omega"][0]], recording["omega"]])
    time = np.concatenate([[recording.time[0] - TICK], recording.time])
    first_edge, end = np.floor(theta[[0, -1]] / COUNT - shift) + 1
    number = np.arange(first_edge, end).astype(np.int64)
    angle = (number + shift) * COUNT
    k = np.clip(np.searchsorted(theta, angle, side="left") - 1, 0, theta.size - 2)
    distance = angle - theta[k]
    whole = theta[k + 1] - theta[k]
    # The initial speed follows more accurately from the mean speed than from a stop within the tick.
    first, last = omega[k], 2.0 * whole / TICK - omega[k]
    slope = (last - first) / TICK
    root = np.sqrt(np.maximum(first**2 + 2.0 * slope * distance, 0.0))
    inside = np.divide(2.0 * distance, first + root, out=np.zeros_like(distance), where=first + root > 0.0)
    return Edges(time[k] + np.clip(inside, 0.0, TICK), number)


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty by deviating encoder edges; 0 for ideal edges."""

    of_age: NDArray[np.float64]  # error bound of the last captured edge at every slow tick [timer ticks]
    of_m2: NDArray[np.float64]  # error bound of the interval between the last two captured edges [timer ticks]
    of_edge: NDArray[np.bool_]  # the occurrence of an edge is uncertain
    longer: NDArray[np.float64]
    """Ratio of the interval to the shortest possible one: at each end the next edge of track B (two counts) may be
    captured, if the edge is on the other side of the start of a slow loop."""


def uncertainty_of(
    recording: Trace, start_angle: float, shift: float, now: NDArray[np.float64], counts: NDArray[np.float64]
) -> Uncertainty:
    """Uncertainty of a recording.

    Parameters
    ----------
    recording : Trace
        Recording of the shaft.
    start_angle : float
        Angle before the recording [rad].
    shift : float
        Largest deviation of an edge, in both directions [counts].
    now : ndarray
        Start of the slow loops [s].
    counts : ndarray
        Counts between the last two captured edges.
    """
    edges, early, late = (edges_of(recording, start_angle, distance).of_b() for distance in (0.0, -shift, shift))
    captured = _captured(edges, now)
    number = edges.number[np.searchsorted(edges.time, captured)]
    first = np.interp(number, early.number, early.time, left=0.0)
    last = np.interp(number, late.number, late.time, right=np.inf)
    off = np.maximum(last - captured, captured - first) * TIMER
    k = np.searchsorted(captured, now, side="right") - 1
    of_age = np.where(k >= 1, off[np.maximum(k, 1)] if off.size > 1 else np.inf, np.inf)
    before = np.where(k >= 1, off[np.maximum(k, 1) - 1] if off.size > 1 else np.inf, np.inf)
    come, gone = (np.searchsorted(those.time, now, side="right") for those in (early, late))
    at = (early.number[0] - late.number[0]) // 2 if early.number.size and late.number.size else 0
    longer = np.maximum(counts, 2.0) / np.maximum(counts - 4.0, 2.0) if shift > 0.0 else np.ones_like(counts)
    return Uncertainty(of_age, of_age + before, come + at != gone, longer)


@dataclass(frozen=True)
class Methods:
    """Speeds at every slow tick, by method, and the timer values."""

    m: NDArray[np.float64]  # M method, from the true edges [rad/s]
    t: NDArray[np.float64]  # T method, from the true edges [rad/s]
    mt: NDArray[np.float64]  # M/T method, from the firmware [rad/s]
    enhanced: NDArray[np.float64]  # enhanced M/T method, from the firmware [rad/s]
    m2: NDArray[np.float64]  # timer ticks between the last two captured edges (M/T)
    age: NDArray[np.float64]  # timer ticks since the last captured edge
    from_edges: NDArray[np.float64]  # E33 and F19 for these edges [rad/s]
    t_m2: NDArray[np.float64]  # as `m2`, for the pulses of the T method [timer ticks]
    t_age: NDArray[np.float64]  # as `age`, for the pulses of the T method [timer ticks]
    uncertainty: Uncertainty  # uncertainty of `m2` and `age` by the encoder


def drive(plant: PlantConfig, seed: int, speed_at: Callable[[int], float], seconds: float, enhanced: bool) -> Trace:
    """Drive the shaft of a disabled motor externally; `speed_at` is the speed after each slow tick [rad/s]."""
    axis = plant.axes[AXIS]
    with fresh_board(plant, seed) as board:
        board.run(0.03)
        features(board, AXIS, ENHANCED_MT=enhanced)

        def act(k: int) -> None:
            omega, target = board.truth(AXIS).omega_m, speed_at(k)
            if target == 0.0 and omega == 0.0:
                board.set_load(AXIS, 0.0)
                return
            drag = axis.friction + axis.viscous * 0.5 * (omega + target)
            board.set_load(AXIS, -(axis.inertia * (target - omega) / TICK + drag))

        return record(board, [AXIS], seconds, act)[AXIS]


def start_angle(plant: PlantConfig, seed: int) -> float:
    """Angle of the shaft before the first motion [rad]."""
    angle = plant.drawn(seed).axes[AXIS].theta_start
    assert angle != "random"
    return angle


def methods(plant: PlantConfig, seed: int, speed_at: Callable[[int], float], seconds: float) -> tuple[Trace, Methods]:
    """One run with a speed [rad/s] by tick for `seconds` [s], evaluated with all methods."""
    plain = drive(plant, seed, speed_at, seconds, enhanced=False)
    better = drive(plant, seed, speed_at, seconds, enhanced=True)
    assert np.array_equal(plain["theta"], better["theta"]), "a disabled motor must not act on the shaft"
    edges = edges_of(better, start_angle(plant, seed))
    now = better.time + SNAPSHOT
    t_m2, t_age, _ = _intervals(edges, now, edges.time)
    m2, age, counts = _intervals(edges.of_b(), now, _captured(edges.of_b(), now))
    edge_speed = np.divide(counts * COUNT * TIMER, m2, out=np.zeros_like(m2), where=m2 > 0)
    factor = np.where(age > m2, m2 / np.maximum(age, 1.0), 1.0)
    found = Methods(
        m=np.diff(better["position"], prepend=0.0) * COUNT / TICK,
        t=np.divide(COUNT * TIMER, t_m2, out=np.zeros_like(t_m2), where=t_m2 > 0),
        mt=plain["speed"],
        enhanced=better["speed"],
        m2=m2,
        age=age,
        from_edges=np.where(age < 0x10000, edge_speed * factor, 0.0),
        t_m2=t_m2,
        t_age=t_age,
        uncertainty=uncertainty_of(better, start_angle(plant, seed), edge_shift(plant.axes[AXIS]), now, counts),
    )
    return better, found


def _captured(b_edges: Edges, now: NDArray[np.float64]) -> NDArray[np.float64]:
    """Times of the captured edges: the first one after each slow loop."""
    first = np.unique(np.searchsorted(b_edges.time, now, side="right"))
    return b_edges.time[first[first < b_edges.time.size]]


def _intervals(
    edges: Edges, now: NDArray[np.float64], captured: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Ticks between the last two captured edges, ticks since the last one, and counts between them, at each time."""
    last = np.searchsorted(captured, now, side="right") - 1
    known = last >= 1
    ticks = np.floor(captured * TIMER + 1e-6)
    number = edges.number[np.searchsorted(edges.time, captured)].astype(np.float64)
    k = np.maximum(last, 1)
    if captured.size < 2:
        return np.zeros_like(now), np.full_like(now, np.inf), np.zeros_like(now)
    m2 = np.where(known, ticks[k] - ticks[k - 1], 0.0)
    age = np.where(known, np.floor(now * TIMER) - ticks[k], np.inf)
    return m2, age, np.where(known, number[k] - number[k - 1], 0.0)


# ---- steady speed ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Steady:
    """Largest relative errors at one speed; `floor` is the error bound by M2, `_times` are errors relative to it."""

    m: float  # relative error, M method
    t: float  # relative error, T method
    mt: float  # relative error, M/T method
    enhanced: float  # relative error, enhanced M/T method
    floor: float  # error bound by M2 and the edges
    mt_times: float  # error relative to the bound, M/T method
    enhanced_times: float  # error relative to the bound, enhanced M/T method
    m2: float  # median [timer ticks]


def steady(plant: PlantConfig, seed: int, speed: float) -> Steady:
    """Largest errors at a constant speed [rad/s]."""
    spacing = 2.0 * COUNT / speed  # interval of the edges of track B [s]
    seconds = max(0.1, 6.0 * spacing)
    recording, found = methods(plant, seed, lambda k: speed, seconds)
    window = recording.time > 0.02 + 3.0 * spacing
    true = recording["omega"][window]

    def worst(measured: NDArray[np.float64], weight: NDArray[np.float64] | float = 1.0) -> float:
        return float(np.max(np.abs(measured[window] / true - 1.0) * weight))

    m2 = found.m2[window]
    floor = (1.0 + found.uncertainty.of_m2[window]) * found.uncertainty.longer[window] / m2
    return Steady(
        m=worst(found.m),
        t=worst(found.t),
        mt=worst(found.mt),
        enhanced=worst(found.enhanced),
        floor=float(floor.max()),
        mt_times=worst(found.mt, 1.0 / floor),
        enhanced_times=worst(found.enhanced, 1.0 / floor),
        m2=float(np.median(m2)),
    )


# ---- slowing down ---------------------------------------------------------------------------------------------------


def braking(k: int) -> float:
    """Speed that decreases linearly to zero and remains zero [rad/s]."""
    lead = 0.1
    return BRAKE_FROM * float(np.clip(1.0 - (k * TICK - lead) / BRAKE_TIME, 0.0, 1.0))


def stagnation(speed: NDArray[np.float64], overdue: NDArray[np.bool_]) -> float:
    """Longest time of a constant measured speed above zero while the next edge is overdue [s]."""
    same = np.concatenate([[False], speed[1:] == speed[:-1]]) & overdue & (speed > 0.0)
    longest = run_length = 0
    for stands in same:
        run_length = run_length + 1 if stands else 0
        longest = max(longest, run_length)
    return longest * TICK


@dataclass(frozen=True)
class Slowing:
    """Decelerating shaft: longest stagnation by method [s]; largest deviation from E33 and F19 [timer ticks]."""

    t: float  # stagnation, T method [s]
    mt: float  # stagnation, M/T method [s]
    enhanced: float  # stagnation, enhanced M/T method [s]
    deviation: float  # largest, from E33 and F19 [timer ticks]


def slowing(brake: Trace, slow: Methods) -> Slowing:
    """Stagnation of every method, and deviation of the enhanced method while the next edge is overdue."""
    moving = (brake.time > 0.05) & (slow.m2 > 0)
    late = moving & (slow.age > slow.m2 + slow.uncertainty.of_m2) & ~slow.uncertainty.of_edge
    t_late = moving & (slow.t_age > slow.t_m2)
    law = moving & (slow.age + slow.uncertainty.of_age < 0x10000) & ~slow.uncertainty.of_edge
    ticks = np.maximum(np.minimum(slow.m2, slow.age + 1.0) / slow.uncertainty.longer - slow.uncertainty.of_m2, 0.0)
    deviation = np.abs(slow.enhanced / np.maximum(slow.from_edges, 1e-9) - 1.0) * ticks - slow.uncertainty.of_m2
    return Slowing(
        stagnation(slow.t, t_late),
        stagnation(slow.mt, late),
        stagnation(slow.enhanced, late),
        max(float(deviation[law].max()), 0.0),
    )


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Errors from 0.5 to 3500 rpm, stagnation during deceleration, and the worked example."""
    found = {rpm: steady(plant, seed, rpm * RPM) for rpm in SPEEDS}
    low, high = found[SPEEDS[0]], found[SPEEDS[-1]]
    at_low, at_high = (f"error at {rpm:g} rpm" for rpm in (SPEEDS[0], SPEEDS[-1]))
    m_floor = 100.0 * COUNT / TICK / (SPEEDS[-1] * RPM)  # one count per slow loop
    judge, exact_edges = Judge(), "E33: time stamps of one tick, edges in their places"
    mt, enhanced = max(s.mt_times for s in found.values()), max(s.enhanced_times for s in found.values())
    yield judge(f"M, {at_low}", 100 * low.m, "%", 100.0, reference="2.4.4: M is poor at low speed")
    yield judge(f"M, {at_high}", 100 * high.m, "%", maximum=m_floor, reference="2.4.4: M is good at high speed")
    yield judge(f"T, {at_low}", 100 * low.t, "%", maximum=0.1, reference="2.4.4: T is good at low speed")
    yield judge(f"T, {at_high}", 100 * high.t, "%", 5.0, reference="2.4.4: T is poor at high speed")
    yield judge("M/T, largest error relative to 1/M2", mt, "1/M2", maximum=FLOOR, reference=exact_edges)
    yield judge(
        "enhanced M/T, largest error relative to 1/M2",
        enhanced,
        "1/M2",
        maximum=FLOOR,
        reference="as M/T at steady speed",
    )
    m2_says = "781.25 kHz, 1000 lines: 46875"
    yield judge(f"M2 at {SPEEDS[0]:g} rpm", low.m2, "ticks", 46874.0, 46876.0, reference=m2_says)
    exact = sum(a == b for a, b in zip(worked_example(), F19_FACTORS, strict=True))
    yield judge("F19, exact values", exact, "of 5", 5.0, 5.0, reference="1, 4/5, 4/8, 4/11, then 1/3")
    brake, slow = methods(plant, seed, braking, 0.1 + BRAKE_TIME + BRAKE_REST)
    braked, what, maximum = slowing(brake, slow), "firmware against E33 and F19 while braking", 1e3 * TICK
    yield judge(what, braked.deviation, "ticks", maximum=2.0, reference="F19: M2 / TMR3")
    yield judge("T, stagnation", 1e3 * braked.t, "ms", 5.0, reference="2.4.5: until the next pulse")
    yield judge("M/T, stagnation", 1e3 * braked.mt, "ms", 5.0, reference="F18: until the next pulse")
    reference = "F19: none beyond the slow loop"
    yield judge("enhanced M/T, stagnation", 1e3 * braked.enhanced, "ms", maximum=maximum, reference=reference)
    yield _error_panel(found)
    yield _brake_panel(brake, slow)
    yield f"axis {AXIS + 1}; M over {1e3 * TICK:g} ms, {COUNTS_PER_TURN} counts"
    yield f"braking from {BRAKE_FROM / RPM:g} rpm to a stop in {BRAKE_TIME:g} s"
    yield "stagnation: longest time at one value after the expected time of the next edge"


def _error_panel(found: dict[float, Steady]) -> Panel:
    lines = {"M": "m", "T": "t", "M/T": "mt", "enhanced M/T": "enhanced", "floor 1/M2": "floor"}
    curves: list[Curve] = []
    for label, field in lines.items():
        errors = 100.0 * np.array([getattr(s, field) for s in found.values()])
        curves.append(Curve(label, np.array(list(found)), errors, "k--" if field == "floor" else "o-"))
    return Panel("largest error at steady speed", "speed [rpm]", "error [%]", curves, log_x=True, log_y=True)


def _brake_panel(brake: Trace, slow: Methods) -> Panel:
    part = slice(round((0.1 + 0.7 * BRAKE_TIME) / TICK), None)
    time = 1e3 * brake.time[part]
    named = {"true": brake["omega"], "T": slow.t, "M/T": slow.mt, "enhanced M/T": slow.enhanced}
    curves = [Curve(label, time, y[part] / RPM, "k-" if label == "true" else "-") for label, y in named.items()]
    return Panel("deceleration to standstill (M: multiples of 30 rpm)", "time [ms]", "speed [rpm]", curves)
