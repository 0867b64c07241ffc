"""Robot description (URDF) of the joints of a servo: generation and parsing.

The description contains the data for robot_state_publisher and MoveIt, and a ``ros2_control`` tag for hardware that
communicates over the topics of the bridge. Its transmissions contain gear ratio, direction and offset; twin, viewer and
commander read them from there. Its joints contain the nominal values of the motors.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

from servo_msgs_py.catalogue import AXES, Catalogue, axis_name
from servo_msgs_py.joints import Joint, JointLimits

NO_LIMIT: Final = 1.0e15
"""Represents an infinite limit, which is invalid for some XML and YAML parsers."""

COMMAND_INTERFACES: Final = ("position", "velocity")
"""Default command interfaces of a joint."""

_STATE_INTERFACES: Final = ("position", "velocity", "effort")
_BASE: Final = "servo_base"
_PLUGIN: Final = "joint_state_topic_hardware_interface/JointStateTopicSystem"
_TRANSMISSION: Final = "transmission_interface/SimpleTransmission"

# A dial for each joint, in a row [m].
_DISTANCE: Final = 0.26
_RADIUS: Final = 0.1
_HEIGHT: Final = 0.01


@dataclass(frozen=True)
class Motor:
    """Nominal values of the motor of an axis."""

    torque_constant: float  # torque per current i_q [N m/A]
    inertia: float  # of rotor and load, at the motor shaft [kg m^2]


# ---- writing
def describe(
    joints: Sequence[Joint],
    catalogue: Catalogue,
    *,
    commands_topic: str,
    states_topic: str,
    interfaces: Mapping[str, Collection[str]] | None = None,
    motors: Sequence[Motor] = (),
) -> str:
    """Description of the joints of one board.

    Parameters
    ----------
    joints : sequence of Joint
        In the order of the axes.
    catalogue : Catalogue
        Source of the speed limit of the board, which also limits the velocity of the joints, and of the range of its
        position counter, which is that of a joint without position limits.
    commands_topic, states_topic : str
        Names of the topics of set-points and of states, fully resolved.
    interfaces : mapping of str to collection of str, optional
        Command interfaces by joint; by default `COMMAND_INTERFACES`.
    motors : sequence of Motor
        In the order of the axes; empty if unknown.

    Returns
    -------
    str
        URDF.
    """
    robot = ET.Element("robot", name="servo")
    _link(robot, _BASE, [])
    for axis, joint in enumerate(joints):
        _link(robot, _link_name(joint), _pointer())
        _joint(robot, joint, axis, catalogue)
    control = ET.SubElement(robot, "ros2_control", name="servo", type="system")
    hardware = ET.SubElement(control, "hardware")
    ET.SubElement(hardware, "plugin").text = _PLUGIN
    for name, topic in (("joint_commands_topic", commands_topic), ("joint_states_topic", states_topic)):
        ET.SubElement(hardware, "param", name=name).text = topic
    for axis, joint in enumerate(joints):
        given = COMMAND_INTERFACES if interfaces is None else interfaces[joint.name]
        part = ET.SubElement(control, "joint", name=joint.name)
        for interface in _STATE_INTERFACES:
            if interface in given:
                ET.SubElement(part, "command_interface", name=interface)
        for interface in _STATE_INTERFACES:
            ET.SubElement(part, "state_interface", name=interface)
        for name, value in vars(motors[axis]).items() if motors else ():
            ET.SubElement(part, "param", name=name).text = _text(value)
    for axis, joint in enumerate(joints):
        gear = ET.SubElement(control, "transmission", name=f"{joint.name}_transmission")
        ET.SubElement(gear, "plugin").text = _TRANSMISSION
        ET.SubElement(gear, "actuator", name=f"{axis_name(axis)}_motor", role="actuator1")
        part = ET.SubElement(gear, "joint", name=joint.name, role="joint1")
        ET.SubElement(part, "mechanical_reduction").text = _text(joint.reduction)
        ET.SubElement(part, "offset").text = _text(joint.offset)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _joint(robot: ET.Element, joint: Joint, axis: int, catalogue: Catalogue) -> None:
    limits = joint.limits
    # A controller takes the shorter way to a position of a continuous joint; one that counts turns is not continuous.
    part = ET.SubElement(robot, "joint", name=joint.name, type="continuous" if joint.wraps else "revolute")
    ET.SubElement(part, "parent", link=_BASE)
    ET.SubElement(part, "child", link=_link_name(joint))
    ET.SubElement(part, "origin", xyz=f"{axis * _DISTANCE:g} 0 0", rpy="0 0 0")
    ET.SubElement(part, "axis", xyz="0 0 1")
    velocity = min(limits.velocity_max, abs(joint.velocity(catalogue["cmd.speed"].maximum)))
    values = {"effort": limits.effort_max, "velocity": velocity}
    if not joint.wraps:
        low, high = _counter_range(joint, catalogue)
        values["lower"] = limits.position_min if limits.position_min > -math.inf else low
        values["upper"] = limits.position_max if limits.position_max < math.inf else high
    ET.SubElement(part, "limit", {name: _text(value) for name, value in values.items()})


def _counter_range(joint: Joint, catalogue: Catalogue) -> tuple[float, float]:
    """Positions of a joint at the ends of the position counter of the board [rad]; they stand for no limit."""
    counter = catalogue["axis1.position"]
    low, high = sorted(joint.position(end) for end in (counter.minimum, counter.maximum))
    return low, high


def _link_name(joint: Joint) -> str:
    return f"{joint.name}_link"


def _pointer() -> list[tuple[str, dict[str, str], str]]:
    """A dial and a pointer along x: shape, dimensions, position."""
    return [
        ("cylinder", {"radius": f"{_RADIUS:g}", "length": f"{_HEIGHT:g}"}, "0 0 0"),
        ("box", {"size": f"{_RADIUS:g} 0.01 0.005"}, f"{0.5 * _RADIUS:g} 0 {0.5 * _HEIGHT + 0.0025:g}"),
    ]


def _link(robot: ET.Element, name: str, shapes: list[tuple[str, dict[str, str], str]]) -> None:
    link = ET.SubElement(robot, "link", name=name)
    for shape, sizes, place in shapes:
        visual = ET.SubElement(link, "visual")
        ET.SubElement(visual, "origin", xyz=place, rpy="0 0 0")
        ET.SubElement(ET.SubElement(visual, "geometry"), shape, sizes)
        colour = ET.SubElement(visual, "material", name="servo_dial" if shape == "cylinder" else "servo_pointer")
        ET.SubElement(colour, "color", rgba="0.25 0.27 0.30 1" if shape == "cylinder" else "0.16 0.47 0.84 1")


def _text(value: float) -> str:
    """Text of a number, limited to `NO_LIMIT`; it converts back to the same number."""
    return repr(min(max(float(value), -NO_LIMIT), NO_LIMIT))


# ---- reading
def joints_of(description: str) -> list[Joint]:
    """Joints of a description generated by `describe`, in the order of the axes.

    Raises
    ------
    ValueError
        If the description is not one of a servo.
    """
    try:
        robot = ET.fromstring(description)
    except ET.ParseError as error:
        raise ValueError(f"the robot description is not XML: {error}") from None
    catalogue = Catalogue.load()
    joints = []
    for gear in robot.iterfind("ros2_control/transmission"):
        part = _child(gear, "joint")
        name = part.get("name", "")
        matches = [joint for joint in robot.iterfind("joint") if joint.get("name") == name]
        if len(matches) != 1:
            raise ValueError(f"the robot description has a transmission of joint {name!r}, which does not exist")
        reduction = _number(_child(part, "mechanical_reduction").text, f"mechanical_reduction of {name}")
        offset = _number(_child(part, "offset").text, f"offset of {name}")
        joint = Joint(name, abs(reduction), -1 if reduction < 0.0 else 1, offset)
        wraps = matches[0].get("type") == "continuous"
        joints.append(replace(joint, limits=_limits(matches[0], _counter_range(joint, catalogue)), wraps=wraps))
    if len(joints) != AXES:
        raise ValueError(f"the robot description has {len(joints)} transmissions; {AXES} expected")
    return joints


def motors_of(description: str) -> list[Motor]:
    """Motors of a description generated by `describe`, in the order of the axes; empty if it contains none.

    Raises
    ------
    ValueError
        If a value is not a number.
    """
    motors = []
    for joint in ET.fromstring(description).iterfind("ros2_control/joint"):
        values = {param.get("name", ""): param.text for param in joint.iterfind("param")}
        names = [each.name for each in fields(Motor)]
        if all(name in values for name in names):
            motors.append(Motor(*(_number(values[name], f"{name} of {joint.get('name')}") for name in names)))
    return motors if len(motors) == AXES else []


def _limits(joint: ET.Element, unlimited: tuple[float, float]) -> JointLimits:
    name, limit = joint.get("name"), _child(joint, "limit")
    keys = ("velocity", "effort") if joint.get("type") == "continuous" else ("lower", "upper", "velocity", "effort")
    found = {key: _number(limit.get(key), f"limit {key} of {name}") for key in keys}
    finite = {key: value for key, value in found.items() if abs(value) < NO_LIMIT and value not in unlimited}
    return JointLimits(
        finite.get("lower", -math.inf),
        finite.get("upper", math.inf),
        finite.get("velocity", math.inf),
        finite.get("effort", math.inf),
    )


def _child(parent: ET.Element, tag: str) -> ET.Element:
    found = parent.find(tag)
    if found is None:
        raise ValueError(f"the robot description has a {parent.tag} {parent.get('name', '')} without {tag}")
    return found


def _number(text: str | None, label: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"the robot description has {text!r} as {label}, which is not a number")
    return value
