"""Board, twin and viewer for a machine with ROS 2 installed.

ros2 launch servo_bridge bridge.launch.py port:=/dev/ttyUSB0
ros2 launch servo_bridge bridge.launch.py virtual:=true
ros2 launch servo_bridge bridge.launch.py virtual:=true port:=/tmp/board_b namespace:=robotB
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, GroupAction, RegisterEventHandler
from launch.conditions import IfCondition, UnlessCondition
from launch.event_handlers import OnProcessExit
from launch.events.process import ProcessExited
from launch.substitutions import EqualsSubstitution, IfElseSubstitution, LaunchConfiguration
from launch_ros.actions import Node, PushRosNamespace
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage


def _defaults(package: str, name: str) -> str:
    return str(Path(get_package_share_directory(package)) / "config" / name)


ARGUMENTS = {
    "virtual": ("false", "true: start a virtual board and create the link `port` to it, which must not exist"),
    "port": (
        "",
        "serial port of the board, or a pyserial URL; empty: /dev/ttyUSB0, /tmp/servo_board for a virtual board",
    ),
    "baud": ("115200", "line speed [bit/s]"),
    "autostart": ("true", "false: the bridge waits for the transitions configure and activate"),
    "namespace": ("", "namespace before `servo` and `twin`, different for each board"),
    "params": (_defaults("servo_bridge", "servo_bridge.yaml"), "parameter file of the bridge"),
    "more_params": (LaunchConfiguration("params"), "second parameter file of the bridge, with precedence"),
    "twin_params": (_defaults("servo_twin", "servo_twin.yaml"), "parameter file of the twin"),
    "viewer_params": (_defaults("servo_twin", "servo_viewer.yaml"), "parameter file of the viewer"),
    "twin": ("true", "false: no twin"),
    "viewer": ("true", "false: no rerun viewer"),
    "use_sim_time": ("false", "true: stamps in the time of the topic /clock"),
    "respawn": ("false", "true: restart programs that end unexpectedly"),
}


def generate_launch_description() -> LaunchDescription:
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    default_port = IfElseSubstitution(value["virtual"], "/tmp/servo_board", "/dev/ttyUSB0")
    port = IfElseSubstitution(EqualsSubstitution(value["port"], ""), default_port, value["port"])
    sim_time = {"use_sim_time": ParameterValue(value["use_sim_time"], value_type=bool)}
    common = {"respawn": value["respawn"], "respawn_delay": 2.0, "output": "screen"}
    bridge = Node(
        package="servo_bridge",
        executable="servo_bridge",
        namespace="servo",
        parameters=[
            value["params"],
            value["more_params"],
            {
                "port": ParameterValue(port, value_type=str),
                "baud": ParameterValue(value["baud"], value_type=int),
                "autostart": ParameterValue(value["autostart"], value_type=bool),
            },
            sim_time,
        ],
        **common,
    )
    # Not a node, because it does not accept the arguments that Node adds.
    board = ExecuteProcess(
        cmd=[ExecutableInPackage("virtual_board", "servo_twin"), "--link", port, "--baud", value["baud"]],
        condition=IfCondition(value["virtual"]),
        output="screen",
    )
    twin = Node(
        package="servo_twin",
        executable="servo_twin",
        namespace="twin",
        parameters=[value["twin_params"], sim_time],
        condition=IfCondition(value["twin"]),
        **common,
    )
    viewer = Node(
        package="servo_twin",
        executable="servo_viewer",
        parameters=[value["viewer_params"], sim_time],
        condition=IfCondition(value["viewer"]),
        **common,
    )

    def bridge_ended(event: ProcessExited, context: LaunchContext) -> None:
        """End the launch with a failure if the bridge ends."""
        if not context.is_shutdown:
            raise RuntimeError(f"the bridge has ended with status {event.returncode}")

    # The condition is evaluated here: arguments of a file that another one includes are unknown when the bridge ends.
    end = RegisterEventHandler(
        OnProcessExit(target_action=bridge, on_exit=bridge_ended), condition=UnlessCondition(value["respawn"])
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    nodes = GroupAction([PushRosNamespace(value["namespace"]), bridge, twin, viewer])
    return LaunchDescription([*declared, end, board, nodes])
