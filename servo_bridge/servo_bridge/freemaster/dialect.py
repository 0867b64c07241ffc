"""What a client needs to know of one version of the protocol: how requests are built and answers are read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from servo_bridge.freemaster.board_info import BoardInfo
from servo_bridge.freemaster.commands import Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.line import Ask, Fence
from servo_bridge.freemaster.recorder import Recorder


class Dialect(Protocol):
    """One version of the protocol, as one target speaks it.

    The methods build requests and raise `CodecError` for what this version cannot express; those named ``parse_...``
    read the data of an answer.
    """

    def identify(self, ask: Ask) -> BoardInfo:
        """Ask the target who it is, and learn what the requests depend on."""

    def fence(self, ask: Ask) -> Fence | None:
        """Find a request whose answer never changes, once the target is identified."""

    def get_config(self, ask: Ask, key: str) -> bytes | None:
        """Read a configuration value; None where there is none of that name."""

    def read_memory(self, address: int, size: int) -> Request: ...

    def write_memory(self, address: int, data: bytes) -> Request: ...

    def set_scope(self, slots: Sequence[ScopeSlot], *, scope: int, payload_limit: int) -> list[Request]: ...

    def read_scope(self, size: int, *, scope: int) -> Request: ...

    def get_tsa_info(self, index: int) -> Request: ...

    def parse_tsa_info(self, data: bytes) -> TsaTable: ...

    def get_string_length(self, address: int) -> Request: ...

    def parse_size(self, data: bytes) -> int: ...

    def send_command(self, code: int, arguments: bytes) -> Request: ...

    def get_command_status(self) -> Request: ...

    def exchange_pipe(self, payload: bytes) -> Request:
        """Build a request to a pipe; `Pipe` says what is in it."""

    def log_in(self, ask: Ask, level: int, password: str) -> int:
        """Prove the knowledge of a password; returns the level that the target grants.

        Raises
        ------
        StatusError
            If the password is wrong.
        FreemasterError
            If the version has no passwords.
        """

    def recorder(self, ask: Ask, info: BoardInfo, index: int, payload_limit: int) -> Recorder:
        """Give the recorder of that number."""
