"""A virtual board at level ``ideal`` compiled for another simulator (``native/exported``), doc/coupling.md."""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import AXES, Catalogue, Variable, axis_name
from servo_msgs_py.quantity import Quantity

from servo_twin._board_pointers import write_pointers
from servo_twin._build_native import (
    CFLAGS,
    COMPILER,
    EXTRA,
    FIRMWARE,
    IDEAL,
    NATIVE,
    OPTIONS,
    WARNINGS,
    board_files,
    build_identity,
)
from servo_twin.board import Board
from servo_twin.board_memory import SimulationError
from servo_twin.plant import AxisPlant, BusPlant, PinsPlant, PlantConfig, quantities
from servo_twin.servo_config import ServoConfig
from servo_twin.truth import QUANTITIES as TRUTH

_BOOT: Final = 0.03  # until the parameters of the firmware have their values [s]

_WRITTEN: Final = ("enable", "mode", "position", "speed", "i_q", "quick_stop", "clear_faults", "home")
"""Commands that are inputs."""

_TIMEOUT: Final = "param.command_timeout"
_PASSWORDS: Final = 3  # levels of access in board_servo_config_t
_BLOCK: Final = 1000
_BLOCKS: Final = {"input": 1, "firmware": 2, "truth": 3, "plant": 5, "bus": 7}  # EXPORTED_* in exported_board.h
_INPUTS: Final = (
    ("torque", "N m", "external torque on the shaft, positive in the direction of positive motion"),
    ("locked", "", "1: the shaft is locked"),
    ("motor_unplugged", "", "1: the motor cable is disconnected"),
    ("encoder_unplugged", "", "1: the encoder is disconnected"),
)
_FAULTS: Final = (
    *((f"fault.open_phase_{p}", "", f"1: phase {p} is open", "BOARD_OPEN_PHASE", k) for k, p in enumerate("abc")),
    *(
        (f"fault.glitches_{p}", "1/s", f"rate of pulses on encoder line {p}", "BOARD_ENCODER_GLITCHES", k)
        for k, p in enumerate("ab")
    ),
    ("fault.current_noise", "A", "standard deviation of a current sample, 0: of the plant", "BOARD_CURRENT_NOISE", 0),
    ("fault.heat", "deg C", "temperature at which the power stage is held, 0: free", "BOARD_HEAT", 0),
    *(
        (f"fault.cut_{p}", "", f"1: the wire of the pin {p} is cut", "BOARD_CUT_WIRE", f"BOARD_PIN_{p.upper()}")
        for p in ("home", "limit_min", "limit_max", "enable", "brake")
    ),
)
"""Inputs behind `_INPUTS`, each 0 without the fault: name, unit, description, kind and part of a ``board_fault_t``."""


@dataclass(frozen=True)
class ExportedVariable:
    """A quantity behind a value reference of ``exported_board.h``."""

    name: str
    reference: int
    causality: str  # input, output, parameter
    quantity: Quantity  # its range is that of a parameter
    start: float | None = None  # of inputs and parameters


@dataclass(frozen=True)
class _Element:
    """An element of a variable of the firmware."""

    name: str
    address: int
    variable: Variable
    causality: str  # input, parameter, output
    start: float
    initial: bool  # written at the start

    def row(self) -> str:
        flags = ", ".join(str(int(f)) for f in (self.variable.format.signed, self.causality != "output", self.initial))
        size, lsb = self.variable.element_size, float(self.variable.lsb)
        return f'    {{"{self.name}", {self.address}u, {size}u, {lsb!r}, {self.start!r}, {flags}}},\n'


def _elements(board: Board) -> Iterator[_Element]:
    """Set-points that are inputs, parameters of the firmware, then the snapshot and the results of homing."""
    catalogue = board.catalogue
    inputs = [catalogue[_TIMEOUT], *(catalogue[f"cmd.{name}"] for name in _WRITTEN)]
    tunable = [variable for variable in parameters(catalogue) if variable.name != _TIMEOUT]
    outputs = [*catalogue.snapshot_variables(), *(catalogue[f"{axis_name(k)}.home_result"] for k in range(AXES))]
    for variable, causality in [
        *((one, "input") for one in inputs),
        *((one, "parameter") for one in tunable),
        *((one, "output") for one in outputs),
    ]:
        address = board.address(variable.name)
        words = board.read_words(variable.name)
        for k in range(variable.count):
            yield _Element(
                variable.name if variable.count == 1 else f"{axis_name(k)}.{variable.name}",
                address + k * variable.element_size,
                variable,
                causality,
                words[k] * float(variable.lsb) if causality == "parameter" else 0.0,
                variable.name == _TIMEOUT,
            )


class _Number(NamedTuple):
    """A number of a structure of ``board.h``."""

    name: str
    value: float
    valid: Quantity


def _parameters(values: Mapping[str, Any], *parts: type) -> list[_Number]:
    """Numbers of a structure, which contains these parts of the plant, in the order of the memory."""
    known = {name: one for part in parts for name, one in quantities(part).items()}
    return [
        _Number(f"{name}_{k}" if isinstance(value, Sequence) else name, number, known[name])
        for name, value in values.items()
        for k, number in enumerate(_listed(value))
    ]


def _ranges_text(name: str, parameters: Sequence[_Number]) -> str:
    """Array of ``range_t`` for C."""

    def row(one: _Number) -> str:
        bounds = ", ".join(repr(bound).replace("inf", "INFINITY") for bound in (one.valid.minimum, one.valid.maximum))
        return f'    {{"{one.name}", {bounds}, {int(one.valid.whole)}}},\n'

    return f"static const range_t {name}[] = {{\n{''.join(map(row, parameters))}}};\n\n"


def _listed(value: Any) -> list[float]:
    """A number, or several, of a structure of ``board.h``."""
    return list(map(float, value)) if isinstance(value, Sequence) else [float(value)]


def _c_members(values: Mapping[str, Any]) -> str:
    """Initialiser of such a structure."""

    def text(value: Any) -> str:
        numbers = ", ".join(repr(number).replace("inf", "INFINITY") for number in _listed(value))
        return f"{{{numbers}}}" if isinstance(value, Sequence) else numbers

    return ", ".join(f".{name} = {text(value)}" for name, value in values.items())


def _axis_parameters(plant: PlantConfig, axis: int) -> list[_Number]:
    return _parameters(plant.axes[axis].members(), AxisPlant, PinsPlant)


def _bus_parameters(plant: PlantConfig) -> list[_Number]:
    return _parameters(vars(plant.bus), BusPlant)


def _servo_text(servo: ServoConfig | None) -> str:
    """``exported_servo``, the configuration of the firmware, for C."""
    if servo is None:
        return "static const board_servo_config_t *const exported_servo = NULL; /* that of the firmware */\n\n"

    def members(axis: int) -> str:
        return ", ".join(map(str, servo.blocks[axis]))

    def digest(level: int) -> str:
        return ", ".join(map(str, servo.passwords.get(level, bytes(1))))

    blocks = "".join(f"static const int32_t servo_axis{k}[] = {{{members(k)}}};\n" for k in range(AXES))
    places = ", ".join(f"servo_axis{k}" for k in range(AXES))
    fields = "".join(f"    .{name} = {value},\n" for name, value in servo.board.items())
    passwords = ", ".join(f"{{{digest(level)}}}" for level in range(_PASSWORDS))
    return (
        f"{blocks}static const board_servo_config_t given_servo = {{\n    .member = {{{places}}},\n{fields}"
        f"    .password = {{{passwords}}},\n}};\n"
        "static const board_servo_config_t *const exported_servo = &given_servo;\n\n"
    )


def _fault_names() -> str:
    return ", ".join(f'[{flag.bit}] = "{flag.name}"' for flag in Catalogue.load().flags["faults"])


def _header(
    plant: PlantConfig,
    servo: ServoConfig | None,
    seed: int,
    elements: Sequence[_Element],
    points: int,
    names: str,
    token: str,
) -> str:
    """Text of ``exported_variables.h``."""
    faults = ", ".join(f"{{{kind}, {part}}}" for *_, kind, part in _FAULTS)
    axes = ",\n        ".join(f"{{{_c_members(axis.members())}}}" for axis in plant.axes)
    return (
        f'#define INSTANTIATION_TOKEN "{token}"\n#define EXPORT_TOKEN UINT64_C(0x{token[:16]})\n\n'
        "typedef struct {\n    const char *name;\n    uint32_t address;\n    uint16_t size; /* [bytes] */\n"
        "    double lsb, start;\n"
        "    bool is_signed, writable, initial;\n} firmware_value_t;\n\n"
        f"static const uint32_t points_address = {points}u;\n\n"
        f"static const firmware_value_t firmware_values[] = {{\n{''.join(e.row() for e in elements)}}};\n\n"
        "typedef struct {\n    const char *name;\n    double minimum, maximum;\n    bool whole;\n} range_t;\n\n"
        f"{_ranges_text('axis_ranges', _axis_parameters(plant, 0))}{_ranges_text('bus_ranges', _bus_parameters(plant))}"
        "typedef struct {\n    int kind, part;\n} axis_fault_t;\n\n"
        f"static const axis_fault_t axis_faults[] = {{{faults}}};\n\n"
        f"static const board_config_t exported_config = {{\n    .axis = {{{axes}}},\n"
        f"    .bus = {{{_c_members(vars(plant.bus))}}},\n    .pwm_frequency = {plant.pwm_frequency!r},\n"
        f"    .ambient = {plant.ambient!r},\n    .baud = 115200.0,\n    .seed = UINT64_C({seed}),\n}};\n\n"
        f"{_servo_text(servo)}"
        f"static const char *const fault_names[] = {{{_fault_names()}}};\n\n"
        f"static const exported_variable_t exported_names[] = {{\n{names}}};\n"
    )


def _variables(plant: PlantConfig, elements: Sequence[_Element]) -> Iterator[ExportedVariable]:
    def reference(block: str, index: int, axis: int = 0) -> int:
        return (_BLOCKS[block] + axis) * _BLOCK + index

    inputs = [*_INPUTS, *((name, unit, text) for name, unit, text, *_ in _FAULTS)]
    for axis in range(AXES):
        for k, (name, unit, text) in enumerate(inputs):
            start = -plant.axes[axis].load_torque if name == "torque" else 0.0
            index = reference("input", axis * len(inputs) + k)
            yield ExportedVariable(f"{axis_name(axis)}.{name}", index, "input", Quantity(unit=unit, text=text), start)
    index = reference("input", AXES * len(inputs))
    source = Quantity(unit="V", text="open-circuit voltage of the supply")
    yield ExportedVariable("supply.u_source", index, "input", source, plant.bus.u_source)
    for k, e in enumerate(elements):
        given = None if e.causality == "output" else e.start
        quantity = Quantity(unit=e.variable.unit, text=e.variable.text)  # the firmware checks its range
        yield ExportedVariable(e.name, reference("firmware", k), e.causality, quantity, given)
    for axis in range(AXES):
        for k, (name, one) in enumerate(TRUTH.items()):
            index = reference("truth", k, axis)
            yield ExportedVariable(f"truth.{axis_name(axis)}.{name}", index, "output", one)
        for k, number in enumerate(_axis_parameters(plant, axis)):
            index = reference("plant", k, axis)
            yield _parameter(f"plant.{axis_name(axis)}", index, number)
    for k, number in enumerate(_bus_parameters(plant)):
        yield _parameter("plant.bus", reference("bus", k), number)


def _parameter(part: str, reference: int, number: _Number) -> ExportedVariable:
    return ExportedVariable(f"{part}.{number.name}", reference, "parameter", number.valid, number.value)


def _names(variables: Sequence[ExportedVariable]) -> str:
    """Rows of ``exported_variable_t`` for C."""

    def row(one: ExportedVariable) -> str:
        return f'    {{"{one.name}", {one.reference}u, {int(one.causality != "output")}}},\n'

    return "".join(map(row, variables))


@dataclass(frozen=True)
class ExportedBoard:
    """A compiled board: its quantities, the shared library, and the files that it was made from."""

    variables: Sequence[ExportedVariable]
    token: str
    library: Path
    files: Sequence[Path]
    headers: Sequence[Path]


@contextmanager
def exported_board(
    name: str,
    shell: Sequence[Path],
    plant: PlantConfig | None,
    servo: ServoConfig | None,
    seed: int,
    options: Sequence[str | Path] = (),
) -> Iterator[ExportedBoard]:
    """Compile a board for this machine; its files exist until the end of the context.

    Parameters
    ----------
    name : str
        Name of the library, without ending.
    shell : sequence of Path
        C files of the interface to the other simulator.
    plant : PlantConfig, optional
        Start values of the parameters; the packaged plant by default.
    servo : ServoConfig, optional
        Configuration of the firmware; that of ``firmware/config/servo.toml`` by default.
    seed : int
        Seed of all random numbers.
    options : sequence of str or Path
        Further options of the compiler.

    Raises
    ------
    SimulationError
        If there is no compiler, or it fails.
    OSError
        If the package is not in a checkout with the sources of the firmware.
    """
    plant = (plant or PlantConfig.load()).drawn(seed)
    with Board(plant, seed=seed, level="ideal", servo=servo) as board:
        board.run(_BOOT)
        elements, points = list(_elements(board)), board.address("cmd.points")
    variables = list(_variables(plant, elements))
    files, headers = board_files([*IDEAL, NATIVE / "exported" / "exported_board.c", *shell])
    with tempfile.TemporaryDirectory() as folder:
        generated = Path(folder)
        try:
            identity = build_identity([*files, *headers], [*OPTIONS, *EXTRA])
            pointers = write_pointers(IDEAL[0], [NATIVE, FIRMWARE], [], identity, generated)
            text = _header(plant, servo, seed, elements, points, _names(variables), identity)
            token = hashlib.sha256(text.encode()).hexdigest()[:32]
            header = generated / "exported_variables.h"
            text = _header(plant, servo, seed, elements, points, _names(variables), token)
            header.write_text(text, encoding="ascii")
            library = generated / f"{name}.so"
            include = [f"-I{folder}" for folder in (NATIVE, FIRMWARE, generated)]
            # Libraries are after the files that need them.
            _compile([*CFLAGS, *WARNINGS, *EXTRA, "-fPIC", "-shared", *include, *files, *options, "-lm", "-o", library])
        except FileNotFoundError as error:
            raise SimulationError(f"no program {error.filename}; install a C compiler") from None
        yield ExportedBoard(variables, token, library, files, [*headers, header, pointers])


def _compile(arguments: Sequence[str | Path]) -> None:
    done = subprocess.run([*COMPILER, *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SimulationError(f"the compiler failed: {done.stderr.strip()}")
