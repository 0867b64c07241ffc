"""F15 and F16: where is the rotor? Bisection with coordinate correction, from everywhere, gently."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.experiments.rig import COUNT, TICK, TICK_NS, fresh_board, level
from servo_twin.level import Level
from servo_twin.plant import AxisPlant, PlantConfig

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
"""Vectors after those: the last one, which the shaft has to follow, searches no more."""
TIME_F16: Final = 1.2  # [s]
TIME_HEAVY: Final = TIME_F16 * math.sqrt(10.0)
"""The same for a shaft with ten times the inertia, every movement of which takes so much longer [s]."""

EVERY: Final = 5  # [degrees electrical]
DAMAGE_EVERY: Final = 40  # [degrees electrical]

HALF_INTERVAL: Final = 0.7
"""Half of the interval at which the search ends [degrees electrical]: eight halvings of a turn."""

TWITCH_COUNTS: Final = 2 * (3 + 1)
"""Most that one vector may move the shaft [counts]: three counts by which the twitch is seen and one that comes in the
slow tick in which it is, and the same again for the brake, which is the pull played backwards."""

TURN_COUNTS: Final = 12
"""Most that the last vector, which turns, may move it besides [counts]: three counts to follow, as far as a heavy shaft
swings beyond, and half an interval to lie on the vector."""

VECTOR_MIN: Final = 0.1  # current that is shown as a vector [A]
BOOT_NS: Final = 60 * TICK_NS  # from reset until both axes are in STOP
SEARCH_MAX: Final = 6.0  # [s]
LOOK: Final = 0.02  # between two looks at the state [s]
NAMED_MAX: Final = 1.5  # until a search that cannot succeed ends in its fault [s]; under way it is verified first
NAMED_LATE: Final = 4.0  # the same for one that has to be tried again, after the shaft has come to rest [s]
REST_TICKS: Final = 5  # shortest pause between two vectors, in slow ticks; noise may give one or two zeros


@dataclass(frozen=True)
class Damage:
    """What keeps a search from succeeding."""

    name: str
    fault: str  # expected name
    do: Callable[[Board, int], None]  # does it to an axis of a board
    maximum: float = NAMED_MAX  # time until the fault is named [s]


HELD: Final = Damage("shaft held", "ROTOR_SEARCH", lambda board, axis: board.lock_shaft(axis))
UNPLUGGED: Final = Damage("encoder unplugged", "ENCODER_LOST", lambda board, axis: board.connect_encoder(axis, False))
DAMAGES: Final = (
    HELD,
    UNPLUGGED,
    Damage("encoder line A dead", "ENCODER_LOST", lambda board, axis: board.cut_encoder_line(axis, "A")),
    Damage("encoder line B dead", "ENCODER_LOST", lambda board, axis: board.cut_encoder_line(axis, "B")),
    Damage("motor unplugged", "PHASE_LOST", lambda board, axis: board.connect_motor(axis, False)),
    Damage("encoder backwards", "ENCODER_REVERSED", lambda board, axis: board.reverse_encoder(axis), NAMED_LATE),
    Damage(
        "shaft with play of 2 counts",
        "ROTOR_SEARCH",
        lambda board, axis: board.obstruct_shaft(axis, 1.5 * COUNT, 0.5 * COUNT),
        NAMED_LATE,
    ),
)
LOOSE: Final[Mapping[Level, float]] = {"ideal": 0.0, "registers": 0.03}
"""Friction of a loose shaft, over the plant's own.

Between two vectors the shaft has to come to rest, and the windings are short-circuited. On the averaged plant, whose
drops fade away with the current, that brakes. With real drops it does not: at 0.3 rad/s the rotor induces some 10 mV
against 1.4 V. Without any friction only the viscous one would be left, with a time constant of 0.8 s, for each of the
18 vectors that it takes to recognise an encoder that counts backwards; the search gives up after 5 s (ROTOR_SEARCH).
With this part of the friction the shaft rests within 0.1 s.
"""
TWITCHING: Final = Damage(
    "twitching from stop to stop",
    "ROTOR_SEARCH",
    lambda board, axis: board.obstruct_shaft(axis, 3.6 * COUNT, 0.5 * COUNT),
    NAMED_LATE,
)
"""An obstructed shaft that can twitch, by some counts to both sides: held, or found where it is."""
UNDER_WAY: Final = (0.08, 0.10, 0.12, 0.14, 0.16, 0.18)
"""Times after the enable at which a search is disturbed under way [s]; the first vector begins to pull after 0.06 s."""


@dataclass(frozen=True)
class Search:
    """One search of one axis."""

    error: float | None  # found minus true electrical angle [degrees]; None when nothing was found
    searches: int  # vectors tried
    time: float  # length of ALIGN [s]
    movement: float  # from the lowest to the highest position of the shaft [degrees mechanical]
    current: float  # largest current [A]
    faults: frozenset[str]  # names of the faults at the end
    counts: NDArray[np.float64]  # position over time [counts]
    theta_m: NDArray[np.float64]
    """Angle of the current vector over time [degrees electrical], NaN while none pulls; empty unless traced."""


def wrapped(degrees: float) -> float:
    """Angle within -180 .. 180."""
    return (degrees + 180.0) % 360.0 - 180.0


def start_at(plant: PlantConfig, degrees: float) -> PlantConfig:
    """Both rotors at an electrical angle [degrees]."""
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, theta_start=math.radians(degrees) / entry.pole_pairs)
    return plant


def find(
    plant: PlantConfig,
    seed: int,
    *,
    damage: Damage | None = None,
    axes: Iterable[int] = range(AXES),
    after: float = 0.0,
    trace: bool = False,
) -> list[Search]:
    """Search both rotors once.

    Parameters
    ----------
    plant : PlantConfig
        What is really there.
    seed : int
        Of the noise.
    damage : Damage, optional
        What happens to some axes.
    axes : iterable of int
        Which axes it happens to.
    after : float
        When it happens, after the enable [s].
    trace : bool
        Also keep the angle of the current vector, which only the plant knows.
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
        pause = TICK if trace else LOOK
        for look in range(round(SEARCH_MAX / pause)):
            if damage is not None and look == round(after / pause):
                for axis in axes:
                    damage.do(board, axis)
            rows = board.record(board.time_ns + round(pause / TICK) * TICK_NS)
            logs.append(rows.tobytes())
            last = rows[-1]
            for axis in range(AXES):
                name = axis_name(axis)
                if trace:
                    vectors[axis].append(_vector(board, axis))
                if spins[axis] and found[axis] is None:
                    done[axis] = True
                    true = math.degrees(plant.axes[axis].pole_pairs * board.truth(axis).theta_m)
                    found[axis] = wrapped(180.0 / 32768.0 * float(last[f"{name}.theta_e"]) - true)
                # Seen in this look, read in the next one: the fast loop has then used the angle.
                spins[axis] = (last[f"{name}.state"], last[f"{name}.substate"]) == closed_loop
                done[axis] = done[axis] or bool(last[f"{name}.faults"])
            if all(done):
                break
        log = np.frombuffer(b"".join(logs), board.snapshot_dtype)
        return [_search(board, log, axis, found[axis], vectors[axis]) for axis in range(AXES)]


def _vector(board: Board, axis: int) -> float:
    """Angle of the current vector in the stator frame [degrees]; NaN where there is hardly one."""
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
    pulls = driven & (si[f"{name}.i_d"][align] > VECTOR_MIN)  # along the vector; reversed while it brakes
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
    """Where a vector is applied: between vectors the firmware reports exactly no current."""
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
    """Largest error of a sound search [degrees electrical].

    Half the last interval, the angle within which friction holds the shaft against the largest current, and two counts.
    """
    ratio = axis.friction / (axis.torque_constant * max(current, 1e-9))
    two_counts = math.degrees(2.0 * COUNT * axis.pole_pairs)
    return HALF_INTERVAL + math.degrees(math.asin(min(ratio, 1.0))) + two_counts


def movement_bound(searches: int) -> float:
    """Most that the shaft may move in a search of so many vectors [degrees mechanical]."""
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
    """F16, every 5 degrees under three conditions, the trap, and what has to end in a fault."""
    first = find(start_at(plant, START_F16), seed, trace=True)
    for axis, search in enumerate(first):
        judge, halvings = Judge(f"{axis_name(axis)} from 30 degrees, "), search.searches - VERIFICATIONS
        yield judge("searches", halvings, "", 1.0, SEARCHES_F16, reference="F16: 8")
        yield from _rows("from 30 degrees", plant, axis, [search])
    for axis, search in enumerate(find(plant, seed)):
        yield from _rows("from the plant's own angle", plant, axis, [search])
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
        "from everywhere": (plant, TIME_F16),
        "three times the friction": (_scaled(plant, friction=3.0), TIME_F16),
        "three times the inertia": (_scaled(plant, inertia=3.0), TIME_F16),
        "heavy and light-running": (_scaled(plant, inertia=10.0, friction=0.1), TIME_HEAVY),
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
    """Worst figures of an axis."""
    judge = Judge(f"{axis_name(axis)} {condition}, ")
    errors = [s.error for s in searches if s.error is not None]
    worst = max(map(abs, errors)) if len(errors) == len(searches) else None
    bound = error_bound(plant.axes[axis], max(s.current for s in searches))
    yield judge("error", worst, "deg el", maximum=bound, reference="F16: theta_M is the rotor's angle")
    yield judge("time", max(s.time for s in searches), "s", maximum=time_max, reference="F16: within 1.2 s")
    # The longest movement; but if one is too long for the number of its vectors, that one.
    longest = max(searches, key=lambda s: (s.movement > movement_bound(s.searches), s.movement))
    movement_max = movement_bound(longest.searches)
    yield judge("movement", longest.movement, "deg", maximum=movement_max, reference="2.4.3: a tiny shift")


def _rows_fault(plant: PlantConfig, seed: int) -> Iterator[Row]:
    """The named fault, and no other, in time: from many angles, with and without friction, heavy; and under way."""
    loose, stiff = _scaled(plant, friction=LOOSE[level()]), _scaled(plant, friction=3.0, inertia=3.0)
    starts = [(changed, degrees) for changed in (plant, loose, stiff) for degrees in range(-170, 180, DAMAGE_EVERY)]

    def from_everywhere(damage: Damage) -> list[list[Search]]:
        return by_axis(find(start_at(changed, d), seed + k, damage=damage) for k, (changed, d) in enumerate(starts))

    for damage in DAMAGES:
        yield from _rows_named(damage, "", from_everywhere(damage))
    for damage in (HELD, UNPLUGGED):
        when = enumerate(itertools.product((-101.0, 64.0), UNDER_WAY))
        found = by_axis(find(start_at(plant, d), seed + k, damage=damage, after=after) for k, (d, after) in when)
        yield from _rows_named(damage, " under way", found)
    for axis, searches in enumerate(from_everywhere(TWITCHING)):
        judge = Judge(f"{axis_name(axis)} {TWITCHING.name}: ", NOT_SHOWN)
        bound = error_bound(plant.axes[axis], max(s.current for s in searches))
        true = [s.faults == {TWITCHING.fault} or (s.error is not None and abs(s.error) <= bound) for s in searches]
        yield judge("held or found true", sum(true) / len(true), "of all", 1.0, 1.0)
        yield judge("time", max(s.time for s in searches), "s", maximum=TWITCHING.maximum)


def _rows_named(damage: Damage, when: str, found: Sequence[Sequence[Search]]) -> Iterator[Row]:
    """How many of the searches end in the fault that belongs to the damage."""
    for axis, searches in enumerate(found):
        judge = Judge(f"{axis_name(axis)} {damage.name}{when}: ", NOT_SHOWN)
        share = sum(s.faults == {damage.fault} and s.error is None for s in searches) / len(searches)
        yield judge(damage.fault, share, "of all", 1.0, 1.0)
        yield judge("named", max(s.time for s in searches), "s", maximum=damage.maximum)


def _panel_f16(title: str, label: str, lines: Sequence[NDArray[np.float64]]) -> Panel:
    curves = [Curve(axis_name(axis), TICK * np.arange(y.size, dtype=np.float64), y) for axis, y in enumerate(lines)]
    return Panel(f"F16, from 30 degrees electrical: {title}", "time [s]", label, curves)
