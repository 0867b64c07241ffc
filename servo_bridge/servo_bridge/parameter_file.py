"""Parameters of a board in a file, TOML or JSON, and the difference between file and board. Pure."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from servo_bridge.freemaster.tsa import Number
from servo_bridge.wire.session import BoardVariable

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["ParameterFileError", "changes", "dump", "parse", "to_bytes"]

Parameters = Mapping[str, list[Number]]

_HASH: Final = "catalogue_hash"
_TABLE: Final = "parameters"


class ParameterFileError(ValueError):
    """The file is not a file of parameters, or one of them does not fit the board."""


def dump(path: Path, parameters: Parameters, units: Mapping[str, str], catalogue_hash: int | None) -> str:
    """Text of a file; JSON when its name ends in ``.json``, else TOML."""
    plain = {name: values if len(values) > 1 else values[0] for name, values in parameters.items()}
    if path.suffix.lower() == ".json":
        return json.dumps({_HASH: catalogue_hash, _TABLE: plain}, indent=2) + "\n"
    lines = ["# Parameters of a servo board, SI units.", ""]
    if catalogue_hash is not None:
        lines += [f"{_HASH} = {catalogue_hash}", ""]
    lines.append(f"[{_TABLE}]")
    for name, value in plain.items():
        unit = f"  # {units[name]}" if units.get(name) else ""
        lines.append(f"{json.dumps(name)} = {json.dumps(value)}{unit}")
    return "\n".join(lines) + "\n"


def parse(path: Path, text: str) -> Parameters:
    """Parameters of a file.

    Raises
    ------
    ParameterFileError
        If it is not one; the message says what is wrong.
    """
    try:
        table: Any = json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except (json.JSONDecodeError, tomllib.TOMLDecodeError) as error:
        raise ParameterFileError(f"{path}: {error}") from None
    parameters = table.get(_TABLE) if isinstance(table, dict) else None
    if not isinstance(parameters, dict) or not parameters:
        raise ParameterFileError(f"{path}: there is no table [{_TABLE}]; `servo-tool save` writes such files")
    result: dict[str, list[Number]] = {}
    for name, value in parameters.items():
        values = value if isinstance(value, list) else [value]
        if not values or not all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in values):
            raise ParameterFileError(f"{path}: {name} is neither a number nor a list of numbers")
        result[name] = values
    return result


def to_bytes(variables: Mapping[str, BoardVariable], parameters: Parameters) -> dict[str, bytes]:
    """Bytes for the board of all parameters of a file.

    Raises
    ------
    ParameterFileError
        If one does not exist, cannot be written or is out of limits.
    """
    result: dict[str, bytes] = {}
    for name, values in parameters.items():
        variable = variables.get(name)
        if variable is None:
            raise ParameterFileError(f"the board has no parameter {name}")
        if len(values) != variable.count:
            raise ParameterFileError(f"{name}: {len(values)} values in the file, {variable.count} on the board")
        try:
            result[name] = variable.encode([_snap(variable, value) for value in values])[1]
        except ValueError as error:
            raise ParameterFileError(str(error)) from None
    return result


def _snap(variable: BoardVariable, value: Number) -> Number:
    """Move a value onto a limit that it misses by less than one raw unit, as a limit itself does once rounded."""
    contract = variable.contract
    if contract is None:
        return value
    clipped = min(max(value, contract.minimum), contract.maximum)
    return clipped if abs(clipped - value) < contract.lsb else value


def changes(
    variables: Mapping[str, BoardVariable], wanted: Mapping[str, bytes], found: Mapping[str, bytes]
) -> list[str]:
    """Names of parameters whose bytes differ, in the order of the board."""
    return [name for name in variables if name in wanted and wanted[name] != found[name]]
