"""Hardware interfaces that exchange JointState messages with a driver."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

POSITION: Final = "position"
VELOCITY: Final = "velocity"

_THRESHOLD: Final = 1e-5
"""Default of the parameter ``trigger_joint_command_threshold``."""


@dataclass(frozen=True)
class CommandMessage:
    """JointState with commands."""

    names: tuple[str, ...]  # all joints of the hardware, in the order of its description
    positions: tuple[float, ...]  # of the joints with this command interface [rad]; NaN: never written
    velocities: tuple[float, ...]  # of the joints with this command interface [rad/s]; NaN: never written


@dataclass(frozen=True)
class StateMessage:
    """JointState with states."""

    names: tuple[str, ...]
    positions: tuple[float, ...]  # [rad]
    velocities: tuple[float, ...]  # [rad/s]; empty: not given


@dataclass(frozen=True)
class Plugin:
    """Properties in which the two plugins differ."""

    initial: float  # value of every state and command before the first message, and before a controller writes
    compared: tuple[str, ...]  # command interfaces that are compared with their state before a message is sent


CURRENT_PLUGIN: Final = Plugin(math.nan, (POSITION, VELOCITY))
"""joint_state_topic_hardware_interface 1.1."""

OLD_PLUGIN: Final = Plugin(0.0, (POSITION,))
"""topic_based_ros2_control 0.3."""


class TopicHardware:
    """Values of the command and state interfaces of all joints, between controllers and messages.

    Commands keep their last value when a controller releases them and when the hardware is deactivated.

    Parameters
    ----------
    joints : sequence of str
        Joints in the order of the description.
    interfaces : mapping of str to sequence of str
        Command interfaces by joint.
    plugin : Plugin
        The plugin.
    threshold : float
        No message is sent while the sum of the distances between commands and states is not above it.
    """

    def __init__(
        self,
        joints: Sequence[str],
        interfaces: Mapping[str, Sequence[str]],
        plugin: Plugin = CURRENT_PLUGIN,
        threshold: float = _THRESHOLD,
    ) -> None:
        self.joints = tuple(joints)
        self.interfaces = {joint: tuple(interfaces[joint]) for joint in joints}
        self.active = True  # inactive hardware reads states, but sends no commands
        self._plugin = plugin
        self._threshold = threshold
        self._latest: StateMessage | None = None
        keys = [(joint, interface) for joint in joints for interface in (POSITION, VELOCITY)]
        self.states: dict[tuple[str, str], float] = dict.fromkeys(keys, plugin.initial)
        self.commands: dict[tuple[str, str], float] = {
            (joint, interface): plugin.initial for joint in joints for interface in self.interfaces[joint]
        }

    def receive(self, message: StateMessage) -> None:
        """Keep the newest message for the next `read`."""
        self._latest = message

    def read(self) -> None:
        """Copy the newest message to the states; unknown joints and values that are not finite are skipped."""
        if self._latest is None:
            return
        for interface, values in ((POSITION, self._latest.positions), (VELOCITY, self._latest.velocities)):
            for joint, value in zip(self._latest.names, values, strict=False):
                if joint in self.joints and math.isfinite(value):
                    self.states[joint, interface] = value

    def write(self) -> CommandMessage | None:
        """Message with the commands of all joints, claimed or not; None while states and commands agree."""
        if not self.active:
            return None
        difference = 0.0
        for (joint, interface), command in self.commands.items():
            if interface in self._plugin.compared:
                difference += abs(self.states[joint, interface] - command)
        if difference <= self._threshold:  # false for NaN
            return None
        return CommandMessage(self.joints, self._array(POSITION), self._array(VELOCITY))

    def _array(self, interface: str) -> tuple[float, ...]:
        return tuple(value for (_, each), value in self.commands.items() if each == interface)
