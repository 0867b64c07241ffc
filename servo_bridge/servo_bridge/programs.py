"""Entry points of the programs; this module imports little."""

from __future__ import annotations

from servo_msgs_py.runtime.program import end, run


def bridge() -> int:
    """``servo_bridge``."""
    return run("servo_bridge", "servo_bridge.node", ros=True)


def command() -> int:
    """``servo-command``."""
    end("servo-command", run("servo-command", "servo_bridge.command", ros=True))


def demo() -> int:
    """``servo-demo``."""
    end("servo-demo", run("servo-demo", "servo_bridge.demo", ros=True))


def tool() -> int:
    """``servo-tool``."""
    return run("servo-tool", "servo_bridge.tool")
