"""Command line of the tuning tool: ``python firmware/config/tune.py --help``; see `servo_tuning`."""

from __future__ import annotations

import sys

from servo_msgs_py.runtime.program import program, run

if __name__ == "__main__":
    sys.exit(program("tune.py")(lambda: run("tune.py", "servo_tuning.command"))())
