"""Position hold against a load step of nominal torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.experiments.outcome import Bound, Curve, Outcome, Panel, Row
from servo_twin.experiments.rig import COUNT, TICK, Recording, set_axis, spinning, stays_from, watch
from servo_twin.plant import AxisPlant, PlantConfig

NAME: Final = "stiffness"
HELP: Final = """\
Position hold at standstill: the load jumps to nominal torque (2 A) and later back, current limit 4 A.
The reference design shows no measurement; a servo has to come back to its position, without a lasting error."""

NOMINAL: Final = 2.0  # [A]
LIMIT: Final = 4.0  # [A]
LEAD: Final = 0.1  # before the load [s]
LOADED: Final = 1.0  # [s]
UNLOADED: Final = 1.0  # [s]
ARRIVED: Final = 2.0  # [counts]
RECOVERY_MOST: Final = 0.5  # [s]
DEFLECTION_MOST: Final = 0.05  # [turns]


@dataclass(frozen=True)
class Answer:
    """What a load step did.

    Attributes
    ----------
    torque : float
        The load [N m].
    deflection : float
        Largest distance of the true shaft from where it was [rad].
    recovery : float or None
        Until the position is back within 2 counts for good [s].
    release : float or None
        The same after the load has gone [s].
    error : float
        Mean distance at the end of the load [counts].
    current : float
        Largest current set-point [A].
    recording : Recording
        All of it.
    """

    torque: float
    deflection: float
    recovery: float | None
    release: float | None
    error: float
    current: float
    recording: Recording


def least_deflection(axis: AxisPlant) -> float:
    """How far the load drives the shaft within one slow loop, before any controller can answer [rad]."""
    free = NOMINAL * axis.torque_constant - axis.friction
    return 0.5 * free / axis.inertia * TICK**2


def load_step(plant: PlantConfig, seed: int, axis: int) -> Answer:
    """Nominal torque on and off."""
    torque = NOMINAL * plant.axes[axis].torque_constant
    with spinning(plant, seed) as board:
        set_axis(board, "param.i_q_limit", axis, LIMIT)

        def act(k: int) -> None:
            if k == round(LEAD / TICK):
                board.set_load(axis, torque)
            if k == round((LEAD + LOADED) / TICK):
                board.set_load(axis, 0.0)

        whole = watch(board, [axis], LEAD + LOADED + UNLOADED, act)[axis]
    target = float(whole.position_ref[0])
    loaded, after = whole.part(LEAD, LEAD + LOADED), whole.part(LEAD + LOADED)
    low, high = target - ARRIVED, target + ARRIVED
    back = stays_from(loaded, loaded.position, low, high)
    again = stays_from(after, after.position, low, high)
    return Answer(
        torque=torque,
        deflection=float(np.abs(loaded.theta - whole.part(0.0, LEAD).theta[-1]).max()),
        recovery=None if back is None else max(back - LEAD, 0.0),
        release=None if again is None else max(again - LEAD - LOADED, 0.0),
        error=float(np.abs(loaded.position[-200:] - target).mean()),
        current=float(np.abs(whole.i_q_ref).max()),
        recording=whole,
    )


def run(plant: PlantConfig, seed: int) -> Outcome:
    """Both axes, one after the other."""
    rows: list[Row] = []
    curves: tuple[list[Curve], list[Curve]] = ([], [])
    for axis in range(AXES):
        answer = load_step(plant, seed, axis)
        rows.extend(_rows(axis_name(axis), plant.axes[axis], answer))
        r = answer.recording
        curves[0].append(Curve(axis_name(axis), r.time, np.degrees(r.theta - r.theta[0])))
        curves[1].append(Curve(axis_name(axis), r.time, r.i_q))
    panels = (
        Panel("load step of nominal torque", "time [s]", "deflection [degrees]", tuple(curves[0])),
        Panel("load step of nominal torque", "time [s]", "i_q [A]", tuple(curves[1])),
    )
    notes = (f"load: the torque of {NOMINAL:g} A, limit {LIMIT:g} A; stiffness: torque over the largest deflection",)
    return Outcome(NAME, tuple(rows), panels, notes)


def _rows(name: str, axis: AxisPlant, answer: Answer) -> tuple[Row, ...]:
    seed = "not shown"
    most = DEFLECTION_MOST * 2.0 * np.pi
    deflection = Bound(float(np.degrees(least_deflection(axis))), float(np.degrees(most)))
    return (
        Row(f"{name}, deflection", seed, float(np.degrees(answer.deflection)), "deg", deflection),
        Row(
            f"{name}, stiffness",
            seed,
            answer.torque / max(answer.deflection, COUNT),
            "N m/rad",
            Bound(answer.torque / most),
        ),
        Row(f"{name}, recovery", seed, answer.recovery, "s", Bound(1.0 * TICK, RECOVERY_MOST)),
        Row(f"{name}, recovery after the load", seed, answer.release, "s", Bound(1.0 * TICK, RECOVERY_MOST)),
        Row(f"{name}, steady-state error under load", seed, answer.error, "counts", Bound(most=ARRIVED)),
        Row(f"{name}, largest i_q*", "4 A limit", answer.current, "A", Bound(NOMINAL, LIMIT + 1e-3)),
    )
