"""Parameters of the bridge node: declaration with descriptors, checks, and the typed object `Settings`.

Most of them can be changed only while the node is unconfigured.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from servo_msgs_py.board_parameters import Assignment, merged
from servo_msgs_py.catalogue import AXES, Catalogue
from servo_msgs_py.joints import Joint, JointLimits, joint_names
from servo_msgs_py.robot_description import NO_LIMIT
from servo_msgs_py.run_file.series import Limits
from servo_msgs_py.runtime.node_shell import full_name
from servo_msgs_py.runtime.parameters import ParameterError, Spec, spec
from servo_msgs_py.runtime.parameters import declare as declare_all

from servo_bridge.bursts.request import BurstRequest
from servo_bridge.runs.run_service import RunSettings
from servo_bridge.telemetry import telemetry_variables
from servo_bridge.tool_values import UsageError
from servo_bridge.trajectory.goal import GoalDefaults
from servo_bridge.trajectory.tolerances import Tolerance
from servo_msgs_py import board_parameters, topics

__all__ = [
    "PARAMETERS",
    "Configured",
    "ParameterError",
    "Settings",
    "Spec",
    "declare",
    "settings_from",
    "values_of",
    "watch",
]

_ENTRIES_MAX: Final = 256
"""Largest number of entries of a list; the board has fewer variables that can be chosen."""

_TEXT_MAX: Final = 4096
"""Longest text; that of a path."""

_JOINT = re.compile(r"[A-Za-z][A-Za-z0-9_]*")

_AT_START: Mapping[str, Spec] = {
    "autostart": spec(
        True, "whether the node configures and activates itself, read once at the start; no axis is enabled by it"
    ),
}

_SETTINGS: Mapping[str, Spec] = {
    "port": spec(
        "/dev/ttyUSB0", "serial port of the board: a device path or any pyserial URL such as socket://host:port"
    ),
    "baud": spec(115200, "line speed of the serial port [bit/s]", 1200, 4_000_000),
    "joints": spec(["axis1", "axis2"], "joint names in the order of the axes"),
    "gear_ratio": spec([1.0, 1.0], "turns of the motor per turn of the joint, per joint, 0.0001 .. 100000"),
    "direction": spec([1, 1], "1, or -1 if joint and motor turn in opposite directions, per joint"),
    "offset": spec([0.0, 0.0], "position of the joint at motor position 0, per joint [rad]"),
    "wraps": spec(
        [False, False],
        "true: positions of the joint are angles in -pi .. pi, as of a joint that is continuous in URDF; set-points "
        "take the shorter way. False: the joint counts its turns. Per joint",
    ),
    "used": spec(
        [True, True],
        "false: no motor is connected; the service enable leaves the axis off, its set-points are refused, and its "
        "faults do not keep the other joint from moving. Per joint, at least one true",
    ),
    "telemetry": spec(
        [
            "u_dc",
            *(
                f"axis{k}.{name}"
                for k in (1, 2)
                for name in ("position_ref", "speed_ref", "i_q_ref", "limits", "u_d", "u_q")
            ),
        ],
        "variables read with every sample and published on snapshot, in addition to those that the bridge requires "
        "(tick, applied_tick, applied_count; of each axis position, speed, i_q, state, substate, faults); each "
        "additional byte reduces the sample rate; [''] for none",
    ),
    "telemetry_rate": spec(
        0.0,
        "highest rate of samples [Hz]; 0.0: as fast as the line permits. A lower rate reduces the load of the computer "
        "and leaves more of the line for set-points",
        0.0,
        10_000.0,
    ),
    "variables": spec(
        ["u_dc", "axis1.i_q", "axis2.i_q"],
        "variables published one by one as var/<name>; those that are not in the telemetry are read one at a time, "
        "which reduces the sample rate; [''] for none",
    ),
    "variable_rate": spec(20.0, "rate of the var/ topics [Hz]", 0.1, 200.0),
    "joint_states_rate": spec(0.0, "highest rate of joint_states [Hz]; 0 publishes every sample", 0.0, 10_000.0),
    "snapshot_period": spec(
        0.02, "shortest time between two snapshot messages, which carry all samples since the last one [s]", 0.0, 1.0
    ),
    "position_min": spec(
        [-NO_LIMIT, -NO_LIMIT],
        "lowest position set-point per joint [rad]; -1.0e+15: no limit. Single steps are limited to 2^30 counts of the "
        "motor (1686630 rad of its shaft)",
        read_only=False,
    ),
    "position_max": spec(
        [NO_LIMIT, NO_LIMIT], "highest position set-point per joint [rad]; 1.0e+15: no limit", read_only=False
    ),
    "velocity_max": spec(
        [419.0, 419.0], "largest velocity set-point per joint [rad/s], within the limit of the board", read_only=False
    ),
    "effort_max": spec(
        [1.0, 1.0],
        "largest effort set-point per joint [N m], within the limit of the board: current limit times torque constant "
        "times gear ratio",
        read_only=False,
    ),
    "command_interfaces": spec(
        ["", ""],
        "arrays of joint_commands that contain each joint, such as 'position velocity' or 'effort'; needed if the "
        "sender omits joints in an array, as ros2_control does with joints of different command interfaces; "
        "empty: all",
    ),
    "stream_delay_max": spec(
        0.0,
        "longest delay for the compensation of jitter and loss of streamed set-points [s]; 0.0: one period of them "
        "and up to 0.02 s of jitter",
        0.0,
        1.0,
    ),
    "path_tolerance": spec(
        [0.0, 0.0],
        "default for goals of follow_joint_trajectory: largest distance of a joint from its path [rad]; 0.0: any",
    ),
    "goal_tolerance": spec(
        [0.02, 0.02],
        "default for goals of follow_joint_trajectory: largest distance of a joint from the end of its path [rad]; "
        "0.0: any",
    ),
    "stopped_velocity_tolerance": spec(
        0.0,
        "for goals of follow_joint_trajectory: largest speed of a joint at the end of its path [rad/s]; 0.0: any",
        0.0,
        1000.0,
    ),
    "goal_time": spec(
        1.0,
        "default for goals of follow_joint_trajectory: time after the end of the path in which the joints must be "
        "within their tolerances [s]; 0.0: no waiting",
        0.0,
        3600.0,
    ),
    "recording": spec(
        "axis1.i_q axis1.i_q_ref axis2.i_q axis2.i_q_ref",
        "variables and options of the recordings of the service record, as for servo-tool record, such as "
        "\"axis1.i_a axis1.i_q --trigger 'axis1.i_q > 1.0' --before 30% --rate 16000\"",
        read_only=False,
    ),
    "run_file": spec(
        "",
        "path of a .mcap file on the computer of the bridge for a recording of the run (doc/recording.md), with the "
        "codes of strftime such as %Y%m%d-%H%M%S; if it is set at the start the recording begins then, else with the "
        "service record_run; empty: none",
        read_only=False,
    ),
    "run_file_size": spec(
        1000.0,
        "largest size of all files of a recording of the run, beyond which the oldest messages are removed [MB]",
        1.0,
        1e6,
        read_only=False,
    ),
    "run_file_duration": spec(
        0.0,
        "largest duration of a recording of the run, beyond which the oldest messages are removed [s]; 0.0: any",
        0.0,
        1e7,
        read_only=False,
    ),
    "run_topics": spec(
        ["../twin/", "/rosout"],
        "topics of other nodes in a recording of the run; with / at the end: all that begin so; ../ begins beside the "
        "namespace of the bridge; [''] for none",
        read_only=False,
    ),
    "run_left_out": spec(
        [""],
        "topics that a recording of the run leaves out, in the form of run_topics, but relative to the namespace of "
        "the bridge: ['joint_states', 'var/', '../twin/'] can be computed again from the others; [''] for none",
        read_only=False,
    ),
    "tuning": spec(
        "",
        "path of a TOML file in the form of servo.toml, on the computer of the bridge: the configuration of the axes "
        "that the service tune sends to the board",
        read_only=False,
    ),
    "home_positions": spec(
        [0.0, 0.0],
        "position of each joint at its homing stop or switch, or at which its position is set [rad] (doc/homing.md)",
        read_only=False,
    ),
    "restore_positions": spec(
        True,
        "whether the positions of a restarted board are restored (home_state ASSUMED), for axes with the feature "
        "HOMING that are at rest",
        read_only=False,
    ),
    "preferred_source": spec(
        "",
        "topic with precedence, such as joint_commands: while it commands an axis, and for 1 s after that, set-points "
        "of other topics for this axis are refused; empty: the newest set-point applies",
        read_only=False,
    ),
    "board_parameters": spec(
        [""],
        "parameters set on the board at every connection and whenever this list changes, each as NAME=VALUE such as "
        "param.features[0]=ANTI_WINDUP+POSITION_LIMITS or param.i_q_limit=1.0,1.5; [''] for none. A parameter removed "
        "from the list keeps its value on the board until a reset. A velocity or effort set-point that is not sent "
        "again within 0.5 s ends in a stop; param.command_timeout=1.0 changes this time [s], 0: no timeout",
        read_only=False,
    ),
}

PARAMETERS: Mapping[str, Spec] = {**_AT_START, **_SETTINGS}
"""All parameters of the node; ``config/servo_bridge.yaml`` is generated from them."""


@dataclass(frozen=True)
class Settings:
    """Checked parameter values; see `PARAMETERS` for their meaning."""

    port: str
    baud: int  # [bit/s]
    joints: tuple[Joint, ...]
    telemetry: tuple[str, ...]
    telemetry_rate: float  # [Hz]
    variables: tuple[str, ...]
    variable_rate: float  # [Hz]
    joint_states_rate: float  # [Hz]
    snapshot_period: float  # [s]
    command_interfaces: Mapping[str, frozenset[str]] | None
    stream_delay_max: float  # [s]
    goal_defaults: GoalDefaults
    board_parameters: tuple[Assignment, ...]
    recording: BurstRequest
    run: RunSettings
    tuning: str
    preferred_source: str
    home_positions: tuple[float, ...]  # by axis, joint units [rad]
    restore_positions: bool

    @property
    def names(self) -> list[str]:
        """Joint names in the order of the axes."""
        return joint_names(self.joints)


def settings_from(values: Mapping[str, Any], catalogue: Catalogue) -> Settings:
    """Check the values for consistency and against the catalogue.

    Raises
    ------
    ParameterError
        If a value is invalid.
    """
    _check_sizes(values)
    names = tuple(values["joints"])
    if len(names) != AXES or len(set(names)) != AXES or not all(map(_JOINT.fullmatch, names)):
        raise ParameterError(
            f"parameter joints is {list(names)}; write {AXES} different names of letters, digits and underscores"
        )
    if not values["port"]:
        raise ParameterError("parameter port is empty; write a device path or a pyserial URL")
    # One empty name represents an empty list: ROS parameter files have no typed empty list.
    extra = [name for name in values["telemetry"] if name]
    variables = tuple(name for name in values["variables"] if name)
    try:
        telemetry = tuple(telemetry_variables(catalogue, extra))
    except ValueError as error:
        raise ParameterError(f"parameter telemetry: {error}") from None
    try:
        telemetry_variables(catalogue, variables)
    except ValueError as error:
        raise ParameterError(f"parameter variables: {error}") from None
    return Settings(
        port=values["port"],
        baud=values["baud"],
        joints=_joints(values),
        telemetry=telemetry,
        telemetry_rate=values["telemetry_rate"],
        variables=variables,
        variable_rate=values["variable_rate"],
        joint_states_rate=values["joint_states_rate"],
        snapshot_period=values["snapshot_period"],
        command_interfaces=_interfaces(values["command_interfaces"], names),
        stream_delay_max=values["stream_delay_max"],
        goal_defaults=_goal_defaults(values, names),
        board_parameters=_board_parameters(values["board_parameters"], catalogue),
        recording=_recording(values["recording"]),
        run=_run(values),
        tuning=values["tuning"],
        preferred_source=_preferred_source(values["preferred_source"], names),
        home_positions=_home_positions(values, catalogue),
        restore_positions=values["restore_positions"],
    )


def _check_sizes(values: Mapping[str, Any]) -> None:
    """Refuse large values before any work on them: a change is checked in the thread that serves the axes."""
    for name, value in values.items():
        entries = value if isinstance(value, list) else [value]
        if len(entries) > _ENTRIES_MAX:
            raise ParameterError(
                f"parameter {name} has {len(entries)} entries, more than {_ENTRIES_MAX}; write at most {_ENTRIES_MAX}"
            )
        longest = max((len(entry) for entry in entries if isinstance(entry, str)), default=0)
        if longest > _TEXT_MAX:
            raise ParameterError(
                f"parameter {name} has a text of {longest} characters, more than {_TEXT_MAX}; write a shorter one"
            )


def _interfaces(texts: Sequence[str], joints: Sequence[str]) -> Mapping[str, frozenset[str]] | None:
    known = ("position", "velocity", "effort")
    if len(texts) != len(joints) or not {word for text in texts for word in text.split()} <= set(known):
        raise ParameterError(
            f"parameter command_interfaces is {list(texts)}; write {len(joints)} texts, one per joint, of the words "
            f"{', '.join(known)}"
        )
    if not any(texts):
        return None
    return {joint: frozenset(text.split() or known) for joint, text in zip(joints, texts, strict=True)}


def _preferred_source(topic: str, joints: Sequence[str]) -> str:
    known = [
        topics.JOINT_COMMANDS,
        topics.COMMANDS,
        topics.JOINT_TRAJECTORY,
        topics.FOLLOW_JOINT_TRAJECTORY,
        *map(topics.joint_position_topic, joints),
    ]
    if topic and topic not in known:
        raise ParameterError(
            f"parameter preferred_source is {topic!r}; write one of {', '.join(known)}, or an empty text"
        )
    return topic


def _home_positions(values: Mapping[str, Any], catalogue: Catalogue) -> tuple[float, ...]:
    numbers = _per_joint(values, "home_positions")
    reference = catalogue["cmd.home_position"]
    for joint, position in zip(_joints(values), numbers, strict=True):
        low, high = sorted(joint.position(reference.scale(raw)) for raw in reference.raw_range)
        if not low <= position <= high:
            raise ParameterError(
                f"parameter home_positions of {joint.name} is {position:g} rad, outside {low:g} .. {high:g} rad, the "
                "range of the board; write a position within it"
            )
    return tuple(numbers)


def _recording(text: str) -> BurstRequest:
    try:
        return BurstRequest.parse(text)
    except UsageError as error:
        raise ParameterError(f"parameter recording: {error}") from None


def _run(values: Mapping[str, Any]) -> RunSettings:
    path = values["run_file"]
    if path and not path.endswith(".mcap"):
        raise ParameterError(f"parameter run_file is {path!r}; write a path that ends with .mcap, or an empty text")
    limits = Limits(values["run_file_size"] * 1e6, values["run_file_duration"] or math.inf)
    others, left_out = (tuple(filter(None, values[name])) for name in ("run_topics", "run_left_out"))
    return RunSettings(path, limits, others, left_out)


def _board_parameters(texts: Sequence[str], catalogue: Catalogue) -> tuple[Assignment, ...]:
    try:
        result = merged([], (board_parameters.parse(text, catalogue) for text in texts if text))
    except ValueError as error:
        raise ParameterError(f"parameter board_parameters: {error}") from None
    problem = board_parameters.contradiction(board_parameters.applied(result, {}), catalogue)
    if problem:
        raise ParameterError(f"parameter board_parameters: {problem}")
    return tuple(result)


def _joints(values: Mapping[str, Any]) -> tuple[Joint, ...]:
    gears = (_per_joint(values, name) for name in ("gear_ratio", "direction", "offset"))
    used = _flags(values, "used")
    if not any(used):
        raise ParameterError(f"parameter used is {list(used)}; write true for at least one joint")
    rows = zip(values["joints"], *gears, _limits(values), _flags(values, "wraps"), used, strict=True)
    try:
        return tuple(Joint(*row) for row in rows)
    except ValueError as error:
        raise ParameterError(f"parameter {error}") from None


def _limits(values: Mapping[str, Any]) -> list[JointLimits]:
    rows = {name: _per_joint(values, name) for name in ("position_min", "position_max", "velocity_max", "effort_max")}
    for name in ("velocity_max", "effort_max"):
        if min(rows[name]) < 0.0:
            raise ParameterError(f"parameter {name} is {list(values[name])}; must not be negative")
    limits = [JointLimits(*map(_unlimited, row)) for row in zip(*rows.values(), strict=True)]
    for limit in limits:
        if limit.position_min > limit.position_max:
            raise ParameterError(
                f"parameter position_min {limit.position_min:g} is above position_max {limit.position_max:g}"
            )
    return limits


def _per_joint(values: Mapping[str, Any], name: str) -> Sequence[Any]:
    numbers: Sequence[Any] = values[name]
    if len(numbers) != AXES or any(math.isnan(x) for x in numbers):
        raise ParameterError(f"parameter {name} is {list(numbers)}; write {AXES} numbers, one per joint")
    return numbers


def _flags(values: Mapping[str, Any], name: str) -> Sequence[bool]:
    flags: Sequence[bool] = values[name]
    if len(flags) != AXES:
        raise ParameterError(f"parameter {name} is {list(flags)}; write {AXES} of true and false, one per joint")
    return flags


def _goal_defaults(values: Mapping[str, Any], names: Sequence[str]) -> GoalDefaults:
    rows = {name: _per_joint(values, name) for name in ("path_tolerance", "goal_tolerance")}
    for name, numbers in rows.items():
        if min(numbers) < 0.0:
            raise ParameterError(f"parameter {name} is {list(numbers)}; must not be negative; 0.0: any distance")
    speed = values["stopped_velocity_tolerance"] or math.inf
    path = {joint: Tolerance(x or math.inf) for joint, x in zip(names, rows["path_tolerance"], strict=True)}
    goal = {joint: Tolerance(x or math.inf, speed) for joint, x in zip(names, rows["goal_tolerance"], strict=True)}
    return GoalDefaults(path, goal, values["goal_time"])


def _unlimited(limit: float) -> float:
    """Infinity for limits from `NO_LIMIT`: some tools read infinity and Python exponents in YAML as strings."""
    return limit if abs(limit) < NO_LIMIT else math.copysign(math.inf, limit)


def declare(node: Node) -> dict[str, Any]:
    """Declare all parameters; return their values at the start.

    Raises
    ------
    ParameterError
        If a given value has the wrong type or is out of range.
    """
    return {**declare_all(node, _AT_START), **declare_all(node, _SETTINGS, managed=True)}


def values_of(node: Node) -> dict[str, Any]:
    """Values of the declared parameters, for `settings_from`."""
    return {name: _plain(node.get_parameter(name).value) for name in PARAMETERS}


def _plain(value: Any) -> Any:
    """Convert an array to the declared list."""
    return value.tolist() if isinstance(value, array) else value


class Configured(Protocol):
    """Object that uses the settings."""

    def refuse_settings(self, settings: Settings) -> str:
        """Return a reason to refuse new settings; empty if they can be applied."""

    def settings_changed(self, settings: Settings) -> None:
        """Apply new settings."""


def watch(node: Node, catalogue: Catalogue, configured: Callable[[], Configured | None]) -> None:
    """Check changes at run time; an invalid change is refused with its reason.

    Parameters
    ----------
    node : Node
        Node whose parameters are declared.
    catalogue : Catalogue
        Used for the checks.
    configured : callable
        Returns the object that uses the settings; None while the node is unconfigured.
    """

    def check(parameters: list[Parameter]) -> SetParametersResult:
        before = values_of(node)
        reason = refusal(before, before | {p.name: _plain(p.value) for p in parameters})
        return SetParametersResult(successful=not reason, reason=reason)

    def refusal(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
        target = configured()
        fixed = [name for name, spec in PARAMETERS.items() if spec.read_only and after[name] != before[name]]
        if fixed and target is not None:
            return (
                f"parameter {fixed[0]} can be changed only while the node is unconfigured: ros2 lifecycle set "
                f"/{full_name(node)} deactivate, then cleanup"
            )
        try:
            settings = settings_from(after, catalogue)
        except ParameterError as error:
            # Several invalid parameters are corrected one by one; configure reports the remaining ones.
            return "" if target is None and not _is_valid(before, catalogue) else str(error)
        return "" if target is None else target.refuse_settings(settings)

    def apply(parameters: list[Parameter]) -> None:
        target = configured()
        if target is not None and any(p.name in PARAMETERS for p in parameters):
            target.settings_changed(settings_from(values_of(node), catalogue))

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(apply)


def _is_valid(values: Mapping[str, Any], catalogue: Catalogue) -> bool:
    try:
        settings_from(values, catalogue)
    except ParameterError:
        return False
    return True
