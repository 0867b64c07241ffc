"""Run compilers and simulators, and find missing tools."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

JOBS: Final = os.cpu_count() or 1
"""Number of parallel builds or runs."""


class TargetError(RuntimeError):
    """A target could not be built, or its program failed."""


def run(
    command: Sequence[str | Path],
    *,
    data: bytes = b"",
    timeout: float = 600.0,
    merged: bool = False,
    folder: Path | None = None,
) -> str:
    """Run a command and return its output.

    Parameters
    ----------
    command : sequence
        Program and arguments.
    data : bytes
        Standard input of the program.
    timeout : float
        Time-out [s].
    merged : bool
        Return the standard error as well.
    folder : Path, optional
        Working directory.

    Raises
    ------
    TargetError
        If it fails, or exceeds the time-out.
    """
    words = [str(word) for word in command]
    try:
        errors = subprocess.STDOUT if merged else subprocess.PIPE
        result = subprocess.run(
            words, input=data, stdout=subprocess.PIPE, stderr=errors, timeout=timeout, cwd=folder, check=False
        )
    except subprocess.TimeoutExpired:
        raise TargetError(f"{words[0]} did not end within {timeout:g} s") from None
    except OSError as error:
        raise TargetError(f"{words[0]}: {error.strerror}") from None
    text = result.stdout.decode("utf-8", "replace")
    if result.returncode != 0:
        message = (result.stderr or b"").decode("utf-8", "replace") or text
        raise TargetError(f"{words[0]} ended with status {result.returncode}:\n{message[-4000:].strip()}")
    return text


def compile_objects(command: Sequence[str], files: Sequence[Path], folder: Path, root: Path) -> list[Path]:
    """Compile C files into a folder, one job per processor.

    Parameters
    ----------
    command : sequence
        Compiler and options.
    files : sequence of Path
        Files below `root`.
    folder : Path
        Folder of the objects.
    root : Path
        Root of the sources. Paths are passed relative to it, so that ccache finds a file in every copy of the sources.

    Raises
    ------
    TargetError
        If a file does not compile.
    """

    # The list of headers (-MD) spares ccache a run of the preprocessor (CCACHE_DEPEND in the Makefile).
    relative = [*(word.replace(f"{root}/", "") for word in command), "-MD"]

    def compile_one(source: Path) -> Path:
        output = folder / f"{source.parent.name}_{source.stem}.o"
        run([*relative, "-c", source.relative_to(root), "-o", output], folder=root)
        return output

    with ThreadPoolExecutor(JOBS) as pool:
        return list(pool.map(compile_one, files))


def has_program(name: str) -> bool:
    return shutil.which(name) is not None


def has_library(compiler: str, name: str, *options: str) -> bool:
    """True if the compiler is installed with a library file such as ``libasan.so``."""
    if not has_program(compiler):
        return False
    return Path(run([compiler, *options, f"-print-file-name={name}"]).strip()).is_absolute()


def version(program: str) -> str:
    """Version of a compiler."""
    return run([program, "-dumpfullversion"]).strip()
