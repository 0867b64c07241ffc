"""Channels of a recorder, and its points as a trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from servo_msgs_py.trace import Trace, with_unit

from servo_bridge.bursts.trigger_text import channel_slot
from servo_bridge.freemaster.commands import ScopeSlot
from servo_bridge.freemaster.errors import CodecError
from servo_bridge.freemaster.tsa import TypeKind
from servo_bridge.wire.session import BoardVariable

_LETTERS: Final = {TypeKind.UNSIGNED: "u", TypeKind.SIGNED: "i", TypeKind.FLOAT: "f"}


@dataclass(frozen=True)
class Channel:
    """One number of every point."""

    name: str  # variable or element
    variable: BoardVariable  # variable of the number
    slot: ScopeSlot  # address and size of the number

    @property
    def head(self) -> str:
        """Name with unit."""
        return with_unit(self.name, self.variable.unit)

    @property
    def raw_type(self) -> str:
        """NumPy name of the type of the number."""
        type_ = self.variable.target.type
        order = ">" if self.variable.target.order == "big" else "<"
        return f"{order}{_LETTERS[type_.kind]}{type_.size}"

    def scaled(self, raw: NDArray[Any]) -> NDArray[Any]:
        """Values [SI] of raw numbers, same shape; integers and variables without a scale stay raw."""
        native = raw.astype(raw.dtype.newbyteorder("="))
        contract, fraction = self.variable.contract, self.variable.target.type.fraction_bits
        if contract is not None:
            return native if contract.lsb == 1.0 else native * contract.lsb
        return np.ldexp(native.astype(np.float64), -fraction) if fraction else native


def channels_of(selection: Sequence[tuple[str, BoardVariable, int | None]]) -> list[Channel]:
    """Channels of variables; for an array of all elements.

    Parameters
    ----------
    selection : sequence of (str, BoardVariable, int or None)
        Given name, variable, and element.

    Raises
    ------
    UsageError
        If a variable is a block of bytes.
    """
    result = []
    for name, variable, element in selection:
        if element is None and variable.count > 1:
            result += [Channel(f"{name}[{k}]", variable, channel_slot(variable, k)) for k in range(variable.count)]
        else:
            result.append(Channel(name, variable, channel_slot(variable, element)))
    return result


def burst_of(channels: Sequence[Channel], data: bytes, period_ns: int, zero: int) -> Trace:
    """Decode the points of a recorder.

    Parameters
    ----------
    channels : sequence of Channel
        In the order of a point.
    data : bytes
        All points, oldest first.
    period_ns : int
        Time between two points [ns]; 0: not known.
    zero : int
        Index of the point with time zero: the trigger, or the first point.

    Raises
    ------
    CodecError
        If the data are not a whole number of points.
    """
    fields = [f"f{k}" for k in range(len(channels))]
    layout = np.dtype([(field, channel.raw_type) for field, channel in zip(fields, channels, strict=True)])
    if len(data) % layout.itemsize:
        raise CodecError(f"{len(data)} bytes of samples are not a whole number of points of {layout.itemsize} bytes")
    points = np.frombuffer(data, layout)
    columns = {channel.name: channel.scaled(points[field]) for field, channel in zip(fields, channels, strict=True)}
    units = {channel.name: channel.variable.unit for channel in channels}
    return Trace(period_ns * 1e-9, columns, -zero, units)
