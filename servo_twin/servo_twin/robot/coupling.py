"""Joints of a MuJoCo model, driven by the axes of a virtual board (servo_twin/doc/coupling.md).

MuJoCo owns the joint with its whole inertia, friction and stops, the board electronics, firmware and air-gap torque.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import choose, read_axis, write_axis
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.units import PERIOD_NS

from servo_twin.board import Board
from servo_twin.board_state import BoardState
from servo_twin.simulation import SEARCH_MAX, enable

Mode = Literal["POSITION", "SPEED", "TORQUE"]
"""What the control signal of an actuator means: angle [rad], speed [rad/s] or torque [N m] of the motor's shaft."""

_VARIABLES: Final[dict[Mode, str]] = {"POSITION": "cmd.position", "SPEED": "cmd.speed", "TORQUE": "cmd.i_q"}
_INERTIA_TOLERANCE: Final = 0.01  # largest relative difference between armature and inertia of the plant
_TIME_TOLERANCE: Final = 1e-9  # [s]


class CouplingError(ValueError):
    """A model or a control signal does not fit the board; the message has what, where and a remedy."""


@dataclass(frozen=True)
class Drive:
    """One axis of the board at one actuator of the model.

    Parameters
    ----------
    actuator : str
        Name of the actuator.
    axis : int
        Index of the axis.
    mode : Mode, optional
        Meaning of the control signal; None: it is not read, the axis is commanded otherwise.
    """

    actuator: str
    axis: int
    mode: Mode | None = "POSITION"


@dataclass(frozen=True)
class CoupledState:
    """State of model and board at an instant; can be pickled."""

    board: BoardState  # state of the board
    simulator: NDArray[np.float64]  # state of MuJoCo, ``mjSTATE_INTEGRATION``
    time: float  # time of MuJoCo [s]
    impulse: tuple[float, ...]  # integral of the air-gap torque of each drive at the end of the last step [N m s]
    zero: tuple[float, ...]  # length of each actuator at position 0 of the firmware [rad]


class RobotDrives:
    """A board whose axes move joints of a MuJoCo model.

    Each actuator is ``<general joint=... gear=... dyntype="user" armature=.../>``: `gear` is the ratio of the gearbox,
    `armature` the inertia of the rotor, `mjData.act` the torque at the shaft of the motor, and `mjData.ctrl` the
    set-point (see `Mode`). Length and velocity of an actuator are angle and speed of the motor. The torque of a
    step acts in the next one.

    Parameters
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        The model and its state. The time step is a multiple of a PWM period, 62.5 us.
    board : Board
        The board, at any instant. From now on only the coupling lets its time elapse.
    drives : sequence of Drive
        Actuators of the axes. An axis that is not named keeps the rotor of its plant.

    Raises
    ------
    CouplingError
        If actuator, axis, time step or inertia do not fit.
    """

    def __init__(self, model: Any, data: Any, board: Board, drives: Sequence[Drive]) -> None:
        self.model, self.data, self.board, self.drives = model, data, board, tuple(drives)
        self._step_ns = _step_ns(model)
        ids = [_actuator(model, board, drive) for drive in self.drives]
        for what, used in (("actuator", ids), ("axis", [drive.axis for drive in self.drives])):
            if len(set(used)) < len(used):
                raise CouplingError(f"two drives have the same {what}; name each one once")
        joints = [int(model.actuator_trnid[i, 0]) for i in ids]
        self._gear = np.array([model.actuator_gear[i, 0] for i in ids])
        self._qpos = np.array([model.jnt_qposadr[joint] for joint in joints], dtype=np.intp)
        self._qvel = np.array([model.jnt_dofadr[joint] for joint in joints], dtype=np.intp)
        self._act = np.array([model.actuator_actadr[i] for i in ids], dtype=np.intp)
        self._ctrl = np.array([model.actuator_ctrladr[i] for i in ids], dtype=np.intp)
        self._limits = np.array(
            [model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-math.inf, math.inf) for i in ids]
        ).reshape(-1, 2)
        lengths = self.lengths()
        self._offset = [
            board.truth(drive.axis).theta_m - float(length) for drive, length in zip(self.drives, lengths, strict=True)
        ]
        self._impulse = self._impulses()
        self._zero = lengths
        self._time = float(data.time)
        for drive in self.drives:
            if drive.mode is not None:
                choose(board, "cmd.mode", drive.axis, drive.mode)
        self._start = self.state()

    def lengths(self) -> NDArray[np.float64]:
        """Angles of the motors: joint times gear [rad]."""
        return np.asarray(self._gear * self.data.qpos[self._qpos])

    def _impulses(self) -> NDArray[np.float64]:
        return np.array([self.board.truth(drive.axis).impulse_e for drive in self.drives])

    # ---- time -------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One time step of model and board.

        Raises
        ------
        CouplingError
            If a control signal is not valid, or the time of the model was changed outside of the coupling.
        BoardError
            If a joint jumps or turns the motor faster than 2000 rad/s.
        """
        if abs(self.data.time - self._time) > _TIME_TOLERANCE:
            raise CouplingError(
                f"the time of mjData is {self.data.time:g} s, that of the board {self._time:g} s: "
                "use reset() and restore() of the coupling instead of mj_resetData and mj_setState"
            )
        self._command()
        mujoco.mj_step(self.model, self.data)
        self._time = float(self.data.time)
        board = self.board
        end_ns = (board.time_ns // self._step_ns + 1) * self._step_ns
        seconds = (end_ns - board.time_ns) * 1e-9
        speeds = self._gear * self.data.qvel[self._qvel]
        for drive, offset, length, speed in zip(self.drives, self._offset, self.lengths(), speeds, strict=True):
            board.drive_shaft(drive.axis, float(length) + offset, float(speed), seconds)
        board.advance(end_ns)
        impulse = self._impulses()
        self.data.act[self._act] = (impulse - self._impulse) / (self._step_ns * 1e-9)
        self._impulse = impulse

    def _command(self) -> None:
        """Give the control signals to the firmware."""
        signals = np.clip(self.data.ctrl[self._ctrl], self._limits[:, 0], self._limits[:, 1])
        for drive, signal, zero in zip(self.drives, signals.tolist(), self._zero.tolist(), strict=True):
            if drive.mode is None:
                continue
            if not math.isfinite(signal):
                raise CouplingError(f"actuator '{drive.actuator}': the control signal is {signal}")
            if drive.mode == "POSITION":
                signal -= zero
            elif drive.mode == "TORQUE":
                signal /= self.board.plant.axes[drive.axis].torque_constant
            try:
                write_axis(self.board, _VARIABLES[drive.mode], drive.axis, signal)
            except ValueError as error:
                raise CouplingError(f"actuator '{drive.actuator}': {error}") from None

    # ---- `servo_msgs_py.board_port.BoardPort`, with the robot --------------------------------------------------------

    @property
    def catalogue(self) -> Catalogue:
        """Variables of the board."""
        return self.board.catalogue

    def clock(self) -> float:
        """Simulated time of the board [s]."""
        return self.board.clock()

    def wait(self, seconds: float) -> None:
        """Step for at least some simulated time [s]."""
        end = self._time + seconds - _TIME_TOLERANCE
        while self._time < end:
            self.step()

    def read_words(self, name: str) -> list[int]:
        """See `Board.read_words`."""
        return self.board.read_words(name)

    def write_words(self, name: str, words: Sequence[int], first: int = 0) -> bool:
        """See `Board.write_words`."""
        return self.board.write_words(name, words, first)

    # ---- drive and state ---------------------------------------------------------------------------------------------

    def enable(self, search_max: float = SEARCH_MAX) -> float:
        """Enable both axes and wait for the end of the rotor search, then `align`; returns its duration [s].

        Raises
        ------
        SimulationError
            If an axis has a fault, or on a timeout of the rotor search.
        """
        seconds = enable(self, search_max)
        self.align()
        return seconds

    def align(self) -> None:
        """Let control signals of position be lengths of the actuators, and hold the present position.

        The firmware counts its position from the rotor search or from the home position; call this after either.
        """
        position = [read_axis(self.board, f"{axis_name(drive.axis)}.position", 0) for drive in self.drives]
        self._zero = self.lengths() - position
        held = np.array([drive.mode == "POSITION" for drive in self.drives], dtype=bool)
        self.data.ctrl[self._ctrl[held]] = self.lengths()[held]

    def state(self) -> CoupledState:
        """Complete state of model and board; at level ``registers`` see `Board.state`."""
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        simulator = np.empty(mujoco.mj_stateSize(self.model, signature))
        mujoco.mj_getState(self.model, self.data, simulator, signature)
        return CoupledState(
            self.board.state(), simulator, self._time, tuple(self._impulse.tolist()), tuple(self._zero.tolist())
        )

    def restore(self, state: CoupledState) -> None:
        """Continue from a state of this coupling or a copy; every later bit is that of the other run.

        As after ``mj_setState``, quantities that MuJoCo derives are old until the next step.

        Raises
        ------
        BoardError
            If the state is from another build or level.
        """
        self.board.restore(state.board)
        mujoco.mj_setState(self.model, self.data, state.simulator, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._time = state.time
        self._impulse, self._zero = np.array(state.impulse), np.array(state.zero)

    def reset(self) -> None:
        """Continue from the state at construction."""
        self.restore(self._start)

    def copy(self) -> RobotDrives:
        """The same robot and board once more, with the same model; each continues by itself."""
        other = copy.copy(self)
        other.data, other.board = copy.copy(self.data), self.board.copy()
        return other


def _step_ns(model: Any) -> int:
    seconds = float(model.opt.timestep)
    step_ns = round(seconds * 1e9)
    if step_ns < PERIOD_NS or step_ns % PERIOD_NS or abs(seconds * 1e9 - step_ns) > 1e-3:
        raise CouplingError(
            f"the time step {seconds:g} s of the model is not a multiple of a PWM period; "
            'write for example <option timestep="0.0005"/>'
        )
    return step_ns


def _actuator(model: Any, board: Board, drive: Drive) -> int:
    """Index of an actuator after a check that it fits."""
    where = f"actuator '{drive.actuator}'"
    if drive.axis not in range(AXES):
        raise CouplingError(f"{where}: the board has no axis with index {drive.axis}; write 0 .. {AXES - 1}")
    actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, drive.actuator)
    if actuator < 0:
        known = ", ".join(model.actuator(i).name or "(no name)" for i in range(model.nu)) or "none"
        raise CouplingError(f"{where}: not in the model; its actuators: {known}")
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    joint = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT or model.jnt_type[joint] not in (slide, hinge):
        raise CouplingError(f"{where}: a motor turns a hinge or a slide; write joint=... of one of them")
    if (
        model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_USER
        or model.actuator_gaintype[actuator] != mujoco.mjtGain.mjGAIN_FIXED
        or model.actuator_gainprm[actuator, 0] != 1.0
        or model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_NONE
        or model.actuator_actnum[actuator] != 1
    ):
        raise CouplingError(
            f'{where}: the torque of the motor is its activation; write <general dyntype="user" actdim="1" ...> '
            "without gain and bias"
        )
    plant = board.plant.axes[drive.axis]
    armature = float(model.actuator_armature[actuator])
    if not math.isclose(armature, plant.inertia, rel_tol=_INERTIA_TOLERANCE):
        raise CouplingError(
            f"{where}: armature {armature:g} kg m^2 is not the inertia of {axis_name(drive.axis)} in the plant; "
            f'write armature="{plant.inertia:g}", or change inertia in the plant file'
        )
    if plant.pins.brake_torque > 0.0:
        raise CouplingError(
            f"{where}: the holding brake of {axis_name(drive.axis)} does not act on a joint of MuJoCo; "
            "set brake_torque = 0 in the plant file"
        )
    return int(actuator)
