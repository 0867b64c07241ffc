"""Interface of a protocol version: encoding of requests and decoding of responses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from servo_bridge.freemaster.board_info import BoardInfo
from servo_bridge.freemaster.commands import Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.line import Fence, SendRequest
from servo_bridge.freemaster.recorder import Recorder


class Dialect(Protocol):
    """Protocol version of one target.

    Methods return requests and raise `CodecError` for arguments that this version does not support; methods named
    ``parse_...`` decode the data of a response.
    """

    def identify(self, send: SendRequest) -> BoardInfo:
        """Identify the target; determines the parameters of later requests."""

    def fence(self, send: SendRequest) -> Fence | None:
        """Request whose response never changes; after `identify`."""

    def get_config(self, send: SendRequest, key: str) -> bytes | None:
        """Read a configuration value; None if it does not exist."""

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
        """Request to a pipe; see `Pipe` for its payload."""

    def log_in(self, send: SendRequest, level: int, password: str) -> int:
        """Log in with a password; returns the granted level.

        Raises
        ------
        StatusError
            If the password is wrong.
        FreemasterError
            If the version has no passwords.
        """

    def recorder(self, send: SendRequest, info: BoardInfo, index: int, payload_limit: int) -> Recorder:
        """Return the recorder with this number."""
