"""The core with sanitizers; no file-scope state, no floating point."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from core_library import CORE_SOURCES
from firmware_compiler import FIRMWARE, compile_objects, has_library

# With optimisation an unused read is removed before the address sanitizer checks it.
SANITIZE = "-O0 -g1 -fsanitize=undefined,address -fno-sanitize-recover=all"
INSIDE = "FIRMWARE_TESTS_SANITIZED"


@pytest.mark.slow
@pytest.mark.skipif(INSIDE in os.environ, reason="this is the sanitized run")
def test_code_outside_of_the_recordings_passes_with_the_address_sanitizer() -> None:
    """All other code is replayed with it (target ``gcc sanitizers`` of tests/test_targets.py)."""
    if not has_library("gcc", "libasan.so"):
        pytest.skip("gcc has no address sanitizer")
    runtime = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
    ).stdout.strip()
    folder = Path(__file__).parent
    files = [*folder.glob("test_app_*.py"), folder / "test_drive_homing.py", folder / "test_drive_states.py"]
    tests = sorted(map(str, files))
    environment = {
        **os.environ,
        INSIDE: "1",
        "FIRMWARE_CFLAGS": SANITIZE,
        "LD_PRELOAD": runtime,
        "ASAN_OPTIONS": "detect_leaks=0:malloc_context_size=0",  # allocations of Python are ignored
    }
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-s", "-p", "no:cacheprovider", *tests],
        env=environment,
        cwd=FIRMWARE.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[:6000]
    assert re.search(r"\d{3} passed", result.stdout)


def test_no_file_scope_state(tmp_path: Path) -> None:
    """Several boards may run in one process: no object file has writable data."""
    objects = compile_objects(tmp_path, CORE_SOURCES, ["-O0", "-fno-pie"], "gcc")
    listing = subprocess.run(["nm", *map(str, objects)], capture_output=True, text=True, check=True).stdout
    assert re.search(r"\sR servo_config$", listing, re.MULTILINE)
    assert not re.findall(r"\s[bBdDcC] \w+$", listing, re.MULTILINE)


def test_no_floating_point() -> None:
    """`double` has 32 bits on some targets: the core uses integers only."""
    for source in CORE_SOURCES:
        text = re.sub(r"/\*.*?\*/", "", (FIRMWARE / source).read_text(encoding="utf-8"), flags=re.DOTALL)
        text = re.sub(r'"[^"]*"', "", text)
        assert not re.search(r"\b(float|double)\b|\b\d+\.\d", text), source
