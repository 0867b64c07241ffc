"""Runs the peers in a separate virtual environment, which the bench creates and `make clean` removes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).resolve().parents[3] / "out" / "bench" / "motulator"
SCRIPT: Final = Path(__file__).with_name("motulator_drive.py")
TIMEOUT_S: Final = 600.0
REQUIREMENTS: Final = ("motulator==0.18.*", "motulator-export==0.11.*")  # versions that the script supports
PYTHON_VARIABLE: Final = "PEER_PYTHON"
"""Environment variable with the interpreter of the peers, which need Python 3.12 or later."""


def _pythons() -> Iterator[str]:
    """Suitable interpreters: of `PYTHON_VARIABLE`, on the path, of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/3.1[2-9]*/bin/python")
    for name in (os.environ.get(PYTHON_VARIABLE, ""), sys.executable, "python3.13", "python3.12", *map(str, pyenv)):
        path = shutil.which(name)
        version_test = "import sys; sys.exit(sys.version_info < (3, 12))"
        if path is not None and subprocess.run([path, "-c", version_test], capture_output=True).returncode == 0:
            yield path


def _run(*command: str) -> str:
    """Output of a command.

    Raises
    ------
    OSError
        If it fails or exceeds the time-out, with the last line of its errors.
    """
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise OSError(f"{Path(command[0]).name} takes longer than {TIMEOUT_S:g} s") from None
    if result.returncode != 0:
        raise OSError((result.stderr.strip().splitlines() or ["it failed"])[-1])
    return result.stdout


def peers() -> dict[str, Any] | str:
    """Real-time factors of one drive by simulator and inverter model, or the reason of a failure."""
    python = str(FOLDER / "bin" / "python")
    try:
        if not Path(python).exists():
            interpreter = next(_pythons(), None)
            if interpreter is None:
                raise OSError("there is no Python 3.12 or later")
            _run(interpreter, "-m", "venv", str(FOLDER))
        try:
            _run(python, "-c", "import motulator_export")
        except OSError:
            _run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *REQUIREMENTS)
        figures: dict[str, Any] = json.loads(_run(python, str(SCRIPT)))
    except (OSError, ValueError) as error:
        return f"not compared with motulator: {error} (its Python: {PYTHON_VARIABLE}=python3.12)"
    return figures
