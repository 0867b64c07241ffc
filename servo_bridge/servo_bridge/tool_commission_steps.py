"""The steps of a commissioning, in their order."""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from servo_measurement.access import MeasurementError
from servo_measurement.bode import measure
from servo_measurement.bode_plan import BodeRequest
from servo_measurement.frequency_response import Measured
from servo_measurement.motor_values import Limits
from servo_measurement.position_move import OVERSHOOT_MAX, TOLERANCE
from servo_msgs_py.axis_config import AxisConfigError
from servo_msgs_py.axis_config_transfer import BlockRefusedError, take_blocks
from servo_msgs_py.board_storage import StorageRefusedError, execute_request, success_text
from servo_msgs_py.catalogue import axis_name
from servo_msgs_py.run_file.virtual_board_file import read_virtual_board
from servo_msgs_py.runtime.program import deferred
from servo_msgs_py.text_file import parse_json, read_text
from servo_msgs_py.units import PERIOD

from servo_bridge import tool_bode, tool_identify
from servo_bridge.commissioning import checks
from servo_bridge.commissioning.figure import Figure
from servo_bridge.commissioning.pack import Done
from servo_bridge.commissioning.recorded_move import DURATION, RECORDING, MoveError, move_and_back
from servo_bridge.freemaster.errors import FreemasterError
from servo_bridge.measurement_access import SessionAccess, measurement_access
from servo_bridge.tool_commands import Context
from servo_bridge.tool_measurement import measured
from servo_bridge.tuning.plan import Plan, computed, read_blocks
from servo_bridge.wire.session_port import SessionPort

CONFIG, PLANT = "servo.toml", "plant.toml"
_CROSSOVER: Final = 0.3  # tolerance of a measured crossover against its prediction, relative
_PHASE_MIN: Final = 30.0  # phase margin [degrees]
_GAIN_MIN: Final = 2.0  # gain margin


class StepError(Exception):
    """A step was not possible; the text has the reason."""


@dataclass(frozen=True)
class Subject:
    """What is commissioned, and with which files."""

    context: Context  # session with the board
    axis: int  # index
    limits: Limits  # of the user
    base: Mapping[str, Any]  # parsed servo.toml with all other entries
    config: Path | None  # its file; None: the one of the checkout
    plant: Path | None  # plant.toml with the values of the other axis; None: the packaged one
    folder: Path  # of the pack
    ask: Callable[[str], str] | None  # asks a question at the terminal; None: every step is confirmed (--yes)

    @property
    def name(self) -> str:
        return axis_name(self.axis)

    @property
    def port(self) -> SessionPort:
        return SessionPort(self.context.session)

    @property
    def virtual(self) -> bool:
        """Whether the board is a virtual one."""
        return read_virtual_board(self.context.port) is not None

    def measured(self, function: Callable[[SessionAccess], Any]) -> Any:
        """Result of a measurement; a signal ends it."""
        with deferred() as stop, measurement_access(self.context.session, stop.check) as access:
            return function(access)


@dataclass(frozen=True)
class Step:
    """One step."""

    name: str
    about: Callable[[Subject], str]  # what it does and needs, for the user
    run: Callable[[Subject], Done]
    confirmed: bool = False
    """The shaft moves or the data flash is written: the user has to agree, and the result is kept on a continuation."""


# ---- outputs off ----------------------------------------------------------------------------------------------------


def _board(subject: Subject) -> Done:
    info = subject.context.session.info
    texts = [f"{info.name} {info.version}, built {info.build}; the table of variables matches"]
    return Done(subject.measured(partial(checks.board, real=not subject.virtual)), texts)


def _supply(subject: Subject) -> Done:
    cleared = subject.measured(lambda access: checks.clear_faults(access, subject.axis))
    figures = subject.measured(lambda access: checks.supply(access, subject.axis, subject.limits.voltage))
    return Done(figures, [f"faults before: {', '.join(cleared)}"] if cleared else [])


def _pins(subject: Subject) -> Done:
    names = subject.measured(lambda access: checks.pins(access, subject.axis))
    text = f"active inputs: {', '.join(names) or 'none'}"
    if subject.ask is not None and subject.ask(f"{text}. Is that right? [Enter: yes, n: no] ").strip():
        raise StepError(f"{text}: change the wiring, or [{subject.name}.pins] of servo.toml")
    return Done(texts=[text])


def _encoder(subject: Subject) -> Done:
    figures = subject.measured(lambda access: checks.encoder(access, subject.axis))
    if subject.ask is None:
        return Done(figures, ["the shaft was not turned by hand"])
    before = subject.measured(_position(subject))
    if subject.ask("Turn the shaft by hand, one turn in the positive direction, then press Enter [s: skip] ").strip():
        return Done(figures, ["the shaft was not turned by hand"])
    return Done([*figures, *checks.turned(before, subject.measured(_position(subject)))])


def _position(subject: Subject) -> Callable[[SessionAccess], float]:
    return lambda access: access.read(f"{subject.name}.position")[0]


# ---- motor and controller -------------------------------------------------------------------------------------------


def _identify(subject: Subject) -> Done:
    args = argparse.Namespace(
        axis=subject.axis + 1,
        limits=subject.limits,
        base=subject.base,
        config=subject.config,
        plant=subject.plant,
        out=subject.folder,
    )
    if tool_identify.identify(replace(subject.context, args=args)):
        raise StepError("the motor is not identified; the reasons are above")
    document = parse_json(read_text(subject.folder / tool_identify.ESTIMATES))
    scale = subject.context.catalogue[f"{subject.name}.i_q"].maximum
    estimates = document["estimates"]
    motor = [Figure(name, one["value"], one["unit"]) for name, one in estimates.items() if name not in checks.OWN]
    return Done([*checks.identified(estimates, scale, PERIOD), *motor], pictures=[tool_identify.PICTURE])


def _tune(subject: Subject) -> Done:
    axis, limits, memory = subject.axis, subject.limits, subject.port
    blocks = computed(subject.folder / CONFIG, subject.context.catalogue).blocks
    plan = Plan(read_blocks(memory, [axis]), {axis: blocks[axis]})
    if plan.axes:
        print("\n".join(plan.table()))
        plan.send(memory)
        take_blocks(memory, plan.axes)
    left = len(Plan(read_blocks(memory, [axis]), {axis: blocks[axis]}).axes)

    def limited(access: SessionAccess) -> list[Figure]:
        found = []
        for name, value, unit in (("i_q_limit", limits.current, "A"), ("speed_limit", limits.speed, "rad/s")):
            variable = access.catalogue[f"param.{name}"]
            access.write(variable.name, [min(value, variable.maximum)], axis)
            high = value + 0.5 * variable.lsb
            found.append(Figure(variable.name, access.read(variable.name)[axis], unit, high=high))
        return found

    return Done([Figure("blocks that differ from servo.toml", left, "", 0, 0), *subject.measured(limited)])


def _bode(loop: str, subject: Subject) -> Done:
    request = BodeRequest(subject.axis, loop, travel_max=math.tau * subject.limits.turns)
    result = measured(subject.context.session, partial(measure, request=request, enable=True))
    stem = tool_bode.write_files(result, subject.folder)
    predicted = result.prediction.margins
    remedy = "the identified motor values, or a load behind a spring (servo-tool resonance)"
    expected = predicted.crossover or 0.0
    ends = expected * (1.0 - _CROSSOVER), expected * (1.0 + _CROSSOVER)
    figures = [
        Figure("crossover", _value(result.figures.crossover), "Hz", *ends, remedy),
        Figure("phase margin", _value(result.figures.phase_margin), "degrees", _PHASE_MIN, remedy=remedy),
    ]
    gain = result.figures.gain_margin
    if gain is not None:  # else the phase does not reach 180 degrees within the band
        figures.append(Figure("gain margin", gain.value, "", _GAIN_MIN, remedy=remedy))
    return Done(figures, result.notes, [f"{stem}.png"])


def _value(measured: Measured | None) -> float:
    return math.nan if measured is None else measured.value


def _store(subject: Subject) -> Done:
    return Done(texts=[success_text("SAVE", execute_request(subject.port, "SAVE"))])


# ---- first move -----------------------------------------------------------------------------------------------------


def _distance(subject: Subject) -> float:
    return math.tau * min(1.0, subject.limits.turns)


def _move(subject: Subject) -> Done:
    context, folder = subject.context, subject.folder
    context.release()  # the bridge needs the port
    distance = _distance(subject)
    move_and_back(context.port, context.baud, subject.axis, distance, folder)
    steps = [
        step
        for step in _twin("steps", folder / RECORDING, "-o", folder / "steps.png")
        if step["axis"] == subject.name
        and step["quantity"] == "position"
        # the set-point also changes, little, when the rotor search ends
        and abs(step["commanded"] - step["begin"]) > 0.5 * distance
    ]
    figures = [Figure("moves in the recording", len(steps), "", 2, 2)]
    for number, step in enumerate(steps, 1):
        settling = math.nan if step["settling_time"] is None else step["settling_time"]
        figures += [
            Figure(f"move {number}: settled after", settling, "s"),
            Figure(f"move {number}: error at rest", step["error"], "rad", -TOLERANCE, TOLERANCE),
            Figure(f"move {number}: overshoot", step["overshoot"], "rad", 0.0, OVERSHOOT_MAX * distance),
            Figure(f"move {number}: largest error", step["tracking_max"], "rad"),
        ]
    # The plant of a virtual board is in the recording; that of a real one is what was identified.
    plant = () if subject.virtual else ("--plant", folder / PLANT)
    replayed = _twin("replay", folder / RECORDING, *plant, "-o", folder / "replay.json")
    return Done(figures, [f"replay on the twin: {replayed['verdict']}"], ["steps.png"])


def _twin(verb: str, *arguments: object) -> Any:
    """JSON document of a command of ``servo-twin``, in a separate process."""
    command = [sys.executable, "-m", "servo_twin.runs.command", verb, "--json", *map(str, arguments)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    try:
        return json.loads(done.stdout)
    except ValueError:
        raise StepError(done.stderr.strip() or f"servo-twin {verb} has failed ({done.returncode})") from None


def _what(text: str) -> Callable[[Subject], str]:
    return lambda subject: text.format(
        axis=subject.name,
        volts=subject.limits.voltage,
        amperes=subject.limits.current,
        speed=subject.limits.speed,
        turns=subject.limits.turns,
        distance=_distance(subject),
        duration=DURATION,
    )


STEPS: Final[Sequence[Step]] = (
    Step("board", _what("identification, time and error counters of the board; the outputs stay off"), _board),
    Step(
        "supply",
        _what("clears the faults of {axis}, and checks the bus voltage against {volts:g} V; the outputs stay off"),
        _supply,
    ),
    Step("pins", _what("the inputs of {axis}; the outputs stay off"), _pins),
    Step("encoder", _what("the encoder of {axis} at rest; the outputs stay off"), _encoder),
    Step(
        "identify",
        _what(
            "identification of the motor of {axis}, about 70 s: the shaft turns with at most {amperes:g} A, {speed:g} "
            "rad/s and {turns:g} turns in each direction. Remove the load and anything that the shaft could catch"
        ),
        _identify,
        confirmed=True,
    ),
    Step("tune", _what("servo.toml of the identified motor and the limits are written to {axis}"), _tune),
    Step(
        "bode current",
        _what("Bode plot of the current loop of {axis}: a current holds the rotor, which turns to it first"),
        partial(_bode, "current"),
        confirmed=True,
    ),
    Step(
        "bode speed",
        _what("Bode plot of the speed loop of {axis}: the shaft turns up to {turns:g} turns in each direction"),
        partial(_bode, "speed"),
        confirmed=True,
    ),
    Step(
        "store", _what("configuration and parameters are stored in the data flash of the board"), _store, confirmed=True
    ),
    Step(
        "move",
        _what(
            "a move of {axis} by {distance:.3g} rad in {duration:g} s and back, through servo_bridge, which records it"
        ),
        _move,
        confirmed=True,
    ),
)
"""All steps. Those that are not `confirmed` are repeated when a sequence is continued: they take a few seconds."""

FAILURES: Final = (
    StepError,
    MeasurementError,
    AxisConfigError,
    BlockRefusedError,
    StorageRefusedError,
    MoveError,
    FreemasterError,
    ValueError,
)
"""Errors of a step that end the sequence, with reason and remedy."""


def missing() -> str:
    """What a commissioning needs and is not installed; empty if everything is there."""
    needed: Mapping[str, str] = {
        "servo_twin": "servo_twin",
        "rclpy": "servo_msgs_py[ros]",
        "mcap": "servo_msgs_py[record]",
    }
    return ", ".join(package for module, package in needed.items() if importlib.util.find_spec(module) is None)
