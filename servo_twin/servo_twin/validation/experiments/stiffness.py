"""Position hold with a load step of nominal torque."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from servo_msgs_py.board_port import write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK

from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.validation.experiments.outcome import NOT_SHOWN, Curve, Item, Judge, Panel, Row, experiment
from servo_twin.validation.experiments.rig import COUNT, at, record, settling_time, spinning

NAME: Final = "stiffness"
HELP: Final = """\
Position hold at standstill: the load steps to nominal torque (2 A) and later back, current limit 4 A. The reference
design shows no measurement; a servo has to return to its position without a steady-state error."""

NOMINAL: Final = 2.0  # [A]
LIMIT: Final = 4.0  # [A]
LEAD: Final = 0.1  # time before the load [s]
LOADED: Final = 1.0  # [s]
UNLOADED: Final = 1.0  # [s]
ARRIVED: Final = 2.0  # [counts]
RECOVERY_MAX: Final = 0.5  # [s]
DEFLECTION_MAX: Final = 0.05 * 2.0 * np.pi  # [rad]


def deflection_min(axis: AxisPlant) -> float:
    """Deflection within one slow loop, before a controller can respond [rad]."""
    free = NOMINAL * axis.torque_constant - axis.friction
    return 0.5 * free / axis.inertia * TICK**2


def load_step(plant: PlantConfig, seed: int, axis: int) -> Trace:
    """Apply and remove the nominal torque."""
    torque = NOMINAL * plant.axes[axis].torque_constant
    with spinning(plant, seed) as board:
        write_axis(board, "param.i_q_limit", axis, LIMIT)
        loads = {LEAD: lambda: board.set_load(axis, torque), LEAD + LOADED: lambda: board.set_load(axis, 0.0)}
        return record(board, [axis], LEAD + LOADED + UNLOADED, at(loads))[axis]


@experiment(NAME)
def run(plant: PlantConfig, seed: int) -> Iterator[Item]:
    """Both axes, separately."""
    found = [load_step(plant, seed, axis) for axis in range(AXES)]
    for axis, r in enumerate(found):
        yield from _rows(Judge(f"{axis_name(axis)}, ", NOT_SHOWN), plant.axes[axis], r)
    title = "load step of nominal torque"
    deflection = [
        Curve(axis_name(axis), r.time, np.degrees(r["theta"] - r["theta"][0])) for axis, r in enumerate(found)
    ]
    yield Panel(title, "time [s]", "deflection [degrees]", deflection)
    yield Panel(
        title, "time [s]", "i_q [A]", [Curve(axis_name(axis), r.time, r["i_q"]) for axis, r in enumerate(found)]
    )
    yield f"load: the torque of {NOMINAL:g} A, limit {LIMIT:g} A; stiffness: torque over the largest deflection"


def _rows(judge: Judge, motor: AxisPlant, r: Trace) -> Iterator[Row]:
    loaded, after, target = r.part(LEAD, LEAD + LOADED), r.part(LEAD + LOADED), float(r["position_ref"][0])
    deflection = float(np.abs(loaded["theta"] - r.part(0.0, LEAD)["theta"][-1]).max())
    torque = NOMINAL * motor.torque_constant
    error = np.abs(loaded["position"][-200:] - target).mean()
    bounds = float(np.degrees(deflection_min(motor))), float(np.degrees(DEFLECTION_MAX))
    yield judge("deflection", np.degrees(deflection), "deg", *bounds)
    yield judge("stiffness", torque / max(deflection, COUNT), "N m/rad", torque / DEFLECTION_MAX)
    yield judge("recovery time", settling_time(loaded, target, ARRIVED, LEAD), "s", TICK, RECOVERY_MAX)
    yield judge(
        "recovery time after the load", settling_time(after, target, ARRIVED, LEAD + LOADED), "s", TICK, RECOVERY_MAX
    )
    yield judge("steady-state error under load", error, "counts", maximum=ARRIVED)
    yield judge("largest i_q*", np.abs(r["i_q_ref"]).max(), "A", NOMINAL, LIMIT + 1e-3, reference="4 A limit")
