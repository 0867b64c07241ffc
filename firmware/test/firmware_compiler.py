"""Compile C sources of the firmware for a test; warnings are errors."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cffi
import pytest

FIRMWARE = Path(__file__).resolve().parents[1]
TEST = FIRMWARE / "test"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror")

SANITIZED = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
"""Undefined behaviour ends the process; ``pytest -s`` prints its location."""

Sources = Sequence["str | Path"]


def run_compiler(output: Path, sources: Sources, options: Sequence[str], compiler: str) -> Path:
    """Compile and link `sources` (relative ones are relative to the firmware folder, absolute ones may be objects).

    A missing compiler skips the test, a warning fails it.
    """
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    command = [compiler, *STRICT, f"-I{FIRMWARE}", f"-I{TEST}", *options]
    _run([*command, *(str(FIRMWARE / source) for source in sources), "-o", str(output)])
    return output


def compile_objects(folder: Path, sources: Sources, options: Sequence[str], compiler: str) -> list[Path]:
    """Compile each source separately, in parallel; ccache does not store commands with several sources."""
    folder.mkdir(exist_ok=True)
    jobs = [(folder / f"{number}.o", source) for number, source in enumerate(sources)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(lambda job: run_compiler(job[0], [job[1]], [*options, "-MD", "-c"], compiler), jobs))


def _run(command: Sequence[str]) -> None:
    # A preloaded address sanitizer doubles the time of a compiler.
    environment = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        pytest.fail(f"{' '.join(command)}\n{result.stderr}", pytrace=False)


def defined(defines: Sequence[str]) -> list[str]:
    """Compiler options for preprocessor definitions."""
    return [f"-D{define}" for define in defines]


class CompileC:
    """``compile_c``: builds a library with checks of undefined behaviour; equal requests share one build."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._compiler = os.environ.get("CC", "gcc")
        self._sanitized = SANITIZED if has_library(self._compiler, "libubsan.so") else ()
        self._loaded: dict[tuple[object, ...], tuple[cffi.FFI, Any]] = {}

    def __call__(
        self, name: str, sources: Sources, cdef: str, defines: Sequence[str] = (), quoted: Sequence[Path] = ()
    ) -> tuple[cffi.FFI, Any]:
        """Build and load; `quoted`: folders of quoted includes before those of the firmware."""
        key = (name, tuple(map(str, sources)), cdef, tuple(defines), tuple(quoted))
        if key not in self._loaded:
            extra = os.environ.get("FIRMWARE_CFLAGS", "").split()  # coverage, for example
            options = ["-O1", "-g", "-fPIC", *self._sanitized, *extra, *defined(defines)]
            options += [f"-iquote{folder}" for folder in quoted]
            output = self._folder / f"lib{name}_{len(self._loaded)}.so"
            objects = compile_objects(output.with_suffix(""), sources, options, self._compiler)
            path = run_compiler(output, objects, [*options, "-shared"], self._compiler)
            ffi = cffi.FFI()
            ffi.cdef(cdef)
            self._loaded[key] = (ffi, ffi.dlopen(str(path)))
        return self._loaded[key]


class CompileProgram:
    """``compile_program``: builds a program for the host or, with a cross compiler, for a target."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(
        self,
        name: str,
        sources: Sources,
        options: Sequence[str] = (),
        defines: Sequence[str] = (),
        compiler: str = "gcc",
    ) -> Path:
        output, options = self._folder / name, [*options, *defined(defines)]
        if len(sources) > 1:
            sources = compile_objects(output.with_suffix(".objects"), sources, options, compiler)
        return run_compiler(output, sources, options, compiler)


def has_library(compiler: str, name: str) -> bool:
    """True if the compiler is installed with a library file such as ``libasan.so``."""
    if shutil.which(compiler) is None:
        return False
    result = subprocess.run([compiler, f"-print-file-name={name}"], capture_output=True, text=True, check=True)
    return Path(result.stdout.strip()).is_absolute()
