"""Joints of a MuJoCo model, driven by the axes of virtual boards (servo_twin/doc/coupling.md).

MuJoCo owns the joint with its whole inertia, friction and stops, the board electronics, firmware, air-gap torque and
holding brake.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import active, choose, place, reached, read_axis, word, write_axis
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.timed_points import TimedPoint, encode_points
from servo_msgs_py.units import PERIOD_NS, TICK_NS

from servo_twin.board import Board, BoardError
from servo_twin.board_state import BoardState
from servo_twin.fault_injection import Pin
from servo_twin.simulation import SEARCH_MAX, SimulationError, enable

Mode = Literal["POSITION", "SPEED", "TORQUE", "TRAJECTORY"]
"""What the control signal of an actuator means, at the motor's shaft.

Angle [rad], speed [rad/s] or torque [N m]. TRAJECTORY: successive angles of a smooth path, which the shaft follows
`RobotDrives.delays` later.
"""

_VARIABLES: Final[dict[Mode, str]] = {"POSITION": "cmd.position", "SPEED": "cmd.speed", "TORQUE": "cmd.i_q"}
_ANGLES: Final = ("POSITION", "TRAJECTORY")
_POINT_NS: Final = 2_000_000  # shortest time between two points of a path [ns]
_AHEAD_NS: Final = 2_000_000  # from the arrival of a point until its predecessor is reached; the board needs 1.5 ms
_TO_SWITCH: Final = "SWITCH_"  # beginning of methods of homing
_SNAPSHOT: Final = 2e-9 * TICK_NS  # until a snapshot has the position that a homing has set [s]
_HOMING_MAX: Final = 60.0  # duration of a homing [s]
_INERTIA_TOLERANCE: Final = 0.01  # largest relative difference between armature and inertia of the plant
_TIME_TOLERANCE: Final = 1e-9  # [s]

_Array = NDArray[np.float64]


class CouplingError(ValueError):
    """A model does not fit the board; the message has what, where and a remedy."""


@dataclass(frozen=True)
class Drive:
    """One axis of a board at one actuator of the model.

    Parameters
    ----------
    actuator : str
        Name of the actuator.
    axis : int
        Index of the axis: 0 and 1 are those of the first board, 2 and 3 those of the second.
    mode : Mode, optional
        Meaning of the control signal; None: it is not read, the axis is commanded otherwise.
    """

    actuator: str
    axis: int
    mode: Mode | None = "POSITION"


@dataclass(frozen=True)
class CoupledState:
    """State of model and boards at an instant; can be pickled."""

    boards: tuple[BoardState, ...]  # state of each board
    simulator: _Array  # state of MuJoCo, ``mjSTATE_INTEGRATION``
    time: float  # time of MuJoCo [s]
    drives: _Array  # private numbers of the coupling, one row per quantity


class RobotDrives:
    """Boards whose axes move joints of a MuJoCo model.

    Each actuator is ``<general joint=... gear=... dyntype="user" armature=.../>``: `gear` is the ratio of the gearbox,
    `armature` the inertia of the rotor, `mjData.act` the torque of motor and holding brake, and `mjData.ctrl` the
    set-point (see `Mode`). Length and velocity of an actuator are angle and speed of the motor.

    Parameters
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        The model and its state. The time step is a multiple of a PWM period, 62.5 us.
    boards : Board or sequence of Board
        The boards, at any instant. From now on their time elapses in the steps of the model (`Board.follow`): what
        runs a board moves the robot.
    drives : sequence of Drive
        Actuators of the axes. An axis that is not named keeps the rotor of its plant.

    Raises
    ------
    CouplingError
        If actuator, axis, time step or inertia do not fit.
    """

    def __init__(self, model: Any, data: Any, boards: Board | Sequence[Board], drives: Sequence[Drive]) -> None:
        self.model, self.data, self.drives = model, data, tuple(drives)
        self.boards = (boards,) if isinstance(boards, Board) else tuple(boards)
        self.step_ns = _step_ns(model)
        if len(set(map(id, self.boards))) < len(self.boards):
            raise CouplingError("a board is named twice; name each board once")
        _check_once(self.drives)
        ids = [_actuator(model, self.boards, drive) for drive in self.drives]
        joints = [int(model.actuator_trnid[i, 0]) for i in ids]
        _check_joints(model, self.drives, joints)
        self.gear = np.array([model.actuator_gear[model.actuator_outadr[i], 0] for i in ids])
        self._qpos = np.array([model.jnt_qposadr[joint] for joint in joints], dtype=np.intp)
        self._qvel = np.array([model.jnt_dofadr[joint] for joint in joints], dtype=np.intp)
        self._act = np.array([model.actuator_actadr[i] for i in ids], dtype=np.intp)
        self.channels = np.array([model.actuator_ctrladr[i] for i in ids], dtype=np.intp)
        self._limits = np.array(
            [
                model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-math.inf, math.inf)
                for i in self.channels
            ]
        ).reshape(-1, 2)
        self._where = [(self.boards[drive.axis // AXES], drive.axis % AXES) for drive in self.drives]
        dofs = [int(model.jnt_dofadr[joint]) for joint in joints]
        self._brakes = [
            (k, dof)
            for k, (dof, (board, axis)) in enumerate(zip(dofs, self._where, strict=True))
            if board.plant.axes[axis].pins.brake_torque > 0.0
        ]  # drive and degree of freedom
        lengths = self.lengths()
        self._offset = np.array([board.truth(axis).theta_m for board, axis in self._where]) - lengths
        # Of each drive: length at position 0 of the firmware [rad], NaN before `align`; the control signal of mode
        # TRAJECTORY one and two points ago; tick of the firmware at time 0 of its board [PWM periods].
        self._numbers = np.full((4, len(ids)), math.nan)
        self._time = float(data.time)
        self._ends: dict[Board, int] = {}  # end of the step under way [ns]; empty: none is
        self._impulses: list[float] = []  # of each drive at the begin of that step [N m s]
        self._point_steps = -(-_POINT_NS // self.step_ns)
        for drive, (board, axis) in zip(self.drives, self._where, strict=True):
            if drive.mode is not None:
                choose(board, "cmd.mode", axis, drive.mode)
            if drive.mode == "TRAJECTORY" and self.step_ns % TICK_NS:
                raise CouplingError(
                    f"actuator '{drive.actuator}': in mode TRAJECTORY the time step of the model is a multiple of "
                    'a slow tick; write for example <option timestep="0.0005"/>'
                )
        for board in self.boards:
            board.follow(self)
        try:
            self._start: CoupledState | None = self.state()
        except BoardError as error:
            self._start, self._no_start = None, str(error)

    @property
    def delays(self) -> _Array:
        """Time from each control signal of mode TRAJECTORY until the shaft is at its angle [s]; 0 for other signals."""
        result = np.zeros(self.model.nu)
        paths = [drive.mode == "TRAJECTORY" for drive in self.drives]
        result[self.channels[paths]] = (2 * self._point_steps * self.step_ns + _AHEAD_NS) * 1e-9
        return result

    def lengths(self) -> _Array:
        """Angles of the motors: joint times gear [rad]."""
        return np.asarray(self.gear * self.data.qpos[self._qpos])

    def speeds(self) -> _Array:
        """Speeds of the motors [rad/s]."""
        return np.asarray(self.gear * self.data.qvel[self._qvel])

    def torques(self) -> _Array:
        """Torques of motors and holding brakes in the next step [N m]; of a motor its mean in the last one."""
        return np.array(self.data.act[self._act])

    # ---- time -------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One time step of model and boards, or the rest of the step under way.

        Raises
        ------
        SimulationError
            If a control signal is not valid, the time of the model was changed outside of the coupling, or MuJoCo has
            reset the model.
        BoardError
            If a joint jumps or turns the motor faster than 2000 rad/s.
        """
        if not self._ends:
            self._begin()
        self.finish()

    def finish(self) -> None:
        """Complete the step under way, if there is one."""
        if not self._ends:
            return
        for board, end_ns in self._ends.items():
            board.advance_alone(end_ns)
        self._ends = {}
        after = [board.impulse(axis) for board, axis in self._where]
        self.data.act[self._act] = np.subtract(after, self._impulses) / (self.step_ns * 1e-9)
        for k, dof in self._brakes:
            board, axis = self._where[k]
            if board.truth(axis).brake_holds:
                self.data.act[self._act[k]] += board.brake_torque(axis, self._inertia(k, dof), self.step_ns * 1e-9)

    def _inertia(self, k: int, dof: int) -> float:
        """Inertia of all that a motor moves, at its shaft [kg m^2]."""
        force, acceleration = np.zeros((1, self.model.nv)), np.zeros((1, self.model.nv))
        force[0, dof] = self.gear[k]
        mujoco.mj_solveM(self.model, self.data, acceleration, force)
        return float(1.0 / (self.gear[k] * acceleration[0, dof]))

    def end_ns(self, board: Board) -> int:
        """End of the present step of a board [ns], see `servo_twin.board.Leader`."""
        if self._ends and board.time_ns >= self._ends[board]:
            self.finish()
        if not self._ends:
            self._begin()
        return self._ends[board]

    def _begin(self) -> None:
        """Step the model, and let the boards follow its motion."""
        if abs(self.data.time - self._time) > _TIME_TOLERANCE:
            raise SimulationError(
                f"the time of mjData is {self.data.time:g} s, that of the boards {self._time:g} s: "
                "use reset() and restore() of the coupling instead of mj_resetData and mj_setState"
            )
        self._command()
        mujoco.mj_step(self.model, self.data)
        self._check_step()
        self._time = float(self.data.time)
        self._impulses = [board.impulse(axis) for board, axis in self._where]
        speeds, angles = self.speeds(), self.lengths() + self._offset
        ends = {board: (board.time_ns // self.step_ns + 1) * self.step_ns for board in self.boards}
        for (board, axis), angle, speed in zip(self._where, angles.tolist(), speeds.tolist(), strict=True):
            board.drive_shaft(axis, angle, speed, (ends[board] - board.time_ns) * 1e-9)
        self._ends = ends

    def _check_step(self) -> None:
        """Refuse a step that is not the next one of the boards."""
        if self.data.time < self._time:
            raise SimulationError(
                f"MuJoCo has reset the model at {self._time:g} s: position, speed or acceleration was no number or too "
                "large (see its warning); continue with reset() or restore()"
            )
        if abs(self.data.time - self._time - self.step_ns * 1e-9) > _TIME_TOLERANCE:
            raise SimulationError(
                f"the time step of the model changed from {self.step_ns * 1e-9:g} to {self.model.opt.timestep:g} s; "
                "make new RobotDrives for it"
            )

    def _command(self) -> None:
        """Give the control signals to the firmware."""
        signals = np.clip(self.data.ctrl[self.channels], self._limits[:, 0], self._limits[:, 1])
        for drive, (board, axis), signal, zero in zip(
            self.drives, self._where, signals.tolist(), self._numbers[0].tolist(), strict=True
        ):
            if drive.mode is None:
                continue
            if not math.isfinite(signal):
                raise SimulationError(f"actuator '{drive.actuator}': the control signal is {signal}")
            if (drive.mode in _ANGLES and math.isnan(zero)) or drive.mode == "TRAJECTORY":
                continue
            if drive.mode == "POSITION":
                signal -= zero
            elif drive.mode == "TORQUE":
                signal /= board.plant.axes[axis].torque_constant
            try:
                write_axis(board, _VARIABLES[drive.mode], axis, signal)
            except ValueError as error:
                raise SimulationError(f"actuator '{drive.actuator}': {error}") from None
        if round(self._time * 1e9) // self.step_ns % self._point_steps == 0:
            self._send_points(signals)

    def _send_points(self, signals: _Array) -> None:
        """Send the previous control signals of mode TRAJECTORY as timed points, with their central differences."""
        zero, last, before_last, ticks = self._numbers
        aligned = np.isfinite(zero)
        interval_ns = self._point_steps * self.step_ns
        speeds = (signals - before_last) / (2e-9 * interval_ns)
        for board in self.boards:
            points = [
                TimedPoint(
                    axis,
                    (int(ticks[k]) + (board.time_ns + interval_ns + _AHEAD_NS) // PERIOD_NS) % (1 << 32),
                    float(last[k] - zero[k]),
                    float(speeds[k]),
                )
                for k, (drive, (owner, axis)) in enumerate(zip(self.drives, self._where, strict=True))
                if owner is board and drive.mode == "TRAJECTORY" and place(board, axis) == "SPIN" and aligned[k]
            ]
            if points:
                self._write_points(board, points)
        self._numbers = np.array([zero, signals, last, ticks])

    def _write_points(self, board: Board, points: Sequence[TimedPoint]) -> None:
        """Send points; raise `SimulationError` if the board has refused earlier ones."""
        names = [drive.actuator for drive, (owner, _) in zip(self.drives, self._where, strict=True) if owner is board]
        where = f"actuator {' or '.join(map(repr, names))}"
        reason = board.catalogue.label("point_refusal_t", board.read_words("point_refusal")[0])
        if reason not in ("NONE", "MODE"):  # MODE: the axis opens its brake, or stops
            raise SimulationError(
                f"{where}: the firmware refuses the path ({reason}); let ctrl change smoothly, or use mode POSITION"
            )
        try:
            board.write_words("cmd.points", encode_points(board.catalogue, points))
        except ValueError as error:
            raise SimulationError(f"{where}: {error}") from None

    def wait(self, seconds: float) -> None:
        """Step for at least some simulated time [s]."""
        end = self._time + seconds - _TIME_TOLERANCE
        while self._time < end:
            self.step()

    # ---- drive and state ---------------------------------------------------------------------------------------------

    def enable(self, search_max: float = SEARCH_MAX) -> float:
        """Enable both axes of one board after the other, with rotor search, then `align`; returns the duration [s].

        Raises
        ------
        SimulationError
            If an axis has a fault, or on a timeout of the rotor search.
        """
        seconds = sum(enable(board, search_max) for board in self.boards)
        self.align()
        return seconds

    def align(self) -> None:
        """Let control signals of angles be lengths of the actuators, and hold the present set-point.

        The firmware counts its position from the rotor search or from the home position; call this after either.
        """
        self.finish()

        def of(name: str) -> list[float]:
            return [read_axis(board, f"{axis_name(axis)}.{name}", 0) for board, axis in self._where]

        zero = self.lengths() - of("position")
        held = zero + of("position_ref")
        ticks = [board.read_words("tick")[0] - board.time_ns // PERIOD_NS for board, _ in self._where]
        self._numbers = np.array([zero, held, held, ticks])
        angles = np.array([drive.mode in _ANGLES for drive in self.drives], dtype=bool)
        self.data.ctrl[self.channels[angles]] = held[angles]

    def home(self, drive: int, method: str) -> None:
        """Home an axis that is enabled, then `align`.

        Parameters
        ----------
        drive : int
            Index in `drives`.
        method : str
            Name of a ``home_method_t``, such as ``STOP_NEGATIVE``.

        Raises
        ------
        CouplingError
            If the method needs a home switch, and plant or firmware has none.
        SimulationError
            If the firmware does not find its reference.
        """
        board, axis = self._where[drive]
        where = f"actuator '{self.drives[drive].actuator}'"
        check_home_switch(board, self.drives[drive], method)
        self._numbers[0, drive] = math.nan  # a set-point would end the homing
        choose(board, "cmd.home", axis, method)

        def result() -> str:
            return board.catalogue.label("home_result_t", word(board, axis, "home_result"))

        board.wait(0.01)
        if not reached(board, lambda: result() != "RUNNING", _HOMING_MAX, 0.01) or result() != "DONE":
            faults = ", ".join(sorted(active(board, axis)))
            raise SimulationError(f"{where}: homing {method} ends with {result()}" + (f"; {faults}" if faults else ""))
        board.wait(_SNAPSHOT)
        self.align()

    def state(self) -> CoupledState:
        """Complete state of model and boards, at the end of the step under way; see `Board.state`.

        At level ``registers`` the boards go on for less than a PWM period, and their next step is shorter: a later bit
        may differ from that of a run without this call.
        """
        self.finish()
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        simulator = np.empty(mujoco.mj_stateSize(self.model, signature))
        mujoco.mj_getState(self.model, self.data, simulator, signature)
        boards = tuple(board.state() for board in self.boards)
        return CoupledState(boards, simulator, self._time, self._numbers.copy())

    def restore(self, state: CoupledState) -> None:
        """Continue from a state of this coupling or a copy; every later bit is that of the other run.

        As after ``mj_setState``, quantities that MuJoCo derives are old until the next step.

        Raises
        ------
        BoardError
            If the state is from another build or level.
        """
        for board, image in zip(self.boards, state.boards, strict=True):
            board.restore(image)
        mujoco.mj_setState(self.model, self.data, state.simulator, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._time, self._numbers, self._ends = state.time, state.drives.copy(), {}

    def reset(self) -> None:
        """Continue from the state at construction.

        Raises
        ------
        CouplingError
            If there was no state of a board then.
        """
        if self._start is None:
            raise CouplingError(f"no state to go back to: {self._no_start}")
        self.restore(self._start)

    def copy(self) -> RobotDrives:
        """The same robot and boards once more, with the same model; each continues by itself."""
        self.finish()
        other = copy.copy(self)
        other.data, other.boards = copy.copy(self.data), tuple(board.copy() for board in self.boards)
        other._where = [(other.boards[drive.axis // AXES], drive.axis % AXES) for drive in self.drives]
        other._numbers = self._numbers.copy()
        for board in other.boards:
            board.follow(other)
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


def _check_once(drives: Sequence[Drive]) -> None:
    for k, drive in enumerate(drives):
        for other in drives[:k]:
            if drive.actuator == other.actuator:
                raise CouplingError(f"actuator '{drive.actuator}': two drives have it; name each actuator once")
            if drive.axis == other.axis:
                raise CouplingError(
                    f"actuator '{drive.actuator}': {axis_name(drive.axis)} drives '{other.actuator}' already; "
                    "choose another axis"
                )


def _check_joints(model: Any, drives: Sequence[Drive], joints: Sequence[int]) -> None:
    """Refuse two boards, which do not know of each other, at one joint."""
    for k, drive in enumerate(drives):
        for other, joint in zip(drives[:k], joints[:k], strict=True):
            if joint == joints[k] and drive.axis // AXES != other.axis // AXES:
                raise CouplingError(
                    f"actuator '{drive.actuator}': another board drives the joint '{model.joint(joint).name}' by "
                    f"'{other.actuator}'; use the two axes of one board"
                )


def _actuator(model: Any, boards: Sequence[Board], drive: Drive) -> int:
    """Index of an actuator after a check that it fits."""
    where = f"actuator '{drive.actuator}'"
    if drive.mode is not None and drive.mode not in get_args(Mode):
        raise CouplingError(f"{where}: there is no mode {drive.mode!r}; write {', '.join(get_args(Mode))}, or None")
    if drive.axis not in range(len(boards) * AXES):
        raise CouplingError(
            f"{where}: there is no axis with index {drive.axis}; write 0 .. {len(boards) * AXES - 1}, "
            f"or add a board: each has {AXES} axes"
        )
    actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, drive.actuator)
    if actuator < 0:
        known = ", ".join(model.actuator(i).name or "(no name)" for i in range(model.nactuator)) or "none"
        raise CouplingError(f"{where}: not in the model; its actuators: {known}")
    slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
    joint = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT or model.jnt_type[joint] not in (slide, hinge):
        raise CouplingError(f"{where}: a motor turns a hinge or a slide; write joint=... of one of them")
    gear = float(model.actuator_gear[model.actuator_outadr[actuator], 0])
    if gear == 0.0 or not math.isfinite(gear):
        raise CouplingError(f'{where}: the gear is {gear:g}; write the ratio of the gearbox, for example gear="100"')
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
    board, axis = boards[drive.axis // AXES], drive.axis % AXES
    plant = board.plant.axes[axis]
    armature = float(model.actuator_armature[actuator])
    if not math.isclose(armature, plant.inertia, rel_tol=_INERTIA_TOLERANCE):
        raise CouplingError(
            f"{where}: armature {armature:g} kg m^2 is not the inertia of {axis_name(drive.axis)} in the plant; "
            f'write armature="{plant.inertia:g}", or change inertia in the plant file'
        )
    if plant.load_inertia > 0.0:
        raise CouplingError(
            f"{where}: {axis_name(drive.axis)} has a second mass in the plant, but MuJoCo owns all inertia; set "
            "load_inertia to 0"
        )
    if plant.pins.brake_torque > 0.0 and "brake" not in board.pins(axis):
        raise CouplingError(f"{where}: the firmware does not open the holding brake; {_pin_remedy(drive, 'brake')}")
    return int(actuator)


def check_home_switch(board: Board, drive: Drive, method: str) -> None:
    """Refuse a homing to a switch that firmware or plant of a drive does not have (`CouplingError`)."""
    if not method.startswith(_TO_SWITCH):
        return
    where, axis = f"actuator '{drive.actuator}': homing {method}", drive.axis % AXES
    pins = board.plant.axes[axis].pins
    if "home" not in board.pins(axis):
        raise CouplingError(f"{where}: the firmware has no home switch; {_pin_remedy(drive, 'home')}")
    if pins.home_from > pins.home_to:
        raise CouplingError(
            f"{where}: the plant has no home switch; write its angles home_from and home_to in "
            f"[{axis_name(axis)}.pins] of the plant file, or in the model "
            f'<text name="servo.plant.{axis_name(drive.axis)}.pins.home_from" .../>'
        )


def _pin_remedy(drive: Drive, pin: Pin) -> str:
    return (
        f"write {pin} = true in [{axis_name(drive.axis % AXES)}.pins] of servo.toml, or in the model "
        f'<text name="servo.config.{axis_name(drive.axis)}.pins.{pin}" data="true"/>'
    )
