"""Joints of MuJoCo that the firmware drives: motion, energy, faults, states, refusals."""

from __future__ import annotations

import math
import pickle
from typing import Any, Final

import numpy as np
import pytest
from servo_msgs_py.board_port import active
from servo_msgs_py.units import TICK
from servo_twin.board import Board, BoardError, SimulationError
from servo_twin.plant import PlantConfig

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

import mujoco
from servo_twin.robot.coupling import CouplingError, Drive, Mode, RobotDrives

PLANT: Final = PlantConfig.load().with_axis(0, friction=0.0)
ROTOR: Final = f'armature="{PLANT.axes[0].inertia}" damping="{PLANT.axes[0].viscous}"'

pytestmark = pytest.mark.usefixtures("level")


def joint_model(
    actuator: str = f'dyntype="user" actdim="1" {ROTOR}',
    *,
    inertia: float = 1e-12,
    length: float = 0.0,
    transmission: str = 'joint="joint"',
    options: str = "",
    step: float = 0.0005,
    first: str = "",
) -> Any:
    """Model of one joint with a body of 1 kg at the end of a massless rod, axis horizontal."""
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <compiler boundinertia="0"/>
        <option timestep="{step}" {options}><flag energy="enable"/></option>
        <worldbody>
          <body name="body">
            <joint name="joint" axis="0 1 0"/>
            <inertial pos="0 0 {-length}" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
          </body>
        </worldbody>
        <equality><joint name="block" joint1="joint" active="false" solref="0.002 1"/></equality>
        <actuator>{first}<general name="motor" {transmission} {actuator}/></actuator>
      </mujoco>""")


def coupled(board: Board, mode: Mode | None = "POSITION", model: Any = None) -> RobotDrives:
    model = joint_model() if model is None else model
    return RobotDrives(model, mujoco.MjData(model), board, [Drive("motor", 0, mode)])


def test_joint_of_the_rotor_alone_moves_as_the_rotor_of_the_board() -> None:
    """Free inertia: a reversal of speed in MuJoCo and in the plant of the board, with steps of 0.5 ms."""
    with Board(PLANT, seed=4) as board, Board(PLANT, seed=4) as other:
        drives = coupled(board, "SPEED")
        drives.enable()
        drives.data.ctrl[0] = 60.0
        drives.wait(0.3)
        other.restore(board.state())
        other.release_shaft(0)
        drives.data.ctrl[0] = -40.0
        other.write("cmd.speed", [-40.0, 0.0])
        start = board.truth(0).theta_m
        difference = 0.0
        for _ in range(400):
            drives.step()
            other.advance(board.time_ns)
            difference = max(difference, abs(board.truth(0).theta_m - other.truth(0).theta_m))
        assert board.truth(0).theta_m - start < -6.0
        assert difference < 0.01  # the torque is late by one step
        assert drives.data.qvel[0] == pytest.approx(-40.0, abs=1.0)


def test_time_of_a_board_elapses_in_steps_of_the_model() -> None:
    """Whatever runs a board moves the robot: in pieces that end anywhere, with the same bits."""
    with Board(PLANT, seed=4) as board, Board(PLANT, seed=4) as other:
        whole, pieces = coupled(board, "SPEED"), coupled(other, "SPEED")
        for drives in (whole, pieces):
            drives.data.ctrl[0] = 40.0
            drives.boards[0].write("cmd.enable", [1, 0])
        whole.wait(1.5)
        snapshots = [other.record(time_ns) for time_ns in range(0, 1_500_000_000, 1_234_567)]
        other.advance(board.time_ns)
        pieces.finish()
        assert sum(map(len, snapshots)) == pytest.approx(1.5 / TICK, abs=20)
        assert whole.data.qpos[0] > 0.5
        assert pieces.data.qpos[0] == whole.data.qpos[0]
        assert pieces.state().boards[0].image == whole.state().boards[0].image


def test_pendulum_takes_the_work_of_the_air_gap() -> None:
    """Kinetic and potential energy in MuJoCo against torque of the board times rotation, and the angle of rest."""
    model = joint_model(
        f'dyntype="user" actdim="1" gear="20" {ROTOR}', length=0.05, options='gravity="0 0 -9.81" integrator="RK4"'
    )
    with Board(PLANT, seed=4) as board:
        drives = coupled(board, "TORQUE", model)
        drives.enable()
        data, viscous = drives.data, PLANT.axes[0].viscous
        data.ctrl[0] = 0.4 * 9.81 * 0.05 / 20.0  # rest at asin 0.4
        mujoco.mj_forward(model, data)
        before, work, loss, exchanged = float(data.energy.sum()), 0.0, 0.0, 0.0
        torque, impulse = float(data.act[0]), board.truth(0).impulse_e
        for _ in range(800):
            angle, speed = float(drives.lengths()[0]), 20.0 * float(data.qvel[0])
            drives.step()
            rotation = float(drives.lengths()[0]) - angle
            work += torque * rotation  # the torque of the step before
            exchanged += abs(torque * rotation)
            loss += viscous * 0.5 * (speed + 20.0 * float(data.qvel[0])) * rotation
            torque, impulse = (board.truth(0).impulse_e - impulse) / model.opt.timestep, board.truth(0).impulse_e
        mujoco.mj_forward(model, data)
        assert exchanged > 0.1
        assert float(data.energy.sum()) - before == pytest.approx(work - loss, abs=1e-3 * exchanged)
        assert work / float(drives.lengths()[0]) == pytest.approx(data.ctrl[0], rel=0.02)


def test_blocked_joint_is_a_fault_of_the_firmware() -> None:
    with Board(PLANT, seed=4) as board:
        drives = coupled(board)
        drives.enable()
        drives.data.eq_active[0] = 1
        drives.data.ctrl[0] += 30.0
        drives.wait(2.0)
        assert active(board, 0) & {"STALLED", "FOLLOWING_ERROR"}
        assert abs(drives.data.act[0]) < 1e-3  # the outputs are off


def test_trajectory_is_followed_with_its_feed_forward() -> None:
    """A sine of 2 Hz and 1 rad; the path begins where the shaft is held."""
    with Board(PLANT, seed=4) as board:
        drives = coupled(board, "TRAJECTORY")
        drives.enable()
        held, begin, delay = float(drives.data.ctrl[0]), drives.data.time, float(drives.delays[0])
        errors = []
        for _ in range(2000):
            time = drives.data.time - begin
            drives.data.ctrl[0] = held + path(time)
            drives.step()
            errors.append(drives.data.qpos[0] - held - path(time + model_step(drives) - delay))
        assert np.abs(errors).max() < 0.02  # at most 0.012 seen at level registers
        drives.data.ctrl[0] += 1.0
        with pytest.raises(SimulationError, match=r"refuses the path .*ctrl change smoothly"):
            drives.wait(0.02)


def path(time: float) -> float:
    time = max(time, 0.0)
    return min(2.0 * time, 1.0) ** 2 * math.sin(4.0 * math.pi * time)


def model_step(drives: RobotDrives) -> float:
    return float(drives.model.opt.timestep)


def test_axes_of_two_boards_move_two_joints() -> None:
    """Axis 3 is the first one of the second board."""
    model = mujoco.MjModel.from_xml_string(TWO_JOINTS)
    with Board(PLANT, seed=4, level="ideal") as first, Board(PLANT, seed=5, level="ideal") as second:
        boards = [first, second]
        drives = RobotDrives(model, mujoco.MjData(model), boards, [Drive("a", 0, "SPEED"), Drive("b", 2, "SPEED")])
        drives.enable()
        drives.data.ctrl[:2] = 20.0, -30.0
        drives.wait(0.2)
        assert drives.data.qvel == pytest.approx([20.0, -30.0], abs=1.0)
        assert first.time_ns == second.time_ns
        assert {first.truth(1).omega_m, second.truth(1).omega_m} == {0.0}
        copy = drives.copy()
        for one in (drives, copy):
            one.wait(0.01)
        assert copy.state().boards == drives.state().boards


TWO_JOINTS: Final = f"""
  <mujoco>
    <compiler boundinertia="0"/>
    <option timestep="0.0005"/>
    <default><general dyntype="user" actdim="1" {ROTOR}/></default>
    <worldbody>
      <body><joint name="one"/><inertial pos="0 0 0" mass="1" diaginertia="1e-12 1e-12 1e-12"/></body>
      <body><joint name="two"/><inertial pos="0 0 0" mass="1" diaginertia="1e-12 1e-12 1e-12"/></body>
    </worldbody>
    <actuator>
      <general name="a" joint="one"/>
      <general name="b" joint="two"/>
      <general name="c" joint="one"/>
    </actuator>
  </mujoco>"""


def test_two_boards_on_one_joint_are_refused() -> None:
    model = mujoco.MjModel.from_xml_string(TWO_JOINTS)
    with Board(PLANT, seed=4, level="ideal") as first, Board(PLANT, seed=5, level="ideal") as second:
        boards = [first, second]
        with pytest.raises(CouplingError, match="'c': another board drives the joint 'one' by 'a'"):
            RobotDrives(model, mujoco.MjData(model), boards, [Drive("a", 0), Drive("c", 2)])
        RobotDrives(model, mujoco.MjData(model), boards, [Drive("b", 2, None)])


def test_states_and_copies_continue_with_the_same_bits() -> None:
    with Board(PLANT, seed=4) as board:
        drives = coupled(board)
        assert drives.copy().state().boards == drives.state().boards
        drives.enable()
        drives.data.ctrl[0] += 5.0
        drives.wait(0.02)
        state = pickle.loads(pickle.dumps(drives.state()))
        copy = drives.copy()
        ends = []
        for one in (drives, copy, drives):
            one.wait(0.05)
            ends.append(one.state())
            drives.restore(state)
        assert ends[0].boards == ends[1].boards == ends[2].boards
        assert ends[0].simulator.tobytes() == ends[1].simulator.tobytes() == ends[2].simulator.tobytes()
        drives.reset()
        assert drives.data.time == 0.0
        copy.reset()
        assert copy.enable() == drives.enable()


@pytest.mark.parametrize("first", ["", '<dcmotor joint="joint" motorconst="0.05" resistance="1" input="pos vel"/>'])
def test_control_signals_have_range_and_bits_of_the_firmware(first: str) -> None:
    """Also behind an actuator with two control signals."""
    model = joint_model(f'dyntype="user" actdim="1" ctrlrange="-10 10" {ROTOR}', first=first)
    with Board(PLANT, seed=4) as board:
        drives = coupled(board, "SPEED", model)
        drives.data.ctrl[-1] = 1000.0
        drives.step()
        assert board.read("cmd.speed")[0] == pytest.approx(10.0, abs=1e-5)  # type: ignore[index]
        drives.data.ctrl[-1] = math.nan
        with pytest.raises(SimulationError, match="actuator 'motor': the control signal is nan"):
            drives.step()
    with Board(PLANT, seed=4) as board:
        drives = coupled(board, "SPEED")
        drives.data.ctrl[0] = 1000.0
        with pytest.raises(SimulationError, match=r"actuator 'motor': .*419"):
            drives.step()


def test_foreign_changes_of_the_model_are_refused() -> None:
    with Board(PLANT, seed=4) as board:
        drives = coupled(board)
        drives.wait(0.01)
        mujoco.mj_resetData(drives.model, drives.data)
        with pytest.raises(SimulationError, match="instead of mj_resetData"):
            drives.step()
        drives.reset()
        drives.data.qpos[0] = 100.0
        with pytest.raises(BoardError, match="faster than 2000 rad/s"):
            drives.step()
        drives.reset()
        drives.wait(0.01)
        drives.data.qfrc_applied[0] = math.nan
        with pytest.raises(SimulationError, match=r"MuJoCo has reset the model at 0\.01 s"):
            drives.step()
        drives.reset()
        drives.model.opt.timestep = 0.0007
        with pytest.raises(SimulationError, match=r"time step of the model changed from 0.0005 to 0.0007 s"):
            drives.step()


@pytest.mark.parametrize(
    ("model", "drives", "message"),
    [
        ({}, [Drive("elbow", 0)], "actuator 'elbow': not in the model; its actuators: motor"),
        ({}, [Drive("motor", 2)], "no axis with index 2"),
        ({}, [Drive("motor", 0), Drive("motor", 0)], "actuator 'motor': two drives have it"),
        ({"step": 0.00075}, [Drive("motor", 0, "TRAJECTORY")], "'motor': .* multiple of a slow tick"),
        ({"step": 0.0001}, [Drive("motor", 0)], "time step 0.0001 s .* not a multiple of a PWM period"),
        ({"actuator": ROTOR}, [Drive("motor", 0)], 'write <general dyntype="user"'),
        (
            {"transmission": 'body="body"', "actuator": 'dyntype="user" actdim="1"'},
            [Drive("motor", 0)],
            "a motor turns a hinge or a slide",
        ),
        ({"actuator": 'dyntype="user" actdim="1"'}, [Drive("motor", 0)], 'write armature="8e-06"'),
        ({}, [Drive("motor", 0, "TORK")], "'motor': there is no mode 'TORK'; write POSITION"),  # type: ignore[arg-type]
        *(
            ({"actuator": f'dyntype="user" actdim="1" {ROTOR} gear="{gear}"'}, [Drive("motor", 0)], "'motor': the gear")
            for gear in ("0", "nan")
        ),
    ],
)
def test_model_that_does_not_fit_is_refused(model: dict[str, Any], drives: list[Drive], message: str) -> None:
    one = joint_model(**model)
    with Board(PLANT, seed=4) as board, pytest.raises(CouplingError, match=message):
        RobotDrives(one, mujoco.MjData(one), board, drives)


def test_board_that_does_not_fit_is_refused() -> None:
    model = joint_model()
    second = PLANT.with_axis(0, load_inertia=1e-5, shaft_stiffness=1.0, shaft_damping=1e-3)
    with Board(second, seed=4) as board, pytest.raises(CouplingError, match="'motor': axis1 has a second mass"):
        RobotDrives(model, mujoco.MjData(model), board, [Drive("motor", 0)])
    with Board(PLANT, seed=4) as board, pytest.raises(CouplingError, match="a board is named twice"):
        RobotDrives(model, mujoco.MjData(model), [board, board], [Drive("motor", 2)])


def test_holding_brake_that_the_firmware_does_not_open_is_refused() -> None:
    model = joint_model()
    with Board(PLANT.with_value("axis1.pins.brake_torque", 0.1), seed=4) as board:
        data = mujoco.MjData(model)
        with pytest.raises(CouplingError, match=r"'motor': the firmware does not open .* write brake = true"):
            RobotDrives(model, data, board, [Drive("motor", 0)])
