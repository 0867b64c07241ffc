"""Triggers of a recorder as text, such as ``axis1.i_q > 1.0``."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.catalogue import Catalogue

from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.recorder import Compare, Trigger
from servo_bridge.freemaster.tsa import Number, TypeKind, ValueType
from servo_bridge.tool_values import UnknownVariableError, UsageError, lookup, number_text, parse_values
from servo_bridge.wire.session import BoardVariable

_FORM: Final = re.compile(r"\s*(\S.*?)\s*(>=|<=|>|<|(?<=\s)(?:rising|falling)(?=\s))\s*(\S.*?)\s*\Z", re.DOTALL)
_ABOVE: Final = (">", ">=", "rising")
_BEYOND: Final = (">", "<=")
"""Operators for which equality counts as below the value; the target compares with >=."""
_KINDS: Final = {
    TypeKind.UNSIGNED: Compare.UNSIGNED,
    TypeKind.SIGNED: Compare.SIGNED,
    TypeKind.FLOAT: Compare.FLOAT,
}
_NEAR: Final = 1e-9


@dataclass(frozen=True)
class Expression:
    """Trigger expression: variable, operator, and value or variable."""

    name: str
    operator: str
    value: str


def parse_expression(text: str) -> Expression:
    """Parse a trigger expression.

    Raises
    ------
    UsageError
        If it does not have the form ``VAR > VALUE``, with ``>``, ``>=``, ``<``, ``<=``, ``rising`` or ``falling``.
    """
    match = _FORM.match(text)
    if match is None:
        raise UsageError(f"{text!r} is not a trigger; write e.g. 'axis1.i_q > 1.0', 'u_dc < 20' or 'x rising 3'")
    return Expression(*match.groups())


def channel_slot(variable: BoardVariable, element: int | None) -> ScopeSlot:
    """Address and size of a number, or of an element of an array.

    Raises
    ------
    UsageError
        If it is a block of bytes, or an array without an element index.
    """
    if variable.is_block:
        raise UsageError(f"{variable.name} is a block of bytes; write the variables in it")
    if element is None and variable.count > 1:
        raise UsageError(f"{variable.name} is an array; write one element, such as {variable.name}[0]")
    size = variable.target.type.size
    return ScopeSlot(variable.address + size * (element or 0), size)


def trigger_of(
    expression: Expression, variables: Mapping[str, BoardVariable], catalogue: Catalogue, *, level: bool = False
) -> Trigger:
    """Build the trigger of an expression.

    Parameters
    ----------
    expression : Expression
        Expression; the value is in SI units if the catalogue has the variable, and may be another variable.
    variables : mapping
        Variables of the board.
    catalogue : Catalogue
        Names of enumeration values.
    level : bool
        Trigger also if the expression holds from the start.

    Raises
    ------
    UnknownVariableError
        If the variable does not exist.
    UsageError
        If the value is not a number, or is outside the range of the variable.
    """
    variable, element = lookup(variables, expression.name)
    slot = channel_slot(variable, element)
    above = expression.operator in _ABOVE
    compare = _KINDS[variable.target.type.kind]
    threshold, address = 0, None
    other = _other_variable(expression.value, variables)
    if other is not None:
        address = _threshold_address(variable, *other)
    else:
        threshold = _threshold(variable, expression, catalogue)
    return Trigger(
        slot, compare, above=above, below=not above, threshold=threshold, threshold_address=address, level=level
    )


def _other_variable(text: str, variables: Mapping[str, BoardVariable]) -> tuple[BoardVariable, int | None] | None:
    try:
        return lookup(variables, text)
    except UnknownVariableError:
        return None


def _threshold_address(variable: BoardVariable, other: BoardVariable, element: int | None) -> int:
    """Address of a variable used as threshold."""
    slot = channel_slot(other, element)
    first, second = variable.target.type, other.target.type
    if (first.kind, first.size, first.fraction_bits, _lsb(variable)) != (
        second.kind, second.size, second.fraction_bits, _lsb(other),
    ):  # fmt: skip
        raise UsageError(
            f"{other.name} ({second.name}) cannot be the threshold of {variable.name} ({first.name}): "
            "both must have the same type and scale"
        )
    return slot.address


def _lsb(variable: BoardVariable) -> float:
    """Value of one raw unit."""
    if variable.contract is not None:
        return variable.contract.lsb
    return math.ldexp(1.0, -variable.target.type.fraction_bits)


def _threshold(variable: BoardVariable, expression: Expression, catalogue: Catalogue) -> int:
    """Raw threshold for the comparison in the target."""
    try:
        values = parse_values(variable, expression.value, catalogue)
    except UsageError as error:
        raise UsageError(f"trigger: {error}") from None
    if len(values) != 1 or not math.isfinite(values[0]):
        raise UsageError(f"trigger: {expression.value!r} is not one finite number")
    value, type_ = values[0], variable.target.type
    beyond = expression.operator in _BEYOND
    if type_.kind is TypeKind.FLOAT:
        return _float_bits(variable, float(value), beyond)
    raw = _raw(value, _lsb(variable), beyond)
    low, high = _raw_range(type_)
    if not low <= raw <= high:
        lsb = _lsb(variable)
        unit = f" {variable.unit}" if variable.unit else ""
        raise UsageError(
            f"trigger: {expression.value} is outside the range of {variable.name}: "
            f"{number_text(low * lsb)} .. {number_text(high * lsb)}{unit}"
        )
    return raw


def _raw(value: Number, lsb: float, beyond: bool) -> int:
    """Smallest raw number at or beyond the value; tolerates rounding of a value that is a multiple of the unit."""
    if isinstance(value, int) and lsb == 1.0:
        return value + beyond
    units = value / lsb
    nearest = round(units)
    if abs(units - nearest) <= _NEAR * abs(units):
        return nearest + beyond
    return math.ceil(units)


def _raw_range(type_: ValueType) -> tuple[int, int]:
    bits = 8 * type_.size
    return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if type_.kind is TypeKind.SIGNED else (0, (1 << bits) - 1)


def _float_bits(variable: BoardVariable, value: float, beyond: bool) -> int:
    """Bits of the smallest number of this type at or beyond the value."""
    size, code = variable.target.type.size, "f" if variable.target.type.size == 4 else "d"
    try:
        bits = int.from_bytes(struct.pack(f"<{code}", value), "little")
    except OverflowError:
        raise UsageError(f"trigger: {value:g} is outside the range of {variable.name}") from None
    (rounded,) = struct.unpack(f"<{code}", bits.to_bytes(size, "little"))
    if rounded > value or (rounded == value and not beyond):
        return bits
    sign = 1 << (8 * size - 1)
    if rounded == 0.0:
        return 1
    return bits - 1 if bits & sign else bits + 1
