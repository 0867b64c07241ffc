"""Recorder of version 4."""

from __future__ import annotations

from typing import Final

from servo_bridge.freemaster.commands import Command, Request
from servo_bridge.freemaster.errors import CodecError, RecorderError, Status, StatusError
from servo_bridge.freemaster.frames import decode_uleb, encode_sleb, encode_uleb
from servo_bridge.freemaster.line import SendRequest
from servo_bridge.freemaster.recorder import Compare, Limits, SampleMemory, Setup, State, Trigger, too_many_points

_CONFIGURE, _VARIABLE, _START, _STOP = 0x01, 0x02, 0x03, 0x04
_NAME, _LIMITS, _INFO, _STATE = 0x81, 0x82, 0x83, 0x84

_TRIGGER_ONLY: Final = 0x04
_ABOVE: Final = 0x10
_BELOW: Final = 0x20
_LEVEL: Final = 0x40
_VARIABLE_THRESHOLD: Final = 0x80


def set_up(index: int, setup: Setup, payload_limit: int) -> list[Request]:
    """Requests that configure a recorder, in as few frames as possible."""
    trigger = setup.trigger
    slots = [(slot.address, slot.size) for slot in setup.slots]
    triggering = None
    if trigger is not None:
        triggering = (trigger.slot.address, trigger.slot.size)
        if triggering not in slots:
            slots.append(triggering)
    operations = [
        _operation(
            _CONFIGURE,
            bytes((len(slots),))
            + encode_uleb(setup.points)
            + encode_uleb(setup.before)
            + encode_uleb(setup.divider - 1),
        )
    ]
    for number, (address, size) in enumerate(slots):
        flags, threshold = 0, b"\x00"
        if trigger is not None and (address, size) == triggering:
            flags, threshold = _trigger(trigger)
            triggering = None  # the same variable may be recorded twice
            flags |= _TRIGGER_ONLY if number >= len(setup.slots) else 0
        body = bytes((number,)) + encode_uleb(address) + bytes((size, flags)) + threshold
        operations.append(_operation(_VARIABLE, body))
    head = bytes((index,))
    payloads = [head]
    for operation in operations:
        if len(payloads[-1]) + len(operation) > payload_limit and payloads[-1] != head:
            payloads.append(head)
        payloads[-1] += operation
    return [Request(f"SETREC {len(slots)} variables", Command.SETREC, payload, 0, lengthy=True) for payload in payloads]


def _operation(code: int, body: bytes = b"") -> bytes:
    return bytes((code, len(body))) + body


def _trigger(trigger: Trigger) -> tuple[int, bytes]:
    """Flags and threshold of a variable."""
    flags = trigger.compare.value
    flags |= (_ABOVE if trigger.above else 0) | (_BELOW if trigger.below else 0) | (_LEVEL if trigger.level else 0)
    if trigger.threshold_address is not None:
        return flags | _VARIABLE_THRESHOLD, encode_uleb(trigger.threshold_address)
    encode = encode_sleb if trigger.compare is Compare.SIGNED else encode_uleb
    return flags, encode(trigger.threshold)


class RecorderV4:
    """Recorder of a version 4 target; see `Recorder`."""

    def __init__(self, send: SendRequest, index: int, payload_limit: int) -> None:
        self._send = send
        self._index = index
        self._payload_limit = payload_limit

    def limits(self) -> Limits:
        try:
            name = self._get(_NAME).decode("utf-8", "replace")
        except StatusError:
            name = ""
        data, numbers, end = self._get(_LIMITS), [], 0
        for _ in range(4):
            number, end = decode_uleb(data, end)
            numbers.append(number)
        memory, period_ns, overhead, slot_overhead = numbers
        return Limits(name, memory, period_ns, overhead, slot_overhead)

    def configure(self, setup: Setup) -> int:
        self.limits().check(setup)
        try:
            for request in set_up(self._index, setup, self._payload_limit):
                self._send(request)
            points = self.memory().count
        except StatusError as error:
            raise _explained(error, setup) from error
        if points and setup.points > points:
            raise too_many_points(setup, points)
        return points or setup.points

    def start(self) -> None:
        try:
            self._set(_START)
        except StatusError as error:
            if error.code == Status.BAD_SIZE:
                raise RecorderError(
                    "the board has lost the configuration of its recorder, probably by a reset; start again"
                ) from error
            raise

    def stop(self) -> None:
        self._set(_STOP)

    def state(self) -> State:
        return _state(self._get(_STATE))

    def memory(self) -> SampleMemory:
        data = self._get(_INFO)
        if len(data) < 6:
            raise CodecError(f"response about the recorder of {len(data)} bytes; 6 or more expected")
        address, end = decode_uleb(data, 2)
        point_size, end = decode_uleb(data, end)
        count, end = decode_uleb(data, end)
        first, _ = decode_uleb(data, end)
        return SampleMemory(address, point_size, count, first)

    def _get(self, operation: int) -> bytes:
        return self._send(Request("GETREC", Command.GETREC, bytes((self._index, operation)), None)).data

    def _set(self, operation: int) -> None:
        payload = bytes((self._index,)) + _operation(operation)
        # A START that arrives late would begin again.
        self._send(Request("SETREC", Command.SETREC, payload, 0, lengthy=True))


def _state(data: bytes) -> State:
    try:
        return State(data[0])
    except (IndexError, ValueError):
        raise CodecError(f"the state of the recorder is {data!r}, which is not defined") from None


def _explained(error: StatusError, setup: Setup) -> Exception:
    """Error that explains a refusal of the configuration."""
    if error.code == Status.NO_FLOAT_TRIGGER:
        return RecorderError("the board does not support triggers on floating-point variables")
    if error.code in (Status.BAD_BUFFER, Status.BAD_SIZE, Status.BAD_INSTANCE, Status.OUT_OF_RANGE):
        return RecorderError(
            f"the board refuses {len(setup.slots)} variable(s) and {setup.points or 'all'} points ({error.meaning}); "
            "record fewer"
        )
    return error
