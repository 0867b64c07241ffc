"""``servo-tool identify``: identify the motor of an axis; the shaft moves."""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
from dataclasses import fields
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Final

from servo_measurement.access import MeasurementError
from servo_measurement.estimation import estimates_of
from servo_measurement.log import MeasurementLog
from servo_measurement.motor_test import MotorTest
from servo_measurement.motor_values import Limits
from servo_msgs_py.axis_config import AxisConfigError, AxisConfigTable
from servo_msgs_py.axis_config_transfer import BlockRefusedError
from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.runtime.program import Interrupted, complain, deferred
from servo_msgs_py.text_file import TextFileError, read_toml
from servo_msgs_py.units import PERIOD_NS
from servo_tuning.errors import ConfigError
from servo_tuning.reading import SERVO_TOML, complete, read_table

from servo_bridge.freemaster.errors import FreemasterError
from servo_bridge.measurement_access import measurement_access
from servo_bridge.tool_values import UsageError
from servo_bridge.tuning.plan import computed, read_blocks
from servo_bridge.wire.session_port import SessionPort
from servo_msgs_py import argument

if TYPE_CHECKING:
    from servo_bridge.tool_commands import Context

_OUT: Final = "out/identify"
_RECORDING: Final = "measurement.npz"
ESTIMATES: Final = "estimates.json"
PICTURE: Final = "identify.png"
"""Files of the evaluation by the twin."""
_MACHINE: Final = ("pins.", "stop.disable", "stop.quick_stop", "stop.shorted", "stop.ramp", "stop.hold", "heat.")
"""Members that depend on the machine and not on its motor."""


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    command.add_argument("--axis", type=int, choices=range(1, AXES + 1), default=1, help="default: %(default)s")
    add_limits(command)
    command.add_argument(
        "--out", type=argument.output_folder, default=_OUT, metavar="FOLDER", help="default: %(default)s"
    )


def add_limits(command: argparse.ArgumentParser) -> None:
    """Add the limits of the test, and the files with what it does not find."""
    command.add_argument("--voltage", type=argument.positive, required=True, help="voltage of the bus [V]")
    command.add_argument("--current", type=argument.positive, required=True, help="permitted motor current [A, peak]")
    defaults = {field.name: field.default for field in fields(Limits)}
    for name, text in (
        ("speed", "largest speed [rad/s]"),
        ("turns", "largest rotation of the shaft in each direction [turns]"),
        ("energy", "permitted braking energy returned to the bus [J]"),
    ):
        command.add_argument(
            f"--{name}-max", type=argument.positive, default=defaults[name], help=f"{text} (default: %(default)s)"
        )
    command.add_argument(
        "--r-on",
        type=argument.not_negative,
        default=0.0,
        help="on resistance of a switch [ohm]; if omitted it is part of r_s",
    )
    command.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="servo.toml with all other entries (default: the one of the checkout)",
    )
    command.add_argument(
        "--plant",
        type=Path,
        metavar="FILE",
        help="plant.toml with the values of the other axis (default: packaged)",
    )


def check(args: argparse.Namespace) -> None:
    """Check the limits, and read the configuration with all other entries."""
    path = args.config or SERVO_TOML
    if not path.is_file():
        raise UsageError(f"no such file: {path}; write --config with the servo.toml of this board")
    try:
        args.limits = Limits(args.voltage, args.current, args.speed_max, args.turns_max, args.energy_max, args.r_on)
    except ValueError as error:
        raise UsageError(str(error)) from None
    try:
        args.base = read_table(path)
        complete(args.base, Catalogue.load())
        if args.plant is not None:
            path = args.plant
            read_toml(path)  # its entries are known to the twin, which evaluates the measurement
    except (ConfigError, TextFileError) as error:
        raise UsageError(f"{path}: {error}") from None


def identify(context: Context) -> int:
    """Test the motor, save the measurement and evaluate it."""
    args = context.args
    try:
        if args.config is None:
            _refuse_other_machine(context, SERVO_TOML)
        log, problem, signalled = _measured(context, args.limits)
    except (MeasurementError, ConfigError, ValueError) as error:
        print(f"servo-tool: {error}", file=sys.stderr)
        return 1
    path = args.out / _RECORDING
    if log.recordings:  # else that of an earlier measurement stays
        log.save(path)
        print(f"wrote {path}", file=sys.stderr)
    if signalled or not log.recordings:
        print(f"servo-tool: {problem}", file=sys.stderr)
        return signalled or 1
    if _twin_installed():
        return _evaluated(args, path)
    return _shown(log, problem)


def _measured(context: Context, limits: Limits) -> tuple[MeasurementLog, str, int]:
    """Return the measurement, the reason if it is incomplete, and the exit status of a signal, else 0."""
    problem, signalled = "", 0
    with deferred() as stop, measurement_access(context.session, stop.check) as access:
        test = MotorTest(access, context.args.axis - 1, limits, context.args.base, complain)
        begin = access.read("tick")[0]
        try:
            test.run()
        except Interrupted as interruption:
            problem, signalled = f"ended by {interruption}", interruption.status
        except FreemasterError as error:
            problem = f"the line has failed: {error}"
        except (MeasurementError, BlockRefusedError, AxisConfigError) as error:
            problem = str(error)
        if test.restoring_text and test.restoring_text not in problem:
            problem += f"; {test.restoring_text}"
        test.log.notes["problem"] = problem
        with contextlib.suppress(FreemasterError):
            test.log.notes["seconds"] = ((access.read("tick")[0] - begin) % 2**32) * PERIOD_NS * 1e-9
    return test.log, problem, signalled


def _refuse_other_machine(context: Context, path: Path) -> None:
    """Refuse the default file if the board has other pins or stops."""
    blocks = computed(path, context.catalogue).blocks
    for axis, block in read_blocks(SessionPort(context.session)).items():
        other = [
            member.name
            for member in AxisConfigTable.load().changes(block, blocks[axis])
            if member.name.startswith(_MACHINE)
        ]
        if other:
            raise ConfigError(
                f"{axis_name(axis)} of the board has another {', '.join(other)} than {path}; "
                "write --config with the servo.toml of this board"
            )


def _twin_installed() -> bool:
    try:
        metadata.distribution("servo_twin")
    except metadata.PackageNotFoundError:
        return False
    return True


def _evaluated(args: argparse.Namespace, path: Path) -> int:
    """Refine the values and write the files by the twin, in a separate process."""
    command = [sys.executable, "-m", "servo_twin.cli", "identify", "--recording", str(path), "--out", str(args.out)]
    for option in ("config", "plant"):
        if (file := getattr(args, option)) is not None:
            command += [f"--{option}", str(file)]
    return subprocess.run(command, check=False).returncode


def _shown(log: MeasurementLog, problem: str) -> int:
    """Print the closed-form estimates only."""
    found = estimates_of(log)
    print("\n".join(found.lines()))
    reasons = [problem] if problem else [f"{name}: {reason}" for name, reason in found.undetermined.items()]
    for reason in reasons:
        print(f"servo-tool: {reason}", file=sys.stderr)
    print("servo-tool: install servo_twin for the refinement, a plant file and servo.toml", file=sys.stderr)
    return 1 if reasons else 0
