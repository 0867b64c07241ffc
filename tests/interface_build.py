"""Build the package ``control_msgs`` of tests/action_interfaces on a machine without a ROS installation."""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = Path(__file__).with_name("action_interfaces")
BUILDS = ROOT / "build" / "control_msgs"


def action_environment() -> dict[str, str]:
    """Environment of processes that import ``control_msgs``; the first call builds it in about 30 s."""
    if importlib.util.find_spec("control_msgs") is not None:
        return {}
    if shutil.which("cmake") is None or importlib.util.find_spec("ament_package") is None:
        pytest.skip("control_msgs is not installed, and cmake or the ament wheels to build it are missing")
    prefix = _built()
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    added = {
        "PYTHONPATH": prefix / "lib" / version / "site-packages",
        "LD_LIBRARY_PATH": prefix / "lib",
        "AMENT_PREFIX_PATH": prefix,
    }
    return {name: os.pathsep.join(filter(None, [str(path), os.environ.get(name)])) for name, path in added.items()}


def _built() -> Path:
    """Install prefix of the present sources; a lock serialises builds."""
    files = sorted(path for path in SOURCES.rglob("*") if path.is_file())
    key = hashlib.sha256(b"".join(path.read_bytes() for path in files) + sys.executable.encode()).hexdigest()[:12]
    prefix = BUILDS / key / "install"
    BUILDS.mkdir(parents=True, exist_ok=True)
    (BUILDS / "COLCON_IGNORE").touch()
    with (BUILDS / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (prefix / "done").exists():
            _build(prefix)
            (prefix / "done").touch()
    return prefix


def _build(prefix: Path) -> None:
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([str(Path(sys.prefix) / "bin"), os.environ["PATH"]]),
        "AMENT_PREFIX_PATH": sys.prefix,
        "CMAKE_PREFIX_PATH": sys.prefix,
    }
    folder = prefix.parent / "build"
    settings = {"CMAKE_INSTALL_PREFIX": prefix, "Python3_EXECUTABLE": sys.executable, "BUILD_TESTING": "OFF"}
    for command in (
        ["cmake", "-S", SOURCES, "-B", folder, "-Wno-dev", *(f"-D{name}={value}" for name, value in settings.items())],
        ["cmake", "--build", folder, "--parallel", "2"],
        ["cmake", "--install", folder],
    ):
        done = subprocess.run([*map(str, command)], capture_output=True, text=True, env=environment, timeout=600.0)
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
