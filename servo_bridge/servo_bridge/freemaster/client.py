"""Synchronous FreeMASTER client for targets of versions 4 and 3, with one method per command."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.board_info import DEFAULT_MTU, BoardInfo
from servo_bridge.freemaster.commands import Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.dialect_v3 import DialectV3
from servo_bridge.freemaster.dialect_v4 import DialectV4
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    CodecError,
    CommandUnfinishedError,
    DamagedAnswerError,
    DisturbedRequestError,
    FreemasterError,
    RecorderError,
    Status,
    StatusError,
    WrongProtocolError,
)
from servo_bridge.freemaster.frames import MAX_ANSWER_DATA
from servo_bridge.freemaster.line import Exchange, Line
from servo_bridge.freemaster.pipe import Pipe
from servo_bridge.freemaster.recorder import Recorder

__all__ = ["LEVELS", "PASSWORD_VARIABLE", "BoardInfo", "Client", "password_of_environment"]

LEVELS: Final = ("none", "view", "command", "tune")
"""Access levels of a target with passwords: none, read memory, also write it, all commands."""

_SUM_REFUSALS: Final = (b"+\x82\x7e", b"+\x81\x7f")  # refusals of a version 3 target: sum instead of CRC


PASSWORD_VARIABLE: Final = "SERVO_PASSWORD"


def password_of_environment() -> str | None:
    """Password from the environment; it must not be in a parameter file."""
    return os.environ.get(PASSWORD_VARIABLE) or None


class Client:
    """FreeMASTER client.

    Parameters
    ----------
    line : Line
        Line to the target.
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        self.before_exchange: Callable[[], None] | None = None
        """Called before every exchange; may send exchanges itself if it is removed here during that time."""
        self.ask_password: Callable[[], str | None] | None = None
        """Returns the password if the target requires one; None: the refusal is raised."""
        self.info = BoardInfo()  # identification by the target
        self.mtu = DEFAULT_MTU
        self._dialect: DialectV3 | DialectV4 = DialectV4()

    @property
    def read_limit(self) -> int:
        """Largest number of bytes per READMEM."""
        return min(self.mtu, MAX_ANSWER_DATA)

    @property
    def payload_limit(self) -> int:
        """Largest payload of a request [bytes]: command and length share the buffer of the target."""
        return min(self.mtu - 2, MAX_ANSWER_DATA)

    def exchange(self, request: Request, *, retries: int | None = None) -> Exchange:
        """Send a request; see `Line.exchange`. Logs in if the target requires a password and there is one."""
        if self.before_exchange is not None:
            self.before_exchange()
        try:
            return self.line.exchange(request, retries=retries)
        except StatusError as error:
            if error.code != Status.PASSWORD_NEEDED or self.ask_password is None:
                raise
            password = self.ask_password()
            if password is None:
                raise
        self.log_in(password)
        return self.line.exchange(request, retries=retries)

    def _data(self, request: Request) -> bytes:
        return self.exchange(request).data

    # ---- identification -----------------------------------------------------------------------------------------

    def probe(self) -> None:
        """Check that a FreeMASTER target responds, and determine its version.

        Raises
        ------
        WrongProtocolError
            If the response is not FreeMASTER; the message has the probable cause.
        AnswerTimeoutError
            If there is no response.
        """
        request = commands.get_config("PV")
        self.line.fence = None
        for attempts_left in range(self.line.retries, -1, -1):
            try:
                self.exchange(request, retries=0)
            except StatusError:
                pass  # an intact version 4 refusal: the key is optional
            except AnswerTimeoutError:
                if attempts_left == 0:
                    raise
                continue
            except DamagedAnswerError as error:
                if any(refusal in error.received for refusal in _SUM_REFUSALS):
                    self._dialect = DialectV3()
                    return
                if attempts_left > 0:
                    continue
                if isinstance(error, DisturbedRequestError):
                    raise  # the right protocol on a line with errors
                raise WrongProtocolError(_wrong_protocol_text(error.received, request.frame)) from error
            self._dialect = DialectV4()
            return

    def identify(self) -> BoardInfo:
        """Identify the target; sets the version of the protocol and the buffer size.

        Raises
        ------
        WrongProtocolError, AnswerTimeoutError
            See `probe`.
        """
        self.probe()
        self.info = self._dialect.identify(self.exchange)
        self.mtu = self.info.mtu
        self.line.fence = self._dialect.fence(self.exchange)
        return self.info

    def get_config(self, key: str) -> bytes | None:
        """Read the value of a configuration key; None if the target does not have it."""
        return self._dialect.get_config(self.exchange, key)

    def log_in(self, password: str, level: int = len(LEVELS) - 1) -> int:
        """Log in with a password to the highest level that it permits, at most `level`.

        Returns
        -------
        int
            Granted level; see `LEVELS`.

        Raises
        ------
        StatusError
            If the password is wrong, or the target has no passwords.
        """
        for attempts_left in range(self.line.retries, -1, -1):
            try:
                return self._dialect.log_in(self.line.exchange, level, password)
            except (AnswerTimeoutError, DamagedAnswerError):  # the salt may have changed: repeat from the start
                if attempts_left == 0:
                    raise
        raise AssertionError("unreachable")

    # ---- memory -----------------------------------------------------------------------------------------------

    def read_memory(self, address: int, size: int) -> bytes:
        """Read `size` bytes, in several requests if required by the buffer of the target.

        The requests start at multiples of eight from `address`, so that numbers are not split.
        """
        step = self.read_limit & ~7
        pieces = (
            self._data(self._dialect.read_memory(address + done, min(step, size - done)))
            for done in range(0, size, step)
        )
        return b"".join(pieces)

    def write_limit(self, address: int) -> int:
        """Largest number of data bytes in one WRITEMEM to `address`."""
        room = self.payload_limit - len(self._dialect.write_memory(address, b"").payload)
        return room - (room > 127)  # a size of 128 and more takes two bytes

    def write_memory(self, address: int, data: bytes, *, lengthy: bool = False) -> Exchange:
        """Write bytes in one request, so that they take effect simultaneously.

        Parameters
        ----------
        address : int
            Address.
        data : bytes
            Bytes.
        lengthy : bool
            Wait for the response with the full timeout, because a repeated write is executed twice.

        Raises
        ------
        CodecError
            If the data do not fit the buffer of the target.
        """
        request = self._dialect.write_memory(address, data, lengthy=lengthy)
        if len(request.payload) > self.payload_limit:
            limit = self.write_limit(address)
            raise CodecError(f"{len(data)} bytes do not fit one write; the limit of the board is {limit}")
        return self.exchange(request)

    # ---- scope ------------------------------------------------------------------------------------------------

    def set_scope(self, slots: Sequence[ScopeSlot], *, scope: int = 0) -> Request:
        """Set up the scope.

        Returns
        -------
        Request
            Request that reads the scope, for `exchange`.

        Raises
        ------
        CodecError
            If the values do not fit one response.
        """
        size = sum(slot.size for slot in slots)
        if size > self.read_limit:
            raise CodecError(f"{size} bytes of scope variables do not fit one response of {self.read_limit} bytes")
        for request in self._dialect.set_scope(slots, scope=scope, payload_limit=self.payload_limit):
            self._data(request)
        return self._dialect.read_scope(size, scope=scope)

    # ---- table of variables -----------------------------------------------------------------------------------

    def tsa_table(self, index: int) -> TsaTable:
        """Read the location of table `index`; address 0 after the last table."""
        return self._dialect.parse_tsa_info(self._data(self._dialect.get_tsa_info(index)))

    def string_length(self, address: int) -> int:
        """Read the length of a text in target memory."""
        return self._dialect.parse_size(self._data(self._dialect.get_string_length(address)))

    # ---- application commands ---------------------------------------------------------------------------------

    def run_command(self, code: int, arguments: bytes = b"", *, timeout: float = 1.0, repeatable: bool = False) -> int:
        """Run an application command and wait for its result, at most `timeout` [s].

        A `repeatable` command is quick and harmless if executed twice: its responses are awaited for the measured delay
        of the line, as those of a read; others for the full timeout.

        Raises
        ------
        AnswerTimeoutError
            If its response was lost, so that its execution is unknown. It will not be executed later.
        CommandUnfinishedError
            If it, or a previous command, does not finish in time.
        StatusError
            If the target refuses it.
        """
        limit = self.line.clock() + round(timeout * 1e9)
        request = self._dialect.send_command(code, arguments, repeatable=repeatable)
        try:
            self.exchange(request, retries=0)
        except (AnswerTimeoutError, DamagedAnswerError):
            # It may have been received but not executed: targets execute it when the status is read, so read it now.
            with suppress(FreemasterError):
                self.exchange(self._dialect.get_command_status(repeatable=repeatable), retries=0)
            raise
        except StatusError as error:
            if error.code != Status.BUSY:
                raise
            # A command of another client is pending whose result was not read.
            self._command_result(code, limit, timeout, repeatable)
            self._data(request)
        return self._command_result(code, limit, timeout, repeatable)

    def _command_result(self, code: int, limit: int, timeout: float, repeatable: bool) -> int:
        while True:
            result = self._data(self._dialect.get_command_status(repeatable=repeatable))[0]
            if result != commands.COMMAND_RUNNING:
                return result
            if self.line.clock() >= limit:
                raise CommandUnfinishedError(f"application command {code} still runs after {timeout:g} s")

    # ---- pipes ------------------------------------------------------------------------------------------------

    def pipe(self, port: int = 1) -> Pipe:
        """Return the client end of a pipe."""
        return Pipe(self.exchange, self._dialect.exchange_pipe, port)

    # ---- recorder ---------------------------------------------------------------------------------------------

    def recorder(self, index: int = 0) -> Recorder:
        """Return a recorder of the identified target.

        Raises
        ------
        RecorderError
            If the target does not have this recorder.
        """
        if index >= self.info.recorders:
            has = "none" if not self.info.recorders else f"0 .. {self.info.recorders - 1}"
            raise RecorderError(f"the board has no recorder {index}; recorders: {has}")
        return self._dialect.recorder(self.exchange, self.info, index, self.payload_limit)


def _wrong_protocol_text(received: bytes, request: bytes) -> str:
    """Probable cause of bytes that are not a FreeMASTER response."""
    if received.startswith(request):
        return "only the echo of the request was received; check whether TX and RX are connected with each other"
    return f"the response is not FreeMASTER (first bytes {received[:16]!r}); check device and baud rate"
