"""Build script of the virtual board's two levels: firmware, chip and plant in one extension module each.

``servo_twin._native`` has the ideal chip and the averaged plant, ``servo_twin._registers`` the MC56F84789 with its
registers, the firmware's own drivers for it and the plant at switching level. Both have the interface of ``board.h``.
``setup.py`` names them in ``cffi_modules``; then setuptools compiles them for pip and colcon alike.
"""

from __future__ import annotations

import os
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable
from pathlib import Path

from cffi import FFI

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of ``setup.py``, wherever the build was started from."""

NATIVE = PACKAGE / "native"
FIRMWARE = PACKAGE.parent / "firmware"
FIRMWARE_FOLDERS = ("math", "control", "sensing", "diagnosis", "drive", "app", "comm", "config")
PORT = FIRMWARE / "port" / "mc56f84789"

# Without contraction of a * b + c every processor computes the same bits; pairs of doubles in vectors only cost time in
# code where each number waits for the one before. errno and the flags of floating point: no number
# changes by that either.
_FLOATS = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
# With gcc -O3 is more code and 5 % slower.
OPTIONS = ("-std=c99", "-O2", *_FLOATS, "-fno-tree-vectorize", "-fvisibility=hidden", "-flto=auto")

# For the machine at hand, from the Makefile: its processor, the use of a profile.
_EXTRA = os.environ.get("SERVO_TWIN_FLAGS", "").split()

# The headers of Python come in as system headers (-isystem), which makes them exempt. How vectors of numbers are passed
# makes no difference, as all functions of them are inlined: gcc has a note on it that a pragma does not stop.
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Werror", "-Wno-psabi")

_PREAMBLE = """
/* The glue below is cffi's; its warnings are not ours to mend. */
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
#include "board.h"
"""


def declarations(header: str) -> str:
    """Declarations for `cffi.FFI.cdef` out of the text of a header.

    Raises
    ------
    ValueError
        If the marks CFFI-BEGIN and CFFI-END are missing.
    """
    match = re.search(r"^/\* CFFI-BEGIN.*?\*/$(.*?)^/\* CFFI-END \*/$", header, re.MULTILINE | re.DOTALL)
    if match is None:
        raise ValueError("the header has no lines between CFFI-BEGIN and CFFI-END")
    return re.sub(r"/\*.*?\*/", "", match.group(1), flags=re.DOTALL)


def firmware_sources(firmware: Path = FIRMWARE) -> list[Path]:
    """C files of the firmware that run on every target.

    Raises
    ------
    FileNotFoundError
        If there is no firmware beside the package.
    """
    sources = sorted(path for folder in FIRMWARE_FOLDERS for path in (firmware / folder).glob("*.c"))
    if not (firmware / "app" / "servo.c").is_file():
        raise FileNotFoundError(
            f"servo_twin compiles the firmware, but {firmware} does not hold it (app/servo.c is missing). "
            "Build from a checkout of the whole repository; there is no source distribution of this package alone."
        )
    return sources


def _relative(paths: Iterable[Path]) -> list[str]:
    """Paths as setuptools wants them: relative to the working directory."""
    return [os.path.relpath(path) for path in paths]


def _absolute(paths: Iterable[Path]) -> list[str]:
    """Paths for a compiler that is started from another folder."""
    return [str(path.resolve()) for path in paths]


def make_ffi(
    module: str,
    native: Iterable[Path],
    options: Iterable[str] = (),
    sources: Iterable[Path] | None = None,
    paths: Callable[[Iterable[Path]], list[str]] = _relative,
) -> FFI:
    """Description of one extension module for the compiler; `sources` in the place of the firmware's."""
    headers = sorted([*NATIVE.rglob("*.h"), *FIRMWARE.rglob("*.h")])
    builder = FFI()
    for header in (NATIVE / "chip" / "trace.h", NATIVE / "board.h"):
        builder.cdef(declarations(header.read_text(encoding="utf-8")))
    builder.set_source(
        module,
        _PREAMBLE,
        sources=paths(
            [
                NATIVE / "board.c",
                NATIVE / "flash.c",
                *native,
                *sorted((NATIVE / "plant").glob("*.c")),
                *(sources or firmware_sources()),
            ]
        ),
        include_dirs=paths([NATIVE, FIRMWARE]),
        depends=paths(headers),
        libraries=["m"],
        extra_compile_args=[*OPTIONS, *WARNINGS, *options, *_EXTRA, f"-isystem{sysconfig.get_paths()['include']}"],
        extra_link_args=_EXTRA,
    )
    return builder


_IDEAL = [NATIVE / name for name in ("board_ideal.c", "ideal_chip.c", "uart.c")]
_REGISTERS = [NATIVE / "board_registers.c", *sorted((NATIVE / "chip").glob("*.c"))]
_ON_HOST = ["-DCHIP_ON_HOST"]


def charged_sources() -> list[Path]:
    """Firmware and port as the virtual core runs them: with what they take of its time."""
    if str(PACKAGE) not in sys.path:  # setuptools runs this file as a script
        sys.path.insert(0, str(PACKAGE))
    from servo_twin._core_time import write_charged

    return write_charged(
        [*firmware_sources(), *sorted(PORT.glob("*.c"))], FIRMWARE, _ON_HOST, PACKAGE / "build" / "charged"
    )


def board_ffi(module: str, level: str, config: Path) -> FFI:
    """A module with another ``servo_config_gen.c``, for `cffi.FFI.compile` in a folder of its own."""
    native, options, sources = (
        (_IDEAL, [], firmware_sources()) if level == "ideal" else (_REGISTERS, _ON_HOST, charged_sources())
    )
    sources = [config if path.name == "servo_config_gen.c" else path for path in sources]
    return make_ffi(module, native, options, sources, _absolute)


def ffi() -> FFI:
    """``servo_twin._native``."""
    return make_ffi("servo_twin._native", _IDEAL)


def registers_ffi() -> FFI:
    """``servo_twin._registers``."""
    return make_ffi("servo_twin._registers", _REGISTERS, _ON_HOST, charged_sources())
