"""The plugin of MuJoCo: motion by its four modes, states that MuJoCo copies, refusals."""

from __future__ import annotations

import copy
import math
import pickle
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from servo_msgs_py.catalogue import Catalogue
from servo_tuning.reading import SERVO_TOML
from servo_twin.cli import main
from servo_twin.plant import PlantConfig

pytest.importorskip("mujoco", reason="there is no MuJoCo 4 for Python 3.10")

import mujoco
from mujoco import rollout

PLANT: Final = PlantConfig.load()
GEAR: Final = 100.0
PATH_DELAY: Final = 12  # steps of 0.5 ms
SENSORS: Final = (
    "axis1.state axis1.substate axis1.faults axis1.home_state axis2.speed truth.axis2.torque_e u_dc "
    "truth.axis2.brake_holds axis2.home_state axis2.position"
)
STATE: Final = mujoco.mjtState.mjSTATE_INTEGRATION
SPATIAL: Final = '<tendon><spatial name="rope"><site site="hook"/><site site="end"/></spatial></tendon>'
SEARCHED: Final = 2600  # steps until both rotors are found


@pytest.fixture(scope="module", autouse=True)
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plugin, with home switch and holding brake at axis 2."""
    folder = tmp_path_factory.mktemp("plugin")
    path, config = folder / "servo.so", folder / "servo.toml"
    pins = "\n[axis2.pins]\nhome = true\nbrake = true\n"
    config.write_text(SERVO_TOML.read_text(encoding="utf-8") + pins, encoding="utf-8")
    assert main(["export", "--mujoco", str(path), "--seed", "3", "--config", str(config)]) == 0
    mujoco.mj_loadPluginLibrary(str(path))
    return path


@pytest.fixture(autouse=True)
def warnings() -> Iterator[list[str]]:
    """Warnings of MuJoCo, which would be in a file otherwise."""
    texts: list[str] = []
    mujoco.set_mju_user_warning(texts.append)
    yield texts
    mujoco.set_mju_user_warning(None)


def arm(axis1: str = "shoulder", axis2: str = "elbow", config: str = "", step: float = 0.0005) -> str:
    """Text of a model of two joints; each motor with its rotor in the armature of the joint."""
    named = "".join(f'<config key="axis{n}" value="{value}"/>' for n, value in ((1, axis1), (2, axis2)) if value)
    armature = [axis.inertia * GEAR**2 for axis in PLANT.axes]
    joint = 'axis="0 -1 0" damping="0.02" frictionloss="0.05"'
    link = '<geom type="capsule" size="0.02" contype="0" conaffinity="0" fromto="0 0 0 0 0 -0.3" mass="0.5"/>'
    actuators = "".join(
        f'<plugin name="{name}" joint="{name}" gear="{GEAR}" plugin="servo.board" instance="board" {limits}/>'
        for name, limits in (("shoulder", 'ctrlrange="-60 60"'), ("elbow", ""))
    )
    return f"""
      <mujoco>
        <option timestep="{step}" integrator="implicitfast"/>
        <extension><plugin plugin="servo.board"><instance name="board">
          <config key="sensors" value="{SENSORS}"/>{named}{config}
        </instance></plugin></extension>
        <worldbody>
          <body>
            <joint name="shoulder" {joint} armature="{armature[0]}"/>{link}
            <body pos="0 0 -0.3"><joint name="elbow" {joint} armature="{armature[1]}"/>{link}</body>
          </body>
        </worldbody>
        <actuator>{actuators}</actuator>
        <sensor><plugin name="board" plugin="servo.board" instance="board"/></sensor>
        <keyframe><key name="raised" qpos="0.3 -0.2"/></keyframe>
      </mujoco>"""


def started(text: str) -> tuple[Any, Any]:
    """Model and data with both axes in RUN/SPIN."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    run(model, data, SEARCHED)
    assert board(data)["axis1.substate"] == Catalogue.load().enums["substate_t"]["SPIN"]
    return model, data


def run(model: Any, data: Any, steps: int, ctrl: Callable[[float], Any] | None = None) -> None:
    for _ in range(steps):
        if ctrl is not None:
            data.ctrl[:] = ctrl(data.time)
        mujoco.mj_step(model, data)


def board(data: Any) -> dict[str, float]:
    return dict(zip(SENSORS.split(), data.sensor("board").data.tolist(), strict=True))


def bits(data: Any) -> bytes:
    return bytes(data.qpos.tobytes() + data.qvel.tobytes() + data.plugin_state.tobytes())


@pytest.fixture(scope="module")
def moving(library: Path) -> tuple[Any, Any]:
    """An arm in motion; use a copy."""
    model, data = started(arm("shoulder", "elbow SPEED"))
    data.ctrl[:] = [20.0, 5.0]
    run(model, data, 300)
    return model, data


def test_angles_and_speeds_are_those_of_the_control_signals(moving: tuple[Any, Any]) -> None:
    model, data = moving[0], copy.copy(moving[1])
    run(model, data, 1000)
    assert GEAR * data.qpos[0] == pytest.approx(20.0, abs=0.01)
    assert GEAR * data.qvel[1] == pytest.approx(5.0, abs=0.3)
    values = board(data)
    assert values["axis2.speed"] == pytest.approx(5.0, abs=0.5)
    assert values["axis1.faults"] == 0.0
    assert 23.5 < values["u_dc"] < 28.0  # a supply takes no energy back
    data.ctrl[0] = 90.0
    run(model, data, 4000)
    assert GEAR * data.qpos[0] == pytest.approx(60.0, abs=0.01)  # ctrlrange


def test_torque_is_that_of_the_air_gap() -> None:
    model, data = started(arm("shoulder TORQUE", "elbow TORQUE"))
    data.ctrl[:] = [0.01, -0.02]
    torques = []
    for _ in range(400):
        torques.append(data.actuator_force.copy())
        mujoco.mj_step(model, data)
    assert np.mean(torques[20:], axis=0) == pytest.approx([0.01, -0.02], rel=0.03)


def test_set_point_beyond_the_firmware_is_named_once(warnings: list[str]) -> None:
    model, data = started(arm("shoulder TORQUE", "elbow SPEED"))
    for torque in (9.0, 8.0, 7.0, 0.01, 6.0):
        data.ctrl[1] = torque
        data.ctrl[0] = torque
        run(model, data, 10)
    assert [one.partition(" = ")[0] for one in warnings] == 2 * ["servo.board: actuator 0: axis1.cmd.i_q"]
    assert "the firmware refuses the value, and keeps the last one; limit ctrl" in warnings[0]


def test_paths_are_followed_with_their_feed_forward(warnings: list[str]) -> None:
    """Sines of 1 Hz, which begin at rest; then a jump, which the firmware refuses and makes as a move."""
    model, data = started(arm("shoulder TRAJECTORY", "elbow TRAJECTORY"))
    begin = data.time + 0.5
    signals, angles = [], []
    for _ in range(3000):
        cosine = 1.0 - np.cos(2.0 * np.pi * max(0.0, data.time - begin))
        data.ctrl[:] = [20.0 * cosine, -15.0 * cosine]
        signals.append(data.ctrl.copy())
        angles.append(GEAR * data.qpos)
        mujoco.mj_step(model, data)
    error = np.subtract(angles[PATH_DELAY:], signals[:-PATH_DELAY])
    assert np.ptp(angles, axis=0) == pytest.approx([40.0, 30.0], abs=0.1)
    assert np.abs(error).max() < 0.02
    assert warnings == []
    data.ctrl[0] = 30.0
    run(model, data, 5000)
    assert 0 < len(warnings) <= 4
    assert GEAR * data.qpos == pytest.approx(data.ctrl, abs=0.02)


def test_every_copy_of_mujoco_continues_with_the_same_bits(moving: tuple[Any, Any]) -> None:
    model, data = moving[0], copy.copy(moving[1])
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    others = {
        "copy": copy.copy(data),
        "pickle": pickle.loads(pickle.dumps(data)),
        "state": mujoco.MjData(model),
    }
    mujoco.mj_setState(model, others["state"], state, STATE)
    run(model, data, 400)
    for name, other in others.items():
        run(model, other, 400)
        assert bits(other) == bits(data), name
    mujoco.mj_setState(model, data, state, STATE)  # back in time
    run(model, data, 400)
    assert bits(data) == bits(others["copy"])


def test_states_can_be_compared_as_numbers(moving: tuple[Any, Any]) -> None:
    """The bytes of a board include those of NaN, which is not equal to itself."""
    model, data = moving[0], copy.copy(moving[1])
    fresh, other = mujoco.MjData(model), copy.copy(data)
    for one in (fresh, data):
        state = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, one, state, STATE)
        assert np.isfinite(state).all()
    run(model, data, 50)
    run(model, other, 50)
    assert np.array_equal(data.plugin_state, other.plugin_state)
    run(model, other, 1)
    assert not np.array_equal(data.plugin_state, other.plugin_state)


def test_pickle_continues_in_another_process(moving: tuple[Any, Any], library: Path, tmp_path: Path) -> None:
    model, data = moving[0], copy.copy(moving[1])
    (tmp_path / "data").write_bytes(pickle.dumps(data))
    script = (
        "import mujoco, pickle, sys\n"
        "mujoco.mj_loadPluginLibrary(sys.argv[1])\n"
        "data = pickle.load(open(sys.argv[2], 'rb'))\n"
        "for _ in range(100): mujoco.mj_step(data.model, data)\n"
        "sys.stdout.buffer.write(data.qpos.tobytes() + data.qvel.tobytes() + data.plugin_state.tobytes())\n"
    )
    command = [sys.executable, "-c", script, str(library), str(tmp_path / "data")]
    done = subprocess.run(command, capture_output=True, check=True, timeout=60.0)
    run(model, data, 100)
    assert done.stdout == bits(data)


def test_rollouts_in_threads_have_the_bits_of_steps(moving: tuple[Any, Any]) -> None:
    model, data = moving[0], copy.copy(moving[1])
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    initial = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, initial, full)
    signals = np.array([[30.0, 5.0], [-10.0, 0.0], [30.0, 5.0]])
    states, _ = rollout.rollout(
        model,
        [mujoco.MjData(model) for _ in range(2)],
        np.tile(initial, (3, 1)),
        np.repeat(signals[:, np.newaxis], 100, axis=1),
    )
    data.ctrl[:] = signals[0]
    run(model, data, 100)
    final = np.empty_like(initial)
    mujoco.mj_getState(model, data, final, full)
    assert states[0, -1].tobytes() == states[2, -1].tobytes() == final.tobytes()
    assert states[1, -1].tobytes() != final.tobytes()


def test_reset_and_keyframe_start_the_board_anew(moving: tuple[Any, Any]) -> None:
    model, data = moving[0], copy.copy(moving[1])
    ends = []
    for _ in range(2):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        run(model, data, 200)
        ends.append(bits(data))
    fresh = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, fresh, 0)
    run(model, fresh, 200)
    assert ends[0] == ends[1] == bits(fresh)


def test_configuration_of_the_instance_is_that_of_the_board() -> None:
    faults = Catalogue.load().flags["faults"]
    text = arm(config='<config key="axis1.fault.open_phase_b" value="1"/><config key="plant.bus.u_source" value="30"/>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    run(model, data, SEARCHED)
    values = board(data)
    assert values["u_dc"] == pytest.approx(30.0, abs=0.5)
    assert [fault.name for fault in faults if int(values["axis1.faults"]) >> fault.bit & 1]
    assert data.actuator_force[0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("jump", [0.3, 30.0])
@pytest.mark.parametrize("mode", ["POSITION", "TRAJECTORY"])
def test_jump_of_a_joint_is_named_and_the_axis_goes_on(mode: str, jump: float, warnings: list[str]) -> None:
    """The joint is moved by hand, with `ctrl` and alone: each is one warning, and `ctrl` is still the joint's angle."""
    model, data = started(arm(f"shoulder {mode}"))
    message = f"servo.board: actuator 0: the joint has jumped by {jump:g} rad"
    model.opt.gravity[:] = 0.0
    data.ctrl[0] = 20.0
    run(model, data, 2000)
    warnings.clear()  # of the step in mode TRAJECTORY
    data.qpos[0] += jump / GEAR
    data.ctrl[0] += jump
    torques = []
    for _ in range(400):
        mujoco.mj_step(model, data)
        torques.append(data.actuator_force[0])
    assert np.ptp(torques) < 0.03
    assert GEAR * data.qpos[0] == pytest.approx(20.0 + jump, abs=0.05)
    data.qpos[0] += jump / GEAR
    run(model, data, 3000)
    assert GEAR * data.qpos[0] == pytest.approx(20.0 + jump, abs=0.05)
    assert [one[: len(message)] for one in warnings] == 2 * [message]


@pytest.mark.parametrize(("integrator", "step"), [("Euler", 0.002), ("RK4", 0.0005), ("RK4", 0.005)])
def test_impact_at_an_end_stop_is_no_jump(integrator: str, step: float, warnings: list[str]) -> None:
    text = (
        arm(step=step).replace("implicitfast", integrator).replace('name="elbow" ', 'name="elbow" range="-60 60" ', 1)
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[1] = 10.0
    run(model, data, round(0.3 / step))
    assert data.qvel[1] < -0.5
    assert not any("has jumped" in one for one in warnings)


def test_joint_that_is_too_fast_for_an_encoder_is_named_once(warnings: list[str]) -> None:
    model, data = started(arm())
    for _ in range(5):
        data.qvel[0] = 50.0
        mujoco.mj_step(model, data)
    assert len(warnings) == 1
    assert "actuator 0: the motion is not a number, or faster than 2000 rad/s" in warnings[0]


def one_shaft(tie: str, friction: float) -> str:
    """Text of a model whose motors turn one shaft: by one joint, an equality of two joints, or a weld."""
    rotors = [axis.inertia * GEAR**2 for axis in PLANT.axes]
    joint = f'axis="0 0 1" damping="0.02" frictionloss="{friction}"'
    geom = '<geom size="0.05" mass="0.2" contype="0" conaffinity="0"/>'
    second = "a" if tie == "joint" else "b"
    bodies = (
        f'<body name="a"><joint name="a" {joint} armature="{rotors[0] + (tie == "joint") * rotors[1]}"/>{geom}</body>'
    )
    if tie != "joint":
        bodies += f'<body name="b"><joint name="b" {joint} armature="{rotors[1]}"/>{geom}</body>'
    stiff = 'solref="0.004 1" solimp="0.99 0.999 0.001"'
    ties = {
        "joint": "",
        "equality": f'<joint joint1="b" joint2="a" {stiff}/>',
        "weld": f'<weld body1="a" body2="b" {stiff}/>',
    }
    return f"""
      <mujoco>
        <option timestep="0.001"/>
        <extension><plugin plugin="servo.board"><instance name="board">
          <config key="axis1" value="a"/><config key="axis2" value="b TORQUE"/>
          {'<config key="shaft" value="SHARED"/>' if tie == "weld" else ""}
        </instance></plugin></extension>
        <worldbody>{bodies}</worldbody>
        <equality>{ties[tie]}</equality>
        <actuator>
          <plugin name="a" joint="a" gear="{GEAR}" plugin="servo.board" instance="board"/>
          <plugin name="b" joint="{second}" gear="{GEAR}" plugin="servo.board" instance="board"/>
        </actuator>
      </mujoco>"""


@pytest.mark.parametrize(
    ("tie", "friction"), [("joint", 0.05), ("equality", 0.2), ("weld", 0.2), ("joint", 0.0), ("equality", 0.0)]
)
def test_two_motors_of_a_board_turn_one_shaft(tie: str, friction: float, warnings: list[str]) -> None:
    """With friction the rotors are searched in turn; then one motor controls the angle, the other adds a torque."""
    model = mujoco.MjModel.from_xml_string(one_shaft(tie, friction))
    data = mujoco.MjData(model)
    run(model, data, SEARCHED)
    run(model, data, 1500, lambda _: [20.0, 0.002])
    torques = []
    for _ in range(200):
        mujoco.mj_step(model, data)
        torques.append(data.actuator_force.copy())
    assert data.qpos * GEAR == pytest.approx(20.0, abs=0.05)
    assert np.mean(torques, axis=0)[1] == pytest.approx(0.002, abs=2e-4)
    assert warnings == []


@pytest.mark.parametrize("mode", ["POSITION", "SPEED", "TRAJECTORY"])
def test_axis_homes_at_the_end_stop_of_its_joint(mode: str, warnings: list[str]) -> None:
    limited = arm(f"shoulder {mode}", config='<config key="axis1.home" value="STOP_NEGATIVE"/>').replace(
        '<joint name="shoulder" ', '<joint name="shoulder" range="-15 180" '
    )
    model = mujoco.MjModel.from_xml_string(limited)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    run(model, data, 16000)
    enums = Catalogue.load().enums
    assert board(data)["axis1.home_state"] == enums["home_state_t"]["KNOWN"]
    target = 30.0
    began = data.time

    def smoothly(time: float) -> list[float]:
        return [3.0 if mode == "SPEED" else 0.5 * target * (1.0 - math.cos(math.pi * min(1.0, time - began))), 0.0]

    run(model, data, 3000, smoothly)
    if mode == "SPEED":
        assert data.qvel[0] * GEAR == pytest.approx(3.0, abs=1.0)
    else:
        assert data.qpos[0] * GEAR == pytest.approx(target, abs=0.1)
    assert board(data)["axis1.faults"] == 0.0
    assert not warnings


def test_faults_and_supply_change_during_the_run_and_belong_to_the_state(warnings: list[str]) -> None:
    text = arm(config='<config key="inputs" value="axis1.fault.open_phase_b supply.u_source"/>').replace(
        "<extension>", '<size nuserdata="3"/><extension>'
    )
    text = text.replace('key="inputs"', 'key="userdata" value="1"/><config key="inputs"')
    model, data = started(text)
    data.userdata[2] = 3.0
    run(model, data, 400)
    assert board(data)["u_dc"] == pytest.approx(PLANT.bus.u_source + 3.0, abs=0.5)
    data.userdata[1] = 1.0
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    run(model, data, 1200, lambda _: [30.0, 0.0])
    assert board(data)["axis1.faults"] != 0.0
    assert warnings == ["servo.board: actuator 0: fault PHASE_LOST"]
    end = bits(data)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, STATE)
    run(model, data, 1200, lambda _: [30.0, 0.0])
    assert bits(data) == end
    data.userdata[2] = np.nan
    run(model, data, 3)
    assert warnings[-1] == "servo.board: userdata 2, supply.u_source: the value is not a number"
    assert warnings.count(warnings[-1]) == 1
    mujoco.mj_resetData(model, data)
    run(model, data, 400)
    assert board(data)["u_dc"] == pytest.approx(PLANT.bus.u_source, abs=0.5)


def brake(torque: float) -> str:
    return f'<config key="plant.axis2.brake_torque" value="{torque}"/>'


def test_holding_brake_holds_its_joint_without_supply(warnings: list[str]) -> None:
    """The forearm is lifted; then the supply fails, and the brake holds it, also in a restored state."""
    inputs = '<config key="inputs" value="supply.u_source"/>'
    model, data = started(arm(config=brake(0.1) + inputs).replace("<extension>", '<size nuserdata="1"/><extension>'))
    run(model, data, 2000, lambda _: [0.0, 100.0])
    assert GEAR * data.qpos[1] == pytest.approx(100.0, abs=0.1)
    data.userdata[0] = -PLANT.bus.u_source
    assert board(data)["truth.axis2.brake_holds"] == 0.0
    run(model, data, 6000)
    assert board(data)["truth.axis2.brake_holds"] == 1.0
    angle, state = data.qpos[1], np.empty(mujoco.mj_stateSize(model, STATE))
    assert angle == pytest.approx(1.0, abs=0.02)
    mujoco.mj_getState(model, data, state, STATE)
    run(model, data, 400)
    assert data.qpos[1] == pytest.approx(angle, abs=1e-3)  # the other joint swings
    other = mujoco.MjData(model)
    mujoco.mj_setState(model, other, state, STATE)
    run(model, other, 400)
    assert bits(other) == bits(data)
    assert {one.rpartition(" ")[2] for one in warnings} == {"UNDER_VOLTAGE"}


def test_shaft_without_friction_in_large_steps_is_named(warnings: list[str]) -> None:
    """At 2 ms, the default of MuJoCo, the torque that is a step late excites a rotor that nothing damps."""
    text = arm(step=0.002).replace('damping="0.02" frictionloss="0.05"', "")
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    run(model, data, 3500)
    assert warnings
    assert all("in the rotor search, while the shaft turned at" in one for one in warnings)


def test_rotor_search_of_a_shaft_at_rest_has_no_hint(warnings: list[str]) -> None:
    model = mujoco.MjModel.from_xml_string(arm(config='<config key="axis1.motor_unplugged" value="1"/>'))
    model.opt.gravity[:] = 0.0
    run(model, mujoco.MjData(model), SEARCHED)
    assert warnings == ["servo.board: actuator 0: fault PHASE_LOST"]


def test_board_that_cannot_go_on_stands_still_until_a_state_is_restored(warnings: list[str]) -> None:
    """The shaft of an axis without an actuator gets faster than any motor."""
    text = arm(config='<config key="plant.axis2.load_torque" value="1"/>', axis2="")
    joint = '<plugin name="elbow" joint="elbow" gear="100.0" plugin="servo.board" instance="board" />'
    assert joint in text
    model = mujoco.MjModel.from_xml_string(text.replace(joint, ""))
    data = mujoco.MjData(model)
    run(model, data, 500)
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    run(model, data, 100)
    end = bits(data)
    for other in (data, mujoco.MjData(model)):
        warnings.clear()
        run(model, other, 2000)
        assert sum("stands still" in one for one in warnings) == 1
        assert "instance 0: board: a shaft is faster than 20000 rad/s" in warnings[-1]
        assert other.actuator_force[0] == 0.0
        mujoco.mj_setState(model, other, state, STATE)
        run(model, other, 100)
        assert bits(other) == end


@pytest.mark.parametrize(("mode", "step"), [("POSITION", 0.0003), ("POSITION", 1e-5), ("TRAJECTORY", 0.0000625)])
def test_time_step_that_does_not_fit_during_the_run(mode: str, step: float, warnings: list[str]) -> None:
    """The board stands still without torque, also in a copy, and goes on where the joints are then."""
    model, data = started(arm(f"shoulder {mode}", f"elbow {mode}"))
    model.opt.gravity[:] = 0.0
    data.qvel[:] = 1.0
    model.opt.timestep = step
    run(model, data, 100)
    other = copy.copy(data)
    assert [one.partition("; write")[0] for one in warnings] == [
        "servo.board: instance 0: timestep: "
        + ("in mode TRAJECTORY a multiple of a slow tick" if mode == "TRAJECTORY" else "not a multiple of a PWM period")
    ]
    assert data.actuator_force.tolist() == [0.0, 0.0]
    model.opt.timestep = 0.0005
    data.ctrl[:] = other.ctrl[:] = GEAR * data.qpos
    for one in (data, other):
        run(model, one, 3000)
    assert GEAR * data.qpos == pytest.approx(data.ctrl, abs=0.05)
    assert bits(other) == bits(data)


def test_state_that_is_none_of_this_board_starts_it_anew(warnings: list[str]) -> None:
    """Zeros, as in a state that was written by hand, and a damaged one."""
    model, data = started(arm())
    spoilt = copy.copy(data)
    data.plugin_state[:] = 0.0
    spoilt.plugin_state[1000] = 1.0 + np.random.default_rng(1).random()
    ends = []
    for one in (data, spoilt):
        mujoco.mj_forward(model, one)
        run(model, one, SEARCHED)
        ends.append(board(one)["axis1.substate"])
    assert ends == 2 * [Catalogue.load().enums["substate_t"]["SPIN"]]
    assert warnings == [
        f"servo.board: instance 0: plugin state: {what}; the board starts anew"
        for what in ("not one of this export", "the state is incomplete or damaged")
    ]


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_bad_numbers_leave_finite_torques_and_a_state_that_can_be_restored(
    value: float, integrator: str, warnings: list[str]
) -> None:
    """In all that a program may write during a run; without the reset by which MuJoCo ends some of them."""
    inputs = '<config key="inputs" value="supply.u_source axis1.fault.heat"/>'
    text = arm("shoulder SPEED", config=inputs + brake(0.1)).replace("implicitfast", integrator)
    model, data = started(text.replace("<extension>", '<size nuserdata="2"/><extension>'))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    places = {
        **{name: getattr(data, name) for name in ("qpos", "qvel", "ctrl", "userdata", "qfrc_applied", "plugin_state")},
        **{name: getattr(model, name) for name in ("actuator_gear", "actuator_ctrlrange", "dof_armature")},
    }
    ends = {}
    for name in ("nothing", *places):
        mujoco.mj_setState(model, data, state, STATE)
        place = places.get(name)
        if place is not None:
            before = place.copy()
            place.flat[-1 if name == "plugin_state" else 0] = value
            for _ in range(20):
                mujoco.mj_step(model, data)
                assert np.isfinite(data.actuator_force).all(), name
            place[...] = before
        own = [one for one in warnings if one.startswith("servo.board")]
        assert len(own) == len(set(own)), name  # each once
        warnings.clear()
        mujoco.mj_setState(model, data, state, STATE)
        run(model, data, 50)
        ends[name] = bits(data)
    assert [name for name, end in ends.items() if end != ends["nothing"]] == []


def test_axis_homes_at_its_home_switch(warnings: list[str]) -> None:
    """The switch is at angles of the motor: those of the joint times its gear. So is `ctrl` after it."""
    entries = {"axis2.home": "SWITCH_POSITIVE", "plant.axis2.home_from": "5", "plant.axis2.home_to": "30"}
    config = "".join(f'<config key="{key}" value="{value}"/>' for key, value in entries.items())
    model = mujoco.MjModel.from_xml_string(arm(config=config))
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.ctrl[1] = 5.0
    run(model, data, 8000)
    assert board(data)["axis2.home_state"] == Catalogue.load().enums["home_state_t"]["KNOWN"]
    assert board(data)["axis2.position"] == pytest.approx(0.0, abs=0.05)
    assert GEAR * data.qpos[1] == pytest.approx(5.0, abs=0.01)
    run(model, data, 2000, lambda _: [0.0, 2.0])
    assert GEAR * data.qpos[1] == pytest.approx(2.0, abs=0.01)
    assert warnings == []


def test_load_that_turns_the_shaft_before_the_search_is_named(warnings: list[str]) -> None:
    model = mujoco.MjModel.from_xml_string(arm())
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0.0
    for _ in range(2200):
        data.qvel[0] = 0.5
        mujoco.mj_step(model, data)
    assert len(warnings) == 1
    assert "actuator 0: the firmware waits in CALIB until the shaft rests, which turns at" in warnings[0]


def test_delay_of_an_actuator_is_that_of_its_signal() -> None:
    """Twenty steps later than without it, with the same bits; half a step less, against rounding."""
    steps, number = 20, 300
    text = arm("shoulder", "elbow SPEED")
    plain = started(text)
    delay = (steps - 0.5) * 0.0005
    delayed = started(text.replace('gear="100.0"', f'gear="100.0" delay="{delay}" nsample="{steps + 2}"'))
    signals = np.random.default_rng(1).uniform(-5.0, 5.0, (number, 2))
    for k in range(number + steps):
        for (model, data), index in ((plain, k - steps), (delayed, k)):
            data.ctrl[:] = signals[min(max(0, index), number - 1)] if index >= 0 else 0.0
            mujoco.mj_step(model, data)
    assert plain[1].qpos.tobytes() == delayed[1].qpos.tobytes()
    assert plain[1].plugin_state.tobytes() == delayed[1].plugin_state.tobytes()


def test_limits_and_groups_are_those_of_the_options() -> None:
    model, data = started(arm("shoulder SPEED"))
    other = copy.copy(data)
    data.ctrl[0] = 80.0  # ctrlrange: 60
    run(model, data, 500)
    assert GEAR * data.qvel[0] == pytest.approx(60.0, abs=3.0)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    run(model, data, 500)
    assert GEAR * data.qvel[0] == pytest.approx(80.0, abs=3.0)
    model.opt.disableactuator = 1  # of group 0
    other.ctrl[0] = 20.0
    run(model, other, 2)
    assert other.actuator_force.tolist() == [0.0, 0.0]
    model.opt.disableactuator = 2
    run(model, other, 20)
    assert abs(other.actuator_force[0]) > 0.0


def test_halves_of_a_step_are_a_step() -> None:
    model, data = started(arm("shoulder", "elbow SPEED").replace("implicitfast", "Euler"))
    other = copy.copy(data)
    run(model, data, 200, lambda _: [20.0, 5.0])
    for _ in range(200):
        mujoco.mj_step1(model, other)
        other.ctrl[:] = [20.0, 5.0]
        mujoco.mj_step2(model, other)
    assert bits(other) == bits(data)


def test_derivatives_leave_the_board_as_it_is(moving: tuple[Any, Any], warnings: list[str]) -> None:
    model, data = moving[0], copy.copy(moving[1])
    other = copy.copy(data)
    matrix = np.zeros((4, 4))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, matrix, None, None, None)
    assert np.isfinite(matrix).all()
    for one in (data, other):
        run(model, one, 100)
    assert bits(data) == bits(other)
    assert warnings == []


@pytest.mark.parametrize("armature", ["actuator", "tendon"])
def test_two_motors_move_a_beam_by_tendons(armature: str, warnings: list[str]) -> None:
    """A gantry: each motor moves an end of the beam, which slides and yaws; its rotor is in one of two places."""
    gear, half = 200.0, 0.4
    rotors = [axis.inertia for axis in PLANT.axes]
    at_tendon = [f'armature="{r * gear**2}"' if armature == "tendon" else "" for r in rotors]
    at_actuator = [f'armature="{r}"' if armature == "actuator" else "" for r in rotors]
    text = f"""
      <mujoco>
        <option timestep="0.0005"/>
        <extension><plugin plugin="servo.board"><instance name="board">
          <config key="axis1" value="left"/><config key="axis2" value="right"/>
        </instance></plugin></extension>
        <worldbody><body>
          <joint name="y" type="slide" axis="0 1 0" damping="5" frictionloss="1"/>
          <joint name="yaw" axis="0 0 1" damping="2" frictionloss="0.2"/>
          <geom type="box" size="0.4 0.03 0.03" mass="2"/>
        </body></worldbody>
        <tendon>
          <fixed name="left" {at_tendon[0]}><joint joint="y" coef="1"/><joint joint="yaw" coef="{-half}"/></fixed>
          <fixed name="right" {at_tendon[1]}><joint joint="y" coef="1"/><joint joint="yaw" coef="{half}"/></fixed>
        </tendon>
        <actuator>
          <plugin name="left" tendon="left" gear="{gear}" {at_actuator[0]} plugin="servo.board" instance="board"/>
          <plugin name="right" tendon="right" gear="{gear}" {at_actuator[1]} plugin="servo.board" instance="board"/>
        </actuator>
      </mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    run(model, data, 5000)
    run(model, data, 4000, lambda _: [30.0, 50.0])
    assert data.qpos == pytest.approx([40.0 / gear, 20.0 / gear / (2.0 * half)], abs=5e-4)
    assert warnings == []
    with pytest.raises(ValueError, match="'left': the tendon has less than the inertia of its rotors"):
        mujoco.MjModel.from_xml_string(text.replace(at_tendon[0] or at_actuator[0], ""))


def test_rotor_in_the_armature_of_the_actuator() -> None:
    text, own = arm(), arm()
    for axis in PLANT.axes:
        own = own.replace(f'armature="{axis.inertia * GEAR**2}"', "", 1)
        own = own.replace('gear="100.0" plugin', f'gear="100.0" armature="{axis.inertia}" plugin', 1)
    ends = []
    for one in (text, own):
        model, data = started(one)
        run(model, data, 500, lambda _: [20.0, 5.0])
        ends.append(GEAR * data.qpos)
    assert ends[0] == pytest.approx(ends[1], abs=0.01)


def test_controls_are_found_beside_actuators_with_several() -> None:
    """The export of `<dcmotor>` writes actuators with two inputs."""
    text = arm("shoulder", "elbow SPEED").replace(
        "<actuator>",
        '<actuator><dcmotor name="fan" joint="fan" motorconst="0.05" resistance="1" input="pos vel"/>',
    )
    fan = '<body><joint name="fan" armature="1e-4"/><geom size="0.01" contype="0" conaffinity="0"/></body>'
    model, data = started(text.replace("<worldbody>", f"<worldbody>{fan}"))
    run(model, data, 1000, lambda _: [0.0, 0.0, 90.0, 5.0])
    assert GEAR * data.qpos[1] == pytest.approx(60.0, abs=0.2)  # ctrlrange
    assert GEAR * data.qvel[2] == pytest.approx(5.0, abs=0.5)


def test_model_that_is_attached_keeps_its_axes() -> None:
    """Two arms with prefixes in one model: the names of the instance are those before."""
    parent = mujoco.MjSpec()
    parent.option.timestep = 0.0005
    parent.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for prefix in ("left/", "right/"):
        parent.attach(
            mujoco.MjSpec.from_string(arm("shoulder", "elbow SPEED")), prefix=prefix, frame=parent.worldbody.add_frame()
        )
    model = parent.compile()
    data = mujoco.MjData(model)
    run(model, data, SEARCHED)
    run(model, data, 1000, lambda _: [10.0, 5.0, 20.0, -5.0])
    assert GEAR * data.qpos[[0, 2]] == pytest.approx([10.0, 20.0], abs=0.05)
    assert GEAR * data.qvel[[1, 3]] == pytest.approx([5.0, -5.0], abs=0.5)


def test_boards_do_not_share_inputs() -> None:
    """The third of three boards, without an actuator, has inputs behind those of the second one."""

    def entries(first: str, names: str) -> str:
        return f'<config key="inputs" value="{names}"/><config key="userdata" value="{first}"/>'

    def model(first: str, names: str = "supply.u_source axis1.fault.heat", third: str = "") -> Any:
        inputs = '<config key="inputs" value="supply.u_source axis1.fault.heat"/>'
        text = arm(axis1="shoulder", axis2="", config=inputs).replace("<extension>", '<size nuserdata="9"/><extension>')
        others = f'<instance name="second">{entries(first, names)}</instance>{third}'
        text = text.replace("</instance>", f"</instance>{others}", 1)
        elbow = 'joint="elbow" gear="100.0" plugin="servo.board" instance='
        text = text.replace(f'armature="{PLANT.axes[1].inertia * GEAR**2}"', 'armature="0.2"')
        return mujoco.MjModel.from_xml_string(text.replace(f'{elbow}"board"', f'{elbow}"second"'))

    message = (
        "'inputs': the inputs are entries 0 .. 1 of mjData.userdata, those of instance 'second' 1 .. 2; "
        'write <config key="userdata" value="{}"/> and <size nuserdata="{}"/>'
    )
    with pytest.raises(ValueError, match=re.escape(message.format(3, 5))):
        model("1")
    third = f'<instance name="third">{entries("3", "supply.u_source")}</instance>'
    with pytest.raises(ValueError, match=re.escape(message.format(4, 6))):
        model("1", third=third)
    with pytest.raises(ValueError, match="'userdata': not the index of an entry"):
        model("x")
    model("2")
    model("1", "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (arm(axis1="wrist"), "'axis1': no actuator has this name"),
        (arm(axis1="shoulder PATH"), "'axis1': no actuator has this name"),
        (arm(axis2="shoulder"), "two axes"),
        (
            arm().replace("</instance>", '</instance><instance name="other"/>'),
            "'actuator': two axes have one actuator, or",
        ),
        (arm().replace('gear="100.0"', 'gear="0"', 1), "'axis1': the gear is 0"),
        (arm().replace('gear="100.0"', 'gear="nan"', 1), "'axis1': the gear is 0 or no number"),
        (arm().replace('gear="100.0"', 'gear="100.0" dyntype="integrator"', 1), "'axis1': the actuator has an act"),
        (arm().replace('gear="100.0"', 'gear="100.0" actdim="2"', 1), "'axis1': the actuator has an activation"),
        (
            arm()
            .replace("<actuator>", SPATIAL + "<actuator>")
            .replace('joint="shoulder" gear', 'tendon="rope" gear')
            .replace("<worldbody>", '<worldbody><site name="hook" pos="1 0 0"/>')
            .replace('<body pos="0 0 -0.3">', '<body pos="0 0 -0.3"><site name="end"/>'),
            "'axis1': a motor turns a hinge or a slide, or pulls a fixed tendon",
        ),
        (arm(config='<config key="plant.axis1.load_inertia" value="1e-5"/>'), "'shoulder': the axis has a second mass"),
        (arm(axis2=""), "a board has two axes"),
        (arm().replace('joint="elbow"', 'joint="shoulder"'), 'inertia of its rotors; write armature="0.2"'),
        (
            arm(axis2="")
            .replace("</plugin></extension>", '<instance name="other"/></plugin></extension>')
            .replace(
                'joint="elbow" gear="100.0" plugin="servo.board" instance="board"',
                'joint="shoulder" plugin="servo.board" instance="other"',
            ),
            "another board drives its joint",
        ),
        (arm(step=0.0003), "'timestep': not a multiple of a PWM period"),
        (arm("shoulder TRAJECTORY", step=0.0000625), "'timestep': in mode TRAJECTORY a multiple of a slow tick"),
        (arm().replace("u_dc", "u_dcc"), "'u_dcc': the board has no such quantity"),
        (arm(config='<config key="plant.axis1.r_s" value="-1"/>'), "'plant.axis1.r_s': is outside of its range"),
        (arm(config='<config key="plant.axis1.r_s" value="1 ohm"/>'), "'plant.axis1.r_s': not a number"),
        (arm(config='<config key="axis1.home" value="STOP"/>'), "'axis1.home': no method of homing"),
        (arm(config='<config key="inputs" value="plant.axis1.r_s"/>'), "inputs: does not change during the run"),
        (arm(config='<config key="inputs" value="axis1.speed"/>'), "inputs: does not change during the run"),
        (arm(config='<config key="inputs" value="supply.u_source"/>'), 'write <size nuserdata="1"/>'),
        (arm(config='<config key="userdata" value="-1"/>'), "'userdata': not the index"),
        (arm(config='<config key="plant.axis1.brake_torque" value="1"/>'), "'shoulder': the plant has a holding brake"),
        (
            arm(config='<config key="axis1.home" value="SWITCH_POSITIVE"/>'),
            "'shoulder': homing to a switch, but the f",
        ),
        (
            arm(config='<config key="axis2.home" value="SWITCH_POSITIVE"/>'),
            "'elbow': homing to a switch, but the p",
        ),
        (arm(config='<config key="shaft" value="yes"/>'), "'shaft': write SHARED if"),
        (
            arm().replace('axis="0 -1 0"', 'type="ball"', 1).replace("0.3 -0.2", "1 0 0 0 0"),
            "'axis1': a motor turns a hinge",
        ),
        (arm(config='<config key="level" value="registers"/>'), "'level': the plugin has a board at level ideal"),
        (arm(config='<config key="plant.axis3.r_s" value="1"/>'), "unrecognized attribute"),
        (arm().replace(f'armature="{PLANT.axes[0].inertia * GEAR**2}"', ""), 'write armature="0.08"'),
    ],
)
def test_what_does_not_fit_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        mujoco.MjModel.from_xml_string(text)
