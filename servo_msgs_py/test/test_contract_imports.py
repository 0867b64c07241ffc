"""The contract imports neither rclpy nor processes, sockets or signals; only its package `runtime` does."""

from __future__ import annotations

import ast
import pkgutil
import subprocess
import sys
from pathlib import Path

import servo_msgs_py

FORBIDDEN = {"rclpy", "subprocess", "multiprocessing", "signal", "socket", "threading", "serial"}
"""Modules, and `servo_msgs_py.runtime`, that no module of the contract imports."""

MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(servo_msgs_py.__path__, "servo_msgs_py.")
    if not module.name.startswith("servo_msgs_py.runtime")
)


def _imports(module: str) -> set[str]:
    """All modules that `module` imports at any place."""
    path = Path(servo_msgs_py.__path__[0]).parent.joinpath(*module.split("."))
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    found: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def test_no_module_of_the_contract_names_rclpy_processes_or_the_runtime_package() -> None:
    assert len(MODULES) > 40
    wrong = {
        (module, name)
        for module in MODULES
        for name in _imports(module)
        if name.split(".")[0] in FORBIDDEN or name.startswith("servo_msgs_py.runtime")
    }
    assert not wrong


def test_every_module_of_the_contract_is_imported_without_rclpy() -> None:
    code = (
        "import importlib, sys; sys.modules['rclpy'] = None; [importlib.import_module(name) for name in sys.argv[1:]]"
    )
    subprocess.run([sys.executable, "-c", code, *MODULES], check=True)
