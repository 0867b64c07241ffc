"""Board parameters in a TOML or JSON file, and their comparison with the board.

Flags and enumeration values are written as names, ``"ANTI_WINDUP+DEAD_TIME"``; numbers are accepted, too.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.text_file import TextFileError, parse_json, parse_toml, read_text, toml_key, toml_value

from servo_bridge.freemaster.tsa import Number
from servo_bridge.tool_values import parse_values
from servo_bridge.wire.session import BoardVariable

Entry = Number | str
"""A number or the name of a value."""

Parameters = Mapping[str, list[Entry]]

_HASH: Final = "catalogue_hash"
_TABLE: Final = "parameters"


class ParameterFileError(ValueError):
    """Invalid parameter file, or a parameter that does not fit the board."""


def checked(path: Path) -> Path:
    """Return the path if its suffix is known.

    Raises
    ------
    ParameterFileError
        If it ends neither with ``.toml`` nor with ``.json``.
    """
    if path.suffix.lower() not in (".toml", ".json"):
        raise ParameterFileError(f"{path}: the name must end with .toml or .json")
    return path


def dump(path: Path, parameters: Parameters, units: Mapping[str, str], catalogue_hash: int | None) -> str:
    """Text of a parameter file; JSON if the name ends with ``.json``, else TOML."""
    plain = {name: values if len(values) > 1 else values[0] for name, values in parameters.items()}
    if path.suffix.lower() == ".json":
        return json.dumps({_HASH: catalogue_hash, _TABLE: plain}, indent=2) + "\n"
    lines = ["# Parameters of a servo board, SI units.", ""]
    if catalogue_hash is not None:
        lines += [f"{_HASH} = {catalogue_hash}", ""]
    lines.append(f"[{_TABLE}]")
    for name, value in plain.items():
        unit = f"  # {units[name]}" if units.get(name) else ""
        lines.append(f"{toml_key(name)} = {toml_value(value)}{unit}")
    return "\n".join(lines) + "\n"


def load(path: Path, catalogue_hash: int | None) -> Parameters:
    """Read a parameter file.

    Parameters
    ----------
    path : Path
        The suffix is the format.
    catalogue_hash : int or None
        Expected hash, if the file has one; None: not checked.

    Raises
    ------
    ParameterFileError
        If the file is invalid.
    OSError
        If it cannot be read.
    """
    try:
        text = read_text(path)
        table: Any = parse_json(text) if path.suffix.lower() == ".json" else parse_toml(text)
    except TextFileError as error:
        raise ParameterFileError(f"{path}: {error}") from None
    parameters = table.get(_TABLE) if isinstance(table, dict) else None
    if not isinstance(parameters, dict) or not parameters:
        raise ParameterFileError(f"{path}: no table [{_TABLE}]; create the file with `servo-tool save`")
    written = table.get(_HASH)
    if written is not None and catalogue_hash is not None and written != catalogue_hash:
        raise ParameterFileError(
            f"{path} belongs to another version of the board: {_HASH} is {written}, expected {catalogue_hash}; "
            f"check the file and remove the line {_HASH}"
        )
    result: dict[str, list[Entry]] = {}
    for name, value in parameters.items():
        values = value if isinstance(value, list) else [value]
        if not values or not all(isinstance(v, (int, float, str)) and not isinstance(v, bool) for v in values):
            raise ParameterFileError(f"{path}: {name} is not a number, a name or a list of them")
        result[name] = values
    return result


def to_bytes(variables: Mapping[str, BoardVariable], parameters: Parameters, catalogue: Catalogue) -> dict[str, bytes]:
    """Convert all parameters of a file to bytes for the board.

    Raises
    ------
    ParameterFileError
        If a parameter does not exist, is read-only or out of limits.
    """
    result: dict[str, bytes] = {}
    for name, values in parameters.items():
        variable = variables.get(name)
        if variable is None:
            raise ParameterFileError(f"the board has no parameter {name}")
        if len(values) != variable.count:
            raise ParameterFileError(f"{name}: {len(values)} values in the file, {variable.count} on the board")
        try:
            numbers = [_number(variable, value, catalogue) for value in values]
            result[name] = variable.encode([_snap(variable, number) for number in numbers])[1]
        except ValueError as error:
            raise ParameterFileError(str(error)) from None
    return result


def _number(variable: BoardVariable, value: Entry, catalogue: Catalogue) -> Number:
    if not isinstance(value, str):
        return value
    numbers = parse_values(variable, value, catalogue)
    if len(numbers) != 1:
        raise ValueError(f"{variable.name}: {value!r} is not one name; write a list for several values")
    return numbers[0]


def _snap(variable: BoardVariable, value: Number) -> Number:
    """Move a value to a limit that it exceeds by less than one raw unit (rounding)."""
    contract = variable.contract
    if contract is None:
        return value
    clipped = min(max(value, contract.minimum), contract.maximum)
    return clipped if abs(clipped - value) < contract.lsb else value


def changes(
    variables: Mapping[str, BoardVariable], target: Mapping[str, bytes], found: Mapping[str, bytes]
) -> list[str]:
    """Names of the parameters whose bytes differ, in the order of the board."""
    return [name for name in variables if name in target and target[name] != found[name]]
