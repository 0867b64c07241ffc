"""The two axes under ros2_control: bridge, robot_state_publisher, controller_manager and two controllers.

ros2 launch servo_bridge ros2_control.launch.py port:=/dev/ttyUSB0
ros2 launch servo_bridge ros2_control.launch.py virtual:=true
ros2 service call /servo/enable std_srvs/srv/SetBool "{data: true}"       # then the controllers move the axes

Needs ros-jazzy-ros2-control, ros-jazzy-ros2-controllers, ros-jazzy-joint-state-topic-hardware-interface and
ros-jazzy-robot-state-publisher. See doc/ros2_control.md.
"""

import tempfile
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_entity import LaunchDescriptionEntity
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import Node, PushRosNamespace
from launch_ros.parameter_descriptions import ParameterValue
from servo_bridge.description import description_from_file, settings_from_file
from servo_bridge.telemetry import rate_for_controllers
from servo_msgs_py.text_file import read_text

CONFIG = Path(get_package_share_directory("servo_bridge")) / "config"

ARGUMENTS = {
    "virtual": ("false", "true: start a virtual board"),
    "port": ("", "serial port of the board, or a pyserial URL; empty: as for bridge.launch.py"),
    "baud": ("1000000", "line speed [bit/s]; for a real board the value of its firmware"),
    "namespace": ("", "namespace of all nodes, different for each board"),
    "params": (str(CONFIG / "servo_bridge.yaml"), "parameter file of the bridge; also source of joints and limits"),
    "controllers": (str(CONFIG / "ros2_controllers.yaml"), "parameter file of controller_manager and controllers"),
    "twin": ("false", "true: start the twin, too"),
    "viewer": ("false", "true: start the rerun viewer, too"),
}


def _update_rate(controllers: str) -> float:
    """Update rate in a parameter file of the controller_manager [Hz]; 100 Hz is the default of ros2_control."""
    sections = yaml.safe_load(read_text(Path(controllers)))
    rates = [
        section["ros__parameters"].get("update_rate", 100)
        for node, section in sections.items()
        if node.split("/")[-1] == "controller_manager"
    ]
    return float(rates[0]) if rates else 100.0


def _rate_file(rate: float) -> str:
    """Parameter file of the bridge with the rate of its samples [Hz]."""
    with tempfile.NamedTemporaryFile("w", prefix="launch_params_", delete=False) as file:
        yaml.safe_dump({"/**": {"ros__parameters": {"telemetry_rate": rate}}}, file)
    return file.name


def _under_control(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    """All nodes; errors of a file occur before anything is started."""
    value = {name: context.perform_substitution(LaunchConfiguration(name)) for name in ARGUMENTS}
    text = description_from_file(value["params"], value["namespace"])
    rate = settings_from_file(value["params"], value["namespace"]).telemetry_rate
    rate = rate or rate_for_controllers(_update_rate(value["controllers"]))
    passed = {name: LaunchConfiguration(name) for name in ARGUMENTS if name != "controllers"}
    bridge = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([ThisLaunchFileDir(), "bridge.launch.py"])),
        launch_arguments={**passed, "more_params": _rate_file(rate)}.items(),
    )
    robot = {"robot_description": ParameterValue(text, value_type=str)}
    publisher = Node(
        package="robot_state_publisher", executable="robot_state_publisher", parameters=[robot], output="screen"
    )
    manager = Node(
        package="controller_manager",
        executable="ros2_control_node",
        parameters=[value["controllers"]],
        remappings=[("~/robot_description", "robot_description")],
        output="screen",
    )
    spawner = Node(
        package="controller_manager",
        executable="spawner",
        arguments=["joint_state_broadcaster", "joint_trajectory_controller", "--param-file", value["controllers"]],
        output="screen",
    )
    # A controller that starts before the first state would use NaN as the position of its joints.
    namespace = value["namespace"].strip("/")
    states = f"{'/' if namespace else ''}{namespace}/servo/joint_states"
    first_state = ExecuteProcess(cmd=["ros2", "topic", "echo", "--once", states], output="log")
    spawn = RegisterEventHandler(OnProcessExit(target_action=first_state, on_exit=[spawner]))
    nodes = [PushRosNamespace(value["namespace"]), publisher, manager, spawn, first_state]
    return [GroupAction(nodes), GroupAction([bridge])]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_under_control)])
