"""Complete firmware as one host library with the fake board, with types from its headers."""

from __future__ import annotations

from typing import Any, NamedTuple

import cffi
from c_declarations import declarations
from firmware_compiler import FIRMWARE, CompileC
from hypothesis import settings

# Imported by every test module of the core before it declares a property: the same examples in every run.
settings.register_profile("core", derandomize=True, deadline=None, database=None)
settings.load_profile("core")

ROOMS = ("math", "control", "sensing", "diagnosis", "drive", "app", "comm", "config")


def _files(pattern: str) -> tuple[str, ...]:
    return tuple(sorted(str(path.relative_to(FIRMWARE)) for room in ROOMS for path in (FIRMWARE / room).glob(pattern)))


CORE_SOURCES = _files("*.c")
BOARD_SOURCES = (*CORE_SOURCES, "test/core_probe.c", "test/core_inlines.c", "test/fake_hal.c")


class Core(NamedTuple):
    """The library and its types."""

    ffi: cffi.FFI
    lib: Any


def load_core(compile_c: CompileC) -> Core:
    """Build the library."""
    core = Core(*compile_c("core", BOARD_SOURCES, declarations(*_files("*.h"), "core_probe.h", "fake_hal.h")))
    assert core.ffi.sizeof("servo_t") == core.lib.probe_servo_size()
    return core
