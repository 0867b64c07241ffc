"""Definitions of ROS message types, as a recording contains them."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore


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


@cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)
