"""``servo-sim``: the virtual board in simulated time, from the command line and without ROS."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.figure import new_figure, write_figure
from servo_msgs_py.runtime.program import program
from servo_msgs_py.table_text import aligned
from servo_msgs_py.trace import Trace

from servo_msgs_py import argument
from servo_twin.board import Board, BoardError
from servo_twin.diagnosis import command as diagnose
from servo_twin.identification import autotune
from servo_twin.identification import command as identify
from servo_twin.level import DEFAULT_LEVEL, FAST_LEVEL, Level, add_level_options, use_elf
from servo_twin.plant import PlantConfig
from servo_twin.robot import command as robot
from servo_twin.servo_config import ServoConfig
from servo_twin.simulation import MoveResult, SimulationError, enable, move, turns
from servo_twin.validation.experiments import command as experiment
from servo_twin.validation.sweep import command as sweep
from servo_twin.validation.sweep import robust_command
from servo_twin.validation.timing import command as timing
from servo_twin.validation.timing import core_measured


def parser() -> argparse.ArgumentParser:
    """Command line of ``servo-sim``."""
    result = argument.Parser(prog="servo-sim", description="The virtual board in simulated time, without ROS.")
    verbs = result.add_subparsers(dest="verb", required=True, metavar="COMMAND")
    common = argument.Parser(add_help=False)
    common.add_argument("--seed", type=int, default=1, help="seed of every random number (default: %(default)s)")
    common.add_argument("--plant", type=Path, help="plant file (default: the packaged one)")
    levelled = _levelled(DEFAULT_LEVEL)
    common.add_argument("--json", action="store_true", help="print the results as JSON")

    info = verbs.add_parser("info", parents=[common, levelled], help="print the plant data: motors, inverter, bus")
    info.set_defaults(run=_info)

    mover = verbs.add_parser("move", parents=[common, levelled], help="search the rotors, move, measure the response")
    mover.add_argument("--turns", type=argument.finite, default=5.0, help="distance (default: %(default)s)")
    mover.add_argument("--axis", type=int, choices=range(1, AXES + 1), help="only this axis (default: both)")
    mover.add_argument(
        "--time", type=argument.positive, help="length of the recording [s] (default: depends on the distance)"
    )
    mover.add_argument(
        "--plot", type=argument.picture, metavar="FILE", help="file for a plot of position, speed and current"
    )
    mover.set_defaults(run=_move)

    bench = verbs.add_parser("bench", parents=[common, levelled], help="real-time factor of one board with two axes")
    bench.add_argument("--time", type=argument.positive, default=10.0, help="simulated time [s] (default: %(default)s)")
    bench.set_defaults(run=_bench)

    exporter = verbs.add_parser("export", parents=[common], help="write a board for other simulators: FMI 3.0, MuJoCo")
    kinds = exporter.add_mutually_exclusive_group(required=True)
    kinds.add_argument("--fmu", type=argument.output_file, metavar="FILE", help="co-simulation unit to be written")
    kinds.add_argument(
        "--mjcf",
        type=argument.output_file,
        metavar="FILE",
        help="MuJoCo model to be written: the nearest <dcmotor> of each axis, and its error against the firmware "
        "(needs servo_twin[mujoco])",
    )
    kinds.add_argument(
        "--mujoco",
        type=argument.output_file,
        metavar="FILE",
        help="plugin of MuJoCo to be written (.so): actuators with this board (needs servo_twin[mujoco])",
    )
    exporter.add_argument(
        "--config", type=Path, metavar="FILE", help="configuration of the firmware, a servo.toml (default: compiled in)"
    )
    exporter.set_defaults(run=_export)

    robot.add_parser(verbs, common, _levelled(FAST_LEVEL))
    experiment.add_parser(verbs, common, _levelled(FAST_LEVEL))
    sweep.add_parser(verbs, common, _levelled(FAST_LEVEL))
    robust_command.add_parser(verbs, common, _levelled(FAST_LEVEL))
    identify.add_parser(verbs, common, _levelled(FAST_LEVEL))
    autotune.add_parser(verbs, common, _levelled(FAST_LEVEL))
    diagnose.add_parser(verbs, common, _levelled(FAST_LEVEL))
    timing.add_parser(verbs, common)
    core_measured.add_parser(verbs, common)
    return result


def _levelled(default: Level) -> argument.Parser:
    """Parent with ``--level`` and ``--elf``."""
    result = argument.Parser(add_help=False)
    add_level_options(result, "the board is", default)
    return result


def _board(args: argparse.Namespace) -> Board:
    return Board(PlantConfig.load(args.plant) if args.plant else None, seed=args.seed, level=args.level)


def _export(args: argparse.Namespace) -> int:
    plant = PlantConfig.load(args.plant)
    servo = ServoConfig.load(args.config) if args.config else None
    result: dict[str, object]
    if args.mjcf:
        result = {"mjcf": str(args.mjcf), "errors": robot.export_mjcf(args.mjcf, plant, args.seed, servo)}
    elif args.mujoco:
        from servo_twin.robot.plugin import export_plugin  # as below

        export_plugin(args.mujoco, plant, args.seed, servo)
        result = {"mujoco": str(args.mujoco)}
    else:
        from servo_twin.fmu import export_fmu  # needs a C compiler and the sources, unlike the other commands

        export_fmu(args.fmu, plant, args.seed, servo)
        result = {"fmu": str(args.fmu)}
    if args.json:
        print(json.dumps(result))
    else:
        print(f"wrote {args.mjcf or args.mujoco or args.fmu}")
    return 0


def _info(args: argparse.Namespace) -> int:
    with _board(args) as board:
        plant = asdict(board.plant)
    if args.json:
        print(json.dumps(plant, indent=2))
        return 0
    bus = plant.pop("bus")
    axes = plant.pop("axes")
    common = plant | {f"bus.{key}": value for key, value in bus.items()}
    print("\n".join(aligned([[key, str(value)] for key, value in common.items()])), end="\n\n")
    heads = ["", *map(axis_name, range(AXES))]
    print("\n".join(aligned([heads, *([key, *(str(axis[key]) for axis in axes)] for key in axes[0])])))
    return 0


def _move(args: argparse.Namespace) -> int:
    axes = range(AXES) if args.axis is None else [args.axis - 1]
    seconds = args.time if args.time is not None else 1.0 + 2.5 * abs(args.turns) / 45.0
    with _board(args) as board:
        enable(board)
        search_time = board.clock()
        results, log = move(board, {axis: turns(args.turns) for axis in axes}, seconds)
        if args.plot:
            _plot(board.si(log), [axis_name(axis) for axis in axes], args.plot)
    if args.json:
        print(json.dumps({"search_time": search_time, "moves": [asdict(result) for result in results]}, indent=2))
    else:
        print(f"both rotors found {search_time:.2f} s after reset")
        _print_moves(results)
    return 0 if all(result.settling_time is not None for result in results) else 1


def _print_moves(results: Sequence[MoveResult]) -> None:
    rows = [
        ["axis", "target", "reached", "overshoot", "steady state", "settling", "speed", "i_q"],
        ["", "counts", "counts", "counts", "counts", "ms", "rad/s", "A"],
    ]
    for r in results:
        counts = map(str, (r.target, r.reached, r.overshoot, r.steady_state))
        settling = "not settled" if r.settling_time is None else f"{1e3 * r.settling_time:.1f}"
        rows.append([r.axis, *counts, settling, f"{r.speed_max:.1f}", f"{r.i_q_max:.2f}"])
    print("\n".join(aligned(rows, "<>")))


def _plot(trace: Trace, names: Sequence[str], path: Path) -> None:
    figure = new_figure(6.5 * len(names), 8.0, 120)
    plots = figure.subplots(3, len(names), sharex=True, squeeze=False)
    for column, name in enumerate(names):
        for plot, quantity, unit in zip(
            plots[:, column], ("position", "speed", "i_q"), ("rad", "rad/s", "A"), strict=True
        ):
            plot.plot(trace.time, trace[f"{name}.{quantity}_ref"], color="0.6", label="set-point")
            plot.plot(trace.time, trace[f"{name}.{quantity}"], label="shaft" if quantity != "i_q" else "measured")
            plot.set_ylabel(f"{quantity} [{unit}]")
            plot.grid(alpha=0.3)
        plots[0, column].set_title(name)
        plots[0, column].legend()
        plots[-1, column].set_xlabel("time since reset [s]")
    write_figure(figure, path)


def _bench(args: argparse.Namespace) -> int:
    with _board(args) as board:
        enable(board)
        board.write("cmd.mode", [1] * AXES)
        board.write("cmd.speed", [100.0, -50.0])
        begin = time.thread_time()
        board.run(args.time)
        used = time.thread_time() - begin
    factor = args.time / used
    if args.json:
        print(json.dumps({"simulated_s": args.time, "cpu_s": used, "real_time_factor": factor}))
    else:
        print(f"{args.time:g} s of two spinning axes took {used:.3f} s of one core: real-time factor {factor:.0f}")
    return 0


@program("servo-sim")
def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns
    -------
    int
        0: success, 1: the run failed, 2: wrong usage, or a file that cannot be opened or used; else `program`.
    """
    args = parser().parse_args(argv)
    try:
        if "elf" in args:
            use_elf(args)
        return int(args.run(args))
    except (BoardError, SimulationError, ValueError) as error:
        print(f"servo-sim: {error}", file=sys.stderr)
        return 2 if isinstance(error, ValueError) else 1


if __name__ == "__main__":
    sys.exit(main())
