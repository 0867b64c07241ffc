"""Environment variables of ROS for the programs; what the user has set remains in use."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Final

_PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
_PROFILES_IN_FOLDER: Final = Path("DEFAULT_FASTRTPS_PROFILES.xml")  # read from the current folder
_LOG: Final = "ROS_LOG_DIR"


def prepare() -> None:
    """Set the variables; call before the initialisation of ROS.

    Fast DDS announces the program every second instead of every 3 s. A program that starts is answered once by those
    that run. It loses this answer if it is not ready for it, on a busy computer often, and waits for their next
    announcement.

    Without a home, or in one that is read-only, the log files are in the folder for temporary files: without a folder
    for them ROS does not start.
    """
    if not _PROFILES_IN_FOLDER.exists():
        os.environ.setdefault(_PROFILES, str(Path(__file__).with_name("fastdds.xml")))
    if not ({_LOG, "ROS_HOME"} & os.environ.keys() or _home_is_writable()):
        os.environ[_LOG] = str(Path(tempfile.gettempdir(), f"ros-log-{os.getuid()}"))


def _home_is_writable() -> bool:
    """Whether ROS finds its default folder for log files, and can write there."""
    home = os.environ.get("HOME")
    if not home:
        return False
    folder = Path(home, ".ros", "log")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
