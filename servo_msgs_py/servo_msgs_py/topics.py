"""Names of topics and services; their quality of service is in `servo_msgs_py.runtime.qos`.

All names are relative: the board's node lives in the namespace ``/servo``, the twin offers the same names in
``/twin``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

# ---- telemetry
JOINT_STATES: Final = "joint_states"
SNAPSHOT: Final = "snapshot"
"""std_msgs/Float64MultiArray: rows of telemetry, SI; column names, comma separated, in ``layout.dim[1].label``."""
STAMP_COLUMNS: Final = ("stamp.sec", "stamp.nanosec")
"""Last two columns of `SNAPSHOT`: ROS time of the row, exact."""
COMMANDS_APPLIED: Final = "commands_applied"
"""std_msgs/Float64MultiArray: one write that took effect, see `COMMAND_COLUMNS`; raw firmware integers."""
PARAMETERS: Final = "parameters"
"""std_msgs/Float64MultiArray, latched: all parameters of the board, one row in the form of `SNAPSHOT`."""
FAULT_RECORD: Final = "fault_record"
"""std_msgs/Float64MultiArray, latched, ``<joint>/fault_record``: samples before the first fault in the form of
`SNAPSHOT`; ``layout.dim[0].label`` names the fault."""
RECORDING: Final = "recording"
"""std_msgs/Float64MultiArray, latched: a burst of the recorder in the form of `SNAPSHOT`, with the columns ``tick`` and
`BURST_TIME`; ``layout.dim[0].label`` says what it is."""
RECORDER: Final = "recorder"
"""std_msgs/Float64MultiArray, latched: what the recorder is about to record, said before it starts, see
`servo_msgs_py.recorder_setup`; no row when it is idle."""
BURST_TIME: Final = "time"
"""Column of `RECORDING`: time since the trigger [s]."""
TUNING: Final = "tuning"
"""std_msgs/String, latched: the configuration of the axes of the board as the TOML file that gives it."""
ROBOT_DESCRIPTION: Final = "robot_description"
"""std_msgs/String, latched: URDF of the joints, see `servo_msgs_py.robot_description`."""
WINDING_TEMPERATURES: Final = "winding_temperatures"
"""std_msgs/Float64MultiArray, latched, once a second: of both motors, as the board estimates them [deg C]."""
STATE: Final = "state"
ARMED: Final = "armed"
DIAGNOSTICS: Final = "/diagnostics"
RESIDUAL: Final = "residual"
RESIDUAL_RECORDING: Final = "residual/recording"
"""std_msgs/Float64MultiArray, latched: a burst of the board minus that of the twin, in the form of `RECORDING`; NaN
where the two cannot be compared."""
HEALTHY: Final = "healthy"
DIAGNOSIS: Final = "diagnosis"
"""diagnostic_msgs/DiagnosticArray, latched: what has changed on the board against the twin, and the estimates."""

# ---- commands
JOINT_COMMANDS: Final = "joint_commands"
COMMANDS: Final = "commands"
JOINT_TRAJECTORY: Final = "joint_trajectory"
FOLLOW_JOINT_TRAJECTORY: Final = "follow_joint_trajectory"
"""control_msgs/action/FollowJointTrajectory, where that package is installed."""
ENABLE: Final = "enable"
QUICK_STOP: Final = "quick_stop"
CLEAR_FAULTS: Final = "clear_faults"
RECORD: Final = "record"
"""std_srvs/SetBool: begin to record what the parameter ``recording`` says, or end it before its trigger."""
TUNE: Final = "tune"
"""std_srvs/SetBool: give the board the configuration of the file that the parameter ``tuning`` names; with data: false
only say what would change."""
HOME: Final = "home"
"""std_srvs/Trigger, ``<joint>/home/<method>``: make the position of a joint known."""
POSITION_KNOWN: Final = "position_known"
"""std_msgs/Bool, latched, ``<joint>/position_known``: whether the position was set or found since the board's reset."""
SAVE_TO_BOARD: Final = "save_to_board"
"""std_srvs/Trigger: keep parameters and configuration in the data flash of the board."""
RESTORE_FACTORY: Final = "restore_factory"
"""std_srvs/Trigger: erase what the data flash keeps."""
RESYNC: Final = "resync"

COMMAND_VARIABLES: Final = (
    "cmd.position",
    "cmd.speed",
    "cmd.i_q",
    "cmd.mode",
    "cmd.enable",
    "cmd.quick_stop",
    "cmd.clear_faults",
    "cmd.points",
    "config.take",
    "cmd.home_position",
    "cmd.home",
)
"""Command variables in the order that numbers them in `COMMANDS_APPLIED`; the bridge writes no ``cmd.test_*``."""

COMMAND_COLUMNS: Final = ("variable", "applied_tick", "axes_mask", "raw_axis1", "raw_axis2")
"""Columns of `COMMANDS_APPLIED`: index into `COMMAND_VARIABLES`, tick, bit per written axis, raw numbers. The words of
``cmd.points`` stand in the place of the raw numbers of the axes, as many as were written, and so do the members of the
blocks of ``config.take``, one axis after the other."""


def variable_topic(name: str, joints: Sequence[str] = ()) -> str:
    """Topic of one variable: ``axis1.i_q`` becomes ``var/axis1/i_q``, with the joint's name for that of the axis."""
    return "var/" + _by_joint(name, joints)


def residual_topic(name: str, joints: Sequence[str] = ()) -> str:
    """Topic of the residual of one variable, named in the same way."""
    return "residual/" + _by_joint(name, joints)


def _by_joint(name: str, joints: Sequence[str]) -> str:
    """Parts of a variable's name as parts of a topic, ``axis<k>`` replaced by the name of joint k."""
    names = {f"axis{k}": joint for k, joint in enumerate(joints, 1)}
    return "/".join(names.get(part, part) for part in name.split("."))


def fault_record_topic(joint: str) -> str:
    """Topic of what led to the first fault of one joint."""
    return f"{joint}/{FAULT_RECORD}"


def home_service(joint: str, method: str) -> str:
    """Service that makes the position of one joint known in one way."""
    return f"{joint}/{HOME}/{method}"


def position_known_topic(joint: str) -> str:
    """Topic that says whether the position of one joint is known."""
    return f"{joint}/{POSITION_KNOWN}"


def joint_position_topic(joint: str) -> str:
    """Topic that takes a position [rad] for one joint."""
    return f"{joint}/position"


def within(parent: str, namespace: str) -> str:
    """Absolute namespace, without a slash at its end; one that does not begin with a slash lies in `parent`."""
    namespace = namespace.rstrip("/")
    return namespace if namespace.startswith("/") or not namespace else f"{parent.rstrip('/')}/{namespace}"
