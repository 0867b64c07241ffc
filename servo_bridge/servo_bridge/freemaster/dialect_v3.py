"""Version 3 of the protocol: encoding of requests and decoding of responses; see `DialectV4`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from servo_bridge.freemaster import commands_v3
from servo_bridge.freemaster.board_info import BoardInfo
from servo_bridge.freemaster.commands import Request, ScopeSlot, TsaTable
from servo_bridge.freemaster.commands_v3 import MemoryForm
from servo_bridge.freemaster.errors import CodecError, FreemasterError, RecorderError, Status, StatusError
from servo_bridge.freemaster.frames import V3
from servo_bridge.freemaster.line import Fence, SendRequest
from servo_bridge.freemaster.recorder import Recorder
from servo_bridge.freemaster.recorder_v3 import RecorderV3

_MTU_MIN: Final = 8
_BIG_ENDIAN: Final = 0x01
_LARGE_RECORDER: Final = 0x10
_RECORDER_UNIT: Final = 64  # bytes per unit of the memory of a large recorder
_TIME_UNITS: Final = (1_000_000_000, 1_000_000, 1_000, 1)  # of the time base, by its two most significant bits [ns]


class DialectV3:
    """Version 3; with the methods of `DialectV4`.

    A target supports addresses of 16 or 32 bits, or both; this and its byte order are determined by `identify`.
    """

    def __init__(self) -> None:
        self._form = MemoryForm()
        self._recorder_memory: int | None = None
        self._time_base_ns = 0
        self._fence: Fence | None = None

    def identify(self, send: SendRequest) -> BoardInfo:
        request = commands_v3.get_info()
        data = _answer_or_none(send, request)
        if data is None:
            request = commands_v3.get_info_brief()
            data = send(request).data
        self._fence = Fence(request.frame, V3.answer(Status.OK, data))
        protocol, flags, _, major, minor, buffer_size = data[:6]
        form = MemoryForm("big" if flags & _BIG_ENDIAN else "little")
        description = ""
        recorders = 1  # not in the brief form
        if len(data) >= commands_v3.INFO_SIZE:
            self._recorder_memory = form.value(data[6:8]) * (_RECORDER_UNIT if flags & _LARGE_RECORDER else 1)
            time_base = form.value(data[8:10])
            self._time_base_ns = (time_base & 0x3FFF) * _TIME_UNITS[time_base >> 14]
            description = data[10:].split(b"\x00", 1)[0].decode("utf-8", "replace")
            recorders = int(self._recorder_memory > 0)
        self._form = _known_form(send, form)
        return BoardInfo(
            protocol=protocol,
            mtu=max(buffer_size, _MTU_MIN),
            version=f"{major}.{minor}",
            description=description,
            flags=flags & _BIG_ENDIAN,
            recorders=recorders,
            scopes=1,
        )

    def fence(self, send: SendRequest) -> Fence | None:
        return self._fence

    def get_config(self, send: SendRequest, key: str) -> bytes | None:
        return None

    def read_memory(self, address: int, size: int) -> Request:
        return self._form.read_memory(address, size)

    def write_memory(self, address: int, data: bytes, *, lengthy: bool = False) -> Request:
        return self._form.write_memory(address, data, lengthy=lengthy)

    def set_scope(self, slots: Sequence[ScopeSlot], *, scope: int, payload_limit: int) -> list[Request]:
        if scope:
            raise CodecError(f"scope {scope} does not exist; a version 3 target has one")
        request = self._form.set_scope(slots)
        if len(request.payload) > payload_limit:
            raise CodecError(f"{len(slots)} scope variables do not fit the buffer of the target")
        return [request]

    def read_scope(self, size: int, *, scope: int) -> Request:
        return self._form.read_scope(size)

    def get_tsa_info(self, index: int) -> Request:
        return self._form.get_tsa_info(index)

    def parse_tsa_info(self, data: bytes) -> TsaTable:
        return self._form.parse_tsa_info(data)

    def get_string_length(self, address: int) -> Request:
        return self._form.get_string_length(address)

    def parse_size(self, data: bytes) -> int:
        return self._form.value(data)

    def send_command(self, code: int, arguments: bytes, *, repeatable: bool = False) -> Request:
        return self._form.send_command(code, arguments, repeatable=repeatable)

    def get_command_status(self, *, repeatable: bool = False) -> Request:
        return self._form.get_command_status(repeatable=repeatable)

    def exchange_pipe(self, payload: bytes) -> Request:
        return commands_v3.exchange_pipe(payload)

    def log_in(self, send: SendRequest, level: int, password: str) -> int:
        raise FreemasterError("the board uses FreeMASTER version 3, which has no passwords")

    def recorder(self, send: SendRequest, info: BoardInfo, index: int, payload_limit: int) -> Recorder:
        if index:
            raise RecorderError(f"recorder {index} does not exist; a version 3 target has one")
        return RecorderV3(send, self._form, self._recorder_memory, self._time_base_ns, payload_limit)


def _answer_or_none(send: SendRequest, request: Request) -> bytes | None:
    """Data of the response; None if the target does not support the command."""
    try:
        return send(request).data
    except StatusError as error:
        if error.code == Status.UNKNOWN_COMMAND:
            return None
        raise


def _known_form(send: SendRequest, form: MemoryForm) -> MemoryForm:
    """Determine the address form of the target, by read requests."""
    narrow = MemoryForm(form.order, wide=False)
    for candidate in (form, narrow):
        if _answer_or_none(send, candidate.get_tsa_info(0)) is not None:
            return candidate
    try:
        send(form.read_memory(0, 0))
    except StatusError as error:
        return narrow if error.code == Status.UNKNOWN_COMMAND else form
    return form
