"""Names of topics and services; their quality of service is in `servo_msgs_py.runtime.qos`.

All names are relative: the node of the board is in the namespace ``/servo``; the twin has the same names in ``/twin``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

# ---- telemetry
JOINT_STATES: Final = "joint_states"
SNAPSHOT: Final = "snapshot"
"""std_msgs/Float64MultiArray: rows of telemetry, SI; column names, comma separated, in ``layout.dim[1].label``."""
STAMP_COLUMNS: Final = ("stamp.sec", "stamp.nanosec")
"""Last two columns of `SNAPSHOT`: exact ROS time of the row."""
COMMANDS_APPLIED: Final = "commands_applied"
"""std_msgs/Int64MultiArray: one applied write. The label of the dimension is the variable; the data are the tick of its
effect, the bit mask of the written axes, and the raw numbers of `servo_msgs_py.convert.AppliedCommand`."""
PARAMETERS: Final = "parameters"
"""std_msgs/Float64MultiArray, latched: all parameters of the board, one row in the format of `SNAPSHOT`."""
FAULT_RECORD: Final = "fault_record"
"""std_msgs/Float64MultiArray, latched, ``<joint>/fault_record``: samples before the first fault in the format of
`SNAPSHOT`; ``layout.dim[0].label`` contains the fault."""
RECORDING: Final = "recording"
"""std_msgs/Float64MultiArray, latched: a burst of the recorder in the format of `SNAPSHOT`, with the columns ``tick``
and `BURST_TIME`; ``layout.dim[0].label`` contains its description."""
RECORDER: Final = "recorder"
"""std_msgs/Float64MultiArray, latched: set-up of the recorder, published before it starts, see
`servo_msgs_py.recorder_setup`; no row if it is idle."""
BURST_TIME: Final = "time"
"""Column of `RECORDING`: time since the trigger [s]."""
TUNING: Final = "tuning"
"""std_msgs/Int64MultiArray, latched: the configuration blocks of the board, see `servo_msgs_py.blocks_message`."""
ROBOT_DESCRIPTION: Final = "robot_description"
"""std_msgs/String, latched: URDF of the joints, see `servo_msgs_py.robot_description`."""
RUN_INFO: Final = "run_info"
"""std_msgs/String, latched: what runs, a JSON document, see `servo_msgs_py.run_file.run_info`."""
RUN_LOST: Final = "run_lost"
"""std_msgs/UInt64, in recordings only: number of messages that the recorder has lost."""
CALLS: Final = "calls"
"""std_msgs/String, in recordings only: a call of a service that changes something, or of the action, or its response,
as a JSON document with the name of the service and the members of ``request`` or ``response``."""
GOALS: Final = "goals"
"""trajectory_msgs/JointTrajectory, in recordings only, below the name of the action: the trajectory of each goal."""
WINDING_TEMPERATURES: Final = "winding_temperatures"
"""std_msgs/Float64MultiArray, latched, once a second: estimated winding temperatures of both motors [deg C]."""
STATE: Final = "state"
"""std_msgs/String, latched: states of the joints for people; programs read `LINK`, `ARMED` and `SNAPSHOT`."""
LINK: Final = "link"
"""diagnostic_msgs/DiagnosticStatus, latched: level OK while a board is connected, else ERROR; the message is the reason
and the remedy."""
ARMED: Final = "armed"
DIAGNOSTICS: Final = "/diagnostics"
RESIDUAL: Final = "residual"
RESIDUAL_RECORDING: Final = "residual/recording"
"""std_msgs/Float64MultiArray, latched: a burst of the board minus the burst of the twin, in the format of `RECORDING`;
NaN for values without a counterpart."""
HEALTHY: Final = "healthy"
DIAGNOSIS: Final = "diagnosis"
"""diagnostic_msgs/DiagnosticArray, latched: detected changes of the board relative to the twin, and the estimates."""

# ---- commands
JOINT_COMMANDS: Final = "joint_commands"
COMMANDS: Final = "commands"
JOINT_TRAJECTORY: Final = "joint_trajectory"
FOLLOW_JOINT_TRAJECTORY: Final = "follow_joint_trajectory"
"""control_msgs/action/FollowJointTrajectory, if that package is installed."""
ANSWERS: Final = "answers"
"""diagnostic_msgs/DiagnosticStatus: what became of the commands with a ticket, see `servo_msgs_py.answers`."""
LEASES: Final = "leases"
"""std_msgs/String: ticket of a trajectory whose sender is still there, see `servo_msgs_py.answers`."""
ENABLE: Final = "enable"
QUICK_STOP: Final = "quick_stop"
CLEAR_FAULTS: Final = "clear_faults"
RECORD: Final = "record"
"""std_srvs/SetBool: start the recording set by the parameter ``recording``, or end it before its trigger."""
RECORD_RUN: Final = "record_run"
"""std_srvs/SetBool: start a recording of everything in the file of the parameter ``run_file``, or end it."""
TUNE: Final = "tune"
"""std_srvs/SetBool: send the configuration in the file of the parameter ``tuning``; data: false: dry run."""
HOME: Final = "home"
"""std_srvs/Trigger, ``<joint>/home/<method>``: homing service of a joint."""
HOME_METHODS: Final = ("here", "stop_positive", "stop_negative", "switch_positive", "switch_negative")
"""Methods to set the position of a joint; directions are those of the joint."""
POSITION_KNOWN: Final = "position_known"
"""std_msgs/Bool, latched, ``<joint>/position_known``: whether the position was set or found since the last reset."""
SAVE_TO_BOARD: Final = "save_to_board"
"""std_srvs/Trigger: store parameters and configuration in the data flash of the board."""
RESTORE_FACTORY: Final = "restore_factory"
"""std_srvs/Trigger: erase the values stored in the data flash."""
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
"""Command variables; the bridge does not write ``cmd.test_*``. Parameters take effect at a tick like commands."""


def variable_topic(name: str, joints: Sequence[str] = ()) -> str:
    """Topic of one variable: ``axis1.i_q`` becomes ``var/axis1/i_q``, with the joint instead of the axis."""
    return "var/" + _by_joint(name, joints)


def residual_topic(name: str, joints: Sequence[str] = ()) -> str:
    """Topic of the residual of one variable; names as in `variable_topic`."""
    return "residual/" + _by_joint(name, joints)


def _by_joint(name: str, joints: Sequence[str]) -> str:
    """Parts of the name of a variable as parts of a topic, ``axis<k>`` replaced by the name of joint k."""
    names = {f"axis{k}": joint for k, joint in enumerate(joints, 1)}
    return "/".join(names.get(part, part) for part in name.split("."))


def fault_record_topic(joint: str) -> str:
    """Topic of the fault record of one joint."""
    return f"{joint}/{FAULT_RECORD}"


def home_service(joint: str, method: str) -> str:
    """Homing service of one joint by one method."""
    return f"{joint}/{HOME}/{method}"


def position_known_topic(joint: str) -> str:
    """Topic of the state "position known" of one joint."""
    return f"{joint}/{POSITION_KNOWN}"


def joint_position_topic(joint: str) -> str:
    """Topic of position commands [rad] for one joint."""
    return f"{joint}/position"


def within(parent: str, namespace: str) -> str:
    """Absolute namespace without a trailing slash; relative to `parent` if it does not begin with a slash."""
    namespace = namespace.rstrip("/")
    return namespace if namespace.startswith("/") or not namespace else f"{parent.rstrip('/')}/{namespace}"
