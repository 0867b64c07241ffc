"""Telemetry samples: their variables and decoding."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from servo_msgs_py.catalogue import Value, Variable

from servo_bridge.freemaster.commands import SCOPE_SIZES

_FORMATS: Final = {(1, False): "B", (2, False): "H", (2, True): "h", (4, False): "I", (4, True): "i"}


class ScopeLayout:
    """Variables of the scope in the order of a sample.

    Parameters
    ----------
    variables : sequence of Variable
        Without blocks; every one must fit a slot.

    Raises
    ------
    ValueError
        If a variable does not fit a slot of the scope.
    """

    def __init__(self, variables: Sequence[Variable]) -> None:
        self.variables = tuple(variables)
        self.names = tuple(v.name for v in variables)
        for v in variables:
            if v.size not in SCOPE_SIZES:
                raise ValueError(f"{v.name} has {v.size} bytes; telemetry supports variables of 1, 2, 4 or 8 bytes")
        self.size = sum(v.size for v in variables)
        codes = (_FORMATS[v.element_size, v.format.signed] * v.count for v in variables)
        self._struct = struct.Struct("<" + "".join(codes))
        self._slices: dict[str, tuple[Variable, slice]] = {}
        start = 0
        for v in variables:
            self._slices[v.name] = (v, slice(start, start + v.count))
            start += v.count

    def raw(self, data: bytes) -> tuple[int, ...]:
        """All elements of all variables as integers."""
        return self._struct.unpack(data)

    def value(self, name: str, raw: Sequence[int]) -> Value:
        """SI value of one variable.

        Raises
        ------
        KeyError
            If the variable is not in the sample.
        """
        variable, where = self._slices[name]
        values = [variable.scale(number) for number in raw[where]]
        return values[0] if variable.count == 1 else values

    def raw_of(self, name: str, raw: Sequence[int]) -> int | None:
        """First element of a variable as integer; None if it is not in the sample."""
        found = self._slices.get(name)
        return None if found is None else raw[found[1].start]


@dataclass(frozen=True)
class Sample:
    """One telemetry sample: all variables from the same tick."""

    tick: int  # PWM periods since reset, extended beyond 32 bits
    epoch: int  # number of board resets
    request_ns: int  # monotonic host time of the request [ns]
    response_ns: int  # monotonic host time of the response [ns]
    data: bytes  # as received
    raw: tuple[int, ...]  # firmware integers of all elements
    layout: ScopeLayout  # of `raw`

    @property
    def applied_tick(self) -> int | None:
        """Extended tick at which the last command write took effect; None if it is not in the telemetry."""
        raw = self.layout.raw_of("applied_tick", self.raw)
        return None if raw is None else self.tick - ((self.tick - raw) & 0xFFFF_FFFF)

    @property
    def applied_count(self) -> int | None:
        """Command writes that took effect, modulo 65536; None if it is not in the telemetry."""
        return self.layout.raw_of("applied_count", self.raw)

    def value(self, name: str) -> Value:
        """SI value of one variable; `KeyError` if it is not in the sample."""
        return self.layout.value(name, self.raw)

    def values(self) -> dict[str, Value]:
        """SI values of all variables."""
        return {name: self.layout.value(name, self.raw) for name in self.layout.names}
