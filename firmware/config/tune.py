"""Command line of the tuning tool: ``python firmware/config/tune.py --help``; see `servo_tuning`."""

from __future__ import annotations

import sys

from servo_tuning.command import main

if __name__ == "__main__":
    sys.exit(main())
