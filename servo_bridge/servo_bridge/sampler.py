"""Reads a list of variables from any FreeMASTER target: with the scope if possible, else one by one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from servo_msgs_py.catalogue import Value

from servo_bridge.freemaster.commands import SCOPE_SIZES, Request, ScopeSlot
from servo_bridge.freemaster.errors import CodecError, StatusError
from servo_bridge.wire.session import BoardVariable, Session


@dataclass(frozen=True)
class Reading:
    """Values of all variables of a sampler, with their time [monotonic ns]."""

    time_ns: int
    values: tuple[Value, ...]


class Sampler:
    """List of variables that are read together."""

    def __init__(self, session: Session, variables: Sequence[BoardVariable]) -> None:
        self._session = session
        self._variables = tuple(variables)
        self._request = self._set_up()
        self.simultaneous = self._request is not None or len(self._variables) == 1
        """Whether the values of one reading are simultaneous."""

    def _set_up(self) -> Request | None:
        if self._session.info.scopes == 0 or any(v.size not in SCOPE_SIZES for v in self._variables):
            return None
        try:
            return self._session.client.set_scope([ScopeSlot(v.address, v.size) for v in self._variables])
        except (StatusError, CodecError):
            return None  # the scope has too few slots

    def read(self) -> Reading:
        """Read all variables once."""
        if self._request is None:
            values = tuple(self._session.read(variable) for variable in self._variables)
            return Reading(time.monotonic_ns(), values)
        exchange = self._session.client.exchange(self._request)
        values_list: list[Value] = []
        start = 0
        for variable in self._variables:
            values_list.append(variable.decode(exchange.data[start : start + variable.size]))
            start += variable.size
        return Reading(exchange.response_ns, tuple(values_list))
