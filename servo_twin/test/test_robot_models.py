"""``servo-sim robot``: examples in MuJoCo, and what an MJCF file says about its axes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from servo_msgs_py.board_port import active, place, read_axis
from servo_twin.board import SimulationError
from servo_twin.cli import main
from servo_twin.level import FAST_LEVEL, Level, chosen_level
from servo_twin.plant import PlantConfig

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

import mujoco
from rerun.chunk import RrdReader
from servo_twin.robot.command import EXAMPLES, RobotLog, follow, load
from servo_twin.robot.coupling import CouplingError, RobotDrives
from servo_twin.robot.recording import FRAME
from servo_twin.robot.robot_model import Motion, RobotModel
from servo_twin.view.recording import read_scalars

PLANT: Final = PlantConfig.load()

both_levels: Final = pytest.mark.usefixtures("level")


def present_level() -> Level:
    return chosen_level(default=FAST_LEVEL)


def moved(name: str, seconds: float | None = None) -> tuple[RobotDrives, RobotLog]:
    robot = load(name)
    drives = robot.robot(PLANT, level=present_level())
    return drives, follow(robot, drives, seconds)


@both_levels
def test_arm_follows_its_path() -> None:
    _, log = moved("arm", 1.5)
    assert np.abs(log.angle).max() > 40.0
    assert np.abs(log.angle - log.set_point).max() < 0.1  # at the motors
    assert np.abs(100.0 * log.torque).max() < 5.0


@both_levels
def test_gripper_holds_the_box_with_the_current_limit() -> None:
    drives, log = moved("gripper")
    limit = 0.5 * PLANT.axes[0].torque_constant
    held = log.torque[log.time > 1.0, 0]
    assert held.mean() == pytest.approx(limit, rel=0.03)
    assert held.max() < 1.1 * limit
    box = drives.data.body("box").xpos
    assert box[2] == pytest.approx(0.13, abs=0.003)  # 0.1 m above its rest
    assert abs(box[0]) < 1e-3


@both_levels
def test_end_stop_and_switch_of_the_model_are_found() -> None:
    drives, _ = moved("homing", 1.5)
    board = drives.boards[0]
    zero = drives.lengths() - [read_axis(board, f"axis{axis}.position", 0) for axis in (1, 2)]
    assert zero[0] == pytest.approx(-0.02 * 500.0, abs=0.1)  # the stop yields under the force of the homing
    assert zero[1] == pytest.approx(-10.0, abs=0.02)  # the edge of the home switch
    drives.data.ctrl[1] = -25.0  # beyond the limit switch at -22
    drives.wait(1.0)
    assert active(board, 1) == {"LIMIT_SWITCH"}


def test_homed_axis_holds_its_position_at_every_instant(tmp_path: Path) -> None:
    """A homing has its result a slow tick before the new position is read: every run sees it at another tick."""
    text = (EXAMPLES / "homing.xml").read_text(encoding="utf-8").replace("-10.0", "-0.5")
    (tmp_path / "near.xml").write_text(text, encoding="utf-8")
    drives = RobotModel(tmp_path / "near.xml").robot(PLANT, level="ideal")
    drives.enable()
    state = drives.state()
    for ticks in range(20):
        drives.restore(state)
        drives.wait(0.0005 * ticks + 0.0001)
        drives.home(1, "SWITCH_NEGATIVE")
        drives.wait(0.1)
        assert drives.lengths()[1] == pytest.approx(drives.data.ctrl[1], abs=0.01)


@both_levels
def test_holding_brake_holds_a_vertical_axis() -> None:
    """Before the search, disabled, without supply, and after a state was restored; above its torque it slips."""
    drives = load("lift").robot(PLANT, level=present_level())
    board, data, height = drives.boards[0], drives.data, drives.data.qpos
    least = 1e-4  # a tenth of a millimetre is 0.1 rad of the motor
    drives.wait(0.1)
    assert height[0] == pytest.approx(0.0, abs=least)
    drives.enable()
    assert not board.truth(0).brake_holds
    board.write("cmd.enable", [0, 0])
    drives.wait(1.5)  # position hold, then the brake closes
    assert place(board, 0) == "STOP"
    assert board.truth(0).brake_holds
    held, state = height[0], drives.state()
    ends = []
    for _ in range(2):
        drives.wait(0.2)
        ends.append(drives.state().simulator.tobytes())
        assert height[0] == pytest.approx(held, abs=1e-6)
        drives.restore(state)
    assert ends[0] == ends[1]
    data.xfrc_applied[1, 2] = -200.0  # twice the torque of the brake
    drives.wait(0.05)
    assert height[0] < held - 0.01
    data.xfrc_applied[1, 2] = 0.0
    drives.wait(0.2)
    assert data.qvel[0] == pytest.approx(0.0, abs=1e-6)


def test_holding_brake_holds_without_supply() -> None:
    drives = load("lift").robot(PLANT, level="ideal")
    drives.enable()
    held = drives.data.qpos[0]
    drives.boards[0].set_supply(0.0)
    drives.wait(2.0)
    assert "UNDER_VOLTAGE" in active(drives.boards[0], 0)
    assert held - 2e-3 < drives.data.qpos[0] < held  # free fall until the brake has closed
    assert drives.data.qvel[0] == pytest.approx(0.0, abs=1e-6)


def test_search_of_a_falling_load_names_what_it_waits_for(tmp_path: Path) -> None:
    text = (EXAMPLES / "lift.xml").read_text(encoding="utf-8").replace('damping="2"', 'damping="200"')
    path = tmp_path / "lift.xml"
    path.write_text("".join(line for line in text.splitlines(True) if "pins" not in line), encoding="utf-8")
    drives = RobotModel(path).robot(PLANT, level="ideal")
    with pytest.raises(SimulationError, match=r"axis1 waits in CALIB .* turns at -9\d.* rad/s: hold the load"):
        drives.enable(1.0)


def test_pendulum_stands() -> None:
    drives, log = moved("pendulum", 3.0)
    pole = drives.data.joint("pole")
    assert abs(pole.qpos[0]) < 0.005
    assert np.abs(log.torque).max() < 0.1
    robot = load("pendulum")
    robot.feedback.clear()
    falls = robot.robot(PLANT, level=present_level())
    follow(robot, falls, 3.0)
    assert abs(falls.data.joint("pole").qpos[0]) > math.pi / 2


@pytest.mark.parametrize(("name", "seconds"), [("four_bar", 2.0), ("gantry", 2.5)])
def test_work_of_the_motors_is_energy_and_loss(name: str, seconds: float) -> None:
    """Work of motors, constraints (friction, loops) and dampers against kinetic and potential energy."""
    robot = load(name)
    drives = robot.robot(PLANT, level=present_level())
    model, data = drives.model, drives.data
    drives.enable()
    motion, begin = Motion(model, data.ctrl.copy()), data.time
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    before, work, exchanged = float(data.energy.sum()), 0.0, 0.0
    for _ in range(round(seconds / model.opt.timestep)):
        data.ctrl[:] = motion(np.full(model.nu, data.time - begin))
        torque, lengths, position, speed = drives.torques(), drives.lengths(), data.qpos.copy(), data.qvel.copy()
        drives.step()
        gained = float(torque @ (drives.lengths() - lengths))
        damping = -float(model.dof_damping @ (0.5 * (speed + data.qvel) * (data.qpos - position)))
        work += gained + damping + float(data.qfrc_constraint @ (data.qpos - position))
        exchanged += abs(gained)
    mujoco.mj_forward(model, data)
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    assert exchanged > 0.5
    assert float(data.energy.sum()) - before == pytest.approx(work, abs=0.01 * exchanged)
    if name == "four_bar":
        assert np.abs(data.efc_pos[: model.neq * 3]).max() < 1e-3  # the loop is closed [m]
    else:
        assert np.abs(np.diff(drives.lengths())) < 0.1  # the beam is straight


@pytest.fixture
def mjcf(tmp_path: Path) -> Any:
    """Function that writes the arm with a text of the example replaced, and reads it."""

    def write(old: str, new: str) -> RobotModel:
        text = (EXAMPLES / "arm.xml").read_text(encoding="utf-8")
        assert old in text
        path = tmp_path / "robot.xml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return RobotModel(path)

    return write


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('data="elbow TRAJECTORY"', 'data="hand"', "actuator 'hand': not in the model; its actuators: shoulder, elbow"),
        ('data="elbow TRAJECTORY"', 'data="shoulder"', "'shoulder': two drives have it"),
        ("servo.axis2", "servo.axis3", "is not the inertia of axis3"),
        ("servo.axis2", "servo.axes", r"robot.xml: 'servo.axes' in <custom>: no such entry; there are axisN"),
        ('timestep="0.0005"', 'timestep="0.0003"', "time step 0.0003 s .* not a multiple"),
        ("<custom>", '<custom><text name="servo.home.axis1" data="UP"/>', "no method UP; write NONE, HERE"),
        ("<custom>", '<custom><text name="servo.home.x" data="HERE"/>', "'x' is no axis"),
        (
            "<custom>",
            '<custom><text name="servo.home.axis2" data="SWITCH_NEGATIVE"/>',
            r"'elbow': .* the firmware has no home switch; write home = true in \[axis2.pins\]",
        ),
        (
            "<custom>",
            (
                '<custom><text name="servo.home.axis2" data="SWITCH_NEGATIVE"/>'
                '<text name="servo.config.axis2.pins.home" data="true"/>'
            ),
            "'elbow': .* the plant has no home switch; write its angles",
        ),
        (
            "<custom>",
            '<custom><text name="servo.plant.axis1.inertia" data="x"/>',
            "'servo.plant.axis1.inertia'.*line 1",
        ),
        ("<custom>", '<custom><text name="servo.plant.axis1.mass" data="1"/>', "robot.xml: axis1.mass: .*no such"),
        ("<custom>", '<custom><text name="servo.config.axis1.pin.home" data="true"/>', "robot.xml: .*pin"),
        ("<custom>", '<custom><text name="servo.param.i_q_max" data="1"/>', "'servo.param.i_q_max'.*i_q_limit"),
        ("<custom>", '<custom><numeric name="servo.feedback.axis1" data="1 2"/>', "2 numbers; write 4"),
        ("<custom>", '<custom><numeric name="servo.gain" data="1"/>', "no such number; there is feedback.axisN"),
        ('<key time="1" ', '<key name="k" time="0.1" ', "keyframe 1 'k': its time 0.1 s is not after"),
    ],
)
def test_what_does_not_fit_is_refused(mjcf: Any, old: str, new: str, message: str) -> None:
    def use() -> None:
        robot = mjcf(old, new)
        drives = robot.robot(PLANT, level=present_level())
        Motion(robot.model, drives.data.ctrl)

    with pytest.raises(CouplingError, match=message):
        use()


def test_command_writes_figures_and_a_plot(mjcf: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mjcf('<key time="0.5"', '<key name="start"/><key time="0.5"')
    plot = tmp_path / "plot.png"
    assert main(["robot", str(tmp_path / "robot.xml"), "--time", "0.1", "--json", "--plot", str(plot)]) == 0
    assert json.loads(capsys.readouterr().out)["elbow"]["error_max"] < 1e-3
    assert plot.stat().st_size > 10_000
    assert main(["robot", str(tmp_path / "none.xml")]) == 2
    assert "none.xml: no such file" in capsys.readouterr().err
    mjcf('ctrl="8.8 14.4"', 'ctrl="2000 0"')
    assert main(["robot", str(tmp_path / "robot.xml")]) == 1  # not wrong usage
    assert "actuator 'shoulder'" in capsys.readouterr().err
    assert main(["robot", "arm", "--time", "0.1"]) == 0
    assert "elbow     TRAJECTORY" in capsys.readouterr().out


def translations(path: Path, entity: str) -> Any:
    """Places of a body in a recording, shape (N, 3) [m]."""
    column = "Transform3D:translation"
    chunks = RrdReader(path).stream().filter(content=entity, is_static=False, components=column)
    return np.array([place for chunk in chunks for place in chunk.to_record_batch()[column].to_pylist()])[:, 0]


def test_recording_has_the_moving_bodies_and_the_curves(tmp_path: Path) -> None:
    path = tmp_path / "arm.rrd"
    assert main(["robot", "arm", "--time", "1", "--rrd", str(path), "--plot", str(tmp_path / "arm.png")]) == 0
    time, angle = read_scalars(path, "/plot/position/shoulder/board")
    _, target = read_scalars(path, "/plot/position/shoulder/set_point")
    assert time[-1] == pytest.approx(1.0, abs=1e-6)
    assert angle.max() > 0.3
    assert np.abs(angle - target).max() < 1e-3
    elbow = translations(path, "/robot/forearm")
    assert len(elbow) == pytest.approx(1.0 / FRAME, abs=2)
    assert np.ptp(elbow[:, 0]) > 0.05  # it swings
    assert np.linalg.norm(elbow, axis=1) == pytest.approx(0.3, abs=1e-6)  # length of the upper arm


def test_recording_on_a_full_disk_is_one_line_with_the_name_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    full = tmp_path / "arm.rrd"
    full.symlink_to("/dev/full")
    assert main(["robot", "pendulum", "--time", "0.05", "--rrd", str(full)]) == 1
    assert capsys.readouterr().err == f"servo-sim: {full}: No space left on device\n"
