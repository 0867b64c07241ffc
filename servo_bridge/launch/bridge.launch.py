"""Board, twin and viewer for a machine with ROS 2 installed.

ros2 launch servo_bridge bridge.launch.py port:=/dev/ttyUSB0
ros2 launch servo_bridge bridge.launch.py virtual:=true
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "port": ("/dev/ttyUSB0", "serial port of the board: a device path or a pyserial URL"),
    "baud": ("115200", "line speed [bit/s]"),
    "params": (
        str(Path(get_package_share_directory("servo_bridge")) / "config" / "servo_bridge.yaml"),
        "parameter file of the bridge",
    ),
    "virtual": ("false", "true: start a virtual board and link it to `port`, which must not exist"),
    "twin": ("true", "false: no twin"),
    "viewer": ("true", "false: no rerun viewer"),
}


def generate_launch_description() -> LaunchDescription:
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    bridge = Node(
        package="servo_bridge",
        executable="servo_bridge",
        namespace="servo",
        parameters=[value["params"], {"port": value["port"], "baud": ParameterValue(value["baud"], value_type=int)}],
        output="screen",
    )
    board = Node(
        package="servo_twin",
        executable="virtual_board",
        arguments=["--link", value["port"], "--baud", value["baud"]],
        condition=IfCondition(value["virtual"]),
        output="screen",
    )
    twin = Node(
        package="servo_twin",
        executable="servo_twin",
        namespace="twin",
        condition=IfCondition(value["twin"]),
        output="screen",
    )
    viewer = Node(
        package="servo_twin",
        executable="servo_viewer",
        condition=IfCondition(value["viewer"]),
        output="screen",
    )
    # Without the bridge nothing is left to watch; it ends by itself only when it was told something senseless.
    end = RegisterEventHandler(OnProcessExit(target_action=bridge, on_exit=[EmitEvent(event=Shutdown())]))
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, board, bridge, twin, viewer, end])
