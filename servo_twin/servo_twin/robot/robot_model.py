"""An MJCF file whose ``<custom>`` part says which axes drive its joints (servo_twin/doc/coupling.md)."""

from __future__ import annotations

import copy
import hashlib
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from servo_msgs_py.board_parameters import Assignment, parse
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.text_file import parse_toml

from servo_twin.board import Board
from servo_twin.lockstep.axis_alignment import ShaftPosition
from servo_twin.plant import PlantConfig
from servo_twin.robot.command import EXAMPLES
from servo_twin.robot.coupling import CouplingError, Drive, Mode, RobotDrives, check_home_switch
from servo_twin.servo_config import ServoConfig, servo_table

_PREFIX: Final = "servo."
_START: Final = "start"  # name of the keyframe of the initial state
_HOLD: Final = "servo.hold"  # beginning of the names of the constraints that act until the motion begins
_AXIS: Final = re.compile(r"axis([1-9])")
_TEXTS: Final = "axisN, home.axisN, plant.NAME, config.NAME, param.NAME"

_Array = NDArray[np.float64]


class RobotModel:
    """A model, the drives of its joints, and how it moves.

    Parameters
    ----------
    path : Path
        MJCF file.

    Raises
    ------
    CouplingError
        If MuJoCo cannot read the file, or a text or number of its ``<custom>`` part with the prefix ``servo.`` is
        wrong.
    """

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise CouplingError(f"{path}: no such file")
        self.path = path
        try:
            self.model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise CouplingError(f"{path}: {' '.join(str(error).split())}") from None
        self._plant: list[tuple[int, str, float]] = []  # board, name in the plant file, value
        self._config: list[tuple[int, str, object]] = []  # board, name in servo.toml, value
        self._parameters: list[Assignment] = []  # of every board
        self.drives: list[Drive] = []
        self.homing: dict[int, str] = {}  # method by index of the axis
        self.feedback: dict[int, _Array] = {}  # gains of each deviation from qpos0 and of each speed, by axis
        for name, text in self._custom():
            try:
                self._take(name, text)
            except ValueError as error:
                raise CouplingError(f"{path}: '{_PREFIX}{name}' in <custom>: {error}") from None
        self.drives.sort(key=lambda drive: drive.axis)
        if not self.drives:
            raise CouplingError(
                f'{path}: no axis; write <custom><text name="{_PREFIX}axis1" data="ACTUATOR"/></custom>'
            )

    def _custom(self) -> list[tuple[str, str | _Array]]:
        """Entries of ``<custom>`` with our prefix."""
        model = self.model
        found: list[tuple[str, str | _Array]] = []
        for i in range(model.ntext):
            begin, end = model.text_adr[i], model.text_adr[i] + model.text_size[i] - 1  # without the final zero
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, i)
            found.append((name, bytes(model.text_data[begin:end]).decode()))
        for i in range(model.nnumeric):
            begin, end = model.numeric_adr[i], model.numeric_adr[i] + model.numeric_size[i]
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_NUMERIC, i)
            found.append((name, model.numeric_data[begin:end].copy()))
        return [(name.removeprefix(_PREFIX), value) for name, value in found if name.startswith(_PREFIX)]

    def _take(self, name: str, value: str | _Array) -> None:
        kind, _, rest = name.partition(".")
        if not isinstance(value, str):
            if kind != "feedback":
                raise ValueError("no such number; there is feedback.axisN")
            if len(value) != 2 * self.model.nv:
                raise ValueError(f"{len(value)} numbers; write {2 * self.model.nv}: gains of angles, then of speeds")
            self.feedback[_axis(rest)] = value
        elif kind == "plant":
            board, entry = _of_board(rest)
            number = parse_toml(f"value = {value}")["value"]
            if isinstance(number, bool) or not isinstance(number, (int, float)):
                raise ValueError(f"{value} is not a number")
            self._plant.append((board, entry, float(number)))
        elif kind == "config":
            self._config.append((*_of_board(rest), parse_toml(f"value = {value}")["value"]))
        elif kind == "param":
            self._parameters.append(parse(f"{name}={value}", Catalogue.load()))
        elif kind == "home":
            methods = Catalogue.load().enums["home_method_t"]
            if value not in methods:
                raise ValueError(f"no method {value}; write {', '.join(methods)}")
            self.homing[_axis(rest)] = value
        elif _AXIS.fullmatch(name):
            actuator, _, mode = value.rpartition(" ")
            if mode not in get_args(Mode):
                actuator, mode = value, "POSITION"
            self.drives.append(Drive(actuator, _axis(name), mode))  # type: ignore[arg-type]
        else:
            raise ValueError(f"no such entry; there are {_TEXTS}")

    def release(self, data: Any) -> None:
        """End the constraints that act until the motion begins."""
        for k in range(self.model.neq):
            if (self.model.equality(k).name or "").startswith(_HOLD):
                data.eq_active[k] = 0

    def corrections(self, data: Any) -> _Array:
        """Feedback of the state, shape (nu,): minus gains times deviation from qpos0 and times speed."""
        state = np.empty(2 * self.model.nv)
        mujoco.mj_differentiatePos(self.model, state[: self.model.nv], 1.0, self.model.qpos0, data.qpos)
        state[self.model.nv :] = data.qvel
        result = np.zeros(self.model.nu)
        for drive in self.drives:
            if drive.axis in self.feedback:
                result[self.model.actuator_ctrladr[self.model.actuator(drive.actuator).id]] = (
                    -self.feedback[drive.axis] @ state
                )
        return result

    def start(self) -> Any:
        """New ``mjData``: that of the keyframe ``start`` if there is one."""
        data = mujoco.MjData(self.model)
        key = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, _START)
        if key >= 0:
            mujoco.mj_resetDataKeyframe(self.model, data, key)
        mujoco.mj_forward(self.model, data)
        return data

    def robot(self, plant: PlantConfig, **settings: Any) -> RobotDrives:
        """The robot with new boards, whose shafts have the angles of the model; `ctrl` commands them.

        Parameters
        ----------
        plant : PlantConfig
            Plant of every board, before the changes by the file.
        **settings
            For `Board`; each further board has the next seed. A `servo` replaces the configuration in the file.

        Raises
        ------
        CouplingError
            If a drive does not fit the model, or a value of the file is not valid.
        """
        data = self.start()
        boards = self._boards(plant, data, settings)
        for drive in self.drives:
            if drive.axis in self.homing:
                check_home_switch(boards[drive.axis // AXES], drive, self.homing[drive.axis])
        return RobotDrives(self.model, data, boards, self.drives)

    def on_line(self, plant: PlantConfig, **settings: Any) -> RobotDrives:
        """As `robot`, but a host at the serial line commands the only board, and the motion begins now.

        Raises
        ------
        CouplingError
            Also if the robot has more than one board.
        """
        return self.attached(self.board(plant, **settings), {})

    @property
    def name(self) -> str:
        """Name of an example, or absolute path of the file."""
        return self.path.stem if self.path.parent == EXAMPLES else str(self.path.absolute())

    @property
    def sha256(self) -> str:
        """SHA-256 of the compiled model, hexadecimal: equal models move alike."""
        buffer = np.empty(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return hashlib.sha256(buffer.tobytes()).hexdigest()

    def board(self, plant: PlantConfig, **settings: Any) -> Board:
        """The only board of the robot, with shafts of its own; parameters as of `robot`."""
        first, *more = self._boards(plant, self.start(), settings)
        if more:
            raise CouplingError(
                f"{self.path}: the robot has {1 + len(more)} boards, a serial line one; name the axes axis1 and axis2 "
                "only"
            )
        return first

    def attached(self, board: Board, lengths: Mapping[int, float]) -> RobotDrives:
        """The robot at rest in a pose, moved by a board of `board`, which a host at its serial line commands.

        Parameters
        ----------
        board : Board
            From now on the model moves its shafts.
        lengths : mapping
            Length of the actuator of an axis, the angle of its motor [rad]; others are those of the initial state.
        """
        data = self.start()
        drives = [replace(drive, mode=None) for drive in self.drives]
        for drive in drives:
            if drive.axis in lengths:
                actuator = self.model.actuator(drive.actuator).id
                joint = self.model.jnt_qposadr[self.model.actuator_trnid[actuator, 0]]
                data.qpos[joint] = (
                    lengths[drive.axis] / self.model.actuator_gear[self.model.actuator_outadr[actuator], 0]
                )
        mujoco.mj_forward(self.model, data)
        self.release(data)
        return RobotDrives(self.model, data, board, drives)

    def attach(self, board: Board, shafts: Mapping[int, ShaftPosition]) -> None:
        """Let the robot move the shafts of a twin's board (`servo_twin.lockstep.twin.Twin`).

        A position that is counted from where the rotor was found belongs to a robot that began in its initial state;
        the home position is at length 0 of the actuator.
        """
        start = self.start()
        lengths = {
            drive.axis: shafts[drive.axis].theta
            + (0.0 if shafts[drive.axis].referenced else float(start.actuator(drive.actuator).length[0]))
            for drive in self.drives
            if drive.axis in shafts
        }
        self.attached(board, lengths)

    def _boards(self, plant: PlantConfig, data: Any, settings: Mapping[str, Any]) -> list[Board]:
        servo, seed = settings.get("servo"), settings.get("seed", 1)
        boards = [
            Board(one, **{**settings, "servo": servo or self._servo_config(k), "seed": seed + k})
            for k, one in enumerate(self._plants(plant, data))
        ]
        for board in boards:
            for assignment in self._parameters:
                if not board.write_words(assignment.variable.name, assignment.raw, assignment.element or 0):
                    raise CouplingError(f"{self.path}: {assignment.text}: refused by the firmware")
        return boards

    def plant(self, plant: PlantConfig) -> PlantConfig:
        """Plant of the first board."""
        return self._plants(plant, self.start())[0]

    def _plants(self, plant: PlantConfig, data: Any) -> list[PlantConfig]:
        plants = [plant] * (1 + max(drive.axis for drive in self.drives) // AXES)
        for board, name, value in self._plant:
            with self._checking():
                plants[board] = plants[board].with_value(name, value)
        for drive in self.drives:
            actuator = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_ACTUATOR, drive.actuator)
            if actuator >= 0:  # otherwise refused by RobotDrives
                board, axis = divmod(drive.axis, AXES)
                plants[board] = plants[board].with_axis(axis, theta_start=float(data.actuator(actuator).length[0]))
        return plants

    def _servo_config(self, board: int) -> ServoConfig | None:
        """Configuration of a board; None: that of the firmware."""
        changes = [(name, value) for of, name, value in self._config if of == board]
        if not changes:
            return None
        table: dict[str, Any] = copy.deepcopy(dict(servo_table()))
        for name, value in changes:
            *groups, last = name.split(".")
            place = table
            for group in groups:
                place = place.setdefault(group, {})
            place[last] = value
        with self._checking():
            return ServoConfig.of_table(table)

    @contextmanager
    def _checking(self) -> Iterator[None]:
        """Name the file in errors."""
        try:
            yield
        except ValueError as error:
            raise CouplingError(f"{self.path}: {error}") from None


def _axis(name: str) -> int:
    """Index of ``axisN``."""
    match = _AXIS.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is no axis; write axis1, axis2, ...")
    return int(match[1]) - 1


def _of_board(name: str) -> tuple[int, str]:
    """Board of a name that begins with ``axisN``, and the name at that board; others belong to the first board."""
    first, _, rest = name.partition(".")
    if _AXIS.fullmatch(first) is None:
        return 0, name
    board, axis = divmod(_axis(first), AXES)
    return board, f"axis{axis + 1}.{rest}"


class Motion:
    """Control signals as a smooth function of time, through the keyframes of a model.

    Between keyframes each signal is a cubic without overshoot (F. N. Fritsch and J. Butland, SIAM J. Sci. Stat. Comput.
    5, 1984); it rests at an extremum and at the end. The keyframe ``start`` is not part of it.

    Parameters
    ----------
    model : mujoco.MjModel
        The model; `time` of its keyframes is the time since the begin of the motion [s].
    begin : ndarray, shape (nu,)
        Control signals at time 0.

    Raises
    ------
    CouplingError
        If the times do not increase.
    """

    def __init__(self, model: Any, begin: _Array) -> None:
        keys = [k for k in range(model.nkey) if model.key(k).name != _START]
        self.time = np.array([0.0, *(model.key_time[k] for k in keys)])
        ctrl = np.array([begin, *(model.key_ctrl[k] for k in keys)])
        gaps = np.diff(self.time)
        if (gaps <= 0.0).any():
            late = keys[int(np.argmax(gaps <= 0.0))]
            raise CouplingError(
                f"keyframe {late} '{model.key(late).name}': its time {model.key_time[late]:g} s is not after the one "
                f'before it; write <key time="..."> in increasing order, or name="{_START}" for the initial state'
            )
        if not keys:  # a spline has two points
            self._spline = CubicHermiteSpline([0.0, 1.0], ctrl[[0, 0]], np.zeros((2, model.nu)))
            return
        slopes = PchipInterpolator(self.time, ctrl).derivative()(self.time)
        slopes[[0, -1]] = 0.0
        self._spline = CubicHermiteSpline(self.time, ctrl, slopes)

    def __call__(self, times: _Array) -> _Array:
        """Control signals, each at its own time since the begin [s]."""
        return np.asarray(np.diagonal(self._spline(np.clip(times, 0.0, self.time[-1]))))
