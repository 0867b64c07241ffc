"""Topics of a recording."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

_INFINITE: Final = "sec: 9223372036\n    nsec: 854775807"


class Topic(NamedTuple):
    """A topic of a recording."""

    name: str  # absolute, such as ``/servo/snapshot``
    type: str  # such as ``std_msgs/msg/String``
    depth: int = 50  # of the queue of its publisher
    latched: bool = False  # whether a new subscriber receives the last messages

    @property
    def qos(self) -> str:
        """Quality of service in the form of rosbag2, with which ``ros2 bag play`` publishes."""
        durability = "transient_local" if self.latched else "volatile"
        return (
            f"- history: keep_last\n  depth: {self.depth}\n  reliability: reliable\n  durability: {durability}\n"
            f"  deadline:\n    {_INFINITE}\n  lifespan:\n    {_INFINITE}\n  liveliness: automatic\n"
            f"  liveliness_lease_duration:\n    {_INFINITE}\n  avoid_ros_namespace_conventions: false\n"
        )


def type_of(message: type[Any]) -> str:
    """Name of the type of a ROS class, such as ``std_msgs/msg/String``."""
    package, kind, *_ = message.__module__.split(".")
    return f"{package}/{kind}/{message.__name__}"
