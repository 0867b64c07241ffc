"""``servo-sim identify``: motor, shaft and inverter of an axis, from a virtual board or from a recording."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, get_args

from servo_measurement.access import MeasurementError
from servo_measurement.log import MeasurementLog
from servo_measurement.motor_values import Limits
from servo_msgs_py.argument import ParagraphFormatter
from servo_msgs_py.catalogue import AXES, axis_name
from servo_tuning.reading import SERVO_TOML

from servo_msgs_py import argument
from servo_twin.board import Board
from servo_twin.identification.files import draw, report_lines, write_estimates, write_plant, write_servo
from servo_twin.identification.refine import DETAILED_MODEL
from servo_twin.identification.session import Identified, identified, measure_virtual, tuned_table
from servo_twin.identification.trials import Trial, Trials, random_case, summary
from servo_twin.level import FAST_LEVEL, Level, chosen_level
from servo_twin.plant import PlantConfig
from servo_twin.runner import Runner, run_to_file
from servo_twin.servo_config import servo_table

_HELP: Final = """\
Identify the motor: resistance, inductances, flux, pole pairs, inertia, friction, load, voltage error of dead time and
switches, delay, with 95 % intervals. The axis moves automatically, within the limits. Only the voltage of the bus and
the permitted motor current must be known.

  a virtual board, with the motor of --plant:
      servo-sim identify --axis 1 --voltage 24 --current 4
  a virtual board with a random motor, at its voltage and current:
      servo-sim identify --motor 17
  a recording of servo-tool identify:
      servo-sim identify --recording out/identify/measurement.npz
  errors for random motors:
      servo-sim identify --trials 200 --level registers

Output files: measurement.npz (not with --recording), estimates.json, identify.png; if all values are determined,
plant.toml for the twin, and, if there are gains for this motor, servo.toml for the controller; otherwise exit status 1
and the reason. With --trials: trials.json only."""

_OUT: Final = "out/identify"


def add_parser(verbs: Any, common: argparse.ArgumentParser, levelled: argparse.ArgumentParser) -> None:
    """Add ``identify`` to the commands of ``servo-sim``; parameters as of `sweep.command.add_parser`."""
    parser = verbs.add_parser(
        "identify",
        parents=[common, levelled],
        help="identify motor, shaft and inverter of an axis",
        description=_HELP,
        formatter_class=ParagraphFormatter,
    )
    defaults = {field.name: field.default for field in dataclasses.fields(Limits)}
    parser.add_argument("--axis", type=int, choices=range(1, AXES + 1), default=1, help="default: %(default)s")
    parser.add_argument("--voltage", type=argument.positive, help="voltage of the bus [V] (default: of the plant file)")
    parser.add_argument(
        "--current",
        type=argument.positive,
        default=4.0,
        help="permitted motor current [A, peak] (default: %(default)s)",
    )
    for name, text in (
        ("speed", "largest speed [rad/s]"),
        ("turns", "largest travel to both sides [revolutions]"),
        ("energy", "permitted braking energy returned to the bus [J]"),
    ):
        parser.add_argument(
            f"--{name}-max", type=argument.positive, default=defaults[name], help=f"{text} (default: %(default)s)"
        )
    parser.add_argument(
        "--r-on",
        type=argument.not_negative,
        help="on resistance of a switch [ohm]; if wrong, the error is added to r_s (default: plant file)",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="servo.toml with other entries (default: firmware)")
    parser.add_argument("--recording", type=Path, metavar="FILE", help="use this recording, without a measurement")
    parser.add_argument(
        "--model",
        choices=get_args(Level),
        help="level of the boards in the refinement (default: of the virtual board; for a recording registers)",
    )
    parser.add_argument("--no-refinement", action="store_true", help="closed-form estimates only")
    parser.add_argument(
        "--out", type=argument.output_folder, default=_OUT, metavar="FOLDER", help="default: %(default)s"
    )
    real = parser.add_argument_group("plant of the virtual board")
    real.add_argument("--motor", type=int, metavar="K", help="random motor K of --seed, at its own voltage and current")
    real.add_argument("--load", type=argument.finite, default=0.0, help="constant torque [N m]")
    real.add_argument("--locked", action="store_true", help="lock the shaft")
    parser.add_argument(
        "--trials",
        type=argument.count,
        metavar="N",
        help="identify the first N random motors of --seed, print the errors",
    )
    Runner.add_options(parser)
    parser.set_defaults(run=_run)


def _limits(args: argparse.Namespace, plant: PlantConfig) -> Limits:
    r_on = plant.axes[args.axis - 1].r_on if args.r_on is None else args.r_on
    voltage = plant.bus.u_source if args.voltage is None else args.voltage
    return Limits(voltage, args.current, args.speed_max, args.turns_max, args.energy_max, r_on)


def _prepare(axis: int, load: float, locked: bool, board: Board) -> None:
    board.set_load(axis, load)
    if locked:
        board.lock_shaft(axis)


def _report(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _run(args: argparse.Namespace) -> int:
    plant = PlantConfig.load(args.plant)
    base = servo_table(args.config or SERVO_TOML)
    if args.trials is not None:
        return _trials(args, plant, base)
    limits, axis = _limits(args, plant), args.axis - 1
    if args.recording is not None:
        try:
            log = MeasurementLog.load(args.recording)
            problem = str(log.notes.get("problem", ""))
        except MeasurementError as error:
            raise ValueError(str(error)) from None
        limits = Limits(**log.notes["limits"])
    else:
        real = plant
        if args.motor is not None:
            real, limits = random_case(plant, axis, limits, args.seed, args.motor)
        log, problem = measure_virtual(
            real,
            axis,
            limits,
            base,
            level=chosen_level(args.level, default=FAST_LEVEL),
            seed=args.seed,
            prepare=functools.partial(_prepare, axis, args.load, args.locked),
            report=_report,
        )
        log.notes["problem"] = problem
        if log.recordings:  # else that of an earlier measurement stays
            log.save(args.out / "measurement.npz")
    model = args.model or (
        DETAILED_MODEL if args.recording is not None else chosen_level(args.level, default=FAST_LEVEL)
    )
    result = identified(log, plant, problem, refined=not args.no_refinement, level=model, report=_report)
    return _write(args, result, plant, base, limits)


def _write(
    args: argparse.Namespace, result: Identified, plant: PlantConfig, base: Mapping[str, Any], limits: Limits
) -> int:
    args.out.mkdir(parents=True, exist_ok=True)
    problems, lines = [str(one) for one in result.problems], []
    if not problems:
        table, found = tuned_table(base, result, limits)
        lines = list(found)
        if table is None:
            problems += lines
        else:
            write_servo(args.out / "servo.toml", table)
        write_plant(args.out / "plant.toml", result, plant)
    else:
        for name in ("plant.toml", "servo.toml"):
            (args.out / name).unlink(missing_ok=True)  # files of a previous run
    write_estimates(args.out / "estimates.json", result, lines)
    if result.log.recordings:
        draw(args.out / "identify.png", result)
    if args.json:
        print((args.out / "estimates.json").read_text(encoding="utf-8"), end="")
    else:
        print(f"{axis_name(result.log.axis)}, {result.log.notes.get('seconds', result.log.seconds):.1f} s of the board")
        print("\n".join([*report_lines(result), *lines]))
    for problem in problems:
        print(f"servo-sim: {problem}", file=sys.stderr)
    return 1 if problems else 0


def _trials(args: argparse.Namespace, plant: PlantConfig, base: Mapping[str, Any]) -> int:
    level = chosen_level(args.level, default=FAST_LEVEL)
    work = Trials(plant, base, args.axis - 1, _limits(args, plant), level, args.seed, not args.no_refinement)

    def entry_of(number: int, trial: Trial) -> dict[str, object]:
        return {"motor": number, **dataclasses.asdict(trial)}

    file = args.out / "trials.json"
    found, text = run_to_file(Runner.of(args), work, args.trials, "identify, motors", file, entry_of)
    print(text if args.json else "\n".join(summary(found)))
    return 1 if any(trial.false_success for _, trial in found) else 0
