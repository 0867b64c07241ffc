"""Start of a program that needs ROS, with an error message if rclpy is missing."""

from __future__ import annotations

import sys
from importlib import import_module


def run_with_ros(name: str, module: str) -> int:
    """Run ``main`` of a module.

    Parameters
    ----------
    name : str
        Name of the program for the message.
    module : str
        Module with ``main``; it imports rclpy.

    Returns
    -------
    int
        Exit status of the program; 1 when rclpy cannot be imported.
    """
    try:
        import_module("rclpy")
    except ImportError as error:
        remedy = (
            "install ROS 2 Jazzy and source its setup.bash (its rclpy is for Python 3.12), or install its wheels with "
            "pip install 'servo_msgs_py[ros]'"
        )
        print(f"{name}: rclpy cannot be imported by {sys.executable} ({error}); {remedy}", file=sys.stderr)
        return 1
    return int(import_module(module).main())
