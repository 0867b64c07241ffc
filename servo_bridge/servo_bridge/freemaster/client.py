"""Synchronous FreeMASTER client for targets of versions 4 and 3: the commands as methods."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.board_info import DEFAULT_MTU, BoardInfo
from servo_bridge.freemaster.commands import Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.dialect import Dialect
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
"""Access levels of a target with passwords: read memory, write it as well, everything."""

_SUM_REFUSALS: Final = (b"+\x82\x7e", b"+\x81\x7f")  # refusals of a version 3 target: sum instead of CRC


PASSWORD_VARIABLE: Final = "SERVO_PASSWORD"


def password_of_environment() -> str | None:
    """Give the password that the user put into the environment; it must not stand in a file of parameters."""
    return os.environ.get(PASSWORD_VARIABLE) or None


class Client:
    """FreeMASTER client.

    Parameters
    ----------
    line : Line
        The way to the target.
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        self.before_exchange: Callable[[], None] | None = None
        """Called before every exchange; may exchange something itself while it has taken itself out of here."""
        self.ask_password: Callable[[], str | None] | None = None
        """Gives the password when the target requires one; None or a None from it lets the refusal stand."""
        self.info = BoardInfo()  # the target's description of itself
        self.mtu = DEFAULT_MTU
        self._dialect: Dialect = DialectV4()

    @property
    def read_limit(self) -> int:
        """Most bytes per READMEM."""
        return min(self.mtu, MAX_ANSWER_DATA)

    @property
    def payload_limit(self) -> int:
        """Most bytes of payload per request: command and length share the target's buffer."""
        return min(self.mtu - 2, MAX_ANSWER_DATA)

    def exchange(self, request: Request, *, retries: int | None = None) -> Exchange:
        """Send any request; see `Line.exchange`. Logs in when the target requires a password and there is one."""
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

    def _ask(self, request: Request) -> bytes:
        return self.exchange(request).data

    # ---- who is there -----------------------------------------------------------------------------------------

    def probe(self) -> None:
        """Make sure that a FreeMASTER target answers, and find out which version it speaks.

        Raises
        ------
        WrongProtocolError
            If something else answers; the message says what it looks like.
        AnswerTimeoutError
            If nothing answers.
        """
        request = commands.get_config("PV")
        self.line.fence = None
        for left in range(self.line.retries, -1, -1):
            try:
                self.exchange(request, retries=0)
            except StatusError:
                pass  # an intact version 4 refusal: the key is optional
            except AnswerTimeoutError:
                if left == 0:
                    raise
                continue
            except DamagedAnswerError as error:
                if any(refusal in error.received for refusal in _SUM_REFUSALS):
                    self._dialect = DialectV3()
                    return
                if left > 0:
                    continue
                if isinstance(error, DisturbedRequestError):
                    raise  # it is the right protocol on a bad line
                raise WrongProtocolError(_what_answers(error.received, request.frame)) from error
            self._dialect = DialectV4()
            return

    def identify(self) -> BoardInfo:
        """Ask the target who it is and adopt its version of the protocol and its buffer size.

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
        """Read the value of a configuration key, or None when the target does not know it."""
        return self._dialect.get_config(self.exchange, key)

    def log_in(self, password: str, level: int = len(LEVELS) - 1) -> int:
        """Log in with a password to the highest level that it opens, at most `level`.

        Returns
        -------
        int
            The level that the target grants; see `LEVELS`.

        Raises
        ------
        StatusError
            If the password is wrong, or the target has none at all.
        """
        for left in range(self.line.retries, -1, -1):
            try:
                return self._dialect.log_in(self.line.exchange, level, password)
            except (AnswerTimeoutError, DamagedAnswerError):  # the salt may be another one: begin anew
                if left == 0:
                    raise
        raise AssertionError("unreachable")

    # ---- memory -----------------------------------------------------------------------------------------------

    def read_memory(self, address: int, size: int) -> bytes:
        """Read `size` bytes, in as many requests as the target's buffer asks for.

        Pieces start at multiples of eight from `address`, so that no number is torn by the split.
        """
        step = self.read_limit & ~7
        pieces = (
            self._ask(self._dialect.read_memory(address + done, min(step, size - done)))
            for done in range(0, size, step)
        )
        return b"".join(pieces)

    def write_limit(self, address: int) -> int:
        """Tell how many data bytes fit one WRITEMEM to `address`."""
        overhead = len(self._dialect.write_memory(address, b"").payload) + 1  # a size of 128 and more takes two bytes
        return self.payload_limit - overhead

    def write_memory(self, address: int, data: bytes, *, lengthy: bool = False) -> Exchange:
        """Write bytes in one request, so that they take effect together.

        Parameters
        ----------
        address : int
            Where.
        data : bytes
            What.
        lengthy : bool
            Wait for the answer for the full time, because a write that arrives twice does more than one.

        Raises
        ------
        CodecError
            If the data does not fit the target's buffer.
        """
        self._check_write(address, len(data))
        return self.exchange(replace(self._dialect.write_memory(address, data), lengthy=lengthy))

    def _check_write(self, address: int, size: int) -> None:
        if size > self.write_limit(address):
            raise CodecError(f"{size} bytes do not fit one write; the board takes {self.write_limit(address)}")

    # ---- scope ------------------------------------------------------------------------------------------------

    def set_scope(self, slots: Sequence[ScopeSlot], *, scope: int = 0) -> Request:
        """Set up the scope.

        Returns
        -------
        Request
            What to pass to `exchange` to read it.

        Raises
        ------
        CodecError
            If the values together do not fit one answer.
        """
        size = sum(slot.size for slot in slots)
        if size > self.read_limit:
            raise CodecError(f"{size} bytes of scope variables do not fit one answer of {self.read_limit} bytes")
        for request in self._dialect.set_scope(slots, scope=scope, payload_limit=self.payload_limit):
            self._ask(request)
        return self._dialect.read_scope(size, scope=scope)

    # ---- table of variables -----------------------------------------------------------------------------------

    def tsa_table(self, index: int) -> TsaTable:
        """Ask where table `index` lies; address 0 when there are no more."""
        return self._dialect.parse_tsa_info(self._ask(self._dialect.get_tsa_info(index)))

    def string_length(self, address: int) -> int:
        """Ask for the length of a text in target memory."""
        return self._dialect.parse_size(self._ask(self._dialect.get_string_length(address)))

    # ---- application commands ---------------------------------------------------------------------------------

    def run_command(self, code: int, arguments: bytes = b"", *, timeout: float = 1.0) -> int:
        """Run an application command and wait for its result, at most `timeout` [s].

        Raises
        ------
        AnswerTimeoutError
            If its answer was lost, so that it is not known whether it ran. It does not run later.
        CommandUnfinishedError
            If it, or one before it, does not end in time.
        StatusError
            If the target refuses it.
        """
        limit = self.line.clock() + round(timeout * 1e9)
        request = self._dialect.send_command(code, arguments)
        try:
            self._ask(request)
        except (AnswerTimeoutError, DamagedAnswerError):
            # It may have arrived, and may run only when its result is asked for: now, and not at the next command.
            with suppress(FreemasterError):
                self.exchange(self._dialect.get_command_status(), retries=0)
            raise
        except StatusError as error:
            if error.code != Status.BUSY:
                raise
            # One is pending whose sender has gone before it asked for the result.
            self._command_result(code, limit, timeout)
            self._ask(request)
        return self._command_result(code, limit, timeout)

    def _command_result(self, code: int, limit: int, timeout: float) -> int:
        while True:
            result = self._ask(self._dialect.get_command_status())[0]
            if result != commands.COMMAND_RUNNING:
                return result
            if self.line.clock() >= limit:
                raise CommandUnfinishedError(f"application command {code} still runs after {timeout:g} s")

    # ---- pipes ------------------------------------------------------------------------------------------------

    def pipe(self, port: int = 1) -> Pipe:
        """Give the client's end of a pipe."""
        return Pipe(self.exchange, self._dialect, port)

    # ---- recorder ---------------------------------------------------------------------------------------------

    def recorder(self, index: int = 0) -> Recorder:
        """Give a recorder of the identified target.

        Raises
        ------
        RecorderError
            If it has no such recorder.
        """
        if index >= self.info.recorders:
            has = "none" if not self.info.recorders else f"0 .. {self.info.recorders - 1}"
            raise RecorderError(f"the board has no recorder {index}; recorders: {has}")
        return self._dialect.recorder(self.exchange, self.info, index, self.payload_limit)


def _what_answers(received: bytes, request: bytes) -> str:
    """Name the kind of device from the bytes that were no answer."""
    if received.startswith(request):
        return "only the echo of the request came back; are the lines TX and RX connected with each other?"
    return (
        f"something answers, but not in FreeMASTER (first bytes {received[:16]!r}); "
        "another device, or another baud rate?"
    )
