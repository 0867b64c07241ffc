"""Build script of the virtual boards: an extension module of firmware, chip and plant for each board and level.

``servo_twin._native`` has the ideal chip and the averaged plant, ``servo_twin._registers`` the registers of the
MC56F84789, the drivers of the firmware and the switching plant; ``servo_twin._odrive36_ideal`` and
``servo_twin._odrive36`` are those of another board. All have the interface of ``board.h``. ``setup.py`` lists them in
``cffi_modules``, so that setuptools compiles them for pip and colcon.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from cffi import FFI

PACKAGE = Path(__file__).resolve().parents[1]
"""Folder of ``setup.py``, independent of the working directory."""

CONTRACT = PACKAGE.parent / "servo_msgs_py"

for folder in map(str, (PACKAGE, CONTRACT)):  # setuptools runs this file as a script
    if folder not in sys.path:
        sys.path.insert(0, folder)

from servo_msgs_py.board_description import VARIABLE  # noqa: E402

from servo_twin._board_pointers import write_pointers  # noqa: E402
from servo_twin._core_time import write_charged  # noqa: E402

NATIVE = PACKAGE / "native"
FIRMWARE = PACKAGE.parent / "firmware"
FIRMWARE_FOLDERS = ("math", "control", "sensing", "diagnosis", "drive", "app", "comm", "config")
PORT = FIRMWARE / "port" / "mc56f84789"

# -ffp-contract=off: identical results on every processor. -fno-math-errno and -fno-trapping-math do not change results.
# -fno-tree-vectorize (below): vectors of two doubles are slower in this code, a chain of dependent operations.
_FLOATS = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
# -O3 of gcc is 5 % slower.
_CODE = ("-std=c99", "-O2", *_FLOATS, "-fno-tree-vectorize", "-fvisibility=hidden")
OPTIONS = (*_CODE, "-flto=auto")
"""Options on every machine: those of the identity of a build."""

# gcc optimizes on several cores with a makefile, in which it does not quote the folder of temporary files.
CFLAGS = OPTIONS if re.fullmatch(r"[\w@%+,./-]*", tempfile.gettempdir(), re.ASCII) else (*_CODE, "-flto")
"""`OPTIONS` for the compiler of this machine."""

COMPILER = sysconfig.get_config_var("CC").split()
"""Compiler of the extension modules."""

# Options of the Makefile for this machine: processor, profile.
EXTRA = os.environ.get("SERVO_TWIN_FLAGS", "").split()

# -isystem exempts the headers of Python from warnings. -Wno-psabi: vectors are passed to inlined functions only; the
# note of gcc about them cannot be disabled by a pragma.
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
    """Extract the declarations for `cffi.FFI.cdef` from the text of a header.

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
    """C files of the firmware for all targets.

    Raises
    ------
    FileNotFoundError
        If there is no firmware next to the package.
    """
    sources = sorted(path for folder in FIRMWARE_FOLDERS for path in (firmware / folder).glob("*.c"))
    if not (firmware / "app" / "servo.c").is_file():
        raise FileNotFoundError(
            f"servo_twin compiles the firmware, but {firmware}/app/servo.c does not exist. "
            "Build from a checkout of the whole repository; there is no source distribution of this package alone."
        )
    return sources


def _relative(paths: Iterable[Path]) -> list[str]:
    """Paths relative to the working directory, for setuptools."""
    return [os.path.relpath(path) for path in paths]


def build_identity(files: Iterable[Path], options: Iterable[str]) -> str:
    """Digest of sources, options and compiler, 16 hexadecimal digits."""
    compiler = subprocess.run([*COMPILER, "--version"], capture_output=True, text=True, check=True).stdout
    digest = hashlib.sha256(f"{compiler}{[*options]}".encode())
    for path in files:
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def board_files(native: Sequence[Path], sources: Sequence[Path] | None = None) -> tuple[list[Path], list[Path]]:
    """C files of a board, with those of its level in `native`, and all headers; `sources`: see `make_ffi`."""
    headers = sorted([*NATIVE.rglob("*.h"), *FIRMWARE.rglob("*.h")])
    common = [NATIVE / name for name in ("board.c", "board_state.c", "flash.c")]
    return [*common, *native, *sorted((NATIVE / "plant").glob("*.c")), *(sources or firmware_sources())], headers


def make_ffi(
    module: str,
    native: Sequence[Path],
    options: Sequence[str] = (),
    sources: Sequence[Path] | None = None,
    include: Sequence[Path] = (),
    link: Sequence[str] = (),
) -> FFI:
    """Build description of one extension module; `sources` replaces those of the firmware, `include` adds folders.

    The first file of `native` includes the definition of ``struct board``.
    """
    files, headers = board_files(native, sources)
    further = [*WARNINGS, *options, *EXTRA]
    pointers = write_pointers(
        native[0],
        [*include, NATIVE, FIRMWARE],
        options,
        build_identity([*files, *headers], [*OPTIONS, *further]),
        PACKAGE / "build" / "pointers" / module,
    )
    builder = FFI()
    for header in (NATIVE / "chip" / "trace.h", NATIVE / "board.h"):
        builder.cdef(declarations(header.read_text(encoding="utf-8")))
    builder.set_source(
        module,
        _PREAMBLE,
        sources=_relative(files),
        include_dirs=_relative([*include, NATIVE, FIRMWARE, pointers.parent]),
        depends=_relative([*headers, pointers]),
        libraries=["m"],
        extra_compile_args=[*CFLAGS, *further, f"-isystem{sysconfig.get_paths()['include']}"],
        extra_link_args=[*EXTRA, *link],
    )
    return builder


IDEAL = [NATIVE / name for name in ("board_ideal_layout.c", "board_ideal.c", "ideal_chip.c", "uart.c")]
_MC56F84789 = NATIVE / "boards" / "mc56f84789"
_REGISTERS = [
    *(NATIVE / "board_registers.c", NATIVE / "program.c", NATIVE / "serial_line.c", _MC56F84789 / "board_chip.c"),
    *(path for folder in ("arm", "chip") for path in sorted((NATIVE / folder).glob("*.c"))),
]
_ON_HOST = ["-DCHIP_ON_HOST"]


def charged_sources() -> list[Path]:
    """Sources of firmware and port with execution times for the virtual core."""
    return write_charged(
        [*firmware_sources(), *sorted(PORT.glob("*.c"))], FIRMWARE, _ON_HOST, PACKAGE / "build" / "charged"
    )


def generated_for(board: str, folder: Path) -> Path:
    """Write the generated files of the firmware for another board into a folder, which is returned."""
    inherited = os.environ.get("PYTHONPATH", "")  # of pip: the requirements of the build
    path = f"{CONTRACT}{os.pathsep}{inherited}" if inherited else str(CONTRACT)
    environment = {**os.environ, VARIABLE: board, "PYTHONPATH": path}
    config = FIRMWARE / "config"
    source = folder / "config" / "servo_config_gen.c"
    commands: list[list[str | Path]] = [
        ["-m", "servo_msgs_py.codegen", "--output", folder],
        [config / "tune.py", "generate", "--config", config / f"{board}.toml", "--output", source],
    ]
    for command in commands:
        subprocess.run([sys.executable, *command], env=environment, check=True, stdout=subprocess.DEVNULL)
    return folder


_ODRIVE36 = NATIVE / "boards" / "odrive36"


def _make_odrive36(
    module: str,
    native: Sequence[Path],
    options: Sequence[str] = (),
    include: Sequence[Path] = (),
    link: Sequence[str] = (),
) -> FFI:
    """Build description of a module of the board ODrive v3.6, with its generated files."""
    generated = generated_for("odrive36", PACKAGE / "build" / "generated" / module)
    others = sorted(generated.rglob("*.c"))
    replaced = {FIRMWARE / path.relative_to(generated) for path in others}
    sources = [*(path for path in firmware_sources() if path not in replaced), *others]
    return make_ffi(module, native, ["-DBOARD_ODRIVE36", *options], sources, [generated, *include], link)


def odrive36_ffi() -> FFI:
    """``servo_twin._odrive36``: the registers of an STM32F405, whose software is a program.

    The firmware is compiled for its tables; the linker leaves out its functions, which need drivers.
    """
    files = [
        *(NATIVE / "board_registers.c", NATIVE / "program.c", NATIVE / "serial_line.c", _ODRIVE36 / "board_chip.c"),
        *(NATIVE / "chip" / name for name in ("bus.c", "names.c")),
        *(path for folder in ("arm", "stm32f405") for path in sorted((NATIVE / folder).glob("*.c"))),
    ]
    sections = ["-ffunction-sections", "-fdata-sections"]
    return _make_odrive36("servo_twin._odrive36", files, sections, [_ODRIVE36], ["-Wl,--gc-sections"])


def odrive36_ideal_ffi() -> FFI:
    """``servo_twin._odrive36_ideal``."""
    return _make_odrive36("servo_twin._odrive36_ideal", IDEAL)


def ffi() -> FFI:
    """``servo_twin._native``."""
    return make_ffi("servo_twin._native", IDEAL)


def registers_ffi() -> FFI:
    """``servo_twin._registers``."""
    return make_ffi("servo_twin._registers", _REGISTERS, _ON_HOST, charged_sources(), [_MC56F84789])
