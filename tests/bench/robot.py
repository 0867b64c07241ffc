"""Times real time of the arm of ``servo-sim robot arm``: by boards, the plugin, ``<dcmotor>``: ``make bench-robot``."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from servo_msgs_py.catalogue import AXES
from servo_twin.board import Board
from servo_twin.plant import PlantConfig
from servo_twin.robot.command import EXAMPLES
from servo_twin.robot.coupling import Drive, RobotDrives
from servo_twin.robot.plugin import export_plugin
from servo_twin.robot.robot_model import Motion

SECONDS: Final = 4.0  # simulated
SEARCH: Final = 2.0  # until the rotors are found
STEPS: Final = (0.0005, 0.001)  # [s]


def arm(step: float) -> Any:
    """The arm with this time step [s], not compiled."""
    spec = mujoco.MjSpec.from_file(str(EXAMPLES / "arm.xml"))
    spec.option.timestep = step
    return spec


def times_real_time(model: Any, data: Any, step: Callable[[], None]) -> float:
    """Simulated time of the figure over time of the processor."""
    motion = Motion(model, data.ctrl.copy())
    begin, used = data.time, time.thread_time()
    while data.time - begin < SECONDS:
        data.ctrl[:] = motion(np.full(model.nu, data.time - begin))
        step()
    return SECONDS / (time.thread_time() - used)


def by_board(level: Any, step: float) -> float:
    """Of the arm that the firmware drives."""
    model = arm(step).compile()
    with Board(seed=1, level=level) as board:
        axes = [Drive(joint, axis) for axis, joint in enumerate(("shoulder", "elbow"))]
        drives = RobotDrives(model, mujoco.MjData(model), board, axes)
        drives.enable()
        return times_real_time(model, drives.data, drives.step)


def by_plugin(step: float) -> float:
    """Of the arm whose actuators are the plugin."""
    spec = arm(step)
    spec.activate_plugin("servo.board")
    instance = spec.add_plugin(name="board", plugin_name="servo.board")
    instance.config = {f"axis{n + 1}": f"{actuator.name} TRAJECTORY" for n, actuator in enumerate(spec.actuators)}
    for axis, actuator in enumerate(spec.actuators):
        spec.joint(actuator.target).armature = PlantConfig.load().axes[axis].inertia * actuator.gear[0] ** 2
        actuator.dyntype, actuator.actdim, actuator.armature = mujoco.mjtDyn.mjDYN_NONE, 0, 0.0
        actuator.plugin.name, actuator.plugin.plugin_name, actuator.plugin.active = "board", "servo.board", True
    model = spec.compile()
    data = mujoco.MjData(model)
    while data.time < SEARCH:
        mujoco.mj_step(model, data)
    return times_real_time(model, data, lambda: mujoco.mj_step(model, data))


def by_dcmotor(step: float) -> float:
    """Of the arm with motors of MuJoCo, set-point: voltage."""
    spec = arm(step)
    plant = PlantConfig.load()
    for axis in range(AXES):
        motor = plant.axes[axis]
        spec.actuators[axis].set_to_dcmotor(
            motorconst=[motor.torque_constant, motor.torque_constant], resistance=1.5 * motor.r_s
        )
    model = spec.compile()
    data = mujoco.MjData(model)
    return times_real_time(model, data, lambda: mujoco.mj_step(model, data))


def main() -> None:
    """Print a table."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "servo.so"
        export_plugin(library)
        mujoco.mj_loadPluginLibrary(str(library))
    print("time step [ms]   registers   ideal   plugin   <dcmotor>")
    for step in STEPS:
        figures = by_board("registers", step), by_board("ideal", step), by_plugin(step), by_dcmotor(step)
        print(f"{1e3 * step:14g}   {figures[0]:9.1f}   {figures[1]:5.1f}   {figures[2]:6.1f}   {figures[3]:9.0f}")


if __name__ == "__main__":
    main()
