"""F15 and F16: where is the rotor? Bisection with coordinate correction, from everywhere, gently."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.board import Board
from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import COUNT, TICK, TICK_NS
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "rotor-search"
HELP: Final = """\
Initial rotor position without Hall sensors, by bisection with coordinate correction (2.4.3, F15).
The reference design shows (F16): from 30 degrees electrical, eight searches, all within 1.2 s.
Here also: every 5 degrees, both axes, three times the friction and the inertia, a rotor at 180 degrees from the first
vector, a shaft that is held, an encoder that is dead."""

START_F16: Final = 30.0  # [degrees electrical]
SEARCHES_F16: Final = 8
TIME_F16: Final = 1.2  # [s]
EVERY: Final = 5  # [degrees electrical]

HALF_INTERVAL: Final = 0.7
"""Half of the interval at which the search ends [degrees electrical]: eight halvings of a turn."""

MOVEMENT_MOST: Final = 10.0
"""Most that the shaft may move in a whole search [degrees mechanical]: what this project calls gentle."""

BOOT_NS: Final = 60 * TICK_NS  # from reset until both axes are in STOP
SEARCH_MOST: Final = 6.0  # [s]
LOOK: Final = 0.02  # between two looks at the state [s]
REST_TICKS: Final = 5  # shortest pause between two vectors, in slow ticks; noise may give one or two zeros


@dataclass(frozen=True)
class Search:
    """One search of one axis.

    Attributes
    ----------
    error : float or None
        Found minus true electrical angle [degrees]; None when nothing was found.
    searches : int
        Vectors tried.
    time : float
        Length of ALIGN [s].
    movement : float
        From the lowest to the highest position of the shaft [degrees mechanical].
    current : float
        Largest current [A].
    fault : int
        Fault word at the end.
    counts : ndarray
        Position over time [counts].
    theta_m : ndarray
        Angle of the current vector over time [degrees electrical], NaN between vectors; empty unless traced.
    """

    error: float | None
    searches: int
    time: float
    movement: float
    current: float
    fault: int
    counts: NDArray[np.float64]
    theta_m: NDArray[np.float64]


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
    held: Iterable[int] = (),
    dead: Iterable[int] = (),
    trace: bool = False,
) -> list[Search]:
    """Search both rotors once.

    Parameters
    ----------
    plant : PlantConfig
        What is really there.
    seed : int
        Of the noise.
    held, dead : iterable of int
        Axes whose shaft is held, whose encoder is dead.
    trace : bool
        Also keep the angle of the current vector, which only the plant knows.
    """
    with Board(plant, seed=seed) as board:
        for axis in held:
            board.lock_shaft(axis)
        for axis in dead:
            board.connect_encoder(axis, False)
        board.advance(BOOT_NS)
        board.write("cmd.enable", [1] * AXES)
        logs: list[bytes] = []
        vectors: list[list[float]] = [[] for _ in range(AXES)]
        found: list[float | None] = [None] * AXES
        spins, done = [False] * AXES, [False] * AXES
        spin = board.catalogue.enums["substate_t"]["SPIN"]
        run = board.catalogue.enums["state_t"]["RUN"]
        looks = round(SEARCH_MOST / (TICK if trace else LOOK))
        for _ in range(looks):
            rows = board.record(board.time_ns + (TICK_NS if trace else round(LOOK / TICK) * TICK_NS))
            logs.append(rows.tobytes())
            last = rows[-1]
            for axis in range(AXES):
                name = axis_name(axis)
                if trace:
                    vectors[axis].append(_vector(board, axis))
                if spins[axis] and found[axis] is None:
                    done[axis] = True
                    pole_pairs = plant.axes[axis].pole_pairs
                    true = math.degrees(pole_pairs * board.truth(axis).theta_m)
                    found[axis] = wrapped(180.0 / 32768.0 * float(last[f"{name}.theta_e"]) - true)
                # Seen in this look, read in the next one: the fast loop has then used the angle.
                spins[axis] = last[f"{name}.state"] == run and last[f"{name}.substate"] == spin
                done[axis] = done[axis] or bool(last[f"{name}.faults"])
            if all(done):
                break
        log = np.frombuffer(b"".join(logs), board.snapshot_dtype)
        return [_search(board, log, axis, found[axis], vectors[axis]) for axis in range(AXES)]


def _vector(board: Board, axis: int) -> float:
    """Angle of the current vector in the stator frame [degrees]."""
    truth = board.truth(axis)
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
    theta_m = np.where(driven & (current > 0.05), np.array(vectors)[align], np.nan) if vectors else np.array([])
    return Search(
        error=error,
        searches=int(starts),
        time=TICK * counts.size,
        movement=float(np.degrees(np.ptp(counts) * COUNT)) if counts.size else 0.0,
        current=float(current.max(initial=0.0)),
        fault=int(log[f"{name}.faults"][-1]),
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


def everywhere(plant: PlantConfig, seed: int) -> list[list[Search]]:
    """Searches from every 5 degrees, by axis."""
    found = [find(start_at(plant, degrees), seed + k) for k, degrees in enumerate(range(-180, 180, EVERY))]
    return [[both[axis] for both in found] for axis in range(AXES)]


def run(plant: PlantConfig, seed: int) -> Outcome:
    """F16, every 5 degrees under three conditions, the trap, and what has to end in a fault."""
    rows: list[Row] = []
    first = find(start_at(plant, START_F16), seed, trace=True)
    rows.extend(_rows_f16(plant, first))
    rows.extend(_rows_of("from the plant's own angle", plant, [[s] for s in find(plant, seed)]))
    conditions = {
        "from everywhere": plant,
        "three times the friction": _scaled(plant, "friction", 3.0),
        "three times the inertia": _scaled(plant, "inertia", 3.0),
    }
    errors: list[Curve] = []
    times: list[Curve] = []
    degrees = np.arange(-180, 180, EVERY, dtype=np.float64)
    for condition, changed in conditions.items():
        by_axis = everywhere(changed, seed)
        rows.extend(_rows_of(condition, changed, by_axis))
        for axis, searches in enumerate(by_axis):
            label = f"{axis_name(axis)} {condition}"
            errors.append(
                Curve(label, degrees, np.array([np.nan if s.error is None else s.error for s in searches]), ".-")
            )
            times.append(Curve(label, degrees, np.array([s.time for s in searches]), ".-"))
    trap = find(start_at(plant, 180.0), seed)
    rows.extend(_rows_of("rotor at 180 degrees", plant, [[s] for s in trap])[:: len(_FIGURES)])
    rows.extend(_rows_fault(plant, seed))
    panels = (
        _panel_f16("counter", "position [counts]", [s.counts for s in first]),
        _panel_f16("vector", "theta_M [degrees electrical]", [s.theta_m for s in first]),
        Panel("final error", "start [degrees electrical]", "error [degrees electrical]", tuple(errors)),
        Panel("time", "start [degrees electrical]", "time [s]", tuple(times)),
    )
    return Outcome(NAME, tuple(rows), panels, ("error: 0.7 degrees + asin(Tc / (Kt I)) + 2 counts, electrical",))


def _scaled(plant: PlantConfig, name: str, factor: float) -> PlantConfig:
    for axis, entry in enumerate(plant.axes):
        plant = plant.with_axis(axis, **{name: factor * getattr(entry, name)})
    return plant


_FIGURES: Final = ("error", "time", "movement")


def _rows_f16(plant: PlantConfig, searches: Sequence[Search]) -> list[Row]:
    rows: list[Row] = []
    for axis, search in enumerate(searches):
        what = f"{axis_name(axis)} from 30 degrees"
        rows.append(Row(f"{what}, searches", "F16: 8", search.searches, "", Bound(1.0, SEARCHES_F16)))
        rows.extend(_rows_of("from 30 degrees", plant, [[s] for s in searches])[axis * 3 : axis * 3 + 3])
    return rows


def _rows_of(condition: str, plant: PlantConfig, by_axis: Sequence[Sequence[Search]]) -> list[Row]:
    """Worst figures of each axis."""
    rows: list[Row] = []
    for axis, searches in enumerate(by_axis):
        what = f"{axis_name(axis)} {condition}"
        errors = [s.error for s in searches if s.error is not None]
        worst = max(map(abs, errors)) if len(errors) == len(searches) else None
        bound = error_bound(plant.axes[axis], max(s.current for s in searches))
        rows.append(Row(f"{what}, error", "F16: theta_M is the rotor's angle", worst, "deg el", Bound(most=bound)))
        time = max(s.time for s in searches)
        rows.append(Row(f"{what}, time", "F16: within 1.2 s", time, "s", Bound(most=TIME_F16)))
        movement = max(s.movement for s in searches)
        rows.append(Row(f"{what}, movement", "2.4.3: a tiny shift", movement, "deg", Bound(most=MOVEMENT_MOST)))
    return rows


def _rows_fault(plant: PlantConfig, seed: int) -> list[Row]:
    """The named fault, and no other, within the time of a search."""
    with Board(plant, seed=seed) as board:
        masks = {flag.name: flag.mask for flag in board.catalogue.flags["faults"]}
    rows: list[Row] = []
    for what, fault, searches in (
        ("shaft held", "ROTOR_SEARCH", find(plant, seed, held=range(AXES))),
        ("encoder dead", "ENCODER_LOST", find(plant, seed, dead=range(AXES))),
    ):
        for axis, search in enumerate(searches):
            named = float(search.fault == masks[fault] and search.error is None)
            rows.append(Row(f"{axis_name(axis)} {what}: fault {fault}", "not shown", named, "", Bound(1.0, 1.0)))
    return rows


def _panel_f16(title: str, label: str, curves: Sequence[NDArray[np.float64]]) -> Panel:
    return Panel(
        f"F16, from 30 degrees electrical: {title}",
        "time [s]",
        label,
        tuple(Curve(axis_name(axis), TICK * np.arange(y.size, dtype=np.float64), y) for axis, y in enumerate(curves)),
    )
