"""The tuning tool: ``python firmware/config/tune.py --help``; what it does stands in the package ``tuning``."""

from __future__ import annotations

import sys

from tuning.command import main

if __name__ == "__main__":
    sys.exit(main())
