"""The size of the server on a small target."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from firmware_compiler import CompileProgram, has_library
from freemaster_model import COMM_SOURCES

CORTEX_M3 = ["-mcpu=cortex-m3", "-mthumb", "-Os", "-ffreestanding", "-nostdlib", "-r"]
CODE_SIZE_MAX = 8192  # bytes of code and constants on a Cortex-M3


def test_size_on_cortex_m3(compile_program: CompileProgram) -> None:
    if not has_library("arm-none-eabi-gcc", "libc.a") or shutil.which("arm-none-eabi-size") is None:
        pytest.skip("arm-none-eabi-gcc with newlib is not installed")
    image = compile_program("comm_cortex_m3.o", COMM_SOURCES, CORTEX_M3, (), "arm-none-eabi-gcc")
    listing = subprocess.run(["arm-none-eabi-size", str(image)], capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, listing.splitlines()[1].split()[:3])
    assert text <= CODE_SIZE_MAX, f"{text} bytes"
    assert (data, bss) == (0, 0), "no file-scope state"
