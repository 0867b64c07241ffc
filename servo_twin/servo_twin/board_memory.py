"""Memory access to a virtual board as through FreeMASTER, without the serial line: bytes and table of variables."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Final, NamedTuple

_ENTRY_SIZE: Final = 16

BUSY: Final = 0x87
"""FreeMASTER status: busy; also of a board that executes an ELF file, while it starts again after a reset."""

OUT_OF_RANGE: Final = 0x97
"""FreeMASTER status: value outside the range of the variable."""

_STATUS_TEXT: Final[Mapping[int, str]] = {
    0x84: "more bytes than one request can transfer",
    0x86: "wrong number of bytes",
    BUSY: "busy",
    0x89: "access denied: not inside one variable, or read-only",
    OUT_OF_RANGE: "value outside the range of the variable",
}


class SimulationError(RuntimeError):
    """The simulation failed; the message contains the reason."""


class BoardError(RuntimeError):
    """The board refused a request."""

    def __init__(self, message: str, status: int = 0) -> None:
        super().__init__(message)
        self.status = status  # FreeMASTER status code; 0: none


class TableEntry(NamedTuple):
    """One entry of a board's table of variables."""

    name: str
    address: int
    size: int  # [bytes]
    variable: bool  # true: a variable; false: a type, a member or a constant


class BoardMemory:
    """Memory access with the checks of the FreeMASTER server.

    Parameters
    ----------
    ffi, lib : cffi library
        Library with the interface of ``board.h``.
    board : cffi pointer
        The board; must exist as long as this object.
    """

    def __init__(self, ffi: Any, lib: Any, board: Any) -> None:
        self._ffi, self._lib, self._board = ffi, lib, board

    def read(self, address: int, size: int) -> bytes:
        """Read bytes at an address, as FreeMASTER READMEM.

        Raises
        ------
        BoardError
            If the board refuses; `BoardError.status` is the reason.
        """
        data = self._ffi.new("uint8_t[]", max(size, 1))
        status = self._lib.board_read(self._board, address, data, size)
        if status != 0:
            raise BoardError(f"reading {size} bytes at {address:#x}: {status_text(status)}", status)
        return bytes(self._ffi.buffer(data, size))

    def write(self, address: int, data: bytes) -> None:
        """Write bytes at an address, as FreeMASTER WRITEMEM."""
        status = self._lib.board_write(self._board, address, data, len(data))
        if status != 0:
            raise BoardError(f"writing {len(data)} bytes at {address:#x}: {status_text(status)}", status)

    @cached_property
    def table(self) -> tuple[TableEntry, ...]:
        """All entries of the table, in the order of the table."""
        start, size = self._ffi.new("uint32_t *"), self._ffi.new("uint32_t *")
        self._lib.board_table(start, size)
        return tuple(self._entry(at) for at in range(start[0], start[0] + size[0], _ENTRY_SIZE))

    @cached_property
    def variables(self) -> Mapping[str, TableEntry]:
        """Variables of the table, by name."""
        return {entry.name: entry for entry in self.table if entry.variable}

    def _entry(self, at: int) -> TableEntry:
        """Decode an entry: name, type, address and info, four bytes each."""
        data = self.read(at, _ENTRY_SIZE)
        name, _, address, info = (int.from_bytes(data[k : k + 4], "little") for k in (0, 4, 8, 12))
        return TableEntry(self._string(name), address, info >> 2, bool(info & 3))

    def _string(self, address: int) -> str:
        """String from the memory of the board; its terminating zero is not readable and ends the loop."""
        text = bytearray()
        byte = self._ffi.new("uint8_t[1]")
        while self._lib.board_read(self._board, address + len(text), byte, 1) == 0:
            text.append(byte[0])
        return text.decode("latin-1")


def status_text(status: int) -> str:
    """Text of a FreeMASTER status code."""
    return _STATUS_TEXT.get(status, f"status {status:02X}h")
