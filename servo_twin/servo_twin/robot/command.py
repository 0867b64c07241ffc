"""``servo-sim arm``: a two-joint arm in MuJoCo whose joints are moved by the firmware."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.board_port import active
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.table_text import aligned

from servo_msgs_py import argument
from servo_twin.board import Board, SimulationError
from servo_twin.plant import PlantConfig

MODEL: Final = Path(__file__).with_name("arm.xml")
JOINTS: Final = ("shoulder", "elbow")  # axis 1 and axis 2; joints and actuators have the same names

_AMPLITUDE: Final = np.array([0.8, 1.0])  # [rad]
_FREQUENCY: Final = np.array([0.25, 0.375])  # of the Lissajous figure [Hz]
_RISE: Final = 2.0  # time until the full amplitude [s]

_Array = NDArray[np.float64]


class ArmLog(NamedTuple):
    """Rows of a run, one per time step; two columns are shoulder and elbow."""

    time: _Array  # time of the model [s]
    set_point: _Array  # joint angles [rad]
    angle: _Array  # joint angles [rad]
    torque: _Array  # torque of the motors at the joints [N m]
    hand: _Array  # x and z of the hand [m]
    u_dc: _Array  # bus voltage [V]


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``arm`` to the commands of ``servo-sim``; parameters as of `sweep.command.add_parser`."""
    parser = verbs.add_parser(
        "arm",
        parents=[common, levelled],
        help="move a two-joint arm in MuJoCo (needs servo_twin[mujoco])",
        description="Move a two-joint arm in MuJoCo by the firmware: search the rotors, follow a Lissajous figure.",
    )
    parser.add_argument("--time", type=argument.positive, default=8.0, help="of the motion [s] (default: %(default)s)")
    parser.add_argument("--plot", type=argument.picture, metavar="FILE", help="file for a plot of the motion")
    parser.set_defaults(run=run)


def set_points(time: float) -> _Array:
    """Joint angles [rad] at a time since the beginning of the motion [s]."""
    rise = min(time / _RISE, 1.0)
    return np.asarray(rise * rise * (3.0 - 2.0 * rise) * _AMPLITUDE * np.sin(2.0 * math.pi * _FREQUENCY * time))


def follow(board: Board, seconds: float) -> ArmLog:
    """Search the rotors and follow the figure for some time [s].

    Raises
    ------
    SimulationError
        If MuJoCo is not installed, or an axis has a fault.
    """
    try:
        import mujoco
    except ImportError as error:
        raise SimulationError(f"the arm needs MuJoCo ({error}): pip install 'servo_twin[mujoco]'") from None
    from servo_twin.robot.coupling import Drive, RobotDrives

    model = mujoco.MjModel.from_xml_path(str(MODEL))
    data = mujoco.MjData(model)
    drives = RobotDrives(model, data, board, [Drive(joint, axis) for axis, joint in enumerate(JOINTS)])
    drives.enable()
    gear = model.actuator_gear[:, 0]
    begin = data.time
    rows = []
    for _ in range(round(seconds / model.opt.timestep)):
        target = set_points(data.time - begin)
        data.ctrl[:] = gear * target
        drives.step()
        hand = data.sensor("hand").data[[0, 2]]  # that of the beginning of the step
        rows.append((data.time, target, data.qpos.copy(), gear * data.act, hand.copy(), board.truth(0).u_dc))
    for axis, joint in enumerate(JOINTS):
        if faults := active(board, axis):
            raise SimulationError(f"{joint} ({axis_name(axis)}): {', '.join(sorted(faults))}")
    return ArmLog(*map(np.array, zip(*rows, strict=True)))


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    with Board(PlantConfig.load(args.plant), seed=args.seed, level=args.level) as board:
        log = follow(board, args.time)
    error = log.angle - log.set_point
    figures = {
        "error_rms": np.sqrt(np.mean(error**2, axis=0)),
        "error_max": np.abs(error).max(axis=0),
        "torque_max": np.abs(log.torque).max(axis=0),
    }
    if args.plot:
        _plot(log, args.plot)
    if args.json:
        print(json.dumps({joint: {n: float(v[axis]) for n, v in figures.items()} for axis, joint in enumerate(JOINTS)}))
        return 0
    rows = [["joint", "error rms", "largest error", "largest torque"], ["", "rad", "rad", "N m"]]
    rows += [[joint, *(f"{v[axis]:.4f}" for v in figures.values())] for axis, joint in enumerate(JOINTS)]
    print("\n".join(aligned(rows, "<>")))
    return 0


def _plot(log: ArmLog, path: Path) -> None:
    figure = new_figure(12.0, 8.0)
    grid = figure.add_gridspec(3, 2)
    hand = figure.add_subplot(grid[:, 0])
    hand.plot(*log.hand.T)
    hand.set(xlabel="x of the hand [m]", ylabel="z of the hand [m]", aspect="equal")
    angle, torque, bus = (figure.add_subplot(grid[row, 1]) for row in range(3))
    for axis, joint in enumerate(JOINTS):
        (line,) = angle.plot(log.time, log.angle[:, axis], label=joint)
        angle.plot(log.time, log.set_point[:, axis], ":", color=line.get_color())
        torque.plot(log.time, log.torque[:, axis], label=joint, linewidth=0.5)
    bus.plot(log.time, log.u_dc, linewidth=0.5)
    for plot, label in (
        (angle, "angle (set-point: dots) [rad]"),
        (torque, "torque at joint [N m]"),
        (bus, "bus [V]"),
    ):
        plot.set_ylabel(label)
        plot.grid(alpha=0.3)
    angle.legend()
    bus.set_xlabel("time since reset [s]")
    write_figure(figure, path)
