"""Entry points of the programs; this module imports little."""

from __future__ import annotations

import sys

from servo_msgs_py.runtime.program import run


def twin() -> int:
    """``servo_twin``, and ``servo_twin calibrate``."""
    if sys.argv[1:2] == ["calibrate"]:
        del sys.argv[1]
        return run("servo_twin calibrate", "servo_twin.calibrate_node", ros=True)
    return run("servo_twin", "servo_twin.node", ros=True)


def viewer() -> int:
    """``servo_viewer``."""
    return run("servo_viewer", "servo_twin.viewer_node", ros=True)


def board() -> int:
    """``virtual_board``."""
    return run("virtual_board", "servo_twin.virtual_board")


def sim() -> int:
    """``servo-sim``."""
    return run("servo-sim", "servo_twin.cli")


def runs() -> int:
    """``servo-twin``."""
    return run("servo-twin", "servo_twin.runs.command")


def up() -> int:
    """``servo-up``."""
    return run("servo-up", "servo_twin.up")
