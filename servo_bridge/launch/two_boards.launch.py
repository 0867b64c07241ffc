"""Example: two boards, each with bridge and twin in its own namespace. Only the first has a viewer.

ros2 launch servo_bridge two_boards.launch.py port_a:=/dev/ttyUSB0 port_b:=/dev/ttyUSB1
ros2 launch servo_bridge two_boards.launch.py virtual:=true port_a:=/tmp/board_a port_b:=/tmp/board_b
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, ThisLaunchFileDir

ARGUMENTS = {
    "port_a": ("/dev/ttyUSB0", "port of the board in /robotA"),
    "port_b": ("/dev/ttyUSB1", "port of the board in /robotB"),
    "virtual": ("false", "true: start two virtual boards"),
    "viewer": ("true", "false: no rerun viewer"),
}


def generate_launch_description() -> LaunchDescription:
    def board(namespace: str, port: str, viewer: object) -> GroupAction:
        arguments = {"namespace": namespace, "port": LaunchConfiguration(port), "viewer": viewer}
        file = PathJoinSubstitution([ThisLaunchFileDir(), "bridge.launch.py"])
        include = IncludeLaunchDescription(PythonLaunchDescriptionSource(file), launch_arguments=arguments.items())
        return GroupAction([include])  # separates the arguments of both boards

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription(
        [*declared, board("robotA", "port_a", LaunchConfiguration("viewer")), board("robotB", "port_b", "false")]
    )
