"""F15 and F16: rotor search by bisection with coordinate correction, from all angles, with small movements."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import TICK, TICK_NS

from servo_twin.board import Board
from servo_twin.level import Level
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.rig import COUNT, fresh_board, level

NAME: Final = "rotor-search"
HELP: Final = """\
Initial rotor position without Hall sensors, by bisection with coordinate correction (2.4.3, F15). The reference design
shows (F16): from 30 degrees electrical, eight searches, all within 1.2 s. Here also: every 5 degrees, both axes, three
times the friction and the inertia, a large inertia with little friction, a rotor at 180 degrees from the first vector;
the movement of the shaft; and the fault reported by a search that cannot succeed: blocked shaft, or little play;
encoder unplugged, with a dead channel or counting backwards; motor unplugged."""

START_F16: Final = 30.0  # [degrees electrical]
SEARCHES_F16: Final = 8
VERIFICATIONS: Final = 1
"""Additional vectors for verification: the shaft must follow the last one."""
TIME_F16: Final = 1.2  # [s]
TIME_HEAVY: Final = TIME_F16 * math.sqrt(10.0)
"""Time for a shaft with ten times the inertia, with proportionally longer movements [s]."""

EVERY: Final = 5  # [degrees electrical]
FAULT_EVERY: Final = 40  # [degrees electrical]

HALF_INTERVAL: Final = 0.7
"""Half of the final interval of the search [degrees electrical]: eight halvings of a revolution."""

TWITCH_COUNTS: Final = 2 * (3 + 1)
"""Largest movement by one vector [counts]: three counts for the detection, one in the slow tick of the detection, and
the same for the deceleration by the reversed vector."""

TURN_COUNTS: Final = 12
"""Largest additional movement by the last, rotating vector [counts]: three counts of rotation, overshoot of a heavy
shaft, and half an interval."""

VECTOR_MIN: Final = 0.1  # smallest current of a vector [A]
BOOT_NS: Final = 60 * TICK_NS  # from reset until both axes are in STOP
SEARCH_MAX: Final = 6.5  # largest duration of a search [s]
POLL: Final = 0.02  # polling interval of the state [s]
DETECTION_MAX: Final = 1.5  # largest time until a search that cannot succeed ends in its fault [s]
DETECTION_MAX_RETRY: Final = 4.0  # the same for a search with retries, each after standstill [s]
DETECTION_MAX_DIRECTION: Final = 5.0 + 0.9
"""The same for an encoder that counts backwards [s]: `rotor_search.time_max`, after which only the test of the
direction remains; there the current grows for at most 0.2 s, then the vector rotates by three half turns of 0.23 s."""
REST_TICKS: Final = 5  # shortest pause between two vectors, in slow ticks; noise may give one or two zeros


@dataclass(frozen=True)
class SearchFault:
    """A fault that prevents a successful search."""

    name: str
    fault: str  # expected fault name
    inject: Callable[[Board, int], None]  # injects the fault into an axis of a board
    maximum: float = DETECTION_MAX  # largest time until the fault is reported [s]


LOCKED: Final = SearchFault("shaft blocked", "ROTOR_SEARCH", lambda board, axis: board.lock_shaft(axis))
UNPLUGGED: Final = SearchFault(
    "encoder unplugged", "ENCODER_LOST", lambda board, axis: board.connect_encoder(axis, False)
)
SEARCH_FAULTS: Final = (
    LOCKED,
    UNPLUGGED,
    SearchFault("encoder line A dead", "ENCODER_LOST", lambda board, axis: board.cut_encoder_line(axis, "A")),
    SearchFault("encoder line B dead", "ENCODER_LOST", lambda board, axis: board.cut_encoder_line(axis, "B")),
    SearchFault("motor unplugged", "PHASE_LOST", lambda board, axis: board.connect_motor(axis, False)),
    SearchFault(
        "encoder reversed",
        "ENCODER_REVERSED",
        lambda board, axis: board.reverse_encoder(axis),
        DETECTION_MAX_DIRECTION,
    ),
    SearchFault(
        "shaft with play of 2 counts",
        "ROTOR_SEARCH",
        lambda board, axis: board.obstruct_shaft(axis, 1.5 * COUNT, 0.5 * COUNT),
        DETECTION_MAX_RETRY,
    ),
)
LIGHT_FRICTION: Final[Mapping[Level, float]] = {"ideal": 0.0, "registers": 0.03}
"""Friction of a light-running shaft, relative to that of the plant.

Between two vectors the shaft must come to standstill with short-circuited windings. This brakes on the averaged plant,
whose drops decrease with the current, but not with real drops: at 0.3 rad/s the back-EMF is about 10 mV, the drop
1.4 V. Without Coulomb friction the time constant of the viscous friction is 0.8 s for each of the 18 vectors for the
detection of a reversed encoder, and the search ends after 5 s, perhaps without a result (ROTOR_SEARCH). With this
fraction of the friction the shaft is at standstill within 0.1 s.
"""
TWITCHING: Final = SearchFault(
    "shaft between two stops",
    "ROTOR_SEARCH",
    lambda board, axis: board.obstruct_shaft(axis, 3.6 * COUNT, 0.5 * COUNT),
    DETECTION_MAX_RETRY,
)
"""An obstructed shaft that can move by a few counts: either a fault, or the right angle."""
DISTURBED_AT: Final = (0.08, 0.10, 0.12, 0.14, 0.16, 0.18)
"""Times of a fault during a search, after the enable [s]; the first vector starts after 0.06 s."""


@dataclass(frozen=True)
class Search:
    """One search of one axis."""

    error: float | None  # found minus true electrical angle [degrees]; None: not found
    searches: int  # number of vectors
    time: float  # duration of ALIGN [s]
    movement: float  # peak-to-peak movement of the shaft [degrees mechanical]
    current: float  # largest current [A]
    faults: frozenset[str]  # names of the faults at the end
    counts: NDArray[np.float64]  # position over time [counts]
    theta_m: NDArray[np.float64]
    """Angle of the current vector over time [degrees electrical]; NaN without a vector; empty unless traced."""


def wrapped(degrees: float) -> float:
    """Wrap an angle to -180 .. 180 [degrees]."""
    return (degrees + 180.0) % 360.0 - 180.0


def start_at(plant: PlantConfig, degrees: float) -> PlantConfig:
    """Plant with both rotors at an electrical angle [degrees]."""
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, theta_start=math.radians(degrees) / entry.pole_pairs)
    return plant


def find(
    plant: PlantConfig,
    seed: int,
    *,
    search_fault: SearchFault | None = None,
    axes: Iterable[int] = range(AXES),
    after: float = 0.0,
    trace: bool = False,
) -> list[Search]:
    """Search both rotors once.

    Parameters
    ----------
    plant : PlantConfig
        Plant data.
    seed : int
        Seed of the noise.
    search_fault : SearchFault, optional
        Fault to inject.
    axes : iterable of int
        Axes for the fault.
    after : float
        Time of the fault after the enable [s].
    trace : bool
        Record the true angle of the current vector.
    """
    with fresh_board(plant, seed) as board:
        board.advance(BOOT_NS)
        board.write("cmd.enable", [1] * AXES)
        logs: list[bytes] = []
        vectors: list[list[float]] = [[] for _ in range(AXES)]
        found: list[float | None] = [None] * AXES
        spins, done = [False] * AXES, [False] * AXES
        enums = board.catalogue.enums
        closed_loop = enums["state_t"]["RUN"], enums["substate_t"]["SPIN"]
        pause = TICK if trace else POLL
        for poll in range(round(SEARCH_MAX / pause)):
            if search_fault is not None and poll == round(after / pause):
                for axis in axes:
                    search_fault.inject(board, axis)
            rows = board.record(board.time_ns + round(pause / TICK) * TICK_NS)
            if not rows.size:  # at level registers the time of a slow tick varies by some cycles of the core
                continue
            logs.append(rows.tobytes())
            last = rows[-1]
            for axis in range(AXES):
                name = axis_name(axis)
                if trace:
                    vectors[axis] += [_vector(board, axis)] * rows.size
                if spins[axis] and found[axis] is None:
                    done[axis] = True
                    true = math.degrees(plant.axes[axis].pole_pairs * board.truth(axis).theta_m)
                    found[axis] = wrapped(180.0 / 32768.0 * float(last[f"{name}.theta_e"]) - true)
                # Read one polling interval later, after the fast loop has used the angle.
                spins[axis] = (last[f"{name}.state"], last[f"{name}.substate"]) == closed_loop
                done[axis] = done[axis] or bool(last[f"{name}.faults"])
            if all(done):
                break
        log = np.frombuffer(b"".join(logs), board.snapshot_dtype)
        return [_search(board, log, axis, found[axis], vectors[axis]) for axis in range(AXES)]


def _vector(board: Board, axis: int) -> float:
    """Angle of the current vector in stator coordinates [degrees]; NaN below `VECTOR_MIN`."""
    truth = board.truth(axis)
    if math.hypot(truth.i_d, truth.i_q) < VECTOR_MIN:
        return math.nan
    rotor = board.plant.axes[axis].pole_pairs * truth.theta_m
    return wrapped(math.degrees(rotor + math.atan2(truth.i_q, truth.i_d)))


def _search(board: Board, log: NDArray[np.void], axis: int, error: float | None, vectors: Sequence[float]) -> Search:
    name = axis_name(axis)
    enums = board.catalogue.enums
    si = board.si(log)
    align = (log[f"{name}.state"] == enums["state_t"]["RUN"]) & (
        log[f"{name}.substate"] == enums["substate_t"]["ALIGN"]
    )
    current = np.hypot(si[f"{name}.i_d"], si[f"{name}.i_q"])[align]
    counts = log[f"{name}.position"][align].astype(np.float64)
    driven = _driven(current)
    starts = np.count_nonzero(np.diff(driven.astype(np.int8), prepend=0) == 1)
    pulls = driven & (si[f"{name}.i_d"][align] > VECTOR_MIN)  # along the vector; reversed during the deceleration
    theta_m = np.where(pulls, np.array(vectors)[align], np.nan) if vectors else np.array([])
    return Search(
        error=error,
        searches=int(starts),
        time=TICK * counts.size,
        movement=float(np.degrees(np.ptp(counts) * COUNT)) if counts.size else 0.0,
        current=float(current.max(initial=0.0)),
        faults=frozenset(flag.name for flag in board.catalogue.active("faults", int(log[f"{name}.faults"][-1]))),
        counts=counts,
        theta_m=theta_m,
    )


def _driven(current: NDArray[np.float64]) -> NDArray[np.bool_]:
    """True while a vector is applied; between vectors the firmware reports exactly zero current."""
    driven = np.asarray(current != 0.0, dtype=np.bool_)
    gap = 0
    for k in range(driven.size):
        if driven[k]:
            if 0 < gap < REST_TICKS and k > gap:
                driven[k - gap : k] = True
            gap = 0
        else:
            gap += 1
    return driven


def error_bound(axis: AxisPlant, current: float) -> float:
    """Largest error of a successful search [degrees electrical].

    Half of the last interval, the angle at which friction balances the torque of the largest current, and two counts.
    """
    ratio = axis.friction / (axis.torque_constant * max(current, 1e-9))
    two_counts = math.degrees(2.0 * COUNT * axis.pole_pairs)
    return HALF_INTERVAL + math.degrees(math.asin(min(ratio, 1.0))) + two_counts


def movement_bound(searches: int) -> float:
    """Largest movement of the shaft in a search with this number of vectors [degrees mechanical]."""
    return math.degrees((TWITCH_COUNTS * searches + TURN_COUNTS) * COUNT)


def by_axis(found: Iterable[list[Search]]) -> list[list[Search]]:
    """Searches by axis."""
    return [list(searches) for searches in zip(*found, strict=True)]


def _scaled(plant: PlantConfig, **factors: float) -> PlantConfig:
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, **{name: factor * getattr(entry, name) for name, factor in factors.items()})
    return plant


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """F16; every 5 degrees with different shafts; a rotor at 180 degrees; searches that must end in a fault."""
    first = find(start_at(plant, START_F16), seed, trace=True)
    for axis, search in enumerate(first):
        judge, halvings = Judge(f"{axis_name(axis)} from 30 degrees, "), search.searches - VERIFICATIONS
        yield judge("searches", halvings, "", 1.0, SEARCHES_F16, reference="F16: 8")
        yield from _rows("from 30 degrees", plant, axis, [search])
    for axis, search in enumerate(find(plant, seed)):
        yield from _rows("from the angle of the plant", plant, axis, [search])
    yield _panel_f16("counter", "position [counts]", [s.counts for s in first])
    yield _panel_f16("vector", "theta_M [degrees electrical]", [s.theta_m for s in first])
    yield from _everywhere(plant, seed)
    for axis, search in enumerate(find(start_at(plant, 180.0), seed)):
        yield next(_rows("rotor at 180 degrees", plant, axis, [search]))
    yield from _rows_fault(plant, seed)
    yield "error: 0.7 degrees + asin(Tc / (Kt I)) + 2 counts, electrical"
    yield f"movement: {TWITCH_COUNTS} counts for every vector, {TURN_COUNTS} more for the last one"


def _everywhere(plant: PlantConfig, seed: int) -> Iterator[Item]:
    conditions = {
        "from every angle": (plant, TIME_F16),
        "three times the friction": (_scaled(plant, friction=3.0), TIME_F16),
        "three times the inertia": (_scaled(plant, inertia=3.0), TIME_F16),
        "large inertia, low friction": (_scaled(plant, inertia=10.0, friction=0.1), TIME_HEAVY),
    }
    errors: list[Curve] = []
    times: list[Curve] = []
    degrees = np.arange(-180, 180, EVERY, dtype=np.float64)
    for condition, (changed, time_max) in conditions.items():
        all_searches = by_axis(
            find(start_at(changed, angle), seed + k) for k, angle in enumerate(range(-180, 180, EVERY))
        )
        for axis, searches in enumerate(all_searches):
            yield from _rows(condition, changed, axis, searches, time_max)
            label, found = f"{axis_name(axis)} {condition}", [np.nan if s.error is None else s.error for s in searches]
            errors.append(Curve(label, degrees, np.array(found), ".-"))
            times.append(Curve(label, degrees, np.array([s.time for s in searches]), ".-"))
    yield Panel("final error", "start [degrees electrical]", "error [degrees electrical]", errors)
    yield Panel("time", "start [degrees electrical]", "time [s]", times)


def _rows(
    condition: str, plant: PlantConfig, axis: int, searches: Sequence[Search], time_max: float = TIME_F16
) -> Iterator[Row]:
    """Rows with the worst figures of an axis."""
    judge = Judge(f"{axis_name(axis)} {condition}, ")
    errors = [s.error for s in searches if s.error is not None]
    worst = max(map(abs, errors)) if len(errors) == len(searches) else None
    bound = error_bound(plant.axes[axis], max(s.current for s in searches))
    yield judge("error", worst, "deg el", maximum=bound, reference="F16: theta_M is the rotor's angle")
    yield judge("time", max(s.time for s in searches), "s", maximum=time_max, reference="F16: within 1.2 s")
    # The largest movement, preferably one that exceeds the bound for its number of vectors.
    longest = max(searches, key=lambda s: (s.movement > movement_bound(s.searches), s.movement))
    movement_max = movement_bound(longest.searches)
    yield judge("movement", longest.movement, "deg", maximum=movement_max, reference="2.4.3: a tiny shift")


def _rows_fault(plant: PlantConfig, seed: int) -> Iterator[Row]:
    """Rows for the expected fault in time: from many angles, different friction and inertia, and during a search."""
    loose, stiff = _scaled(plant, friction=LIGHT_FRICTION[level()]), _scaled(plant, friction=3.0, inertia=3.0)
    starts = [(changed, degrees) for changed in (plant, loose, stiff) for degrees in range(-170, 180, FAULT_EVERY)]

    def from_every_angle(search_fault: SearchFault) -> list[list[Search]]:
        return by_axis(
            find(start_at(changed, d), seed + k, search_fault=search_fault) for k, (changed, d) in enumerate(starts)
        )

    for search_fault in SEARCH_FAULTS:
        yield from _rows_named(search_fault, "", from_every_angle(search_fault))
    for search_fault in (LOCKED, UNPLUGGED):
        when = enumerate(itertools.product((-101.0, 64.0), DISTURBED_AT))
        found = by_axis(
            find(start_at(plant, d), seed + k, search_fault=search_fault, after=after) for k, (d, after) in when
        )
        yield from _rows_named(search_fault, " during the search", found)
    for axis, searches in enumerate(from_every_angle(TWITCHING)):
        judge = Judge(f"{axis_name(axis)} {TWITCHING.name}: ", NOT_SHOWN)
        bound = error_bound(plant.axes[axis], max(s.current for s in searches))
        true = [s.faults == {TWITCHING.fault} or (s.error is not None and abs(s.error) <= bound) for s in searches]
        yield judge("blocked or correct angle", sum(true) / len(true), "of all", 1.0, 1.0)
        yield judge("time", max(s.time for s in searches), "s", maximum=TWITCHING.maximum)


def _rows_named(search_fault: SearchFault, when: str, found: Sequence[Sequence[Search]]) -> Iterator[Row]:
    """Fraction of the searches with the expected fault, and time of the fault."""
    for axis, searches in enumerate(found):
        judge = Judge(f"{axis_name(axis)} {search_fault.name}{when}: ", NOT_SHOWN)
        share = sum(s.faults == {search_fault.fault} and s.error is None for s in searches) / len(searches)
        yield judge(search_fault.fault, share, "of all", 1.0, 1.0)
        yield judge("detection time", max(s.time for s in searches), "s", maximum=search_fault.maximum)


def _panel_f16(title: str, label: str, lines: Sequence[NDArray[np.float64]]) -> Panel:
    curves = [Curve(axis_name(axis), TICK * np.arange(y.size, dtype=np.float64), y) for axis, y in enumerate(lines)]
    return Panel(f"F16, from 30 degrees electrical: {title}", "time [s]", label, curves)
