"""``servo-command``: send one command to the servo over ROS; a replacement for the ros2 command line.

servo-command enable
servo-command position axis1=6.28 axis2=-6.28
servo-command velocity axis1=50 --for 2
servo-command move axis1=31.4 axis2=-31.4 --time 2
servo-command follow path.csv
servo-command sine axis1 --amplitude 1 --frequency 2 --for 10
servo-command home axis1 --method stop-negative
servo-command zero axis1 0.5
servo-command quick_stop
servo-command state --check
servo-command set 'param.features[0]=ANTI_WINDUP+POSITION_LIMITS' param.i_q_limit=1.0,1.5
servo-command get param.features
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from servo_msgs_py.runtime.program import complain, program

from servo_bridge.command_parser import PATH_VERBS, QUANTITIES, command_parser
from servo_bridge.tool_progress import progress_bar, show

if TYPE_CHECKING:
    from trajectory_msgs.msg import JointTrajectory

    from servo_bridge.commander import Commander
    from servo_bridge.motions import Motions


def _parsed(argv: Sequence[str]) -> argparse.Namespace:
    parser = command_parser()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks for the completions of a line
        import argcomplete

        argcomplete.autocomplete(parser)
    own = list(argv[1:])
    if "--ros-args" in own:
        from rclpy.utilities import remove_ros_args

        own = remove_ros_args(list(argv))[1:]
    arguments = parser.parse_args(own)
    joints = [joint for joint, _ in getattr(arguments, "targets", [])]
    twice = next((joint for joint in joints if joints.count(joint) > 1), None)
    if twice is not None:
        parser.error(f"{twice} is given twice")
    return arguments


def _perform(commander: Commander, args: argparse.Namespace) -> int:
    if args.verb == "state":
        text, trouble = commander.state()
        print(text)
        if args.check and trouble:
            complain(f"servo-command: not ready: {trouble}")
            return 1
        return 0
    print(_result(commander, args))
    return 0


def _result(commander: Commander, args: argparse.Namespace) -> str:
    if args.verb in QUANTITIES or args.verb in PATH_VERBS or args.verb == "home":
        return _move(commander, args)
    if args.verb == "set":
        return commander.set(args.assignments)
    if args.verb == "zero":
        return commander.home(args.joint, "here", args.position)
    if args.verb == "get":
        return commander.get(args.names)
    if args.verb == "enable":
        return commander.enable()
    if args.verb == "disable":
        return commander.disable()
    return commander.trigger(args.verb)


def _move(commander: Commander, args: argparse.Namespace) -> str:
    from servo_bridge.motions import Motions

    if args.verb in QUANTITIES:
        return Motions(commander).set_points(args.verb, dict(args.targets), args.duration)
    if args.verb == "home":
        return Motions(commander).home(args.joint, args.method.replace("-", "_"), args.position)
    from servo_bridge.command_paths import run_path

    return run_path(commander, args, lambda message, duration: _follow(Motions(commander), message, duration))


def _follow(motions: Motions, message: JointTrajectory, duration: float) -> str:
    with progress_bar() as bar:
        motions.follow(message, lambda part: show(bar, "", round(100.0 * part), 100), duration)
    return f"done: {motions.positions_text(message.joint_names)}"


@program("servo-command")
def main(args: Sequence[str] | None = None) -> int:
    """Run the program.

    Returns
    -------
    int
        0: done; 1: refused, not done, or no response (`state --check`: not ready); 2: wrong arguments; else `program`.
    """
    argv = list(sys.argv if args is None else ["servo-command", *args])
    arguments = _parsed(argv)
    # What follows takes long to import.
    from rclpy.exceptions import NameValidationException
    from rclpy.executors import ExternalShutdownException

    from servo_bridge.client import ros_session
    from servo_bridge.commander import Commander
    from servo_bridge.trajectory.errors import TrajectoryError

    refusals: tuple[Any, ...] = (RuntimeError, NameValidationException, TrajectoryError)
    try:
        with (
            ros_session(argv) as session,
            Commander(session, arguments.namespace.rstrip("/"), arguments.wait) as commander,
        ):
            return _perform(commander, arguments)
    except ExternalShutdownException:
        return 1
    except refusals as error:
        complain(f"servo-command: {error}")
        return 1


if __name__ == "__main__":
    sys.exit(main())
