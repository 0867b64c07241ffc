"""Publishing without the lock of the Python interpreter.

While a client joins or leaves the ROS graph, a write of the middleware can wait for a lock of its discovery for 0.3 s.
rclpy keeps the lock of the interpreter during a publication, so that the thread of the link could not run either, and
the board received nothing. Here the message is converted with the lock, and written without it.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any, Final

from rclpy.exceptions import InvalidHandle
from rclpy.serialization import serialize_message

_LIBRARY: Final = "librcl.so"


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


def unlocked(publisher: Any) -> Any:
    """Make a publisher of rclpy publish without the lock of the interpreter, if possible; returns the publisher."""
    function = _publish_function()
    if function is None:
        return publisher
    handle = publisher.handle

    def publish(message: Any) -> None:
        data = message if isinstance(message, bytes) else serialize_message(message)
        try:
            with handle:  # not destroyed meanwhile
                code = function(handle.pointer, ctypes.byref(_Bytes(data, len(data), len(data))), None)
        except InvalidHandle:
            return  # destroyed during the end of the node
        if code:
            raise RuntimeError(f"{publisher.topic_name}: rcl refuses the message with code {code}")

    publisher.publish = publish
    return publisher
