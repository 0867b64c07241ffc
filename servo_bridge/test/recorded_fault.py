"""Fault records as bytes in the format of the board."""

from __future__ import annotations

import struct

from servo_msgs_py.catalogue import Catalogue
from servo_msgs_py.fault_record import FaultRecord

SIZE = 660
"""Size of a record [bytes]."""
NONE = bytes(SIZE)
"""Record of an axis without a fault."""


def recorded(fault: str, tick: int, i_q: int = 0) -> bytes:
    """Record of a spinning axis with a constant raw current `i_q`; all other samples are different."""
    flag = Catalogue.load().flag("faults", fault)
    head = struct.pack("<II6H", flag.mask, tick, flag.bit + 1, 3, 3, 5, 64, 0)
    rings = [[k - 32 for k in range(64)], [i_q] * 64, *([1000 * r + k for k in range(64)] for r in (3, 4, 5))]
    return head + struct.pack("<320h", *(sample for ring in rings for sample in ring))


def decoded(data: bytes, axis: int = 0) -> FaultRecord:
    return FaultRecord.of(axis, data, Catalogue.load())
