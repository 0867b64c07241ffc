"""Discovery of the programs by each other."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

_PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
_IN_FOLDER: Final = Path("DEFAULT_FASTRTPS_PROFILES.xml")  # read from the current folder


def announce_often() -> None:
    """Let Fast DDS announce the program every second instead of every 3 s; call before the initialisation of ROS.

    A program that starts is answered once by those that run. It loses this answer if it is not ready for it, on a busy
    computer often, and waits for their next announcement. Other profiles of the user remain in use.
    """
    if not _IN_FOLDER.exists():
        os.environ.setdefault(_PROFILES, str(Path(__file__).with_name("fastdds.xml")))
