"""Definitions of ROS message types, as a recording contains them."""

from __future__ import annotations

from array import array
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from servo_msgs_py.run_file.topic import type_of

_PADDING_MAX: Final = 32
"""Largest surplus of an estimated size [bytes]: 4 for every empty sequence of a message."""


class Definition(NamedTuple):
    """Definition of a message type."""

    text: str  # ``.msg`` text with those of all nested types, encoding ``ros2msg``
    hash: str  # RIHS01 of the type


@cache
def definition(type_name: str) -> Definition | None:
    """Definition of a type of ROS 2 Jazzy such as ``std_msgs/msg/String``; None if the library does not know it."""
    store = _store()
    if type_name not in store.fielddefs:
        return None
    text, _ = store.generate_msgdef(type_name, ros_version=2)
    return Definition(text, store.hash_rihs01(type_name))


def decoded(data: bytes, type_name: str) -> Any:
    """Message with the members of its ROS class; arrays of numbers are arrays of numpy.

    Parameters
    ----------
    data : bytes
        Serialised message (CDR with its header).
    type_name : str
        Such as ``std_msgs/msg/String``.

    Raises
    ------
    ValueError
        If it is damaged, or its type is not known.
    """
    try:
        return _store().deserialize_cdr(data, type_name)
    except Exception as error:  # the generated code has no errors of its own
        raise ValueError(f"the message is no {type_name} ({error!r})") from None


def without_padding(data: bytes, type_name: str) -> bytes:
    """Serialised message without what is behind its last member, which strict readers refuse.

    rclpy reserves an estimated size, which is too large for messages with empty sequences.
    """
    for padding in range(0, _PADDING_MAX + 1, 4):
        part = data[: len(data) - padding]
        try:
            decoded(part, type_name)
        except ValueError:
            continue
        return part
    return data


def encoded(message: Any) -> bytes:
    """Serialised message (CDR with its header) of an object of a ROS class."""
    return bytes(_store().serialize_cdr(_own(message), type_of(type(message))))


def _own(value: Any) -> Any:
    """A message, or a value in one, as the library has it."""
    if hasattr(value, "get_fields_and_field_types"):
        fields = {name: _own(getattr(value, name)) for name in value.get_fields_and_field_types()}
        return _store().types[type_of(type(value))](**fields)
    if isinstance(value, array):
        return np.asarray(value)
    return [_own(each) for each in value] if isinstance(value, list) else value


@cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)
