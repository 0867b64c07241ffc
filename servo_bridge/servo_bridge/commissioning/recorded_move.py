"""The first move, commanded over ROS through a bridge that records the run."""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from servo_msgs_py.catalogue import AXES, axis_name
from servo_msgs_py.runtime.end_with_parent import with_parent_death_signal
from servo_msgs_py.runtime.ros_arguments import parameter_arguments

if TYPE_CHECKING:
    from trajectory_msgs.msg import JointTrajectory

RECORDING: Final = "run.mcap"
DURATION: Final = 2.0  # of a move [s]
_REST: Final = 0.5  # after a move, for its record [s]
_LOG: Final = "servo_bridge.log"
_CONNECT: Final = 60.0  # longest time for the bridge to connect, and for one answer [s]
_END: Final = 15.0  # longest time for the bridge to switch off and complete the recording [s]


class MoveError(Exception):
    """The bridge has ended, or the move was refused or not completed; the text has the reason."""


@contextlib.contextmanager
def _own_domain() -> Iterator[None]:
    """A ROS domain for this process and its children: another servo on this computer must not move."""
    own = {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    before = {name: os.environ.get(name) for name in own}
    os.environ.update(own)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


@contextlib.contextmanager
def _bridge(port: str, baud: int, axis: int, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A bridge for one axis, which records to `RECORDING`."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob(f"{Path(RECORDING).stem}*.mcap"):
        old.unlink()
    run_file = str((folder / RECORDING).absolute()).replace("%", "%%")  # the bridge inserts the time
    used = [index == axis for index in range(AXES)]
    parameters = parameter_arguments(port=port, baud=baud, used=used, run_file=run_file)
    command = [sys.executable, "-m", "servo_bridge.node", *parameters]
    with (folder / _LOG).open("wb") as log:
        process = subprocess.Popen(
            with_parent_death_signal(command),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C ends the move first, then the bridge
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(_END)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(_END)


def move_and_back(port: str, baud: int, axis: int, distance: float, folder: Path) -> None:
    """Enable an axis, move it by a distance [rad] and back, and disable it; a bridge records that.

    Parameters
    ----------
    port, baud : str, int
        Of the board; no other program uses it.
    axis : int
        Index; the other one stays off.
    distance : float
        Of the move [rad]; it takes `DURATION`, and so does the way back.
    folder : Path
        Of `RECORDING`, which is replaced.

    Raises
    ------
    MoveError
        If that did not succeed; the axis is stopped and off then.
    Interrupted
        After a signal; likewise.
    """
    with _own_domain(), _bridge(port, baud, axis, folder) as process:
        from servo_bridge.client import CommandError, ros_session
        from servo_bridge.command_paths import run_path
        from servo_bridge.commander import Commander
        from servo_bridge.motions import Motions
        from servo_bridge.trajectory.errors import TrajectoryError

        def follow(message: JointTrajectory, duration: float) -> str:
            Motions(commander).follow(message, lambda _: None, duration)
            return ""

        try:
            with ros_session(["commission"]) as session, Commander(session, "/servo", _CONNECT) as commander:
                commander.watch()
                commander.wait_for(
                    lambda: commander.connected or process.poll() is not None, "the board did not answer"
                )
                commander.enable()
                joint = axis_name(axis)
                begin = commander.positions()[joint]
                for target in (begin + distance, begin):
                    move = argparse.Namespace(verb="move", targets=[(joint, target)], time=DURATION, dry_run=False)
                    run_path(commander, move, follow)
                    commander.holds(lambda: False, _REST)
                commander.disable()
        except (CommandError, TrajectoryError) as error:
            ended = process.poll() is not None
            text = f"servo_bridge has ended with status {process.returncode}" if ended else str(error)
            raise MoveError(f"{text}; its log: {folder / _LOG}") from None
