"""Export of a virtual board as FMI 3.0 co-simulation (``native/fmu/fmu.c``), doc/coupling.md."""

from __future__ import annotations

import platform
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Final

from servo_msgs_py.output_file import write_file
from servo_msgs_py.quantity import FINITE
from servo_msgs_py.units import PERIOD

from servo_twin._build_native import FIRMWARE, NATIVE, OPTIONS
from servo_twin.exported_board import ExportedBoard, ExportedVariable, exported_board
from servo_twin.plant import PlantConfig
from servo_twin.servo_config import ServoConfig

MODEL: Final = "servo_board"

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


def _description(variables: Sequence[ExportedVariable], token: str) -> bytes:
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


def export_fmu(path: Path, plant: PlantConfig | None = None, seed: int = 1, servo: ServoConfig | None = None) -> None:
    """Compile a board for this machine and write it as FMU, its sources included.

    Parameters
    ----------
    path : Path
        File to be written.
    plant : PlantConfig, optional
        Start values of the parameters; the packaged plant by default.
    seed : int
        Seed of all random numbers.
    servo : ServoConfig, optional
        Configuration of the firmware; that of ``firmware/config/servo.toml`` by default.

    Raises
    ------
    SimulationError
        If there is no compiler, or it fails.
    OSError
        If the package is not in a checkout with the sources of the firmware, or the file cannot be written.
    """
    with exported_board(MODEL, [NATIVE / "fmu" / "fmu.c"], plant, servo, seed) as board:
        description = _description(board.variables, board.token)
        write_file(path, lambda stream: _pack(stream, description, board))


def _pack(stream: IO[bytes], description: bytes, board: ExportedBoard) -> None:
    """Write the file of an FMU: description, binary, and sources at the places that they have in a checkout."""
    root = FIRMWARE.parent
    folders = [str(NATIVE.relative_to(root)), str(FIRMWARE.relative_to(root)), "generated"]
    places = {
        file: f"{file.relative_to(root)}" if file.is_relative_to(root) else f"generated/{file.name}"
        for file in [*board.files, *board.headers]
    }
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as fmu:
        fmu.writestr("modelDescription.xml", description)
        fmu.write(board.library, f"binaries/{platform.machine()}-{platform.system().lower()}/{board.library.name}")
        fmu.writestr(
            "sources/buildDescription.xml", _build_description([places[file] for file in board.files], folders)
        )
        for file, place in places.items():
            fmu.write(file, f"sources/{place}")
