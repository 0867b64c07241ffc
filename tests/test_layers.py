"""Which package imports which: the contract and the pure cores know neither shells nor what is built on them."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHELLS = {"rclpy", "subprocess", "multiprocessing", "signal", "socket", "threading", "serial"}

RULES = {
    "servo_msgs_py/servo_msgs_py": SHELLS
    | {"servo_msgs_py.runtime", "servo_tuning", "servo_measurement", "servo_bridge", "servo_twin"},
    "servo_msgs_py/servo_tuning": SHELLS | {"servo_msgs_py.runtime", "servo_measurement", "servo_bridge", "servo_twin"},
    "servo_msgs_py/servo_measurement": SHELLS | {"servo_msgs_py.runtime", "servo_bridge", "servo_twin"},
    "servo_bridge/servo_bridge/freemaster": {"rclpy", "servo_msgs_py", "servo_tuning", "servo_measurement"},
    "servo_bridge/servo_bridge": {"servo_twin"},
    "servo_twin/servo_twin": {"servo_bridge", "servo_twin.validation"},
}
"""Modules that no module of a folder imports; the rule of a subfolder is in addition."""

EXEMPT = {
    "servo_msgs_py/servo_msgs_py/runtime": SHELLS | {"servo_msgs_py.runtime"},
    "servo_twin/servo_twin/validation": {"servo_twin.validation"},
    "servo_twin/servo_twin/cli.py": {"servo_twin.validation"},  # lists the commands of both
}


def _imports(source: Path) -> set[str]:
    """All modules that a file imports at any place."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def _within(module: str, packages: set[str]) -> bool:
    return any(f"{module}.".startswith(f"{package}.") for package in packages)


@pytest.mark.parametrize("folder", RULES)
def test_no_module_imports_what_its_layer_does_not_know(folder: str) -> None:
    sources = sorted((ROOT / folder).rglob("*.py"))
    assert len(sources) > 15
    wrong = {
        (str(source.relative_to(ROOT)), module)
        for source in sources
        for module in _imports(source)
        if _within(module, RULES[folder])
        and not any((ROOT / place) in (source, *source.parents) and _within(module, EXEMPT[place]) for place in EXEMPT)
    }
    assert not wrong


def test_every_module_of_the_contract_is_imported_without_rclpy() -> None:
    names = [
        ".".join(source.relative_to(ROOT / "servo_msgs_py").with_suffix("").parts)
        for package in ("servo_msgs_py", "servo_tuning", "servo_measurement")
        for source in sorted((ROOT / "servo_msgs_py" / package).rglob("[!_]*.py"))
        if "runtime" not in source.parts
    ]
    assert len(names) > 60
    code = (
        "import importlib, sys; sys.modules['rclpy'] = None; [importlib.import_module(name) for name in sys.argv[1:]]"
    )
    subprocess.run([sys.executable, "-c", code, *names], check=True)
