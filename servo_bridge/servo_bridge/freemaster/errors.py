"""What can go wrong between the host and a FreeMASTER target."""

from __future__ import annotations

from typing import Final


class Status:
    """Status byte of an answer: bit 7 error, bit 6 a length byte follows."""

    OK: Final = 0x00
    OK_VARIABLE: Final = 0x40
    RECORDER_RUNNING: Final = 0x01  # version 3 only, as the next
    RECORDER_STOPPED: Final = 0x02
    UNKNOWN_COMMAND: Final = 0x81
    CHECKSUM: Final = 0x82
    REQUEST_TOO_LONG: Final = 0x83
    ANSWER_TOO_LONG: Final = 0x84
    BAD_BUFFER: Final = 0x85
    BAD_SIZE: Final = 0x86
    BUSY: Final = 0x87
    NOT_INITIALISED: Final = 0x88
    ACCESS_DENIED: Final = 0x89
    NO_FLOAT_TRIGGER: Final = 0x90
    PASSWORD_NEEDED: Final = 0x91
    WRONG_PASSWORD: Final = 0x92
    BAD_INSTANCE: Final = 0x94
    OUT_OF_RANGE: Final = 0x97
    """What the servo board says of a value; other targets have it for recorders that are not built in."""
    DEBUG_FRAME: Final = 0xA9

    ERROR_BIT: Final = 0x80
    VARIABLE_BIT: Final = 0x40


STATUS_TEXT: Final = {
    0x81: "unknown command or feature not built in",
    0x82: "checksum error in the request",
    0x83: "request longer than the target's buffer",
    0x84: "answer does not fit the target's buffer",
    0x85: "bad buffer or variable index",
    0x86: "bad size",
    0x87: "busy",
    0x88: "not initialised",
    0x89: "access denied",
    0x8A: "SFIO not open",
    0x8B: "SFIO error",
    0x8C: "pipe error",
    0x8D: "fast recorder not built in",
    0x8E: "CAN transport error",
    0x8F: "CAN transport error",
    0x90: "float trigger not built in",
    0x91: "password needed",
    0x92: "wrong password",
    0x93: "user resource error",
    0x94: "bad scope, recorder or pipe index",
    0x95: "bad operation code",
    0x96: "bad instance",
    0x97: "value outside the range of the variable, or configuration not possible",
}
"""Meaning of the error status bytes."""


def status_text(code: int) -> str:
    """Put a status byte into words."""
    return STATUS_TEXT.get(code, "unknown status")


class FreemasterError(Exception):
    """Base class of everything this package raises on purpose."""


class CodecError(FreemasterError, ValueError):
    """A number or a field inside a payload is cut off or malformed."""


class TransportError(FreemasterError):
    """The port itself is gone or refuses bytes."""


class AnswerTimeoutError(FreemasterError):
    """The target did not send a single byte in time."""


class DamagedAnswerError(FreemasterError):
    """Bytes came back, but no intact answer."""

    def __init__(self, message: str, received: bytes = b"") -> None:
        super().__init__(message)
        self.received = received  # all bytes, from the first one on


class DisturbedRequestError(DamagedAnswerError):
    """The target says that requests reach it damaged."""


class WrongProtocolError(FreemasterError):
    """Something answers, but it speaks neither FreeMASTER version 4 nor version 3."""


class StatusError(FreemasterError):
    """The target understood the request and refused it."""

    def __init__(self, code: int, request: str) -> None:
        self.code = code  # status byte, 0x81 and up
        self.meaning = status_text(code)  # the same in words
        super().__init__(f"{request}: the board answers {code:02X}, {self.meaning}")


class OutOfRangeError(StatusError):
    """The board has refused a value; the text says which one, and what it takes."""

    def __init__(self, text: str) -> None:
        super().__init__(Status.OUT_OF_RANGE, text)
        self.args = (text,)


class CommandUnfinishedError(FreemasterError):
    """An application command has been started and still runs."""


class DiscoveryError(FreemasterError):
    """The target's variable table is missing or makes no sense."""


class RecorderError(FreemasterError):
    """The recorder of the target cannot record what is asked for."""
