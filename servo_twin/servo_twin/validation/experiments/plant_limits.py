"""Limits of a plant (speed, acceleration, braking energy), and nominal values measured through feed-forward.

Experiments use these limits for motor-dependent bounds, so that they are also valid for other motors. If a plant does
not permit the set-points for the nominal plant, an experiment reduces them and adds a note.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from servo_msgs_py.axis_config import AxisConfigTable
from servo_msgs_py.axis_config_transfer import read_block
from servo_msgs_py.board_port import read_axis, word, write_axis, write_word
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import TICK

from servo_twin.board import Board
from servo_twin.board_access import VirtualBoardAccess
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.simulation import SimulationError
from servo_twin.validation.experiments import rig
from servo_twin.validation.experiments.rig import COUNT

CURRENT_SHARE: Final = 0.8
"""Fraction of the current limit for set-points; the remainder is for the controller."""

ENERGY_SHARE: Final = 0.95
"""Usable fraction of the energy of the capacitor up to the over-voltage limit."""

TUNED_WITHIN: Final = 2.0
"""Largest ratio of the inertias for which the tuning counts as matched."""

PROBE_SPEED: Final = 2.0
"""Step of the speed set-point for measuring the feed-forward [rad/s]."""

PROBE_HALVINGS: Final = 6
"""How often the step may be halved, for a large inertia, to stay within the current limit."""

PATH_END: Final = 13.0
"""Settling time of the path filter in time constants: then (1 + t) exp(-t) = 3e-5 of the ramp is left."""

NOMINAL_PATH_END: Final = 0.13  # settling time of the path filter for the nominal plant [s]

PROBE_PATH: Final = 0.3  # duration of the move for measuring the path filter [s]
PROBE_SLOPE: Final = 10  # interval for the speed of this move [slow ticks]


@dataclass(frozen=True)
class NominalShaft:
    """Nominal values of the controller: feed-forward current times the torque constant of the plant."""

    friction: float  # friction at low speed [N m]
    inertia: float  # inertia [kg m^2]


@dataclass(frozen=True)
class Demand:
    """Requirements of a set-point."""

    acceleration_per_speed: float
    """Largest acceleration per speed of the ramp; the path filter makes them proportional [1/s]."""
    current: float  # current limit [A]


@functools.cache
def built_in_block(axis: int) -> Mapping[str, int]:
    """Configuration block of an axis that is compiled into the firmware, raw numbers by member."""
    with Board(level="ideal") as board:
        return read_block(VirtualBoardAccess(board), axis)


def over_voltage() -> float:
    """Over-voltage limit of the drive [V]."""
    return AxisConfigTable.load().value("u_dc_max", built_in_block(0))


def modulation() -> float:
    """Largest phase voltage of the drive relative to the bus voltage."""
    return 2.0 / 3.0 * AxisConfigTable.load().value("current_loop.modulation_limit", built_in_block(0))


def nominal_shafts(plant: PlantConfig, seed: int) -> tuple[NominalShaft, ...]:
    """Nominal friction and inertia, from the change of i_q* by feed-forward in the tick of a speed step.

    Until this tick the runs with and without feed-forward are identical.

    Raises
    ------
    SimulationError
        If i_q* is at the current limit.
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
    """Contribution of a feature to i_q* of each axis in the tick of a speed step [A]."""
    without, switched = (_first_current(plant, seed, which, speed) for which in (None, switch))
    return [b - a for a, b in zip(without, switched, strict=True)]


def inertia_ratio(plant: PlantConfig, seed: int, axis: int) -> float:
    """Inertia relative to the nominal one; the bandwidth of a loop is lower by this ratio."""
    return plant.axes[axis].inertia / nominal_shafts(plant, seed)[axis].inertia


def differences(plant: PlantConfig, seed: int) -> tuple[str, ...]:
    """Differences between plant and nominal values, as text; the reference bounds require matched tuning."""
    notes: list[str] = []
    for axis, (entry, nominal) in enumerate(zip(plant.axes, nominal_shafts(plant, seed), strict=True)):
        ratio = entry.inertia / nominal.inertia
        if not 1.0 / TUNED_WITHIN <= ratio <= TUNED_WITHIN:
            notes.append(
                f"{axis_name(axis)}: the acceleration per current is {1.0 / ratio:.2g} times the nominal value of the"
                " tuning (firmware/config/servo.toml)"
            )
    return tuple(notes)


def _first_current(plant: PlantConfig, seed: int, switch: str | None, speed: float) -> list[float]:
    """i_q* of each axis in the tick of a speed step [A].

    At level ideal, without computing times: at level registers a feature shifts the times of all later events.
    """
    with rig.at_level("ideal"), rig.spinning(plant, seed) as board:
        for axis in range(AXES):
            rig.set_up(
                board, axis, "SPEED", parameters={"acceleration_limit": rig.largest(board, "acceleration_limit")}
            )
        rig.record(board, [0], 10 * TICK)
        for axis in range(AXES):
            if switch is not None:
                rig.features(board, axis, **{switch: True})
            write_axis(board, "cmd.speed", axis, speed)
        both = rig.record(board, range(AXES), 5 * TICK)
        limited = board.catalogue.flag("limits", "CURRENT").mask
    currents: list[float] = []
    for recording in both.values():
        k = int(np.argmax(recording["speed_ref"] > 0.5 * speed))
        if recording["limits"][k] & limited:
            raise SimulationError("the feed-forward cannot be measured: i_q* is at the current limit")
        currents.append(float(recording["i_q_ref"][k]))
    return currents


def speed_limits(plant: PlantConfig, seed: int) -> list[float]:
    """``param.speed_limit`` after reset [rad/s]."""
    return _parameter(plant, seed, "speed_limit")


def current_limits(plant: PlantConfig, seed: int) -> list[float]:
    """``param.i_q_limit`` after reset [A]."""
    return _parameter(plant, seed, "i_q_limit")


def _parameter(plant: PlantConfig, seed: int, name: str) -> list[float]:
    with rig.spinning(plant, seed) as board:
        return [read_axis(board, f"param.{name}", axis) for axis in range(AXES)]


def path_demands(plant: PlantConfig, seed: int) -> list[Demand]:
    """Requirements of the path filter for a long move without acceleration limit, measured at its output."""
    with rig.spinning(plant, seed) as board:
        speeds, currents = (
            [read_axis(board, f"param.{name}", axis) for axis in range(AXES)] for name in ("speed_limit", "i_q_limit")
        )
        for axis in range(AXES):
            rig.set_up(board, axis, parameters={"acceleration_limit": rig.largest(board, "acceleration_limit")})
            write_word(
                board,
                "cmd.position",
                axis,
                word(board, axis, "position") + round(10.0 * PROBE_PATH * speeds[axis] / COUNT),
            )
        both = rig.record(board, range(AXES), PROBE_PATH)
    demands: list[Demand] = []
    for axis, recording in both.items():
        step = PROBE_SLOPE
        speed = (recording["position_ref"][step:] - recording["position_ref"][:-step]) * COUNT / (step * TICK)
        acceleration = float((speed[step:] - speed[:-step]).max()) / (step * TICK)
        demands.append(Demand(acceleration / speeds[axis], currents[axis]))
    return demands


def path_ends(plant: PlantConfig, seed: int) -> list[float]:
    """Settling time of the path of each axis after the end of a ramp [s]; longer for a large inertia.

    With E40 and damping 1, a speed step v has a largest acceleration of v omega_n / e.
    """
    return [PATH_END / (math.e * demand.acceleration_per_speed) for demand in path_demands(plant, seed)]


def path_settles(plant: PlantConfig, seed: int, nominal: float) -> list[float]:
    """Permitted settling time of each axis [s]: `nominal`, plus the additional time of its path filter."""
    return [nominal + max(0.0, end - NOMINAL_PATH_END) for end in path_ends(plant, seed)]


def move_speeds(plant: PlantConfig, seed: int, together: bool, share: float = CURRENT_SHARE) -> tuple[list[float], str]:
    """Speed limits for position moves that are feasible with this plant, and a note if they are reduced.

    Parameters
    ----------
    plant : PlantConfig
        Plant data.
    seed : int
        Seed of the noise.
    together : bool
        Both axes move simultaneously.
    share : float
        See `top_speed`.

    Returns
    -------
    list of float
        Limit of each axis [rad/s], at most the default.
    str
        A note; empty: no reduction.
    """
    requested = speed_limits(plant, seed)
    demands = path_demands(plant, seed)
    groups = [range(AXES)] * AXES if together else [[axis] for axis in range(AXES)]
    feasible = [top_speed(plant, group, limit, demands, share) for group, limit in zip(groups, requested, strict=True)]
    speeds = [min(limit, speed) for limit, speed in zip(requested, feasible, strict=True)]
    if speeds == requested:
        return speeds, ""
    lowered = " and ".join(f"{speed:.3g}" for speed in speeds)
    return speeds, f"speed limits reduced to {lowered} rad/s by the current or the braking energy of this plant"


def top_speed(
    plant: PlantConfig,
    axes: Iterable[int],
    requested: float,
    demands: list[Demand] | None = None,
    share: float = CURRENT_SHARE,
) -> float:
    """Highest speed to which all axes can be accelerated and from which they can be braked simultaneously [rad/s].

    Parameters
    ----------
    plant : PlantConfig
        Plant data.
    axes : iterable of int
        Axes that move simultaneously.
    requested : float
        Upper limit: the speed for the nominal plant [rad/s].
    demands : list of Demand, optional
        Requirements of the set-points, by axis; by default a slow acceleration.
    share : float
        Fraction of the current limit for the acceleration; a reversal during a move takes twice as much.

    Raises
    ------
    SimulationError
        If less than a twentieth of `requested` is feasible.
    """
    moving = list(axes)
    for part in np.arange(1.0, 0.04, -0.01):
        speed = float(part) * requested
        drives = all(_drives(plant, axis, speed, None if demands is None else demands[axis], share) for axis in moving)
        if drives and _absorbs(plant, moving, speed):
            return speed
    raise SimulationError(
        f"{requested:.3g} rad/s is not feasible with this plant: not even a twentieth can be reached and braked"
    )


def _drives(plant: PlantConfig, axis: int, speed: float, demand: Demand | None, share: float) -> bool:
    """True if current and voltage are sufficient."""
    entry = plant.axes[axis]
    acceleration = 0.0 if demand is None else demand.acceleration_per_speed * speed
    maximum = (entry.inertia * acceleration + entry.friction) / entry.torque_constant
    # E38: at nine tenths of the speed the acceleration has decreased to a fifth.
    at_speed = (0.2 * entry.inertia * acceleration + entry.friction + entry.viscous * speed) / entry.torque_constant
    return (demand is None or maximum <= share * demand.current) and _voltage(entry, speed, at_speed) <= (
        modulation() * plant.bus.u_source
    )


def ripple(plant: PlantConfig, axis: int, current: float) -> float:
    """Half of the peak-to-peak PWM ripple of a phase current at standstill [A]; 0 on the averaged plant.

    u m (1 - m) / (6 f L) with the largest difference m of the duties, for resistance, dead time and drops.
    """
    if rig.level() == "ideal":
        return 0.0
    entry, u = plant.axes[axis], plant.bus.u_source
    lost = entry.dead_time * plant.pwm_frequency + entry.v_drop / u
    spread = min(math.sqrt(3.0) * (entry.r_s + entry.r_on) * current / u + 2.0 * lost, 0.5)
    return u * spread * (1.0 - spread) / (6.0 * plant.pwm_frequency * min(entry.l_d, entry.l_q))


def _voltage(axis: AxisPlant, speed: float, current: float) -> float:
    """Phase voltage for a q current at a speed, including the drop of the switches [V]."""
    omega = axis.pole_pairs * speed
    u_q = (axis.r_s + axis.r_on) * current + omega * axis.psi_m + 4.0 / math.pi * axis.v_drop
    return math.hypot(u_q, omega * axis.l_q * current)


def _absorbs(plant: PlantConfig, axes: list[int], speed: float) -> bool:
    """True if the capacitor can absorb the kinetic energy; losses are neglected (safe side)."""
    energy = sum(0.5 * plant.axes[axis].inertia * speed**2 for axis in axes)
    return energy <= ENERGY_SHARE * 0.5 * plant.bus.capacitance * (over_voltage() ** 2 - plant.bus.u_source**2)
