"""Torque error by dead time and switch drops near zero current, and the resulting shaft displacement.

The averaged plant models the error as proportional to the current near zero. On the switching plant a phase current
stays at zero until the controller has compensated the error; about 60 mA are lost, more than the friction current of
40 mA. Experiments about feed-forward subtract this displacement, because it is an error of the inverter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace
from servo_msgs_py.units import TICK
from servo_tuning.control_loops import control_loops

from servo_twin.plant import PlantConfig
from servo_twin.validation.experiments.plant_limits import built_in_block
from servo_twin.validation.experiments.rig import COUNT


def displacement(
    recording: Trace, plant: PlantConfig, axis: int, *, position: bool, heavier: float = 1.0
) -> NDArray[np.float64]:
    """Shaft displacement caused by the difference between true current and set-point [counts].

    Parameters
    ----------
    recording : Trace
        Recording of the axis, with the true current.
    plant : PlantConfig
        Plant data.
    axis : int
        Index.
    position : bool
        Position control; false: speed control.
    heavier : float
        Inertia relative to the tuning; the bandwidth is lower by this factor.
    """
    torque_error = plant.axes[axis].torque_constant * (recording["i_q_true"] - recording["i_q_ref"])
    return response(torque_error, plant, axis, position=position, heavier=heavier)


def response(
    torques: NDArray[np.float64], plant: PlantConfig, axis: int, *, position: bool, heavier: float = 1.0
) -> NDArray[np.float64]:
    """Response of the shaft to torques, with linear control loops and the nominal bandwidths [counts].

    Parameters
    ----------
    torques : ndarray
        One per slow tick [N m].
    plant, axis, position, heavier
        See `displacement`.
    """
    loops, inertia = control_loops(built_in_block(axis)), plant.axes[axis].inertia
    gains = loops.used.speed
    corner = gains.ki / (gains.kp * TICK)
    bandwidth = gains.kp * loops.motor.torque_constant / loops.motor.inertia / heavier
    gain = loops.used.position if position else 0.0
    speed = position_error = integral = 0.0
    displacements: list[float] = []
    for torque in torques:
        error = speed + gain * position_error
        integral += TICK * error
        speed += TICK * (float(torque) / inertia - bandwidth * (error + corner * integral))
        position_error += TICK * speed
        displacements.append(position_error)
    return np.asarray(displacements) / COUNT


def displacement_counts(recording: Trace, plant: PlantConfig, axis: int, after: float, heavier: float = 1.0) -> float:
    """Largest displacement under position control after `after` [s], rounded to counts."""
    position_error = displacement(recording, plant, axis, position=True, heavier=heavier)
    return float(round(np.abs(position_error[recording.time > after]).max(initial=0.0)))


def displacement_at(recording: Trace, plant: PlantConfig, axis: int, target: float, within: float) -> float:
    """Largest displacement after the set-point is within `within` counts of a target [counts]."""
    near = np.abs(recording["position_ref"] - target) <= within
    after = float(recording.time[int(np.argmax(near))])
    return displacement_counts(recording, plant, axis, after) if near.any() else 0.0
