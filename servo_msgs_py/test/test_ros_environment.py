"""Environment of ROS: a program starts with any home, and what the user has set remains in use."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from servo_msgs_py.runtime import ros_environment

START = """
import os, rclpy
from servo_msgs_py.runtime import ros_environment
ros_environment.prepare()
rclpy.init()
rclpy.create_node("started")
print(os.environ.get("ROS_LOG_DIR"), flush=True)
os._exit(0)
"""


@pytest.mark.parametrize(
    ("home", "log"),
    [(None, "ros-log-"), ("", "ros-log-"), ("/proc", "ros-log-"), ("/dev/null", "ros-log-"), ("writable ü", "None")],
)
def test_ros_starts_with_any_home(home: str | None, log: str, tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    for name in ("HOME", "ROS_HOME", "ROS_LOG_DIR", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        environment.pop(name, None)
    if home is not None:
        environment["HOME"] = home if log != "None" else str(tmp_path / home)
    started = subprocess.run(
        [sys.executable, "-c", START], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (started.returncode, started.stderr) == (0, "")
    assert log in started.stdout


def test_what_the_user_has_set_remains(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", "/dev/null")
    for given in ({"ROS_LOG_DIR": "mine"}, {"ROS_HOME": "mine"}):
        environment = {"HOME": "/dev/null", "FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml", **given}
        monkeypatch.setattr(os, "environ", dict(environment))
        ros_environment.prepare()
        assert dict(os.environ) == environment
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").touch()
    monkeypatch.setattr(os, "environ", {"ROS_HOME": "mine"})
    ros_environment.prepare()
    assert dict(os.environ) == {"ROS_HOME": "mine"}


def test_the_profile_has_no_other_setting() -> None:
    """It is the default of every program, so it must change nothing else of the middleware."""
    root = ElementTree.parse(Path(ros_environment.__file__).with_name("fastdds.xml")).getroot()
    values = {element.tag.rpartition("}")[2]: element.text for element in root.iter() if not len(element)}
    assert values == {"sec": "1"}
