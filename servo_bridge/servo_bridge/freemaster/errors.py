"""Errors of the communication with a FreeMASTER target."""

from __future__ import annotations

from typing import Final


class Status:
    """Status byte of a response: bit 7 error, bit 6 length byte follows."""

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
    """Value refused by the servo board; on other targets: recorder not available."""
    DEBUG_FRAME: Final = 0xA9

    ERROR_BIT: Final = 0x80
    VARIABLE_BIT: Final = 0x40


STATUS_TEXT: Final = {
    0x81: "unknown command or feature not built in",
    0x82: "checksum error in the request",
    0x83: "request longer than the buffer of the target",
    0x84: "response does not fit the buffer of the target",
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
    """Text of a status byte."""
    return STATUS_TEXT.get(code, "unknown status")


class FreemasterError(Exception):
    """Base class of the errors of this package."""


class CodecError(FreemasterError, ValueError):
    """A number or field of a payload is truncated or invalid."""


class TransportError(FreemasterError):
    """The port is lost or refuses bytes."""


class AnswerTimeoutError(FreemasterError):
    """No byte was received within the timeout."""


class DamagedAnswerError(FreemasterError):
    """Bytes were received, but no intact response."""

    def __init__(self, message: str, received: bytes = b"") -> None:
        super().__init__(message)
        self.received = received  # first bytes received


class DisturbedRequestError(DamagedAnswerError):
    """The target reports that requests arrive damaged."""


class WrongProtocolError(FreemasterError):
    """The response is neither FreeMASTER version 4 nor version 3."""


class StatusError(FreemasterError):
    """The target refused the request."""

    def __init__(self, code: int, request: str) -> None:
        self.code = code  # status byte, 0x81 or above
        self.meaning = status_text(code)  # text of the status byte
        super().__init__(f"{request}: the board returned {code:02X}, {self.meaning}")


class OutOfRangeError(StatusError):
    """The board refused a value; the text has the value and the permitted range."""

    def __init__(self, text: str) -> None:
        super().__init__(Status.OUT_OF_RANGE, text)
        self.args = (text,)


class CommandUnfinishedError(FreemasterError):
    """An application command has not finished yet."""


class DiscoveryError(FreemasterError):
    """The variable table of the target is missing or invalid."""


class RecorderError(FreemasterError):
    """The recorder of the target does not support the request."""
