"""The ``<dcmotor>`` of MuJoCo that is nearest to an axis, and how far it is from the firmware (doc/coupling.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from servo_msgs_py.board_port import read_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.units import TICK

from servo_twin.board import Board
from servo_twin.plant import AxisPlant, PlantConfig
from servo_twin.robot.coupling import Drive, RobotDrives
from servo_twin.servo_config import ServoConfig

_Array = NDArray[np.float64]

_REST: Final = 0.3  # after a move [s]
_ACCELERATION: Final = 2000.0  # peak of a smooth move [rad/s^2]
_LOAD: Final = 0.02  # [N m]
_TURN: Final = 2.0 * math.pi
_SPEED_BANDWIDTH: Final = 2.0 * math.pi * 60.0  # of the first trial [rad/s]
_POSITION_GAIN: Final = 60.0  # of the first trial [1/s]


def _smooth(distance: float) -> _Array:
    """Angle of a smooth move, one value per slow tick [rad]."""
    duration = math.sqrt(6.0 * distance / _ACCELERATION)
    s = np.clip(np.arange(0.0, duration + _REST, TICK) / duration, 0.0, 1.0)
    return np.asarray(distance * s * s * (3.0 - 2.0 * s))


def _sine(frequency: float) -> _Array:
    """Sine of 1 rad that begins and ends at rest."""
    t = np.arange(0.0, 2.0, TICK)
    return np.asarray(np.sin(0.5 * math.pi * t) ** 2 * np.sin(_TURN * frequency * t))


def _load() -> _Array:
    """Torque of 20 mN m for 0.3 s [N m]."""
    return np.repeat([0.0, _LOAD, 0.0], [round(t / TICK) for t in (0.05, 0.3, 0.3)])


class Move(NamedTuple):
    """Set-points of an axis relative to its rest [rad], and external torque [N m]; one value per slow tick."""

    angle: _Array
    load: _Array

    @classmethod
    def free(cls, angle: _Array) -> Move:
        """Without a torque."""
        return cls(angle, np.zeros_like(angle))


MOVES: Final = {
    "smooth move, 0.1 turns": Move.free(_smooth(0.1 * _TURN)),
    "smooth move, 1 turn": Move.free(_smooth(_TURN)),
    "smooth move, 10 turns": Move.free(_smooth(10.0 * _TURN)),
    "sine, 2 Hz, 1 rad": Move.free(_sine(2.0)),
    "load, 20 mN m": Move(np.zeros_like(_load()), _load()),
}


@dataclass(frozen=True)
class Nearest:
    """Motor of MuJoCo with a controller, for one axis."""

    name: str  # of joint and actuator
    plant: AxisPlant
    current_limit: float  # [A]
    u_source: float  # [V]
    k_p: float  # [N m/rad]
    k_i: float  # [N m/(rad s)]
    k_d: float  # [N m s/rad]

    def actuator(self) -> str:
        """Element of the motor."""
        plant, k = self.plant, self.plant.torque_constant
        more = ""
        if plant.cogging_torque:
            phase = plant.cogging_phase
            more += f' cogging="{plant.cogging_torque:g} {plant.cogging_periods:g} {phase:g}"'
        return (
            f'<dcmotor name="{self.name}" joint="{self.name}" input="pos vel" motorconst="{k:.6g} {k:.6g}" '
            f'resistance="{1.5 * plant.r_s:.6g}" inductance="{1.5 * plant.l_q:.6g} 0" '
            f'saturation="{k * self.current_limit:.6g} {self.current_limit:.6g} 0" armature="{plant.inertia:g}" '
            f'controller="{self.k_p:.6g} {self.k_i:.6g} {self.k_d:.6g} 0 {k * self.current_limit:.6g} '
            f'{1.5 * self.u_source / math.sqrt(3.0):.6g}"{more}/>'
        )

    def joint(self) -> str:
        """Element of the joint, with the friction of the motor."""
        return f'<joint name="{self.name}" frictionloss="{self.plant.friction:g}" damping="{self.plant.viscous:g}"/>'

    def moved(self, move: Move) -> _Array:
        """Angle of the rotor, one value per slow tick [rad]."""
        model = mujoco.MjModel.from_xml_string(model_text([self]))
        data = mujoco.MjData(model)
        angles = np.empty_like(move.angle)
        for k, (load, *ctrl) in enumerate(zip(move.load, move.angle, np.gradient(move.angle, TICK), strict=True)):
            data.ctrl[:], data.qfrc_applied[0] = ctrl, load
            angles[k] = data.qpos[0]
            mujoco.mj_step(model, data)
        return angles


def model_text(motors: Sequence[Nearest], comment: str = "") -> str:
    """MJCF file with a free rotor for each motor."""
    bodies = "".join(
        f"    <body>\n      {motor.joint()}\n"
        '      <inertial pos="0 0 0" mass="1" diaginertia="1e-12 1e-12 1e-12"/>\n    </body>\n'
        for motor in motors
    )
    actuators = "".join(f"    {motor.actuator()}\n" for motor in motors)
    note = f"<!--\n{comment}\n-->\n" if comment else ""
    return (
        f'{note}<mujoco model="nearest motors">\n  <compiler boundinertia="0"/>\n'
        f'  <option timestep="{TICK:g}" integrator="implicitfast"/>\n'
        f"  <worldbody>\n{bodies}  </worldbody>\n  <actuator>\n{actuators}  </actuator>\n</mujoco>\n"
    )


def firmware_moves(drives: RobotDrives) -> list[_Array]:
    """Angles of a rotor of the model while the firmware follows `MOVES`, relative to their beginnings [rad]."""
    lead = round(float(drives.delays[0]) / TICK)
    result = []
    for move in MOVES.values():
        begin, held = float(drives.lengths()[0]), float(drives.data.ctrl[0])
        angles = np.empty(lead + len(move.angle))
        for k in range(len(angles)):
            angles[k] = drives.lengths()[0] - begin
            drives.data.ctrl[0] = held + move.angle[min(k, len(move.angle) - 1)]
            drives.data.qfrc_applied[0] = move.load[max(k - lead, 0)]
            drives.step()
        drives.wait(_REST)
        result.append(angles[lead:])
    return result


class Errors(NamedTuple):
    """Distance of a motor from the firmware."""

    axis: str
    move: str  # name in `MOVES`, or all
    rms: float  # [rad]
    largest: float  # [rad]


def nearest(plant: PlantConfig, seed: int, servo: ServoConfig | None = None) -> tuple[list[Nearest], list[Errors]]:
    """Motor of each axis, whose gains give the smallest mean square error over all moves.

    Parameters
    ----------
    plant : PlantConfig
        Motors and supply.
    seed : int
        Seed of the board.
    servo : ServoConfig, optional
        Configuration of the firmware; that of ``firmware/config/servo.toml`` by default.

    Raises
    ------
    SimulationError
        If an axis has a fault.
    """
    motors, found = [], []
    for axis in range(AXES):
        with Board(plant, seed=seed, level="ideal", servo=servo) as board:
            true, motor = _fitted(board, axis)
        motors.append(motor)
        errors = [motor.moved(move) - angles for move, angles in zip(MOVES.values(), true, strict=True)]
        for name, error in [*zip(MOVES, errors, strict=True), ("all", np.concatenate(errors))]:
            found.append(Errors(motor.name, name, float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())))
    return motors, found


def _fitted(board: Board, axis: int) -> tuple[list[_Array], Nearest]:
    """Angles by the firmware, and the nearest motor."""
    plant = board.plant.axes[axis]
    board.run(0.03)  # start of the firmware
    current = read_axis(board, "param.i_q_limit", axis)

    def motor(gains: _Array) -> Nearest:
        k_d = plant.inertia * _SPEED_BANDWIDTH * math.exp(gains[1])
        k_p = _POSITION_GAIN * k_d * math.exp(gains[0])
        k_i = _POSITION_GAIN * k_p * math.exp(gains[2])
        return Nearest(axis_name(axis), plant, current, board.plant.bus.u_source, k_p, k_i, k_d)

    first = motor(np.zeros(3))
    general = f'<general name="m" joint="{first.name}" armature="{plant.inertia:g}" dyntype="user" actdim="1"/>'
    model = mujoco.MjModel.from_xml_string(model_text([first]).replace(first.actuator(), general))
    drives = RobotDrives(model, mujoco.MjData(model), board, [Drive("m", axis, "TRAJECTORY")])
    drives.enable()
    true = firmware_moves(drives)

    def error(gains: _Array) -> float:
        one = motor(gains)
        errors = [one.moved(move) - angles for move, angles in zip(MOVES.values(), true, strict=True)]
        return float(np.mean(np.concatenate(errors) ** 2))

    best = minimize(error, np.zeros(3), method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-9, "maxfev": 80})
    return true, motor(best.x)
