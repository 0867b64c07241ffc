"""FreeMASTER requests to a board at rest: every command, valid, and invalid for each refusal."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Final

from servo_bridge.freemaster import commands
from servo_bridge.freemaster.commands import Command, ScopeSlot
from servo_bridge.freemaster.frames import V4, encode_sleb, encode_uleb

from targets.rig import Rig

VARIABLES: Final = 0x1000
STRINGS: Final = 0x00100000
TABLE: Final = 0x00200000
SAMPLES: Final = 0x00400000
"""Base addresses of variables, names, table and samples of the recorders (``comm/tsa.h``)."""

_ENTRY_SIZE: Final = 16
_CHUNK: Final = 240
"""Bytes of the table in one answer, a multiple of an entry."""

_READ_FROM_BASE: Final = 0x22
_SETREC: Final = 0x24
_GETREC: Final = 0x25
_GETPIPE: Final = 0x2F
_UNENDING: Final = b"\x80"
"""First byte of a number that is longer than the request."""


def frames(rig: Rig) -> Iterator[bytes]:
    """Requests as bytes; each is sent after the answer to the previous one."""
    yield from _configuration()
    yield from _table(rig)
    yield from _memory(rig)
    yield from _scope(rig)
    yield from _recorder(rig)
    yield from _pipe()
    yield from _commands()
    yield from _line()


def _configuration() -> Iterator[bytes]:
    for key in ("MTU", "VS", "NM", "DS", "BD", "F1", "BA", "RC", "SC", "PV", "PC", "XX"):
        yield commands.get_config(key).frame
    for index in (3, -1, 2**31 - 1):
        yield V4.encode(Command.GETCONFIG, encode_sleb(index))
    yield V4.encode(Command.GETCONFIG)
    yield V4.encode(Command.GETCONFIG, b"\x00PV")


def _table(rig: Rig) -> Iterator[bytes]:
    for index in (0, 1):
        yield commands.get_tsa_info(index).frame
    yield V4.encode(Command.GETTSAINFO, _UNENDING)
    size = _ENTRY_SIZE * len(rig.entries)
    for offset in range(0, size, _CHUNK):
        yield commands.read_memory(TABLE + offset, min(_CHUNK, size - offset)).frame
    for address in (STRINGS, STRINGS + 29, TABLE):
        yield commands.get_string_length(address).frame
        yield commands.read_memory(address, 16).frame
    yield commands.read_memory(STRINGS, 3).frame
    yield V4.encode(Command.GETSTRLEN, _UNENDING)


def _memory(rig: Rig) -> Iterator[bytes]:
    speed, position = rig.address("cmd.speed"), rig.address("axis1.position")
    yield commands.read_memory(rig.address("snapshot"), 30).frame
    for address, size in ((VARIABLES, 252), (0xFFFFFFFF, 4), (TABLE, 253), (TABLE, 2**16), (TABLE, 0)):
        yield commands.read_memory(address, size).frame
    yield V4.encode(Command.READMEM, encode_uleb(speed) + _UNENDING)
    for offset, size in ((-1, 4), (4, 2**32 - 1), (4, 4)):
        yield V4.encode(_READ_FROM_BASE, encode_sleb(offset) + encode_uleb(size))
    for data, mask in ((bytes(8), b"\x00\xff\x00\xff" + bytes(4)), (b"++++++++", bytes(8)), (b"++++++++", None)):
        yield commands.write_memory(speed, data, mask).frame
        yield commands.read_memory(speed, 8).frame
    yield commands.write_memory(position, bytes(4)).frame
    whole = b"\x00" + encode_uleb(speed) + encode_uleb(8)
    yield V4.encode(Command.WRITEMEM, whole + bytes(7))
    yield V4.encode(Command.WRITEMEM, b"\x01" + whole[1:] + bytes(15))
    yield V4.encode(Command.WRITEMEM, whole[:2])


def _pipe() -> Iterator[bytes]:
    """The log, and pipes that do not exist."""
    for number in range(6):
        yield log_request(number)
    yield log_request(5)  # repeated
    for payload in (b"", b"\x01", b"\x02\x00", b"\x01\x00text"):
        yield V4.encode(Command.PIPE, payload)
    for payload in (b"", b"\x01\x01\x81", b"\x00\x00\x82", b"\x01\x02\x81", b"\x00\x01\x81"):
        yield V4.encode(_GETPIPE, payload)
    yield V4.encode(Command.AUTH1, b"\x03")
    yield V4.encode(Command.AUTH2, b"\x03" + bytes(20))


def log_request(number: int) -> bytes:
    """Request of the log with the toggle bit of its number; acknowledges all received bytes."""
    return V4.encode(Command.PIPE, bytes((1 | (number & 1) << 7, 0xFF)))


def _scope(rig: Rig) -> Iterator[bytes]:
    yield commands.read_scope(4).frame  # before it is set up
    yield commands.read_scope(4, scope=1).frame
    slots = [ScopeSlot(rig.address(name), 4) for name in ("tick", "axis1.position", "axis2.speed")]
    for request in commands.set_scope(slots):
        yield request.frame
    yield commands.read_scope(12).frame
    yield commands.read_scope(12).frame
    tick = encode_uleb(rig.address("tick"))
    for operation, operand in (
        (1, b""),
        (1, b"\xff"),
        (2, b"\x18" + tick + b"\x04"),
        (2, b"\x00" + tick + b"\x03"),
        (2, b"\x00" + encode_uleb(0x500) + b"\x04"),
        (9, b""),
    ):
        yield V4.encode(Command.SETSCOPE, bytes((0, operation, len(operand))) + operand)
    yield V4.encode(Command.SETSCOPE, b"\x00\x02\x09")
    yield V4.encode(Command.SETSCOPE)
    yield V4.encode(Command.READSCOPE)


def _recorder(rig: Rig) -> Iterator[bytes]:
    """Slots, triggers, samples and refusals of both recorders."""

    def setting(recorder: int, *operations: bytes) -> bytes:
        return V4.encode(_SETREC, bytes([recorder]) + b"".join(operations))

    def operation(code: int, data: bytes = b"") -> bytes:
        return bytes([code, len(data)]) + data

    def variable(slot: int, name: str, trigger: bytes = b"\x00\x00") -> bytes:
        size = 4 if name in ("tick", "u_dc_now", "axis2.pi_q", "axis1.speed_raw") else 2
        return operation(2, bytes([slot]) + encode_uleb(rig.address(name)) + bytes([size]) + trigger)

    start, stop = operation(3), operation(4)
    for payload in (b"", b"\x02", b"\x00\x05\x00", b"\x00\x03\x01", b"\x00" + start, b"\x00" + stop):
        yield V4.encode(_SETREC, payload)
    for payload in (
        b"",
        b"\x00",
        b"\x02\x84",
        b"\x00\x80",
        b"\x00\x81",
        b"\x01\x81",
        b"\x00\x83",
        b"\x01\x84",
        b"\x00\x82",
    ):
        yield V4.encode(_GETREC, payload)
    yield setting(0, operation(1, b"\x09\x14\x05\x00"))
    yield setting(0, operation(1, b"\x01\x14\x05\x00"), variable(1, "tick"))
    yield setting(0, operation(2, b"\x00" + encode_uleb(VARIABLES - 4) + b"\x04\x00\x00"))
    names = (
        "axis1.i_a",
        "tick",
        "axis1.duty_b",
        "u_dc_now",
        "axis2.pi_q",
        "axis1.theta_e",
        "axis1.speed_raw",
        "axis2.mode",
    )
    signed, variable_limit = b"\x52" + encode_sleb(-1), b"\xb1" + encode_uleb(rig.address("tick"))
    for recorder, trigger in ((0, b"\x00\x00"), (0, signed), (1, b"\x00\x00"), (0, variable_limit)):
        yield setting(recorder, operation(1, b"\x08\x14\x05\x00"))
        for slot, name in enumerate(names):
            yield setting(
                recorder, variable(slot, name, trigger if name == ("axis1.i_a", "tick")[trigger[0] >> 7] else b"\0\0")
            )
        yield setting(recorder, start)
        yield setting(1 - recorder, operation(1, b"\x01\x14\x05\x00"))
        yield commands.read_memory(SAMPLES, 4).frame
        for _ in range(4):
            yield V4.encode(_GETREC, bytes([recorder, 0x83]))
        yield setting(recorder, stop)
        yield V4.encode(_GETREC, bytes([recorder, 0x83]))
        for offset in (0, 240):
            yield commands.read_memory(SAMPLES + offset, 240).frame
    # A memory that is full after a short time; the level triggers at once, and points follow.
    yield setting(
        0, operation(1, b"\x02\x06\x02\x00"), variable(0, "tick", b"\x51\x00"), variable(1, "u_dc_now"), start
    )
    for _ in range(8):
        yield V4.encode(_GETREC, b"\x00\x83")
    yield commands.read_memory(SAMPLES, 48).frame
    yield setting(0, operation(1, b"\x01\x06\x02\x00"), start)
    yield setting(0, variable(0, "tick", b"\x04\x00"), start)
    # Every size and alignment, with thresholds of both kinds; no trigger before the memory is full.
    tick, wide = encode_uleb(rig.address("tick")), encode_uleb(rig.address("cmd.position"))
    part = encode_uleb(rig.address("tick") + 1)
    for trigger in (b"\x12" + encode_sleb(-1), b"\x92" + wide, b"\x21" + encode_uleb(7), b"\xa1" + wide):
        yield setting(1, operation(1, b"\x02\x06\x02\x00"), operation(2, b"\x00" + wide + b"\x08" + trigger))
        yield setting(1, operation(2, b"\x01" + part + b"\x02\x11\x00"), start)
        for _ in range(3):
            yield V4.encode(_GETREC, b"\x01\x83")
        yield setting(1, stop)
        yield commands.read_memory(SAMPLES, 60).frame
    yield setting(0, operation(1, b"\x02\x05\x02\x00"), operation(2, b"\x00" + tick + b"\x04\x41\x00"))
    for data in (
        b"",
        b"\x01" + tick + b"\x03\x00\x00",
        b"\x01" + tick + b"\x04\x03\x00",
        b"\x01" + tick + b"\x02\x03\x00",
        b"\x01" + tick + b"\x04\x91" + _UNENDING,
        b"\x01" + tick + b"\x04\x91" + encode_uleb(VARIABLES - 4),
        b"\x01" + tick + b"\x04\x00\x00\x00",
        b"\x01" + tick + b"\x04\x12" + encode_sleb(-(2**31)),
    ):
        yield setting(0, operation(2, data))
    yield setting(0, start, operation(2, b"\x00" + tick + b"\x04\x00\x00"))
    yield setting(0, operation(1, b"\x01\x00\x7f\x00"), variable(0, "axis1.i_a", b"\x04\x00"), start)
    yield setting(0, operation(1, b"\x01\x00" + encode_uleb(2**20) + b"\x00"), variable(0, "axis1.i_a"))
    for what in (0x84, 0x83):
        yield V4.encode(_GETREC, bytes([0, what]))
    for name, size in (("axis1.i_a", 2), ("u_dc_now", 4), ("u_dc_now", 3), ("axis1.i_a", 4)):
        yield commands.read_memory(rig.address(name), size).frame
    yield setting(0, operation(1, b"\x03\x0a\x00\x01"), *(variable(k, "axis1.i_a") for k in range(3)), start)
    yield setting(0, stop, start, operation(1, b"\x00\x00\x00\x00"))


def _commands() -> Iterator[bytes]:
    for code in (1, 2, 3, 9):
        yield commands.send_command(code, b"+" * 5).frame
        yield commands.get_command_status().frame
        yield commands.get_command_data(8).frame
    for size in (3, 253, 2**16):
        yield commands.get_command_data(size).frame
    yield V4.encode(Command.GETAPPCMDDATA, _UNENDING)
    yield V4.encode(Command.SENDAPPCMD)
    yield V4.encode(Command.SENDAPPCMD, b"\xff")
    yield V4.encode(Command.SENDAPPCMD, b"\x03" + bytes(200))
    yield commands.send_command(3).frame
    yield commands.send_command(1).frame  # while a command is pending
    yield commands.get_command_data(8).frame


def _line() -> Iterator[bytes]:
    source = random.Random(7)
    yield b"+\x21\x05" + bytes(5) + b"\x00"  # wrong checksum
    yield b"+\x21+\x21\x02\x10"  # unfinished, twice
    yield b"+\x23\xfe" + source.randbytes(300).replace(b"+", b"-")  # too long
    yield bytes(1) * 64
    yield b"+\x21\xff" + bytes(8)
    yield commands.get_config("PV").frame * 2  # the second while the first is answered
    yield V4.encode(0x77)
