"""Pipe of a target: byte streams in both directions, reliable on a line that loses frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from servo_bridge.freemaster.commands import Request
from servo_bridge.freemaster.errors import CodecError
from servo_bridge.freemaster.line import SendRequest

PORT_MAX: Final = 127
_TOGGLE: Final = 0x80
_HEAD: Final = 2  # port and number of accepted bytes, before the data


class Pipe:
    """Pipe, polled by the client.

    Each request acknowledges the bytes of the previous response and has a toggle bit. For a repeated request (same
    toggle) the target repeats its response, so `Line.exchange` may repeat a request whose response was lost.

    Parameters
    ----------
    send : callable
        Sends a request; see `Line.exchange`.
    request : callable
        Request with a payload, in the version of the protocol.
    port : int
        Number of the pipe, 1 .. 127.

    Raises
    ------
    CodecError
        If the port does not exist.
    """

    def __init__(self, send: SendRequest, request: Callable[[bytes], Request], port: int = 1) -> None:
        if not 1 <= port <= PORT_MAX:
            raise CodecError(f"pipe {port} is not 1 .. {PORT_MAX}")
        self._send, self._request, self._port = send, request, port
        self._odd = False
        self._acknowledged = 0
        self._in_step = False

    def exchange(self, data: bytes = b"") -> tuple[bytes, int]:
        """Send bytes and receive those that the target has written.

        After an error, repeat the call with the same bytes: the target may have accepted them.

        Returns
        -------
        received, accepted : bytes, int
            Bytes of the target, and number of accepted bytes; send the others again.

        Raises
        ------
        StatusError
            If the pipe does not exist or is closed.
        """
        if not self._in_step:
            # The target may treat the first frame as a repetition and ignore its data and acknowledgement.
            first, _ = self._exchange(b"")
            self._in_step = True
            if first:
                return first, 0
        return self._exchange(data)

    def _exchange(self, data: bytes) -> tuple[bytes, int]:
        head = self._port | (_TOGGLE if self._odd else 0)
        answer = self._send(self._request(bytes((head, self._acknowledged)) + data)).data
        if len(answer) < _HEAD or answer[0] != head:
            raise CodecError(f"response {answer.hex(' ') or 'without data'} to a request to pipe {self._port}")
        self._odd = not self._odd
        received = answer[_HEAD:]
        self._acknowledged = len(received)
        return received, answer[1]
