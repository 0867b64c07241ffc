"""Builds virtual boards with another configuration, as separate extension modules.

`Board` contains the firmware with the committed ``servo_config_gen.c``. This module tunes and compiles the firmware for
another ``servo.toml``. Requires a checkout of the whole repository and a C compiler, as the package itself.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.machinery
import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from servo_msgs_py.text_file import TextFileError, read_toml

from servo_twin.board import Firmware, SimulationError
from servo_twin.level import Level, chosen_level

CHECKOUT: Final = Path(__file__).resolve().parents[2]
"""Folder of the checkout, with ``firmware``; the latter is missing in an installed package."""

SERVO_TOML: Final = CHECKOUT / "firmware" / "config" / "servo.toml"

_CACHE: Final = CHECKOUT / "build" / "boards"
_loaded: Final[dict[Path, Firmware]] = {}


@functools.cache
def servo_table(path: Path = SERVO_TOML) -> Mapping[str, Any]:
    """A parsed ``servo.toml``; cached, do not modify it.

    Raises
    ------
    SimulationError
        If the file does not exist or is no TOML.
    """
    if not path.is_file():
        raise SimulationError(f"no such file: {path}")
    try:
        return read_toml(path)
    except TextFileError as error:
        raise SimulationError(f"{path}: {error}") from None


def as_toml(table: Mapping[str, Any], name: str = "") -> str:
    """Nested tables as TOML; values: numbers, booleans, strings and lists of these."""
    groups = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    entries = [f"{key} = {_value(value)}\n" for key, value in table.items() if key not in groups]
    head = f"[{name}]\n" if name else ""
    prefix = f"{name}." if name else ""
    return head + "".join(entries) + "".join(as_toml(group, prefix + key) for key, group in groups.items())


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)


def build_firmware(config: str, level: Level | None = None, folder: Path = _CACHE) -> Firmware:
    """Tune a configuration and compile a virtual board for it.

    Parameters
    ----------
    config : str
        Text of a ``servo.toml``.
    level : {"registers", "ideal"}, optional
        Level of the boards; by default as in `Board`.
    folder : Path
        Cache of the builds, by configuration and sources.

    Raises
    ------
    SimulationError
        If the configuration is refused, the sources are missing, or the compilation fails.
    """
    if not SERVO_TOML.is_file():
        raise SimulationError(
            f"another motor requires the sources of the firmware, which are not in {CHECKOUT}: use a checkout"
        )
    kind = chosen_level(level)
    name = f"_{kind}_{_digest(config)}"
    target = folder / name
    if target not in _loaded:
        if not target.is_dir():
            _build(target, name, kind, config)
        _loaded[target] = _load(target, name)
    return _loaded[target]


def _build(target: Path, name: str, kind: Level, config: str) -> None:
    """Build in a temporary folder, then rename: another process may build the same."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        work = Path(folder) / name
        work.mkdir()
        _tune(work, config)
        _compile(work, name, kind)
        with contextlib.suppress(OSError):  # another process was faster
            work.rename(target)


def _sources() -> list[Path]:
    folders = [CHECKOUT / "firmware", CHECKOUT / "servo_twin" / "native"]
    files = [path for folder in folders for path in folder.rglob("*") if path.suffix in (".c", ".h", ".py")]
    tables = [*(CHECKOUT / "servo_msgs_py").rglob("*.toml"), Path(__file__).with_name("_build_native.py")]
    return sorted([*files, *tables])


def _digest(config: str) -> str:
    digest = hashlib.sha256(config.encode())
    digest.update(sys.version.encode())
    for path in _sources():
        digest.update(str(path).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _run(what: str, *arguments: str | Path, folder: Path) -> None:
    command = [sys.executable, "-W", "ignore", *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SimulationError(f"{what}: {(done.stderr or done.stdout).strip()}")


def _tune(target: Path, config: str) -> None:
    file = target / "servo.toml"
    file.write_text(config, encoding="utf-8")
    tool = SERVO_TOML.with_name("tune.py")
    output = target / "servo_config_gen.c"
    _run("the configuration is refused", tool, "generate", "--config", file, "--output", output, folder=target)


_SCRIPT: Final = """\
import sys
from pathlib import Path
from servo_twin._build_native import board_ffi
board_ffi(sys.argv[1], sys.argv[2], Path(sys.argv[3])).compile(tmpdir=".")
"""


def _compile(target: Path, name: str, level: Level) -> None:
    """Compile in a separate process, because cffi changes the working directory."""
    config = target / "servo_config_gen.c"
    _run("the board does not compile", "-c", _SCRIPT, name, level, config, folder=target)


def _load(target: Path, name: str) -> Firmware:
    for suffix in importlib.machinery.EXTENSION_SUFFIXES:
        path = target / (name + suffix)
        if path.is_file():
            loader = importlib.machinery.ExtensionFileLoader(name, str(path))
            spec = importlib.util.spec_from_loader(name, loader)
            if spec is not None:
                module = importlib.util.module_from_spec(spec)
                loader.exec_module(module)
                return Firmware(module.ffi, module.lib)
    raise SimulationError(f"no module {name} in {target}")
