"""Synchronous FreeMASTER v4 client: the commands as methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.codec import MAX_ANSWER_DATA, decode_uleb
from servo_bridge.freemaster.commands import Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.errors import (
    AnswerTimeoutError,
    CodecError,
    CommandUnfinishedError,
    DamagedAnswerError,
    DisturbedRequestError,
    FreemasterError,
    Status,
    StatusError,
    WrongProtocolError,
)
from servo_bridge.freemaster.line import Exchange, Line

__all__ = ["BoardInfo", "Client"]

_SUM_REFUSALS: Final = (b"+\x82\x7e", b"+\x81\x7f")  # refusals of a version 3 target: sum instead of CRC
_DEFAULT_MTU: Final = 32  # smallest allowed buffer, until the target has named its own


@dataclass(frozen=True)
class BoardInfo:
    """What a target says about itself; values that it does not know are None or empty."""

    protocol: int = 4
    mtu: int = _DEFAULT_MTU
    version: str = ""
    name: str = ""
    description: str = ""
    build: str = ""
    flags: int = 0
    base_address: int | None = None
    recorders: int = 0
    scopes: int = 0
    pipes: int = 0

    @property
    def big_endian(self) -> bool:
        """Whether numbers in the target's memory have their high byte first."""
        return bool(self.flags & 0x01)

    @property
    def password_level(self) -> int:
        """Lowest access level that needs a password: 0 none, 1 read, 2 write, 3 flash."""
        return self.flags >> 4 & 3


class Client:
    """FreeMASTER v4 client.

    Parameters
    ----------
    line : Line
        The way to the target.

    Attributes
    ----------
    before_exchange : callable or None
        Called before every exchange; may exchange something itself while it has taken itself out of here.
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        self.before_exchange: Callable[[], None] | None = None
        self.mtu = _DEFAULT_MTU

    @property
    def read_limit(self) -> int:
        """Most bytes per READMEM."""
        return min(self.mtu, MAX_ANSWER_DATA)

    @property
    def payload_limit(self) -> int:
        """Most bytes of payload per request: command and length share the target's buffer."""
        return min(self.mtu - 2, MAX_ANSWER_DATA)

    def exchange(self, request: Request, *, retries: int | None = None) -> Exchange:
        """Send any request; see `Line.exchange`."""
        if self.before_exchange is not None:
            self.before_exchange()
        return self.line.exchange(request, retries=retries)

    def _ask(self, request: Request) -> bytes:
        return self.exchange(request).data

    # ---- who is there -----------------------------------------------------------------------------------------

    def probe(self) -> None:
        """Make sure that a FreeMASTER v4 target answers.

        Raises
        ------
        WrongProtocolError
            If something else answers; the message says what it looks like.
        AnswerTimeoutError
            If nothing answers.
        """
        request = commands.get_config("PV")
        try:
            self._ask(request)
        except StatusError:
            pass  # an intact version 4 refusal: the key is optional
        except DisturbedRequestError:
            raise  # it is the right protocol on a bad line
        except DamagedAnswerError as error:
            raise WrongProtocolError(_what_answers(error.received, request.frame)) from error

    def identify(self) -> BoardInfo:
        """Ask the target who it is and adopt its buffer size.

        Raises
        ------
        WrongProtocolError, AnswerTimeoutError
            See `probe`.
        """
        self.probe()
        mtu = self._number("MTU")
        flags = self._number("F1", encoded=False) or 0
        info = BoardInfo(
            protocol=self._number("PV", encoded=False) or 4,
            mtu=max(mtu or _DEFAULT_MTU, _DEFAULT_MTU),
            version=self._text("VS"),
            name=self._text("NM"),
            description=self._text("DS"),
            build=self._text("BD"),
            flags=flags,
            base_address=self._number("BA"),
            recorders=self._number("RC", encoded=False) or 0,
            scopes=self._number("SC", encoded=False) or 0,
            pipes=self._number("PC", encoded=False) or 0,
        )
        self.mtu = info.mtu
        return info

    def get_config(self, key: str) -> bytes | None:
        """Read the value of a configuration key, or None when the target does not know it."""
        try:
            return commands.parse_config(key, self._ask(commands.get_config(key)))
        except StatusError as error:
            if error.code in (Status.ACCESS_DENIED, Status.UNKNOWN_COMMAND):
                return None
            raise

    def _text(self, key: str) -> str:
        value = self.get_config(key)
        return "" if value is None else value.split(b"\x00", 1)[0].decode("utf-8", "replace")

    def _number(self, key: str, *, encoded: bool = True) -> int | None:
        value = self.get_config(key)
        if not value:
            return None
        return decode_uleb(value)[0] if encoded else value[0]

    # ---- memory -----------------------------------------------------------------------------------------------

    def read_memory(self, address: int, size: int) -> bytes:
        """Read `size` bytes, in as many requests as the target's buffer asks for.

        Pieces start at multiples of eight from `address`, so that no number is torn by the split.
        """
        step = self.read_limit & ~7
        pieces = (
            self._ask(commands.read_memory(address + done, min(step, size - done))) for done in range(0, size, step)
        )
        return b"".join(pieces)

    def write_limit(self, address: int) -> int:
        """Tell how many data bytes fit one WRITEMEM to `address`."""
        overhead = len(commands.write_memory(address, b"").payload) + 1  # a size of 128 and more takes two bytes
        return self.payload_limit - overhead

    def write_memory(self, address: int, data: bytes, *, retries: int | None = None) -> Exchange:
        """Write bytes in one request, so that they take effect together.

        Raises
        ------
        CodecError
            If the data does not fit the target's buffer.
        """
        self._check_write(address, len(data))
        return self.exchange(commands.write_memory(address, data), retries=retries)

    def write_masked(self, address: int, data: bytes, mask: bytes) -> None:
        """Write only the bits that are set in `mask`."""
        self._check_write(address, 2 * len(data))
        self._ask(commands.write_memory(address, data, mask))

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
        for request in commands.set_scope(slots, scope=scope, payload_limit=self.payload_limit):
            self._ask(request)
        return commands.read_scope(size, scope=scope)

    # ---- table of variables -----------------------------------------------------------------------------------

    def tsa_table(self, index: int) -> TsaTable:
        """Ask where table `index` lies; address 0 when there are no more."""
        return commands.parse_tsa_info(self._ask(commands.get_tsa_info(index)))

    def string_length(self, address: int) -> int:
        """Ask for the length of a text in target memory."""
        return commands.parse_size(self._ask(commands.get_string_length(address)))

    # ---- application commands ---------------------------------------------------------------------------------

    def run_command(self, code: int, arguments: bytes = b"", *, timeout: float = 1.0) -> int:
        """Run an application command and wait for its result.

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
        request = commands.send_command(code, arguments)
        try:
            self._ask(request)
        except (AnswerTimeoutError, DamagedAnswerError):
            # It may have arrived, and may run only when its result is asked for: now, and not at the next command.
            with suppress(FreemasterError):
                self.exchange(commands.get_command_status(), retries=0)
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
            result = self._ask(commands.get_command_status())[0]
            if result != commands.COMMAND_RUNNING:
                return result
            if self.line.clock() >= limit:
                raise CommandUnfinishedError(f"application command {code} still runs after {timeout:g} s")

    def command_data(self, size: int, offset: int = 0) -> bytes:
        """Read result data of the last application command."""
        data = self._ask(commands.get_command_data(size, offset))
        if len(data) != size:
            raise FreemasterError(f"{len(data)} bytes of result data, {size} expected")
        return data


def _what_answers(received: bytes, request: bytes) -> str:
    """Name the kind of device from the bytes that were no answer."""
    if any(refusal in received for refusal in _SUM_REFUSALS):
        return "the board speaks FreeMASTER version 3; this program needs version 4"
    if received.startswith(request):
        return "only the echo of the request came back; are the lines TX and RX connected with each other?"
    return (
        f"something answers, but not in FreeMASTER (first bytes {received[:16]!r}); "
        "another device, or another baud rate?"
    )
