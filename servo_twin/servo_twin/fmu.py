"""Export of a virtual board at level ``ideal`` as FMI 3.0 co-simulation (``native/fmu/fmu.c``), doc/coupling.md."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

from servo_msgs_py.board_parameters import parameters
from servo_msgs_py.catalogue import AXES, Variable, axis_name
from servo_msgs_py.output_file import write_file
from servo_msgs_py.quantity import FINITE, Quantity
from servo_msgs_py.units import PERIOD

from servo_twin._board_pointers import write_pointers
from servo_twin._build_native import COMPILER, EXTRA, FIRMWARE, IDEAL, NATIVE, OPTIONS, board_files, build_identity
from servo_twin.board import Board
from servo_twin.board_memory import SimulationError
from servo_twin.plant import AxisPlant, BusPlant, PinsPlant, PlantConfig, quantities
from servo_twin.truth import QUANTITIES as TRUTH

MODEL: Final = "servo_board"
_BOOT: Final = 0.03  # until the parameters of the firmware have their values [s]

_WRITTEN: Final = ("enable", "mode", "position", "speed", "i_q", "quick_stop", "clear_faults", "home")
"""Commands that are inputs."""

_TIMEOUT: Final = "param.command_timeout"
_BLOCK: Final = 1000
_BLOCKS: Final = {"input": 1, "firmware": 2, "truth": 3, "plant": 5, "bus": 7}  # REFERENCE_* in fmu.c
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

# Exponents of kg, m, s, A, K, rad; offset of deg C.
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "s": {"s": 1},
    "A": {"A": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "V s": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
    "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "J/K": {"kg": 1, "m": 2, "s": -2, "K": -1},
    "K/W": {"kg": -1, "m": -2, "s": 3, "K": 1},
    "1/K": {"K": -1},
    "1/s": {"s": -1},
    "kg m^2": {"kg": 1, "m": 2},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "N m s": {"kg": 1, "m": 2, "s": -1},
    "N m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "deg C": {"K": 1, "offset": 273.15},
}


@dataclass(frozen=True)
class _Variable:
    """A variable of the FMU."""

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
    """Set-points that are inputs, parameters of the firmware, then the variables of the snapshot."""
    catalogue = board.catalogue
    inputs = [catalogue[_TIMEOUT], *(catalogue[f"cmd.{name}"] for name in _WRITTEN)]
    tunable = [variable for variable in parameters(catalogue) if variable.name != _TIMEOUT]
    snapshot = catalogue.snapshot_variables()
    for variable, causality in [
        *((one, "input") for one in inputs),
        *((one, "parameter") for one in tunable),
        *((one, "output") for one in snapshot),
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


def _header(plant: PlantConfig, seed: int, elements: Sequence[_Element], token: str) -> str:
    """Text of ``fmu_variables.h``."""
    faults = ", ".join(f"{{{kind}, {part}}}" for *_, kind, part in _FAULTS)
    axes = ",\n        ".join(f"{{{_c_members(axis.members())}}}" for axis in plant.axes)
    return (
        f'#define INSTANTIATION_TOKEN "{token}"\n#define EXPORT_TOKEN UINT64_C(0x{token[:16]})\n\n'
        "typedef struct {\n    const char *name;\n    uint32_t address;\n    uint16_t size; /* [bytes] */\n"
        "    double lsb, start;\n"
        "    bool is_signed, writable, initial;\n} firmware_value_t;\n\n"
        f"static const firmware_value_t firmware_values[] = {{\n{''.join(e.row() for e in elements)}}};\n\n"
        "typedef struct {\n    const char *name;\n    double minimum, maximum;\n    bool whole;\n} range_t;\n\n"
        f"{_ranges_text('axis_ranges', _axis_parameters(plant, 0))}{_ranges_text('bus_ranges', _bus_parameters(plant))}"
        "typedef struct {\n    int kind, part;\n} axis_fault_t;\n\n"
        f"static const axis_fault_t axis_faults[] = {{{faults}}};\n\n"
        f"static const board_config_t exported_config = {{\n    .axis = {{{axes}}},\n"
        f"    .bus = {{{_c_members(vars(plant.bus))}}},\n    .pwm_frequency = {plant.pwm_frequency!r},\n"
        f"    .ambient = {plant.ambient!r},\n    .baud = 115200.0,\n    .seed = UINT64_C({seed}),\n}};\n"
    )


def _variables(plant: PlantConfig, elements: Sequence[_Element]) -> Iterator[_Variable]:
    def reference(block: str, index: int, axis: int = 0) -> int:
        return (_BLOCKS[block] + axis) * _BLOCK + index

    inputs = [*_INPUTS, *((name, unit, text) for name, unit, text, *_ in _FAULTS)]
    for axis in range(AXES):
        for k, (name, unit, text) in enumerate(inputs):
            start = -plant.axes[axis].load_torque if name == "torque" else 0.0
            index = reference("input", axis * len(inputs) + k)
            yield _Variable(f"{axis_name(axis)}.{name}", index, "input", Quantity(unit=unit, text=text), start)
    index = reference("input", AXES * len(inputs))
    source = Quantity(unit="V", text="open-circuit voltage of the supply")
    yield _Variable("supply.u_source", index, "input", source, plant.bus.u_source)
    for k, e in enumerate(elements):
        given = None if e.causality == "output" else e.start
        quantity = Quantity(unit=e.variable.unit, text=e.variable.text)  # the firmware checks its range
        yield _Variable(e.name, reference("firmware", k), e.causality, quantity, given)
    for axis in range(AXES):
        for k, (name, one) in enumerate(TRUTH.items()):
            index = reference("truth", k, axis)
            yield _Variable(f"truth.{axis_name(axis)}.{name}", index, "output", one)
        for k, number in enumerate(_axis_parameters(plant, axis)):
            index = reference("plant", k, axis)
            yield _parameter(f"plant.{axis_name(axis)}", index, number)
    for k, number in enumerate(_bus_parameters(plant)):
        yield _parameter("plant.bus", reference("bus", k), number)


def _parameter(part: str, reference: int, number: _Number) -> _Variable:
    return _Variable(f"{part}.{number.name}", reference, "parameter", number.valid, number.value)


def _description(variables: Sequence[_Variable], token: str) -> bytes:
    """Text of ``modelDescription.xml``."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName="servo board",
        instantiationToken=token,
        description="Dual-axis servo: firmware, ideal chip and averaged plant",
        generationTool="servo-sim export",
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=MODEL,
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=repr(PERIOD),
    )
    units = ET.SubElement(root, "UnitDefinitions")
    for unit, exponents in _UNITS.items():
        base = {name: str(value) for name, value in exponents.items()}
        ET.SubElement(ET.SubElement(units, "Unit", name=unit), "BaseUnit", base)
    ET.SubElement(root, "DefaultExperiment", stepSize=repr(16 * PERIOD))
    listed = ET.SubElement(root, "ModelVariables")
    ET.SubElement(listed, "Float64", name="time", valueReference="0", causality="independent", variability="continuous")
    for v in variables:
        attributes = {"name": v.name, "valueReference": str(v.reference), "causality": v.causality}
        fixed = v.name.startswith("plant.")
        attributes["variability"] = "fixed" if fixed else "tunable" if v.causality == "parameter" else "discrete"
        if v.quantity.unit in _UNITS:
            attributes["unit"] = v.quantity.unit
        for bound, value in (("min", v.quantity.minimum), ("max", v.quantity.maximum)):
            if abs(value) < FINITE:
                attributes[bound] = repr(value)
        if v.start is not None:
            attributes["start"] = repr(v.start).replace("inf", "INF")
        ET.SubElement(listed, "Float64", {**attributes, "description": v.quantity.text})
    structure = ET.SubElement(root, "ModelStructure")
    for kind in ("Output", "InitialUnknown"):
        for v in variables:
            if v.causality == "output":
                ET.SubElement(structure, kind, valueReference=str(v.reference))
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _build_description(files: Sequence[str], folders: Sequence[str]) -> bytes:
    """Text of ``buildDescription.xml``: the sources in the FMU."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    options = " ".join(OPTIONS)
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=MODEL, description=options)
    listed = ET.SubElement(build, "SourceFileSet", language="C99", compilerOptions=options)
    for name in files:
        ET.SubElement(listed, "SourceFile", name=name)
    for name in folders:
        ET.SubElement(listed, "IncludeDirectory", name=name)
    ET.SubElement(build, "Library", name="m")
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def export_fmu(path: Path, plant: PlantConfig | None = None, seed: int = 1) -> None:
    """Compile a board for this machine and write it as FMU, its sources included.

    Parameters
    ----------
    path : Path
        File to be written.
    plant : PlantConfig, optional
        Start values of the parameters; the packaged plant by default.
    seed : int
        Seed of all random numbers.

    Raises
    ------
    SimulationError
        If there is no compiler, or it fails.
    OSError
        If the package is not in a checkout with the sources of the firmware, or the file cannot be written.
    """
    plant = (plant or PlantConfig.load()).drawn(seed)
    with Board(plant, seed=seed, level="ideal") as board:
        board.run(_BOOT)
        elements = list(_elements(board))
    files, headers = board_files([*IDEAL, NATIVE / "fmu" / "fmu.c"])
    with tempfile.TemporaryDirectory() as name:
        generated = Path(name)
        try:
            identity = build_identity([*files, *headers], [*OPTIONS, *EXTRA])
            pointers = write_pointers(IDEAL[0], [NATIVE, FIRMWARE], [], identity, generated)
            token = hashlib.sha256(_header(plant, seed, elements, identity).encode()).hexdigest()[:32]
            header = generated / "fmu_variables.h"
            header.write_text(_header(plant, seed, elements, token), encoding="ascii")
            library = _compiled(files, generated)
        except FileNotFoundError as error:
            raise SimulationError(f"no program {error.filename}; install a C compiler") from None
        description = _description(list(_variables(plant, elements)), token)
        write_file(path, lambda stream: _pack(stream, description, library, files, [*headers, header, pointers]))


def _compiled(files: Sequence[Path], generated: Path) -> Path:
    """Shared library of the C files."""
    library = generated / f"{MODEL}.so"
    include = [f"-I{folder}" for folder in (NATIVE, FIRMWARE, generated)]
    command = [*COMPILER, *OPTIONS, *EXTRA, "-fPIC", "-shared", *include, *files, "-lm", "-o", library]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SimulationError(f"the compiler failed: {done.stderr.strip()}")
    return library


def _pack(stream: IO[bytes], description: bytes, library: Path, files: Sequence[Path], headers: Sequence[Path]) -> None:
    """Write the file of an FMU: description, binary, and sources at the places that they have in a checkout."""
    root = FIRMWARE.parent
    folders = [str(NATIVE.relative_to(root)), str(FIRMWARE.relative_to(root)), "generated"]
    places = {
        file: f"{file.relative_to(root)}" if file.is_relative_to(root) else f"generated/{file.name}"
        for file in [*files, *headers]
    }
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as fmu:
        fmu.writestr("modelDescription.xml", description)
        fmu.write(library, f"binaries/{platform.machine()}-{platform.system().lower()}/{library.name}")
        fmu.writestr("sources/buildDescription.xml", _build_description([places[file] for file in files], folders))
        for file, place in places.items():
            fmu.write(file, f"sources/{place}")
