"""What a plant can do, from its own data, and the controller's nominal values of it, seen from outside.

Bounds of the experiments that depend on the motor come from here, so that they hold for another motor, too; and where a
plant cannot do what an experiment asks of the nominal one, the experiment asks for less and says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.catalogue import AXES, axis_name

from servo_twin.experiments import rig
from servo_twin.experiments.rig import COUNT, TICK
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError

OVER_VOLTAGE: Final = 33.0
"""Of the drive [V]."""

MODULATION: Final = 0.94 / math.sqrt(3.0)
"""Largest phase voltage over the bus voltage that the drive uses."""

CURRENT_SHARE: Final = 0.8
"""Part of the current limit that a set-point may need: the rest is the controller's."""

ENERGY_SHARE: Final = 0.95
"""Part of what the capacitor can take, up to the over-voltage limit."""

TUNED_WITHIN: Final = 2.0
"""Factor of the inertia within which gains count as made for it."""

PROBE_SPEED: Final = 2.0
"""Step of the speed set-point that shows the feed-forward [rad/s]."""

PROBE_HALVINGS: Final = 6
"""How often that step may be halved, on a heavy shaft, to show the inertia within the current limit."""

PATH_END: Final = 13.0
"""Of the path filter's time constants: after so many, (1 + t) exp(-t) leaves no two counts of any move."""

NOMINAL_PATH_END: Final = 0.13  # the same of the nominal plant [s]

PROBE_PATH: Final = 0.3  # [s], of a move that shows the path filter
PROBE_SLOPE: Final = 10  # [slow ticks] between two points of its speed


@dataclass(frozen=True)
class NominalShaft:
    """Nominal values of one axis in the controller, from the torque that its current makes on the plant's motor."""

    friction: float  # of a slowly turning shaft [N m]
    inertia: float  # [kg m^2]


@dataclass(frozen=True)
class Demand:
    """What a set-point asks of an axis."""

    acceleration: float
    """The largest, per speed: the path filter asks for it in proportion to the speed of its ramp [1/s]."""
    current: float  # the limit [A]


def nominal_shafts(plant: PlantConfig, seed: int) -> tuple[NominalShaft, ...]:
    """Friction and inertia that feed-forward stands for: the difference it makes to i_q* in the very tick of a step.

    Until that tick the runs are the same, bit for bit.

    Raises
    ------
    SimulationError
        If the current limit hides the difference.
    """
    friction = _forward(plant, seed, "FRICTION", PROBE_SPEED)
    for halving in range(PROBE_HALVINGS + 1):
        speed = PROBE_SPEED * 0.5**halving
        try:
            inertia = _forward(plant, seed, "ACCELERATION_FORWARD", speed)
            break
        except SimulationError:
            if halving == PROBE_HALVINGS:
                raise
    return tuple(
        NominalShaft(
            friction=friction[axis] * entry.torque_constant,
            inertia=inertia[axis] * entry.torque_constant / (speed / TICK),
        )
        for axis, entry in enumerate(plant.axes)
    )


def _forward(plant: PlantConfig, seed: int, switch: str, speed: float) -> list[float]:
    """What a feature adds to i_q* of each axis in the tick in which the speed set-point jumps [A]."""
    without, switched = (_first_current(plant, seed, which, speed) for which in (None, switch))
    return [b - a for a, b in zip(without, switched, strict=True)]


def inertia_ratio(plant: PlantConfig, seed: int, axis: int) -> float:
    """Inertia over the nominal one (ratio): a loop is so many times slower, or quicker."""
    return plant.axes[axis].inertia / nominal_shafts(plant, seed)[axis].inertia


def differences(plant: PlantConfig, seed: int) -> tuple[str, ...]:
    """What the controller was told otherwise, in words; the reference design's bounds hold only for a tuned one."""
    notes: list[str] = []
    for axis, (entry, nominal) in enumerate(zip(plant.axes, nominal_shafts(plant, seed), strict=True)):
        ratio = entry.inertia / nominal.inertia
        if not 1.0 / TUNED_WITHIN <= ratio <= TUNED_WITHIN:
            notes.append(
                f"{axis_name(axis)}: a current accelerates the shaft {1.0 / ratio:.2g} times as much as the gains are"
                " made for (firmware/config/servo.toml)"
            )
    return tuple(notes)


def _first_current(plant: PlantConfig, seed: int, switch: str | None, speed: float) -> list[float]:
    """i_q* of each axis in the tick in which its speed set-point has jumped [A].

    At the ideal level, where a feature takes no time: at the other one it moves the instants of everything behind it.
    """
    with rig.at_level("ideal"), rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.set_up(
                board, axis, "SPEED", parameters={"acceleration_limit": rig.largest(board, "acceleration_limit")}
            )
        rig.watch(board, [0], 10 * TICK)
        for axis in range(AXES):
            if switch is not None:
                rig.features(board, axis, **{switch: True})
            rig.command_speed(board, axis, speed)
        both = rig.watch(board, range(AXES), 5 * TICK)
        limited = board.catalogue.flag("limits", "CURRENT").mask
    currents: list[float] = []
    for recording in both.values():
        k = int(np.argmax(recording.speed_ref > 0.5 * speed))
        if recording.limits[k] & limited:
            raise SimulationError("the current limit hides what the feed-forward stands for")
        currents.append(float(recording.i_q_ref[k]))
    return currents


def speed_limits(plant: PlantConfig, seed: int) -> list[float]:
    """``param.speed_limit`` after reset [rad/s]."""
    return _parameter(plant, seed, "speed_limit")


def current_limits(plant: PlantConfig, seed: int) -> list[float]:
    """``param.i_q_limit`` after reset [A]."""
    return _parameter(plant, seed, "i_q_limit")


def _parameter(plant: PlantConfig, seed: int, name: str) -> list[float]:
    with rig.spinning(plant, seed) as board:
        return [rig.get_axis(board, f"param.{name}", axis) for axis in range(AXES)]


def path_demands(plant: PlantConfig, seed: int) -> list[Demand]:
    """What the path filter asks for on the way to a far target, by its output, without a limit of acceleration."""
    with rig.spinning(plant, seed) as board:
        speeds, currents = (
            [rig.get_axis(board, f"param.{name}", axis) for axis in range(AXES)]
            for name in ("speed_limit", "i_q_limit")
        )
        for axis in range(AXES):
            rig.set_up(board, axis, parameters={"acceleration_limit": rig.largest(board, "acceleration_limit")})
            rig.command_position(
                board, axis, rig.position_of(board, axis) + round(10.0 * PROBE_PATH * speeds[axis] / COUNT)
            )
        both = rig.watch(board, range(AXES), PROBE_PATH)
    demands: list[Demand] = []
    for axis, recording in both.items():
        step = PROBE_SLOPE
        speed = (recording.position_ref[step:] - recording.position_ref[:-step]) * COUNT / (step * TICK)
        acceleration = float((speed[step:] - speed[:-step]).max()) / (step * TICK)
        demands.append(Demand(acceleration / speeds[axis], currents[axis]))
    return demands


def path_ends(plant: PlantConfig, seed: int) -> list[float]:
    """From the end of a ramp until the path of each axis has arrived [s]: on a heavy shaft the filter has to be slow.

    E40 with damping 1 asks a speed step v for at most v omega_n / e.
    """
    return [PATH_END / (math.e * demand.acceleration) for demand in path_demands(plant, seed)]


def path_settles(plant: PlantConfig, seed: int, nominal: float) -> list[float]:
    """Time that each axis is given to settle [s]: `nominal`, and what its path takes longer than on that plant."""
    return [nominal + max(0.0, end - NOMINAL_PATH_END) for end in path_ends(plant, seed)]


def move_speeds(plant: PlantConfig, seed: int, together: bool, share: float = CURRENT_SHARE) -> tuple[list[float], str]:
    """Speed limits for position moves that this plant can follow, and what there is to say if they had to be lowered.

    Parameters
    ----------
    plant : PlantConfig
        What is really there.
    seed : int
        Of the noise.
    together : bool
        Whether both axes move at once.
    share : float
        As in `top_speed`.

    Returns
    -------
    list of float
        Limit of each axis [rad/s], at most the one after reset.
    str
        A note; empty when nothing had to be lowered.
    """
    wanted = speed_limits(plant, seed)
    demands = path_demands(plant, seed)
    groups = [range(AXES)] * AXES if together else [[axis] for axis in range(AXES)]
    able = [top_speed(plant, group, limit, demands, share) for group, limit in zip(groups, wanted, strict=True)]
    speeds = [min(limit, speed) for limit, speed in zip(wanted, able, strict=True)]
    if speeds == wanted:
        return speeds, ""
    lowered = " and ".join(f"{speed:.3g}" for speed in speeds)
    return speeds, f"speed limits lowered to {lowered} rad/s: more cannot be accelerated or braked on this plant"


def top_speed(
    plant: PlantConfig,
    axes: Iterable[int],
    wanted: float,
    demands: list[Demand] | None = None,
    share: float = CURRENT_SHARE,
) -> float:
    """Highest speed that axes can be brought to and stopped from, all at once, at most `wanted` [rad/s].

    Parameters
    ----------
    plant : PlantConfig
        What is really there.
    axes : iterable of int
        Axes that move together.
    wanted : float
        Speed that the nominal plant is asked for [rad/s].
    demands : list of Demand, optional
        What the set-points ask for, by axis; without them the speed is reached gently.
    share : float
        Part of the current limit that accelerating may take; turning round on the way takes twice of it.

    Raises
    ------
    SimulationError
        If the plant can do next to nothing of it.
    """
    moving = list(axes)
    for part in np.arange(1.0, 0.04, -0.01):
        speed = float(part) * wanted
        drives = all(_drives(plant, axis, speed, None if demands is None else demands[axis], share) for axis in moving)
        if drives and _absorbs(plant, moving, speed):
            return speed
    raise SimulationError(
        f"{wanted:.3g} rad/s is out of this plant's reach: not a twentieth of it can be reached and braked"
    )


def _drives(plant: PlantConfig, axis: int, speed: float, demand: Demand | None, share: float) -> bool:
    """Whether current and voltage suffice."""
    entry = plant.axes[axis]
    acceleration = 0.0 if demand is None else demand.acceleration * speed
    maximum = (entry.inertia * acceleration + entry.friction) / entry.torque_constant
    # E38 accelerates early: nine tenths of the speed have been reached when a fifth of the acceleration is left.
    at_speed = (0.2 * entry.inertia * acceleration + entry.friction + entry.viscous * speed) / entry.torque_constant
    return (demand is None or maximum <= share * demand.current) and _voltage(entry, speed, at_speed) <= (
        MODULATION * plant.bus.u_source
    )


def ripple(plant: PlantConfig, axis: int, current: float) -> float:
    """Half of the peak-to-peak ripple of a phase current in a motor that stands [A]; the averaged plant has none.

    u m (1 - m) / (6 f L) for duties that differ by m at most: for the resistance, and for the dead time and the drops
    that are made up for.
    """
    if rig.level() == "ideal":
        return 0.0
    entry, u = plant.axes[axis], plant.bus.u_source
    lost = entry.dead_time * plant.pwm_frequency + entry.v_drop / u
    spread = min(math.sqrt(3.0) * (entry.r_s + entry.r_on) * current / u + 2.0 * lost, 0.5)
    return u * spread * (1.0 - spread) / (6.0 * plant.pwm_frequency * min(entry.l_d, entry.l_q))


def _voltage(axis: AxisPlant, speed: float, current: float) -> float:
    """Phase voltage that drives a q current at a speed, with the drop of the switches [V]."""
    omega = axis.pole_pairs * speed
    u_q = (axis.r_s + axis.r_on) * current + omega * axis.psi_m + 4.0 / math.pi * axis.v_drop
    return math.hypot(u_q, omega * axis.l_q * current)


def _absorbs(plant: PlantConfig, axes: list[int], speed: float) -> bool:
    """Whether the capacitor takes what comes back from the shafts; losses are on the safe side."""
    energy = sum(0.5 * plant.axes[axis].inertia * speed**2 for axis in axes)
    return energy <= ENERGY_SHARE * 0.5 * plant.bus.capacitance * (OVER_VOLTAGE**2 - plant.bus.u_source**2)
