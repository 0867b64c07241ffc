"""``servo-sim robot``: the joints of a MuJoCo model, moved by the firmware (servo_twin/doc/coupling.md)."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import active
from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.output_file import write_file
from servo_msgs_py.rerun_file import import_rerun
from servo_msgs_py.table_text import aligned

from servo_msgs_py import argument
from servo_twin.board import SimulationError
from servo_twin.level import FAST_LEVEL, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig
from servo_twin.view import scene

if TYPE_CHECKING:
    from servo_twin.robot.coupling import RobotDrives
    from servo_twin.robot.robot_model import RobotModel

EXAMPLES: Final = Path(__file__).with_name("examples")
MODEL_HELP: Final = "MuJoCo model (MJCF) with joints that the board moves, or an example: " + ", ".join(
    sorted(path.stem for path in EXAMPLES.glob("*.xml"))
)
_REST: Final = 1.0  # simulated after the last keyframe [s]

_Array = NDArray[np.float64]

Curves = dict[str, dict[tuple[str, str], _Array]]
"""Curves of a motion by quantity (with its unit), then by actuator and source."""


class RobotLog(NamedTuple):
    """Rows of a motion, one per time step; columns are the drives."""

    time: _Array  # since the begin of the motion [s]
    set_point: _Array  # control signal, in the unit of its mode
    angle: _Array  # length of the actuator: angle of the motor [rad]
    speed: _Array  # of the motor [rad/s]
    torque: _Array  # of the motor [N m]
    u_dc: _Array  # bus voltage of each board [V]


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``robot`` to the commands of ``servo-sim``; parameters as of `sweep.command.add_parser`."""
    parser = verbs.add_parser(
        "robot",
        parents=[common, levelled],
        help="move the joints of a MuJoCo model by the firmware (needs servo_twin[mujoco])",
        description="Move the joints of a MuJoCo model by the firmware: search the rotors, home, follow the keyframes. "
        "The <custom> part of the MJCF file says which axes drive which actuators (servo_twin/doc/coupling.md).",
    )
    parser.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    parser.add_argument(
        "--time", type=argument.positive, help=f"of the motion [s] (default: {_REST:g} s after the last keyframe)"
    )
    parser.add_argument("--plot", type=argument.picture, metavar="FILE", help="file for a plot of the motion")
    parser.add_argument(
        "--rrd",
        type=argument.output_file,
        metavar="FILE",
        help="recording for the rerun viewer, with the moving robot (needs servo_twin[viewer])",
    )
    parser.set_defaults(run=run)


def load(name: str) -> RobotModel:
    """A model by its file, or by the name of an example.

    Raises
    ------
    SimulationError
        If MuJoCo is not installed.
    ValueError
        If the file is not valid.
    """
    with _needs_mujoco():
        from servo_twin.robot.robot_model import RobotModel
    example = EXAMPLES / f"{name}.xml"
    return RobotModel(example if example.is_file() else Path(name))


def load_on_line(name: str, plant: PlantConfig | None = None) -> RobotModel:
    """A model whose only board has a host at its serial line, checked with a plant; by default the packaged one.

    Raises
    ------
    SimulationError
        If MuJoCo is not installed.
    ValueError
        If the file is not valid, or board and model do not fit.
    """
    robot = load(name)
    robot.on_line(plant or PlantConfig.load(), level=FAST_LEVEL).boards[0].close()
    return robot


def export_mjcf(path: Path, plant: PlantConfig, seed: int, servo: ServoConfig | None = None) -> list[dict[str, object]]:
    """Write a model with the motors of MuJoCo that are nearest to the axes of a board, and their errors.

    Parameters
    ----------
    path : Path
        File to be written.
    plant : PlantConfig
        Motors and supply.
    seed : int
        Seed of the board.
    servo : ServoConfig, optional
        Configuration of the firmware; that of ``firmware/config/servo.toml`` by default.

    Returns
    -------
    list of dict
        Errors by axis and move; see `servo_twin.robot.dcmotor.Errors`.

    Raises
    ------
    SimulationError
        If MuJoCo is not installed, or an axis has a fault.
    OSError
        If the file cannot be written.
    """
    with _needs_mujoco():
        from servo_twin.robot.dcmotor import model_text, nearest
    motors, errors = nearest(plant, seed, servo)
    rows = [["axis", "move", "error rms [rad]", "largest [rad]"]]
    rows += [[e.axis, e.move, f"{e.rms:.5f}", f"{e.largest:.5f}"] for e in errors]
    table = "\n".join(["Angle of the motor against the firmware in mode TRAJECTORY:", *aligned(rows, "<<>")])
    write_file(path, model_text(motors, table))
    return [e._asdict() for e in errors]


@contextmanager
def _needs_mujoco() -> Iterator[None]:
    try:
        yield
    except ImportError as error:
        raise SimulationError(f"this needs MuJoCo ({error}): pip install 'servo_twin[mujoco]'") from None


def follow(
    robot: RobotModel,
    drives: RobotDrives,
    seconds: float | None = None,
    watch: Callable[[float, Any], object] | None = None,
) -> RobotLog:
    """Search the rotors, home, and follow the keyframes.

    Parameters
    ----------
    robot : RobotModel
        The model.
    drives : RobotDrives
        Its drives, from `RobotModel.robot`.
    seconds : float, optional
        Duration of the motion [s]; 1 s after the last keyframe by default.
    watch : callable, optional
        Called at every step with its time [s] and the ``mjData``.

    Raises
    ------
    SimulationError
        If an axis has a fault, or a homing fails.
    """
    from servo_twin.robot.robot_model import Motion

    model, data = drives.model, drives.data
    drives.enable()
    for k, drive in enumerate(drives.drives):
        if drive.axis in robot.homing:
            drives.home(k, robot.homing[drive.axis])
    motion = Motion(model, data.ctrl.copy())
    seconds = float(motion.time[-1]) + _REST if seconds is None else seconds
    step, delays = model.opt.timestep, drives.delays
    lead = max(delays)  # paths begin at rest
    begin = data.time + lead
    robot.release(data)
    rows = []
    for _ in range(round((lead + seconds) / step)):
        time = data.time - begin
        data.ctrl[:] = motion(time + delays) + robot.corrections(data)
        drives.step()
        if watch is not None:
            watch(time + step, data)
        target = motion(np.full(model.nu, time + step))[drives.channels]
        volts = [board.truth(0).u_dc for board in drives.boards]
        rows.append((time + step, target, drives.lengths(), drives.speeds(), drives.torques(), volts))
    for drive in drives.drives:
        board, axis = divmod(drive.axis, AXES)
        if faults := active(drives.boards[board], axis):
            raise SimulationError(f"{drive.actuator} ({axis_name(drive.axis)}): {', '.join(sorted(faults))}")
    return RobotLog(*map(np.array, zip(*rows, strict=True)))


def figures(log: RobotLog, drives: RobotDrives) -> dict[str, dict[str, float | None]]:
    """Figures of each drive: errors of its joint [rad, or m], torques at its joint [N m, or N]."""
    result: dict[str, dict[str, float | None]] = {}
    for k, drive in enumerate(drives.drives):
        gear = float(drives.gear[k])
        values = {"POSITION": log.angle, "TRAJECTORY": log.angle, "SPEED": log.speed}.get(drive.mode or "")
        error = None if values is None else (values[:, k] - log.set_point[:, k]) / gear
        result[drive.actuator] = {
            "error_rms": None if error is None else float(np.sqrt(np.mean(error**2))),
            "error_max": None if error is None else float(np.abs(error).max()),
            "torque_rms": abs(gear) * float(np.sqrt(np.mean(log.torque[:, k] ** 2))),
            "torque_max": abs(gear) * float(np.abs(log.torque[:, k]).max()),
        }
    return result


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    robot = load(args.model)
    drives = robot.robot(
        PlantConfig.load(args.plant), seed=args.seed, level=chosen_level(args.level, default=FAST_LEVEL)
    )
    poses = None
    if args.rrd:
        from servo_twin.robot.recording import Poses, write_recording

        import_rerun()
        poses = Poses(robot.model)
    log = follow(robot, drives, args.time, None if poses is None else poses.watch)
    found = figures(log, drives)
    if args.plot:
        _plot(log, drives, args.plot)
    if poses is not None:
        write_recording(args.rrd, robot.model, poses, log.time, curves(log, drives))
    if args.json:
        print(json.dumps(found))
        return 0
    rows = [["joint", "mode", "error rms", "largest", "torque rms", "largest"]]
    rows += [
        [drive.actuator, drive.mode or "", *("" if x is None else f"{x:.5f}" for x in found[drive.actuator].values())]
        for drive in drives.drives
    ]
    print("\n".join(aligned(rows, "<<>")))
    print("errors [rad or m; of a speed per second] and torques [N m or N] at the joints")
    return 0


def curves(log: RobotLog, drives: RobotDrives) -> Curves:
    """Curves at the joints by quantity, then by actuator and source; voltages of the buses."""
    position: dict[tuple[str, str], _Array] = {}
    speed: dict[tuple[str, str], _Array] = {}
    torque: dict[tuple[str, str], _Array] = {}
    for k, drive in enumerate(drives.drives):
        gear = float(drives.gear[k])
        board = drive.actuator, scene.BOARD
        position[board], speed[board] = log.angle[:, k] / gear, log.speed[:, k] / gear
        torque[board] = log.torque[:, k] * gear
        target = {"POSITION": position, "TRAJECTORY": position, "SPEED": speed}.get(drive.mode or "")
        if target is not None:
            target[drive.actuator, scene.SET_POINT] = log.set_point[:, k] / gear
    return {
        "position [rad or m]": position,
        "speed [rad/s or m/s]": speed,
        "torque [N m or N]": torque,
        "bus [V]": {(f"bus{k + 1}", scene.BOARD): log.u_dc[:, k] for k in range(log.u_dc.shape[1])},
    }


def _plot(log: RobotLog, drives: RobotDrives, path: Path) -> None:
    figure = new_figure(12.0, 8.0)
    shown = curves(log, drives)
    plots = figure.subplots(len(shown), 1, sharex=True)
    for plot, (quantity, series) in zip(plots, shown.items(), strict=True):
        for (actuator, source), values in series.items():
            if source == scene.BOARD:
                plot.plot(log.time, values, label=actuator, linewidth=0.7)
                set_point = series.get((actuator, scene.SET_POINT))
                if set_point is not None:
                    plot.plot(log.time, set_point, ":", color=plot.lines[-1].get_color())
        plot.set_ylabel(quantity)
        plot.grid(alpha=0.3)
    plots[0].legend()
    plots[0].set_title("at the joints; set-points: dots")
    plots[-1].set_xlabel("time since the begin of the motion [s]")
    write_figure(figure, path)
