"""The settings of every test run."""

import common_rig  # noqa: F401
