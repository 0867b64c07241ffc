"""Publishing without the lock of the Python interpreter, and not in the thread of the executor.

While a client joins or leaves the ROS graph, a write of the middleware can wait for a lock of its discovery for 0.3 s.
rclpy keeps the lock of the interpreter during a publication, so that the thread of the link could not run either, and
the board received nothing. After a client was killed, a callback with publications once took 1.6 s and 1.5 ms of
processor time, presumably for the same reason. Here the message is converted at once, and
written by a thread without the lock.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from functools import cache, partial
from queue import SimpleQueue
from typing import Any, Final

from rclpy.exceptions import InvalidHandle
from rclpy.serialization import serialize_message

_LIBRARY: Final = "librcl.so"
_WAITING_MAX: Final = 20_000
"""Largest number of waiting messages, several seconds of telemetry; later ones are lost."""


class _Bytes(ctypes.Structure):
    """``rcl_serialized_message_t``."""

    _fields_ = (
        ("buffer", ctypes.c_char_p),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    )


@cache
def _publish_function() -> Any:
    """``rcl_publish_serialized_message``, which ctypes calls without the lock; None if rcl has another name here."""
    try:
        function = ctypes.CDLL(_LIBRARY).rcl_publish_serialized_message
    except (OSError, AttributeError):
        return None
    function.argtypes = [ctypes.c_void_p, ctypes.POINTER(_Bytes), ctypes.c_void_p]
    function.restype = ctypes.c_int
    return function


class Sender:
    """Sends the messages of publishers of rclpy in order, in a thread of its own.

    Parameters
    ----------
    report : callable
        Receives errors, in that thread.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._waiting: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="publications", daemon=True)
        self._thread.start()

    def unlocked(self, publisher: Any, seen: Callable[[bytes], None]) -> Any:
        """Make a publisher publish in the thread, without the lock of the interpreter; returns the publisher.

        Parameters
        ----------
        publisher : Publisher
            Of rclpy.
        seen : callable
            Receives every serialised message at once.
        """
        function = _publish_function()
        handle, locked = publisher.handle, publisher.publish

        def send(data: bytes) -> None:
            try:
                if function is None:
                    locked(data)
                    return
                with handle:  # not destroyed meanwhile
                    code = function(handle.pointer, ctypes.byref(_Bytes(data, len(data), len(data))), None)
            except InvalidHandle:
                return  # destroyed during the end of the node
            if code:
                self._report(f"{publisher.topic_name}: rcl refuses the message with code {code}")

        def publish(message: Any) -> None:
            data = message if isinstance(message, bytes) else serialize_message(message)
            seen(data)
            if self._waiting.qsize() < _WAITING_MAX:
                self._waiting.put(partial(send, data))

        publisher.publish = publish
        return publisher

    def flush(self, timeout: float = 1.0) -> None:
        """Wait until all messages have been sent, at most for the timeout [s]."""
        sent = threading.Event()
        self._waiting.put(sent.set)
        sent.wait(timeout)

    def close(self) -> None:
        """Send what waits and end the thread, unless the middleware blocks it."""
        self._waiting.put(None)
        self._thread.join(1.0)

    def _run(self) -> None:
        while (send := self._waiting.get()) is not None:
            send()
